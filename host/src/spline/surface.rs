//! The finished surface: a network of triangular B-spline patches with clamped knots.
//!
//! Each face of a triangulated base mesh carries one patch of degree 5; neighbours share the control
//! points of their common edge. Everything that reads a surface (export, pictures, evaluation, planning)
//! starts from [`Surface`].

use super::bernstein::{CONTROL_POINTS, DEGREE, SECOND, edge_index, exponents, index, values};
use super::edges::{EdgeError, EdgeTable};
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

/// Why a surface is no valid network.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// The faces are no proper triangulation.
    #[error(transparent)]
    Edges(#[from] EdgeError),
    /// Lists of different lengths.
    #[error("{what}: {found} entries, {wanted} needed; the surface is damaged, write it again")]
    Count {
        /// Which list.
        what: &'static str,
        /// Entries found.
        found: usize,
        /// Entries needed.
        wanted: usize,
    },
    /// A coordinate that is not finite.
    #[error(
        "control point {number} of patch {patch} is not finite; the surface is damaged, write it again"
    )]
    NotFinite {
        /// The patch.
        patch: usize,
        /// The control point.
        number: usize,
    },
    /// Two patches that share an edge disagree about its control points.
    #[error(
        "patches {0} and {1} share an edge but not its control points; the surface is damaged, write it again"
    )]
    Gap(u32, u32),
}

impl Surface {
    /// Degree of every patch.
    pub const DEGREE: usize = DEGREE;

    /// Checks that lists fit together, numbers are finite and shared edges have shared control points.
    ///
    /// # Errors
    /// The first thing found wrong.
    pub fn check(&self) -> Result<EdgeTable, SurfaceError> {
        let table = EdgeTable::new(self.vertices.len(), &self.faces)?;
        let same = |what, found, wanted| {
            if found == wanted {
                Ok(())
            } else {
                Err(SurfaceError::Count {
                    what,
                    found,
                    wanted,
                })
            }
        };
        same(
            "control points",
            self.control_points.len(),
            self.faces.len(),
        )?;
        if !self.sigma.is_empty() {
            same("sigma", self.sigma.len(), self.vertices.len())?;
        }
        for (patch, points) in self.control_points.iter().enumerate() {
            if let Some(number) = points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
                return Err(SurfaceError::NotFinite { patch, number });
            }
        }
        for edge in &table.edges {
            let Some([p, q]) = edge.both() else { continue };
            for along in 0..=DEGREE {
                let mine = &self.control_points[p.face as usize]
                    [edge_index(usize::from(p.local), 0, along)];
                let theirs = &self.control_points[q.face as usize]
                    [edge_index(usize::from(q.local), 0, DEGREE - along)];
                if mine != theirs {
                    return Err(SurfaceError::Gap(p.face, q.face));
                }
            }
        }
        Ok(table)
    }

    /// Point of patch `face` at barycentric coordinates (sum 1), by de Casteljau's algorithm.
    ///
    /// # Panics
    /// If `face` is no patch of this surface.
    pub fn point(&self, face: usize, barycentric: [f64; 3]) -> Vec3 {
        casteljau(&self.control_points[face], barycentric)
    }

    /// First derivatives of patch `face` by u and v (see [`super::bernstein`]).
    ///
    /// # Panics
    /// If `face` is no patch of this surface.
    pub fn first_derivatives(&self, face: usize, barycentric: [f64; 3]) -> [Vec3; 2] {
        let points = &self.control_points[face];
        point_and_tangents(points, barycentric).1
    }

    /// Second derivatives of patch `face` by uu, uv and vv.
    ///
    /// # Panics
    /// If `face` is no patch of this surface.
    pub fn second_derivatives(&self, face: usize, barycentric: [f64; 3]) -> [Vec3; 3] {
        let points = &self.control_points[face];
        [0, 1, 2].map(|d| combine(points, &SECOND[d].weights(barycentric)))
    }

    /// Outward unit normal of patch `face`; the patch's plane normal where both tangents vanish.
    ///
    /// # Panics
    /// If `face` is no patch of this surface.
    pub fn normal(&self, face: usize, barycentric: [f64; 3]) -> Vec3 {
        let [du, dv] = self.first_derivatives(face, barycentric);
        let cross = du.cross(&dv);
        let length = cross.norm();
        if length > 1e-14 * du.norm_squared().max(dv.norm_squared()) && length > 0.0 {
            return cross / length;
        }
        let corners = &self.control_points[face];
        let flat = (corners[15] - corners[0]).cross(&(corners[20] - corners[0]));
        flat.try_normalize(0.0).unwrap_or_else(Vec3::z)
    }

    /// Mean (H) and Gaussian (K) curvature of patch `face`, positive H where the surface bends away from
    /// its normal (a sphere of radius r seen from outside: H = 1/r, K = 1/r^2). `None` where the patch is
    /// not regular.
    ///
    /// # Panics
    /// If `face` is no patch of this surface.
    pub fn curvature(&self, face: usize, barycentric: [f64; 3]) -> Option<[f64; 2]> {
        let [du, dv] = self.first_derivatives(face, barycentric);
        let [duu, duv, dvv] = self.second_derivatives(face, barycentric);
        let normal = du.cross(&dv).try_normalize(1e-300)?;
        let (e, f, g) = (du.dot(&du), du.dot(&dv), dv.dot(&dv));
        let (l, m, n) = (duu.dot(&normal), duv.dot(&normal), dvv.dot(&normal));
        let det = e * g - f * f;
        (det > 0.0).then(|| {
            [
                -(e * n - 2.0 * f * m + g * l) / (2.0 * det),
                (l * n - m * m) / det,
            ]
        })
    }

    /// Whether the edge between two vertices is a crease.
    pub fn is_crease(&self, a: u32, b: u32) -> bool {
        let key = [a.min(b), a.max(b)];
        self.creases.contains(&key)
    }

    /// Lowest and highest corner of the control points' bounding box, which holds the whole surface
    /// (convex hull property); `None` without patches.
    pub fn bounding_box(&self) -> Option<(Vec3, Vec3)> {
        let mut points = self.control_points.iter().flatten();
        let first = *points.next()?;
        Some(points.fold((first, first), |(low, high), p| (low.inf(p), high.sup(p))))
    }
}

