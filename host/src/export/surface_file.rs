//! The surface file `SURFACE.json`: everything about a surface, exactly, in a form any program can read.
//!
//! # Layout, version 1
//! One JSON object. Numbers are written with as many digits as it takes to read the same `f64` back, so
//! writing and reading loses nothing; the same surface gives the same bytes.
//!
//! | key | value |
//! |---|---|
//! | `format` | `"palpus-surface"` |
//! | `format_version` | 1 (2 for charts: [`super::chart_file`]). Readers refuse versions they do not know; keys they do not know they pass over |
//! | `generator` | program and version |
//! | `units` | unit of all lengths (`"mm"`), or `null` where the input did not say |
//! | `degree` | 5 |
//! | `exponents` | `[[i, j, k], …]`: barycentric exponents of the control points, in the order in which every face lists them; i belongs to the face's first vertex |
//! | `vertices` | `[[x, y, z], …]`: corner points |
//! | `sigma` | one standard deviation of the position per vertex; absent if unknown |
//! | `faces` | `[{"vertices": [a, b, c], "control_points": [[x, y, z], …]}, …]`, counter-clockwise seen from outside; faces that share an edge hold the same control points there |
//! | `knots` | never written in version 1: every face is a triangular B-spline with clamped knots (all knots of a vertex pulled together), which is a Bézier triangle. A face with a key `knots` is refused |
//! | `creases` | `[[a, b], …]`: edges across which only the position is continuous |
//! | `borders` | `[[a, b], …]`: edges with one face; for information, readers find them from the faces |
//! | `provenance` | `inputs`: name, bytes and SHA-256 of each input; `options`: what was asked for |
//! | `error` | error summary, keys as `error` of the report; absent if unknown |
//!
//! A point of a face at barycentric coordinates (b0, b1, b2) is the sum over its control points of
//! 5!/(i! j! k!) b0^i b1^j b2^k times the control point, or de Casteljau's algorithm:
//!
//! ```python
//! import json
//! import numpy as np
//!
//! surface = json.load(open("SURFACE.json"))
//! exponents = [tuple(e) for e in surface["exponents"]]
//!
//! def point(face, b):
//!     """Point and unit normal of a face at barycentric coordinates b, by de Casteljau."""
//!     c = dict(zip(exponents, np.array(surface["faces"][face]["control_points"])))
//!     for degree in range(surface["degree"], 0, -1):
//!         corners = [c[degree, 0, 0], c[0, degree, 0], c[0, 0, degree]]
//!         last = c if degree == 1 else None
//!         c = {(i, j, degree - 1 - i - j): b[0] * c[i + 1, j, degree - 1 - i - j]
//!                                         + b[1] * c[i, j + 1, degree - 1 - i - j]
//!                                         + b[2] * c[i, j, degree - i - j]
//!              for i in range(degree) for j in range(degree - i)}
//!     p0, p1, p2 = corners
//!     normal = np.cross(p1 - p0, p2 - p0)
//!     return c[0, 0, 0], normal / np.linalg.norm(normal)
//!
//! print(point(0, (1 / 3, 1 / 3, 1 / 3)))
//! ```

use super::chart_file::{self, CHART_VERSION, ChartDocument};
use crate::Vec3;
use crate::report::ErrorFigures;
use crate::spline::bernstein::{CONTROL_POINTS, DEGREE, EXPONENTS};
use crate::spline::chart::{Chart, ChartError};
use crate::spline::{Surface, SurfaceError};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;

/// Name of the format, under key `format`.
pub const FORMAT: &str = "palpus-surface";
/// Version of the layout that is written and read.
pub const FORMAT_VERSION: u64 = 1;

/// An input that a surface was made from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origin {
    /// File name, without its folder.
    pub name: String,
    /// Size of the file.
    pub bytes: u64,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
}

impl Origin {
    /// Name, size and hash of a file.
    ///
    /// # Errors
    /// Those of reading the file.
    pub fn of_file(path: &Path) -> io::Result<Self> {
        let name = path.file_name().unwrap_or(path.as_os_str());
        Ok(Self::of_bytes(&name.to_string_lossy(), &fs::read(path)?))
    }

