//! Sampling to a chord tolerance.
//!
//! A triangle whose corners lie on a patch at the corners of a right triangle with legs 1/n in (u, v) is
//! nowhere farther from it than (M_uu + 2 M_uv + M_vv) / (8 n^2), the M being bounds of the second derivatives
//! (Filip, Magedson, Markot 1986); the control points of the derivatives bound them (convex hull property).

use super::super::bernstein::{CONTROL_POINTS, EXPONENTS, index};
use super::super::sampling::{MAX_SEGMENTS, SampledSurface};
use super::super::surface::{Surface, SurfaceError};
use crate::Vec3;

/// Strips between a fine edge and the inner rows have triangles with legs up to this many steps long.
const STRIP: f64 = 1.5;

impl Surface {
    /// Samples so that no triangle is farther than `tolerance` from the surface, each patch only as finely as it
    /// needs; at most [`MAX_SEGMENTS`] segments an edge.
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn sample_chord(&self, tolerance: f64) -> Result<SampledSurface, SurfaceError> {
        let table = self.check()?;
        let of_face: Vec<usize> = self
            .control_points
            .iter()
            .map(|points| {
                let wanted = STRIP * (bend(points) / (8.0 * tolerance)).sqrt();
                if wanted.is_finite() {
                    (wanted.ceil() as usize).clamp(1, MAX_SEGMENTS)
                } else {
                    MAX_SEGMENTS
                }
            })
            .collect();
        let of_edge: Vec<usize> = table
            .edges
            .iter()
            .map(|edge| {
                let faces = edge.sides.iter().flatten();
                faces.map(|s| of_face[s.face as usize]).max().unwrap_or(1)
            })
            .collect();
        Ok(self.sample_edges(&table, &of_edge))
    }
}

/// Bound of |S_uu| + 2 |S_uv| + |S_vv|.
fn bend(points: &[Vec3; CONTROL_POINTS]) -> f64 {
    let mut most = [0.0_f64; 3];
    for [i, j, k] in EXPONENTS {
        if i < 2 {
            continue;
        }
        let at = |u: u8, v: u8| points[index([i - u - v, j + u, k + v])];
        let second = [
            at(2, 0) - at(1, 0) * 2.0 + at(0, 0),
            at(1, 1) - at(1, 0) - at(0, 1) + at(0, 0),
            at(0, 2) - at(0, 1) * 2.0 + at(0, 0),
        ];
        for (most, second) in most.iter_mut().zip(second) {
            *most = most.max(20.0 * second.norm());
        }
    }
    most[0] + 2.0 * most[1] + most[2]
}

#[cfg(test)]
mod tests {
    use super::super::SurfaceTree;
    use crate::export::shapes;

    #[test]
    fn triangles_keep_to_the_tolerance_and_flat_patches_stay_whole() {
        let surface = shapes::torus();
        let tree = SurfaceTree::new(&surface);
        for tolerance in [0.02, 0.002] {
            let sampled = surface.sample_chord(tolerance).unwrap();
            let mut worst = 0.0_f64;
            for corners in sampled.triangles.iter().step_by(7) {
                let [a, b, c] = corners.map(|v| sampled.positions[v as usize]);
                for at in [
                    (a + b + c) / 3.0,
                    (a + b) / 2.0,
                    (b + c) / 2.0,
                    (c + a) / 2.0,
                ] {
                    worst = worst.max(tree.closest(&surface, &at).unwrap().distance);
                }
            }
            assert!(worst <= tolerance, "{worst} {tolerance}");
            // Not many times finer than asked for, either.
            assert!(worst > 0.05 * tolerance, "{worst} {tolerance}");
        }
        assert_eq!(
            shapes::cube().sample_chord(1e-6).unwrap().triangles.len(),
            12
        );
    }
}
