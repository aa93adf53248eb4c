//! The surface file of a chart: one triangular B-spline with its knots.
//!
//! # Layout, version 2
//! As version 1 ([`super::surface_file`]) but for:
//!
//! | key | value |
//! |---|---|
//! | `format_version` | 2 |
//! | `degree` | n, 2 to 5 |
//! | `knots` | `[[[x, y], …], …]`: per vertex of the planar triangulation its n + 1 knots, its own place first |
//! | `faces` | `[{"vertices": [a, b, c], "control_points": [[x, y, z], …]}, …]`: the triangulation, counter-clockwise in the plane; control points in the order of `exponents` |
//! | `border` | `[[x, y], …]`: corners of the region, counter-clockwise; the surface is the image of its inside |
//! | `sigma` | one standard deviation per vertex; absent if unknown |
//!
//! A point at u is the sum over all faces (a, b, c) and exponents (i, j, k) of the control point times
//! |d| M(u | knots 0..=i of a, 0..=j of b, 0..=k of c), M the simplex spline and d twice the area of the triangle of
//! the three last knots. `vertices`, `creases` and `borders` are absent: a chart is smooth and has one border.

use super::surface_file::{FORMAT, Provenance, SurfaceFile, SurfaceFileError, rows, text};
use crate::Vec3;
use crate::report::ErrorFigures;
use crate::spline::chart::Chart;
use crate::spline::simplex::{KnotNet, TriangularBSpline, Vec2, exponents};
use serde::Deserialize;

/// Version of the layout of charts.
pub const CHART_VERSION: u64 = 2;

#[derive(Deserialize)]
pub(super) struct ChartDocument {
    degree: usize,
    exponents: Vec<[usize; 3]>,
    #[serde(default)]
    units: Option<String>,
    knots: Vec<Vec<[f64; 2]>>,
    faces: Vec<ChartFace>,
    border: Vec<[f64; 2]>,
    #[serde(default)]
    sigma: Vec<f64>,
    #[serde(default)]
    provenance: Provenance,
    #[serde(default)]
    error: Option<ErrorFigures>,
}

#[derive(Deserialize)]
struct ChartFace {
    vertices: [u32; 3],
    control_points: Vec<[f64; 3]>,
}

/// The entries of the file between `units` and `error`.
pub(super) fn entries(chart: &Chart) -> Vec<(&'static str, String)> {
    let net = chart.spline().net();
    let per = net.functions_per_triangle();
    let plane = |u: &Vec2| [u.x, u.y];
    let exponents: Vec<[usize; 3]> = exponents(net.degree()).collect();
    let knots = (0..net.vertices()).map(|v| {
        let cloud: Vec<[f64; 2]> = net.cloud(v).iter().map(plane).collect();
        text(&cloud)
    });
    let control = chart.spline().control_points();
    let faces = net.triangles().iter().enumerate().map(|(t, face)| {
        let points: Vec<[f64; 3]> = control[t * per..(t + 1) * per]
            .iter()
            .map(|p| [p.x, p.y, p.z])
            .collect();
        format!(
            "{{\"vertices\": {}, \"control_points\": {}}}",
            text(face),
            text(&points)
        )
    });
    let border: Vec<[f64; 2]> = chart.border().iter().map(plane).collect();
    let mut out = vec![
        ("degree", text(&net.degree())),
        ("exponents", text(&exponents)),
        ("knots", rows(knots)),
        ("faces", rows(faces)),
        ("border", text(&border)),
    ];
    if !chart.sigma().is_empty() {
        out.push(("sigma", text(&chart.sigma())));
    }
    out
}

