//! Surfaces for the tests of this folder: patches over a triangle mesh, their control points moved by a
//! map of space, the same bits on shared edges.

use crate::Vec3;
use crate::mesh::{TriangleMesh, shapes};
use crate::spline::Surface;
use crate::spline::bernstein::EXPONENTS;

/// The mesh's triangles as patches of degree 5, every control point moved by `warp`.
pub(crate) fn warped(mesh: &TriangleMesh, warp: impl Fn(Vec3) -> Vec3) -> Surface {
    let patch = |face: &[u32; 3]| {
        EXPONENTS.map(|exponents| {
            // Summed by rising vertex number, so both sides of an edge round alike.
            let mut terms: Vec<(u32, u8)> = face.iter().copied().zip(exponents).collect();
            terms.sort_unstable();
            let sum = terms
                .into_iter()
                .filter(|(_, e)| *e > 0)
                .fold(Vec3::zeros(), |sum, (v, e)| {
                    sum + mesh.positions[v as usize] * f64::from(e)
                });
            warp(sum / 5.0)
        })
    };
    let control_points: Vec<_> = mesh.faces.iter().map(patch).collect();
    let mut vertices = mesh.positions.clone();
    for (face, points) in mesh.faces.iter().zip(&control_points) {
        for (corner, number) in [0, 15, 20].into_iter().enumerate() {
            vertices[face[corner] as usize] = points[number];
        }
    }
    Surface {
        vertices,
        faces: mesh.faces.clone(),
        control_points,
        ..Surface::default()
    }
}

/// A lumpy sphere of 80 patches with a sigma per vertex.
pub(crate) fn lumpy_sphere() -> Surface {
    let mut surface = warped(&shapes::icosphere(1), |p| {
        p * (1.1 / p.norm().max(0.5)) + Vec3::new((3.0 * p.y).sin(), (2.0 * p.z).cos(), p.x) * 0.05
    });
    surface.sigma = (0..surface.vertices.len())
        .map(|k| 0.001 * k as f64)
        .collect();
    surface
}

/// A torus of 96 patches.
pub(crate) fn torus() -> Surface {
    warped(&shapes::torus(1.0, 0.4, 8, 6), |p| p * (1.0 + 0.1 * p.x))
}

/// An open sheet, exactly the graph z = x^2 / 5 - x y / 10, so smooth to any order across patches.
pub(crate) fn sheet() -> Surface {
    let mesh = shapes::grid(3, 2);
    let form = |p: &Vec3, q: &Vec3| 0.2 * p.x * q.x - 0.05 * (p.x * q.y + p.y * q.x);
    let mut surface = warped(&mesh, |p| p);
    for (face, points) in surface.faces.iter().zip(&mut surface.control_points) {
        for (point, exponents) in points.iter_mut().zip(EXPONENTS) {
            // Blossom: the mean of the bilinear form over all pairs of the five arguments.
            let mut terms: Vec<(u32, u8)> = face.iter().copied().zip(exponents).collect();
            terms.sort_unstable();
            let squares: f64 = terms
                .iter()
                .filter(|(_, e)| *e > 0)
                .map(|(v, e)| {
                    let corner = &mesh.positions[*v as usize];
                    f64::from(*e) * form(corner, corner)
                })
                .sum();
            point.z = (25.0 * form(point, point) - squares) / 20.0;
        }
        for (corner, number) in [0, 15, 20].into_iter().enumerate() {
            surface.vertices[face[corner] as usize] = points[number];
        }
    }
    surface
}

/// A unit cube of 12 patches with its 12 creases.
pub(crate) fn cube() -> Surface {
    let positions = (0..8u32)
        .map(|k| [k & 1, k >> 1 & 1, k >> 2])
        .map(|c| Vec3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2])));
    let quads = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let mesh = TriangleMesh {
        positions: positions.collect(),
        faces: quads
            .iter()
            .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
            .collect(),
    };
    let mut surface = warped(&mesh, |p| p);
    for a in 0..8u32 {
        for bit in [1, 2, 4] {
            if a & bit == 0 {
                surface.creases.push([a, a | bit]);
            }
        }
    }
    surface.creases.sort_unstable();
    surface
}
