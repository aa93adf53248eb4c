//! Sampling to a chord tolerance.
//!
//! A triangle whose corners lie on a patch at the corners of a right triangle with legs 1/n in (u, v) is
//! nowhere farther from it than (M_uu + 2 M_uv + M_vv) / (8 n^2), the M being bounds of the second derivatives
//! (Filip, Magedson, Markot 1986); the control points of the derivatives bound them (convex hull property).

use super::super::bernstein::{CONTROL_POINTS, EXPONENTS, index};
use super::super::edges::{Edge, EdgeTable};
use super::super::surface::Surface;
use crate::Vec3;

/// Strips between a fine edge and the inner rows have triangles with legs up to this many steps long.
const STRIP: f64 = 1.5;

impl Surface {
    /// Segments of every edge with which no triangle is farther than `tolerance` from the surface.
    pub(in super::super) fn segments_by_chord(
        &self,
        table: &EdgeTable,
        tolerance: f64,
    ) -> Vec<f64> {
        let wanted = |face: u32| {
            let bend = bend(&self.control_points[face as usize]);
            STRIP * (bend / (8.0 * tolerance)).sqrt()
        };
        let of_edge = |edge: &Edge| {
            let faces = edge.sides.iter().flatten();
            faces.map(|s| wanted(s.face)).fold(1.0, f64::max)
        };
        table.edges.iter().map(of_edge).collect()
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
    use crate::spline::Fineness;

    #[test]
    fn triangles_keep_to_the_tolerance_and_flat_patches_stay_whole() {
        let surface = shapes::torus();
        let tree = SurfaceTree::new(&surface);
        for tolerance in [0.02, 0.002] {
            let sampled = surface.sample_to(Fineness::Chord(tolerance)).unwrap();
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
            shapes::cube()
                .sample_to(Fineness::Chord(1e-6))
                .unwrap()
                .triangles
                .len(),
            12
        );
    }
}
