//! Charts for tests.

use super::super::simplex::{KnotNet, TriangularBSpline, Vec2};
use super::{Chart, knot_clouds};
use crate::Vec3;

/// A wavy saddle over 32 triangles, its region a quadrilateral in the middle; no polynomial.
pub(crate) fn saddle(degree: usize) -> Chart {
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for row in 0..5_u32 {
        for column in 0..5_u32 {
            vertices.push(Vec2::new(
                f64::from(column) + 0.5 * f64::from(row),
                0.9 * f64::from(row),
            ));
            if row < 4 && column < 4 {
                let corner = row * 5 + column;
                triangles.push([corner, corner + 1, corner + 5]);
                triangles.push([corner + 1, corner + 6, corner + 5]);
            }
        }
    }
    let (clouds, _) = knot_clouds(degree, &vertices, &triangles).expect("vertices are there");
    let net = KnotNet::new(degree, &clouds, triangles).expect("clouds are small");
    let control = net
        .greville_points()
        .iter()
        .map(|u| {
            Vec3::new(
                u.x,
                u.y,
                0.2 * u.x * u.y - 0.1 * u.y * u.y + 0.1 * (3.0 * u.x).sin(),
            )
        })
        .collect();
    let spline = TriangularBSpline::new(net, control).expect("one per function");
    let border = vec![
        Vec2::new(2.1, 1.0),
        Vec2::new(3.5, 1.1),
        Vec2::new(3.9, 2.4),
        Vec2::new(2.9, 2.5),
    ];
    Chart::new(spline, border, vec![0.25; 25]).expect("the region is covered")
}