    /// Size and hash of the content of a file.
    pub fn of_bytes(name: &str, bytes: &[u8]) -> Self {
        let hash = Sha256::digest(bytes);
        Self {
            name: name.to_owned(),
            bytes: bytes.len() as u64,
            sha256: hash.iter().map(|byte| format!("{byte:02x}")).collect(),
        }
    }
}

/// Where a surface came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Inputs in the order they were given.
    #[serde(default)]
    pub inputs: Vec<Origin>,
    /// Options by name, as they were used.
    #[serde(default)]
    pub options: BTreeMap<String, Value>,
}

/// A surface with all that its file says about it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceFile {
    /// The surface; of a chart its Bézier pieces when it was read, and not looked at when it is written.
    pub surface: Surface,
    /// The chart, if it is one (layout version 2, [`super::chart_file`]).
    pub chart: Option<Chart>,
    /// Unit of all lengths, where known.
    pub units: Option<String>,
    /// Where it came from.
    pub provenance: Provenance,
    /// Its error summary, where known.
    pub error: Option<ErrorFigures>,
}

/// Why a surface file cannot be read, and what to do next.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceFileError {
    /// The file cannot be opened or read.
    #[error("{file}: cannot be read ({source}); check the path and the permissions")]
    Open {
        /// File.
        file: String,
        /// What the system says.
        source: io::Error,
    },
    /// The file is no surface file.
    #[error("{file}: is no surface file ({found}); give a file that `palpus reconstruct` wrote")]
    Format {
        /// File.
        file: String,
        /// What stands there instead.
        found: String,
    },
    /// The file is of a version that is not known.
    #[error(
        "{file}: has format version {found}, this program reads {FORMAT_VERSION} and {CHART_VERSION}; use the program that wrote it or write it again"
    )]
    Version {
        /// File.
        file: String,
        /// Version found.
        found: String,
    },
    /// The JSON is damaged or of another layout.
    #[error("{file}: line {line}, column {column}: {message}; copy or write the file again")]
    Json {
        /// File.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong there.
        message: String,
    },
    /// A value that cannot stand where it stands.
    #[error("{file}: {place} is {found}, has to be {expected}; copy or write the file again")]
    Value {
        /// File.
        file: String,
        /// Key, with the number of the face where there is one.
        place: String,
        /// Value found.
        found: String,
        /// What would be right.
        expected: String,
    },
    /// The parts do not form a chart.
    #[error("{file}: {error}")]
    Chart {
        /// File.
        file: String,
        /// What is wrong.
        error: ChartError,
    },
    /// The parts do not form a surface.
    #[error("{file}: {error}")]
    Surface {
        /// File.
        file: String,
        /// What is wrong.
        error: SurfaceError,
    },
}

#[derive(Deserialize)]
struct Document {
    degree: usize,
    exponents: Vec<[u8; 3]>,
    #[serde(default)]
    units: Option<String>,
    vertices: Vec<[f64; 3]>,
    #[serde(default)]
    sigma: Vec<f64>,
    faces: Vec<Face>,
    #[serde(default)]
    creases: Vec<[u32; 2]>,
    #[serde(default)]
    provenance: Provenance,
    #[serde(default)]
    error: Option<ErrorFigures>,
}

#[derive(Deserialize)]
struct Face {
    vertices: [u32; 3],
    control_points: Vec<[f64; 3]>,
    #[serde(default)]
    knots: Option<Value>,
}

impl SurfaceFile {
    /// Reads a surface file.
    ///
    /// # Errors
    /// See [`SurfaceFileError`]; every message names the file and the place.
    pub fn read(path: &Path) -> Result<Self, SurfaceFileError> {
        let file = path.display().to_string();
        match fs::read(path) {
            Ok(bytes) => Self::from_bytes(&file, &bytes),
            Err(source) => Err(SurfaceFileError::Open { file, source }),
        }
    }

