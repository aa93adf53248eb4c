//! Block and cylinder: solids with sharp edges, in closed form.

use super::Foot;
use crate::Vec3;
use crate::mesh::TriangleMesh;
use std::f64::consts::TAU;

/// A solid with sharp edges, centred at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sharp {
    /// Cube of side 2 `half_mm`.
    Block { half_mm: f64 },
    /// Cylinder about the z axis.
    Cylinder { radius_mm: f64, half_height_mm: f64 },
}

/// Segments of the truth mesh around a cylinder: chords of a circle of 45 mm are then within 0.01 mm of it.
const AROUND: u32 = 256;
/// Squares along an edge of the block's truth mesh.
const ALONG: u32 = 24;

impl Sharp {
    pub(super) fn bounding_box_mm(&self) -> (Vec3, Vec3) {
        let high = match *self {
            Self::Block { half_mm } => Vec3::repeat(half_mm),
            Self::Cylinder {
                radius_mm,
                half_height_mm,
            } => Vec3::new(radius_mm, radius_mm, half_height_mm),
        };
        (-high, high)
    }

    pub(super) fn foot(&self, point: &Vec3) -> Foot {
        match *self {
            Self::Block { half_mm } => {
                let clamped = point.map(|v| v.clamp(-half_mm, half_mm));
                // The face nearest to an inner point; the first of equally near ones.
                let axis = (0..3).fold(0, |best, k| {
                    if point[k].abs() > point[best].abs() {
                        k
                    } else {
                        best
                    }
                });
                let face_normal = Vec3::ith(axis, 1f64.copysign(point[axis]));
                finish(point, clamped, face_normal, half_mm - point[axis].abs())
            }
            Self::Cylinder {
                radius_mm,
                half_height_mm,
            } => {
                let rho = point.x.hypot(point.y);
                let radial = if rho > 0.0 {
                    Vec3::new(point.x / rho, point.y / rho, 0.0)
                } else {
                    Vec3::x()
                };
                let z = point.z.clamp(-half_height_mm, half_height_mm);
                let clamped = radial * rho.min(radius_mm) + Vec3::z() * z;
                let (to_side, to_end) = (radius_mm - rho, half_height_mm - point.z.abs());
                if to_side <= to_end {
                    finish(point, clamped, radial, to_side)
                } else {
                    finish(point, clamped, Vec3::z() * 1f64.copysign(point.z), to_end)
                }
            }
        }
    }

    pub(super) fn mesh(&self) -> TriangleMesh {
        match *self {
            Self::Block { half_mm } => block_mesh(half_mm),
            Self::Cylinder {
                radius_mm,
                half_height_mm,
            } => cylinder_mesh(radius_mm, half_height_mm),
        }
    }
}

/// The foot, given the point clamped to the solid, and for a point inside the nearest face's normal and depth.
fn finish(point: &Vec3, clamped: Vec3, face_normal: Vec3, depth: f64) -> Foot {
    let out = point - clamped;
    let distance = out.norm();
    if depth <= 0.0 && distance > 0.0 {
        Foot {
            position_mm: clamped,
            normal: out / distance,
            distance_mm: distance,
        }
    } else {
        Foot {
            position_mm: point + face_normal * depth,
            normal: face_normal,
            distance_mm: -depth,
        }
    }
}

fn block_mesh(half: f64) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut welded = std::collections::BTreeMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for top in [0, ALONG] {
            let mut vertex = |i: u32, j: u32| {
                let mut grid = [0; 3];
                (grid[axis], grid[u], grid[v]) = (top, i, j);
                *welded.entry(grid).or_insert_with(|| {
                    mesh.positions.push(Vec3::from(
                        grid.map(|g| half * (2.0 * f64::from(g) / f64::from(ALONG) - 1.0)),
                    ));
                    mesh.positions.len() as u32 - 1
                })
            };
            for i in 0..ALONG {
                for j in 0..ALONG {
                    let quad =
                        [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| vertex(i, j));
                    let [a, b, c, d] = if top == 0 {
                        [quad[0], quad[3], quad[2], quad[1]]
                    } else {
                        quad
                    };
                    mesh.faces.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
    }
    mesh
}

fn cylinder_mesh(radius: f64, half_height: f64) -> TriangleMesh {
    // Rings from the middle of the bottom, up the side, to the middle of the top.
    let mut rings: Vec<(f64, f64)> = Vec::new();
    let steps = 16;
    for k in 1..=steps {
        rings.push((radius * f64::from(k) / f64::from(steps), -half_height));
    }
    for k in 1..=2 * steps {
        rings.push((
            radius,
            half_height * (f64::from(k) / f64::from(steps) - 1.0),
        ));
    }
    for k in (1..steps).rev() {
        rings.push((radius * f64::from(k) / f64::from(steps), half_height));
    }
    let mut mesh = TriangleMesh::default();
    mesh.positions.push(Vec3::z() * -half_height);
    for &(rho, z) in &rings {
        for k in 0..AROUND {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(AROUND)).sin_cos();
            mesh.positions.push(Vec3::new(rho * cos, rho * sin, z));
        }
    }
    let last = mesh.positions.len() as u32;
    mesh.positions.push(Vec3::z() * half_height);
    let at = |ring: u32, k: u32| 1 + ring * AROUND + k % AROUND;
    for k in 0..AROUND {
        mesh.faces.push([0, at(0, k + 1), at(0, k)]);
        for ring in 0..rings.len() as u32 - 1 {
            let (a, b) = (at(ring, k), at(ring, k + 1));
            let (c, d) = (at(ring + 1, k + 1), at(ring + 1, k));
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
        let top = rings.len() as u32 - 1;
        mesh.faces.push([at(top, k), at(top, k + 1), last]);
    }
    mesh
}