/// de Casteljau's algorithm on the control points of one patch.
pub fn casteljau(control_points: &[Vec3; CONTROL_POINTS], barycentric: [f64; 3]) -> Vec3 {
    let mut points = *control_points;
    for degree in (0..DEGREE).rev() {
        lower(&mut points, degree, barycentric);
    }
    points[0]
}

/// One step of de Casteljau's algorithm: the points of degree + 1 in front become those of `degree`.
pub(super) fn lower(points: &mut [Vec3; CONTROL_POINTS], degree: usize, barycentric: [f64; 3]) {
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

/// Numbers of the control points with one more of each exponent than each term of degree 4.
const RAISED: [[usize; 3]; 15] = {
    let lower = exponents::<15>(DEGREE as u8 - 1);
    let mut table = [[0; 3]; 15];
    let mut row = 0;
    while row < 15 {
        let [i, j, k] = lower[row];
        table[row] = [
            index([i + 1, j, k]),
            index([i, j + 1, k]),
            index([i, j, k + 1]),
        ];
        row += 1;
    }
    table
};

/// Point of a patch and its derivatives by u and v, from the last step of de Casteljau's algorithm: the three points of
/// degree 1 that it would combine.
pub fn point_and_tangents(
    control_points: &[Vec3; CONTROL_POINTS],
    barycentric: [f64; 3],
) -> (Vec3, [Vec3; 2]) {
    let lower = values::<15>(DEGREE as u8 - 1, barycentric);
    let mut last = [Vec3::zeros(); 3];
    for (weight, raised) in lower.iter().zip(&RAISED) {
        for (point, number) in last.iter_mut().zip(raised) {
            *point += control_points[*number] * *weight;
        }
    }
    let [a, b, c] = last;
    let [s, t, r] = barycentric;
    let degree = DEGREE as f64;
    (a * s + b * t + c * r, [(b - a) * degree, (c - a) * degree])
}

/// Weighted sum of a patch's control points.
pub fn combine(control_points: &[Vec3; CONTROL_POINTS], weights: &[f64; CONTROL_POINTS]) -> Vec3 {
    control_points
        .iter()
        .zip(weights)
        .fold(Vec3::zeros(), |sum, (point, weight)| sum + point * *weight)
}