    /// Reads the content of a surface file; `name` stands in messages.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self, SurfaceFileError> {
        #[derive(Deserialize)]
        struct Head {
            format: Option<Value>,
            format_version: Option<Value>,
        }
        let file = || name.to_owned();
        let json = |error: serde_json::Error| {
            let (line, column) = (error.line(), error.column());
            let text = error.to_string();
            // The message repeats the place at its end.
            let message = text.split(" at line ").next().unwrap_or(&text).to_owned();
            SurfaceFileError::Json {
                file: file(),
                line,
                column,
                message,
            }
        };
        if !bytes.trim_ascii_start().starts_with(b"{") {
            let found = match crate::ply::shown(bytes.get(..20).unwrap_or(bytes)) {
                text if text.is_empty() => "it is empty".to_owned(),
                text => format!("begins with `{text}`"),
            };
            return Err(SurfaceFileError::Format {
                file: file(),
                found,
            });
        }
        let head: Head = serde_json::from_slice(bytes).map_err(json)?;
        if head.format.as_ref().and_then(Value::as_str) != Some(FORMAT) {
            let found = head
                .format
                .map_or("no key `format`".into(), |f| format!("format {f}"));
            return Err(SurfaceFileError::Format {
                file: file(),
                found,
            });
        }
        let version = head.format_version.as_ref().and_then(Value::as_u64);
        if version == Some(CHART_VERSION) {
            let document: ChartDocument = serde_json::from_slice(bytes).map_err(json)?;
            return document.into_file(name);
        }
        if version != Some(FORMAT_VERSION) {
            let found = head.format_version.map_or("none".into(), |v| v.to_string());
            return Err(SurfaceFileError::Version {
                file: file(),
                found,
            });
        }
        let document: Document = serde_json::from_slice(bytes).map_err(json)?;
        document.into_file(name)
    }

    /// The file's content.
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn to_bytes(&self) -> Result<Vec<u8>, SurfaceError> {
        let mut entries: Vec<(&str, String)> = Vec::new();
        let (head, body) = match &self.chart {
            Some(chart) => (chart_file::head(), chart_file::entries(chart)),
            None => (
                [
                    ("format", text(&FORMAT)),
                    ("format_version", text(&FORMAT_VERSION)),
                ],
                self.network()?,
            ),
        };
        entries.extend(head);
        entries.push((
            "generator",
            text(&concat!("palpus ", env!("CARGO_PKG_VERSION"))),
        ));
        entries.push(("units", text(&self.units)));
        entries.extend(body);
        // JSON has no NaN; figures that are none are left out.
        let finite = |e: &&ErrorFigures| {
            [e.tolerance, e.sum, e.abs_sum, e.rms, e.max]
                .iter()
                .all(|x| x.is_finite())
        };
        if let Some(error) = self.error.as_ref().filter(finite) {
            entries.push(("error", text(error)));
        }
        entries.push(("provenance", text(&self.provenance)));
        let lines: Vec<String> = entries
            .iter()
            .map(|(key, value)| format!("\"{key}\": {value}"))
            .collect();
        Ok(format!("{{\n{}\n}}\n", lines.join(",\n")).into_bytes())
    }

    /// The entries of a network between `units` and `error`.
    fn network(&self) -> Result<Vec<(&'static str, String)>, SurfaceError> {
        let table = self.surface.check()?;
        let surface = &self.surface;
        let borders: Vec<[u32; 2]> = table
            .edges
            .iter()
            .filter(|e| e.is_border())
            .map(|e| e.vertices)
            .collect();
        let faces = surface
            .faces
            .iter()
            .zip(&surface.control_points)
            .map(|(face, points)| {
                let points: Vec<[f64; 3]> = points.iter().map(|p| [p.x, p.y, p.z]).collect();
                format!(
                    "{{\"vertices\": {}, \"control_points\": {}}}",
                    text(face),
                    text(&points)
                )
            });
        let mut out = vec![
            ("degree", text(&DEGREE)),
            ("exponents", text(&EXPONENTS)),
            (
                "vertices",
                rows(surface.vertices.iter().map(|v| text(&[v.x, v.y, v.z]))),
            ),
        ];
        if !surface.sigma.is_empty() {
            out.push(("sigma", text(&surface.sigma)));
        }
        out.push(("faces", rows(faces)));
        out.push(("creases", text(&surface.creases)));
        out.push(("borders", text(&borders)));
        Ok(out)
    }

    /// Writes the file.
    ///
    /// # Errors
    /// A surface that is no valid network, or a file that cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), super::ExportError> {
        super::write_bytes(path, &self.to_bytes()?)
    }
}

