//! Writes a finished surface: meshes for viewers and printers, STEP for CAD, and the surface file that loses
//! nothing.
//!
//! | file | holds | module |
//! |---|---|---|
//! | `.json` | the surface itself, exactly, with where it came from | [`surface_file`] |
//! | `.ply` | triangles, normals, sigma | [`ply`] |
//! | `.obj` | triangles, normals (one per side at creases) | [`obj`] |
//! | `.stl` | triangles | [`stl`] |
//! | `.glb` | triangles, normals, sigma as attribute and colour | [`glb`] |
//! | `.step` | the surface itself, exactly, as faces of a solid or shell | [`step`] |
//!
//! Promised for all: the same surface gives the same bytes; points on shared edges are the same in every
//! triangle that uses them, to the last bit, so a closed surface is a closed mesh.

pub mod chart_file;
mod colour;
pub mod glb;
pub mod obj;
pub mod ply;
#[cfg(test)]
pub(crate) mod shapes;
pub mod step;
pub mod stl;
pub mod surface_file;
mod weld;

use crate::Vec3;
use crate::mesh::TriangleMesh;
use crate::spline::{SampledSurface, SurfaceError};
use std::fs;
use std::path::Path;

pub use surface_file::{Origin, SurfaceFile, SurfaceFileError};

/// Why something cannot be written, and what to do next.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The file cannot be written.
    #[error("{file}: cannot be written ({source}); check that the folder exists and has room")]
    Write {
        /// File.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// No mesh format has this extension.
    #[error("{file}: no mesh format has this extension; use .ply, .obj, .stl or .glb")]
    Extension {
        /// File.
        file: String,
    },
    /// The chart cannot be cut into pieces.
    #[error(transparent)]
    Chart(#[from] crate::spline::chart::ChartError),
    /// The surface is damaged.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The mesh would take too much memory.
    #[error(
        "{file}: {triangles:.1e} triangles would take about {needed:.1e} bytes, more than the {limit} allowed: sample more coarsely, with at most {most:.1e} triangles, or allow more memory"
    )]
    TooMuchMemory {
        /// File.
        file: String,
        /// How many triangles were asked for.
        triangles: f64,
        /// Bytes they would take.
        needed: f64,
        /// Bytes allowed.
        limit: usize,
        /// Triangles that these are enough for.
        most: f64,
    },
    /// More than the format can count.
    #[error("{file}: {what} are more than {format} can hold; sample more coarsely")]
    TooLarge {
        /// File, or what is being written.
        file: String,
        /// What there is too much of.
        what: String,
        /// The format.
        format: &'static str,
    },
}

/// Bytes per triangle that sampling a network and writing it take, everything counted; measured at 146 (GLB) to 230 (OBJ),
/// and 22 more with curvature.
const BYTES_PER_TRIANGLE: f64 = 260.0;
/// The same for a chart, whose triangles are cut along its border; measured at 470.
const CHART_BYTES_PER_TRIANGLE: f64 = 600.0;

/// Refuses a mesh whose making would take more than `limit` bytes, before any are taken.
///
/// # Errors
/// [`ExportError::TooMuchMemory`], with how many triangles there is room for.
pub fn check_memory(
    path: &Path,
    triangles: f64,
    of_chart: bool,
    limit: usize,
) -> Result<(), ExportError> {
    let each = if of_chart {
        CHART_BYTES_PER_TRIANGLE
    } else {
        BYTES_PER_TRIANGLE
    };
    if triangles * each <= limit as f64 {
        return Ok(());
    }
    Err(ExportError::TooMuchMemory {
        file: path.display().to_string(),
        triangles,
        needed: triangles * each,
        limit,
        most: limit as f64 / each,
    })
}

/// A format for triangle meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Binary PLY.
    Ply,
    /// Wavefront OBJ.
    Obj,
    /// Binary STL.
    Stl,
    /// Binary glTF 2.0.
    Glb,
}

impl MeshFormat {
    /// The format that a file's extension asks for.
    ///
    /// # Errors
    /// An extension of no known format.
    pub fn of(path: &Path) -> Result<Self, ExportError> {
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("ply") => Ok(Self::Ply),
            Some("obj") => Ok(Self::Obj),
            Some("stl") => Ok(Self::Stl),
            Some("glb") => Ok(Self::Glb),
            _ => Err(ExportError::Extension {
                file: path.display().to_string(),
            }),
        }
    }

    /// The file's content in this format.
    ///
    /// # Errors
    /// A mesh too large for the format.
    pub fn encode(self, sampled: &SampledSurface) -> Result<Vec<u8>, ExportError> {
        match self {
            Self::Ply => Ok(ply::encode(sampled)),
            Self::Obj => Ok(obj::encode(sampled)),
            Self::Stl => stl::encode(sampled),
            Self::Glb => glb::encode(sampled),
        }
    }
}