impl ChartDocument {
    pub(super) fn into_file(self, name: &str) -> Result<SurfaceFile, SurfaceFileError> {
        let wrong = |place: &str, found: String, expected: &str| SurfaceFileError::Value {
            file: name.to_owned(),
            place: place.to_owned(),
            found,
            expected: expected.to_owned(),
        };
        let degree = self.degree;
        if !(2..=5).contains(&degree) {
            return Err(wrong("degree", degree.to_string(), "2 to 5"));
        }
        // Control points may be listed in any order that `exponents` states.
        let place_of: Option<Vec<usize>> = exponents(degree)
            .map(|e| self.exponents.iter().position(|other| *other == e))
            .collect();
        let (Some(place_of), true) = (place_of, self.exponents.len() == exponents(degree).count())
        else {
            return Err(wrong(
                "exponents",
                format!("{} triples", self.exponents.len()),
                "the triples whose sum is the degree, each once",
            ));
        };
        let mut control = Vec::new();
        for (number, face) in self.faces.iter().enumerate() {
            if face.control_points.len() != place_of.len() {
                return Err(wrong(
                    &format!("control_points of face {number}"),
                    format!("{} points", face.control_points.len()),
                    &format!("{} points", place_of.len()),
                ));
            }
            control.extend(place_of.iter().map(|p| {
                let [x, y, z] = face.control_points[*p];
                Vec3::new(x, y, z)
            }));
        }
        if let Some(sigma) = self.sigma.iter().find(|s| !(**s >= 0.0 && s.is_finite())) {
            return Err(wrong("sigma", sigma.to_string(), "numbers from 0"));
        }
        let plane = |u: &[f64; 2]| Vec2::new(u[0], u[1]);
        let clouds: Vec<Vec<Vec2>> = self
            .knots
            .iter()
            .map(|cloud| cloud.iter().map(plane).collect())
            .collect();
        let triangles = self.faces.iter().map(|f| f.vertices).collect();
        let border = self.border.iter().map(plane).collect();
        let chart = KnotNet::new(degree, &clouds, triangles)
            .and_then(|net| TriangularBSpline::new(net, control))
            .map_err(Into::into)
            .and_then(|spline| Chart::new(spline, border, self.sigma))
            .and_then(|chart| Ok((chart.pieces()?.surface, chart)));
        let (surface, chart) = chart.map_err(|error| SurfaceFileError::Chart {
            file: name.to_owned(),
            error,
        })?;
        Ok(SurfaceFile {
            surface,
            chart: Some(chart),
            units: self.units,
            provenance: self.provenance,
            error: self.error,
        })
    }
}

/// Name of the format, for the head of the file.
pub(super) fn head() -> [(&'static str, String); 2] {
    [
        ("format", text(&FORMAT)),
        ("format_version", text(&CHART_VERSION)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::chart::shapes::saddle as chart;

    #[test]
    fn a_chart_comes_back_as_it_was() {
        for degree in 2..=5 {
            let chart = chart(degree);
            let file = SurfaceFile {
                chart: Some(chart.clone()),
                units: Some("mm".into()),
                ..SurfaceFile::default()
            };
            let bytes = file.to_bytes().unwrap();
            let back = SurfaceFile::from_bytes("chart.json", &bytes).unwrap();
            let read = back.chart.as_ref().unwrap();
            assert_eq!(
                read.spline().control_points(),
                chart.spline().control_points()
            );
            assert_eq!(back.to_bytes().unwrap(), bytes);
            assert_eq!(back.units.as_deref(), Some("mm"));
            assert!(back.surface.faces.len() > 8);
        }
    }

    #[test]
    fn damaged_charts_are_refused_with_the_place() {
        let file = SurfaceFile {
            chart: Some(chart(3)),
            ..SurfaceFile::default()
        };
        let text = String::from_utf8(file.to_bytes().unwrap()).unwrap();
        for (from, to, place) in [
            ("\"degree\": 3", "\"degree\": 9", "degree is 9"),
            ("[3,0,0]", "[2,0,0]", "exponents"),
            (
                "\"border\": [[2.1,",
                "\"border\": [[-900.0,",
                "leaves the triangulation",
            ),
        ] {
            let damaged = text.replacen(from, to, 1);
            assert_ne!(damaged, text, "{from}");
            let error = SurfaceFile::from_bytes("c.json", damaged.as_bytes())
                .unwrap_err()
                .to_string();
            assert!(error.contains(place) && error.contains("c.json"), "{error}");
        }
    }
}