impl Document {
    fn into_file(self, name: &str) -> Result<SurfaceFile, SurfaceFileError> {
        let wrong = |place: &str, found: String, expected: &str| SurfaceFileError::Value {
            file: name.to_owned(),
            place: place.to_owned(),
            found,
            expected: expected.to_owned(),
        };
        if self.degree != DEGREE {
            return Err(wrong("degree", self.degree.to_string(), "5"));
        }
        // Control points may be listed in any order that `exponents` states.
        let mut place_of = [usize::MAX; CONTROL_POINTS];
        for (place, exponents) in self.exponents.iter().enumerate() {
            if let Some(number) = EXPONENTS.iter().position(|e| e == exponents) {
                place_of[number] = place;
            }
        }
        if self.exponents.len() != CONTROL_POINTS || place_of.contains(&usize::MAX) {
            return Err(wrong(
                "exponents",
                format!("{} triples", self.exponents.len()),
                "the 21 triples with sum 5, each once",
            ));
        }
        let vector = |p: [f64; 3]| Vec3::new(p[0], p[1], p[2]);
        let mut control_points = Vec::with_capacity(self.faces.len());
        for (number, face) in self.faces.iter().enumerate() {
            if let Some(knots) = &face.knots {
                return Err(wrong(
                    &format!("knots of face {number}"),
                    crate::ply::shown(knots.to_string().as_bytes()),
                    "absent: only clamped patches are read",
                ));
            }
            if face.control_points.len() != CONTROL_POINTS {
                return Err(wrong(
                    &format!("control_points of face {number}"),
                    format!("{} points", face.control_points.len()),
                    "21 points",
                ));
            }
            control_points.push(place_of.map(|place| vector(face.control_points[place])));
        }
        let surface = Surface {
            vertices: self.vertices.into_iter().map(vector).collect(),
            faces: self.faces.iter().map(|face| face.vertices).collect(),
            control_points,
            creases: self.creases,
            sigma: self.sigma,
        };
        let table = surface.check().map_err(|error| SurfaceFileError::Surface {
            file: name.to_owned(),
            error,
        })?;
        for crease in &surface.creases {
            if crease[0] >= crease[1] || table.find(crease[0], crease[1]).is_none() {
                return Err(wrong(
                    "creases",
                    format!("{crease:?}"),
                    "edges as [lower, higher] vertex",
                ));
            }
        }
        if let Some(sigma) = surface
            .sigma
            .iter()
            .find(|s| !(**s >= 0.0 && s.is_finite()))
        {
            return Err(wrong("sigma", sigma.to_string(), "numbers from 0"));
        }
        let (low, high) = surface.bounding_box().unwrap_or_default();
        let close = 1e-9 * (high - low).norm();
        for (number, (face, points)) in surface
            .faces
            .iter()
            .zip(&surface.control_points)
            .enumerate()
        {
            for (corner, point) in [points[0], points[15], points[20]].iter().enumerate() {
                let vertex = surface.vertices.get(face[corner] as usize);
                if vertex.is_none_or(|v| (v - point).norm() > close) {
                    return Err(wrong(
                        &format!("corner {corner} of face {number}"),
                        format!("{:?}", [point.x, point.y, point.z]),
                        "at the vertex it names",
                    ));
                }
            }
        }
        Ok(SurfaceFile {
            surface,
            chart: None,
            units: self.units,
            provenance: self.provenance,
            error: self.error,
        })
    }
}