/// Writes sampled triangles in the format that the extension asks for.
///
/// # Errors
/// An unknown extension, a mesh too large for the format, or a file that cannot be written.
pub fn write_mesh(path: &Path, sampled: &SampledSurface) -> Result<(), ExportError> {
    write_bytes(path, &MeshFormat::of(path)?.encode(sampled)?)
}

/// Writes a whole file.
///
/// # Errors
/// A file that cannot be written.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    fs::write(path, bytes).map_err(|source| ExportError::Write {
        file: path.display().to_string(),
        source,
    })
}

/// A plain mesh (of the first two phases) in the form that [`write_mesh`] takes, with normals from its
/// triangles.
pub fn sampled_from_mesh(mesh: &TriangleMesh) -> SampledSurface {
    let unit = |n: Vec3| if n == Vec3::zeros() { Vec3::z() } else { n };
    SampledSurface {
        positions: mesh.positions.clone(),
        normals: mesh.vertex_normals().into_iter().map(unit).collect(),
        triangles: mesh.faces.clone(),
        ..SampledSurface::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::{Fineness, Surface};

    fn word(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    fn float(bytes: &[u8], at: usize) -> f32 {
        f32::from_bits(word(bytes, at))
    }

    fn all() -> [Surface; 4] {
        [
            shapes::lumpy_sphere(),
            shapes::torus(),
            shapes::sheet(),
            shapes::cube(),
        ]
    }

    #[test]
    fn curvature_is_a_property_and_a_colour() {
        let surface = shapes::torus();
        let mut sampled = surface.sample_per_patch(3).unwrap();
        let plain = ply::encode(&sampled);
        surface.add_curvature(&mut sampled);
        let bytes = ply::encode(&sampled);
        let text = String::from_utf8_lossy(&bytes);
        let header = text.split("end_header").next().unwrap();
        assert!(header.contains("float mean_curvature") && header.contains("uchar blue"));
        assert_eq!(
            bytes.len() - plain.len(),
            11 * sampled.positions.len() + header.len()
                - String::from_utf8_lossy(&plain)
                    .split("end_header")
                    .next()
                    .unwrap()
                    .len()
        );
        let glb = glb::encode(&sampled).unwrap();
        let text = String::from_utf8_lossy(&glb);
        for name in ["_MEAN_CURVATURE", "_GAUSS_CURVATURE", "COLOR_0"] {
            assert!(text.contains(name), "{name}");
        }
        let shares = colour::curvature_shares(&sampled);
        for (number, (face, at)) in sampled.parameters.iter().enumerate() {
            let [mean, gauss] = surface.curvature(*face as usize, *at).unwrap();
            let [found_mean, found_gauss] = sampled.curvature[number];
            assert!((found_mean - mean).abs() < 1e-9 && (found_gauss - gauss).abs() < 1e-8);
            // Orange where it bends outwards.
            let [red, _, blue] = colour::srgb(shares[number]);
            assert!((mean > 0.0) == (shares[number] > 0.5));
            assert!(mean.abs() < 0.1 || (red > blue) == (mean > 0.0));
        }
    }

    #[test]
    fn stl_is_watertight_after_joining_equal_vertices() {
        for (surface, closed, euler) in [
            (shapes::lumpy_sphere(), true, 2),
            (shapes::torus(), true, 0),
            (shapes::cube(), true, 2),
            (shapes::sheet(), false, 1),
        ] {
            let sampled = surface.sample_per_patch(4).unwrap();
            let bytes = stl::encode(&sampled).unwrap();
            let count = word(&bytes, 80) as usize;
            assert_eq!(
                (count, bytes.len()),
                (sampled.triangles.len(), 84 + 50 * count)
            );
            let mut seen = std::collections::BTreeMap::new();
            let mut mesh = TriangleMesh::default();
            for triangle in 0..count {
                let corner = |k: usize| 84 + 50 * triangle + 12 + 12 * k;
                mesh.faces.push([0, 1, 2].map(|k| {
                    let at = corner(k);
                    let next = seen.len() as u32;
                    let bits = [0, 4, 8].map(|o| word(&bytes, at + o));
                    *seen.entry(bits).or_insert_with(|| {
                        let [x, y, z] = bits.map(|b| f64::from(f32::from_bits(b)));
                        mesh.positions.push(Vec3::new(x, y, z));
                        next
                    })
                }));
                let normal = Vec3::from_fn(|k, _| float(&bytes, 84 + 50 * triangle + 4 * k).into());
                let face = mesh.face_normal(triangle as u32);
                assert!((normal - face).norm() < 1e-6);
            }
            let topology = crate::mesh::topology(&mesh);
            assert!(topology.is_manifold());
            assert_eq!(
                (topology.border_edges == 0, topology.euler),
                (closed, euler)
            );
        }
    }

    #[test]
    fn obj_keeps_one_position_and_one_normal_per_side() {
        let sampled = shapes::cube().sample_per_patch(3).unwrap();
        let text = String::from_utf8(obj::encode(&sampled)).unwrap();
        let count = |start: &str| text.lines().filter(|l| l.starts_with(start)).count();
        // 8 corners, 18 edges (12 and a diagonal per side) with 2 points, 12 faces with 1 inside.
        assert_eq!((count("v "), count("f ")), (8 + 36 + 12, 12 * 9));
        assert_eq!(count("vn "), sampled.normals.len());
        assert!(count("vn ") > count("v "));
        for line in text.lines().filter(|l| l.starts_with("f ")) {
            for corner in line[2..].split(' ') {
                let (v, n) = corner.split_once("//").unwrap();
                assert!(v.parse::<usize>().unwrap() <= count("v "));
                assert!(n.parse::<usize>().unwrap() <= count("vn "));
            }
        }
    }

    #[test]
    fn glb_is_laid_out_as_its_header_says() {
        for surface in all() {
            let sampled = surface.sample_per_patch(3).unwrap();
            let bytes = glb::encode(&sampled).unwrap();
            assert_eq!((&bytes[..4], word(&bytes, 4)), (&b"glTF"[..], 2));
            assert_eq!(word(&bytes, 8) as usize, bytes.len());
            let json = word(&bytes, 12) as usize;
            let binary = word(&bytes, 20 + json) as usize;
            assert_eq!(28 + json + binary, bytes.len());
            let document: serde_json::Value =
                serde_json::from_slice(&bytes[20..20 + json]).unwrap();
            let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
            assert_eq!(
                attributes.get("_SIGMA").is_some(),
                !surface.sigma.is_empty()
            );
            assert_eq!(
                attributes.get("COLOR_0").is_some(),
                !surface.sigma.is_empty()
            );
            let mut end = 0;
            for view in document["bufferViews"].as_array().unwrap() {
                assert_eq!(view["byteOffset"], end);
                end += view["byteLength"].as_u64().unwrap() as usize;
            }
            assert_eq!(end, binary);
            for (k, normal) in sampled.normals.iter().enumerate() {
                let at = 28 + json + 12 * (sampled.positions.len() + k);
                let read = Vec3::from_fn(|axis, _| float(&bytes, at + 4 * axis).into());
                assert!((read - normal).norm() < 1e-6);
            }
        }
        glb::encode(&SampledSurface::default()).unwrap();
    }

    #[test]
    fn a_mesh_too_large_for_the_memory_is_refused_before_it_is_made() {
        let surface = shapes::torus();
        for fineness in [
            Fineness::Step(1e-30),
            Fineness::Chord(1e-30),
            Fineness::Segments(1_000_000),
        ] {
            let triangles = surface.triangles_at(fineness).unwrap();
            let error = check_memory(Path::new("m.stl"), triangles, false, 2 << 30).unwrap_err();
            let text = error.to_string();
            assert!(
                text.starts_with("m.stl: ") && text.contains("at most 8.3e6 triangles"),
                "{text}"
            );
        }
        // What is said beforehand is what is made.
        for fineness in [
            Fineness::Step(0.2),
            Fineness::Chord(0.01),
            Fineness::Segments(9),
        ] {
            let told = surface.triangles_at(fineness).unwrap();
            let made = surface.sample_to(fineness).unwrap().triangles.len() as f64;
            assert!(
                (0.5..1.5).contains(&(told / made)),
                "{fineness:?}: {told} of {made}"
            );
        }
    }

    #[test]
    fn the_same_surface_gives_the_same_bytes() {
        for surface in all() {
            let sampled = surface.sample_to(Fineness::Step(0.2)).unwrap();
            for format in [
                MeshFormat::Ply,
                MeshFormat::Obj,
                MeshFormat::Stl,
                MeshFormat::Glb,
            ] {
                let (a, b) = (
                    format.encode(&sampled).unwrap(),
                    format.encode(&sampled.clone()).unwrap(),
                );
                assert_eq!(a, b);
            }
        }
    }

    #[test]
    fn files_are_written_by_extension() {
        let folder = tempfile::tempdir().unwrap();
        let sampled = shapes::cube().sample_per_patch(1).unwrap();
        for name in ["a.ply", "a.OBJ", "a.stl", "a.glb"] {
            write_mesh(&folder.path().join(name), &sampled).unwrap();
            assert!(folder.path().join(name).metadata().unwrap().len() > 500);
        }
        let unknown = write_mesh(&folder.path().join("a.off"), &sampled).unwrap_err();
        assert!(unknown.to_string().contains("use .ply, .obj, .stl or .glb"));
        let nowhere = write_mesh(&folder.path().join("no/a.ply"), &sampled).unwrap_err();
        assert!(nowhere.to_string().contains("check that the folder exists"));
    }
}
