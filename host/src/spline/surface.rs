//! The finished surface: a network of triangular B-spline patches with clamped knots.
//!
//! Each face of a triangulated base mesh carries one patch of degree 5; neighbours share the control
//! points of their common edge. Everything that reads a surface (export, pictures, evaluation, planning)
//! starts from [`Surface`].

use super::bernstein::{CONTROL_POINTS, DEGREE};
use crate::Vec3;

/// A network of triangular patches of degree 5, tangent-plane continuous except across creases.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Corner points of the patches, one per vertex of the base mesh.
    pub vertices: Vec<Vec3>,
    /// Three vertex indices per patch, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
    /// 21 control points per patch in the order of [`super::bernstein::EXPONENTS`]; exponents (i, j, k)
    /// belong to the face's vertices 0, 1, 2.
    pub control_points: Vec<[Vec3; CONTROL_POINTS]>,
    /// Edges (lower, higher vertex index) across which only the position is continuous.
    pub creases: Vec<[u32; 2]>,
    /// Standard deviation of the surface's position per vertex, from the data's support; empty if unknown.
    pub sigma: Vec<f64>,
}

/// Points sampled from a surface, joined by triangles without cracks: shared vertices on shared edges.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampledSurface {
    /// Sampled points.
    pub positions: Vec<Vec3>,
    /// Exact unit surface normal per point. Points on a crease stand once per side.
    pub normals: Vec<Vec3>,
    /// Standard deviation per point (linear between the vertices' values); empty if unknown.
    pub sigma: Vec<f64>,
    /// Triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Patch each triangle came from.
    pub patches: Vec<u32>,
}

impl Surface {
    /// Degree of every patch.
    pub const DEGREE: usize = DEGREE;

    /// Point of patch `face` at barycentric coordinates (sum 1), by de Casteljau's algorithm.
    ///
    /// # Panics
    /// If `face` is no patch of this surface.
    pub fn point(&self, face: usize, barycentric: [f64; 3]) -> Vec3 {
        let mut points = self.control_points[face];
        for degree in (0..DEGREE).rev() {
            let mut row = 0;
            for rest in 0..=degree {
                for k in 0..=rest {
                    let first = rest * (rest + 1) / 2 + k;
                    let next = (rest + 1) * (rest + 2) / 2 + k;
                    points[row] = points[first] * barycentric[0]
                        + points[next] * barycentric[1]
                        + points[next + 1] * barycentric[2];
                    row += 1;
                }
            }
        }
        points[0]
    }
}