/// JSON of a value that always serialises: numbers, strings, lists and structs of them.
pub(super) fn text(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// A list with one entry per line.
pub(super) fn rows(entries: impl Iterator<Item = String>) -> String {
    let entries: Vec<String> = entries.collect();
    format!("[\n{}\n]", entries.join(",\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shapes;
    use proptest::prelude::*;

    fn file(surface: Surface) -> SurfaceFile {
        let options = [("lambda", 0.1.into()), ("seed", 7.into())];
        SurfaceFile {
            surface,
            chart: None,
            units: Some("mm".into()),
            provenance: Provenance {
                inputs: vec![Origin::of_bytes("a.ply", b"abc")],
                options: options
                    .map(|(k, v): (&str, Value)| (k.to_owned(), v))
                    .into(),
            },
            error: Some(ErrorFigures {
                rms: 0.1 + 0.2,
                ..Default::default()
            }),
        }
    }

    #[test]
    fn reading_gives_back_every_bit() {
        for surface in [
            shapes::lumpy_sphere(),
            shapes::torus(),
            shapes::sheet(),
            shapes::cube(),
        ] {
            let written = file(surface);
            let bytes = written.to_bytes().unwrap();
            let read = SurfaceFile::from_bytes("s.json", &bytes).unwrap();
            assert_eq!(read, written);
            let bits = |file: &SurfaceFile| -> Vec<u64> {
                let points = file.surface.control_points.iter().flatten();
                points
                    .flat_map(|p| [p.x, p.y, p.z])
                    .map(f64::to_bits)
                    .collect()
            };
            assert_eq!(bits(&read), bits(&written));
            assert_eq!(read.to_bytes().unwrap(), bytes);
        }
    }

    #[test]
    fn inputs_are_named_by_their_hash() {
        let origin = Origin::of_bytes("a.ply", b"abc");
        assert_eq!(origin.bytes, 3);
        assert_eq!(
            origin.sha256,
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }

    #[test]
    fn borders_and_any_order_of_control_points() {
        let bytes = file(shapes::sheet()).to_bytes().unwrap();
        let mut value: Value = serde_json::from_slice(&bytes).unwrap();
        assert!(!value["borders"].as_array().unwrap().is_empty());
        let mut swap = |at: &str| {
            value
                .pointer_mut(at)
                .unwrap()
                .as_array_mut()
                .unwrap()
                .reverse()
        };
        swap("/exponents");
        for face in 0..shapes::sheet().faces.len() {
            swap(&format!("/faces/{face}/control_points"));
        }
        let read = SurfaceFile::from_bytes("s.json", value.to_string().as_bytes()).unwrap();
        assert_eq!(read.surface, shapes::sheet());
    }

    #[test]
    fn damage_is_named() {
        let good = String::from_utf8(file(shapes::cube()).to_bytes().unwrap()).unwrap();
        let change = |from: &str, to: &str| {
            assert!(good.contains(from), "{from}");
            good.replacen(from, to, 1)
        };
        let mut lost: Value = serde_json::from_str(&good).unwrap();
        lost["faces"][3]["control_points"]
            .as_array_mut()
            .unwrap()
            .pop();
        let mut moved: Value = serde_json::from_str(&good).unwrap();
        moved["faces"][3]["control_points"][1][0] = 9.5.into();
        let cases = [
            (String::new(), "it is empty"),
            ("ply\nformat".into(), "begins with `ply"),
            ("{}".into(), "no key `format`"),
            (change("palpus-surface", "other"), "format \"other\""),
            (
                change("\"format_version\": 1", "\"format_version\": 3"),
                "format version 3",
            ),
            (good[..good.len() / 2].to_owned(), "line "),
            (
                change("\"degree\": 5", "\"degree\": 4"),
                "degree is 4, has to be 5",
            ),
            (change("[5,0,0]", "[4,0,0]"), "exponents is 21 triples"),
            (
                change("\"vertices\": [0,2,3]", "\"vertices\": [0,2,33]"),
                "33",
            ),
            (
                change("\"vertices\": [0,2,3]", "\"vertices\": [0,2,-3]"),
                "line ",
            ),
            (
                change("\"creases\": [[0,1]", "\"creases\": [[1,0]"),
                "creases is [1, 0]",
            ),
            (
                change(
                    "{\"vertices\": [0,2,3]",
                    "{\"knots\": [], \"vertices\": [0,2,3]",
                ),
                "knots of face 0",
            ),
            (lost.to_string(), "control_points of face 3 is 20 points"),
            (
                moved.to_string(),
                "share an edge but not its control points",
            ),
        ];
        for (text, part) in cases {
            let error = SurfaceFile::from_bytes("s.json", text.as_bytes())
                .unwrap_err()
                .to_string();
            assert!(
                error.starts_with("s.json: ") && error.contains(part),
                "{part}: {error}"
            );
        }
    }

    proptest! {
        #[test]
        fn no_damaged_byte_panics(place in any::<prop::sample::Index>(), byte in any::<u8>()) {
            let mut bytes = file(shapes::cube()).to_bytes().unwrap();
            let place = place.index(bytes.len());
            bytes[place] = byte;
            let _ = SurfaceFile::from_bytes("s.json", &bytes);
        }
    }
}
