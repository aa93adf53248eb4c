//! Questions to a finished surface: closest point, ray, volume, area, chord-tolerant sampling.
//!
//! | file | answers |
//! |---|---|
//! | `tree` | where pieces of patches lie: boxes around their control points, which hold them (convex hull property) |
//! | `cell` | a part of a patch: on which side of a plane it lies, where the distance from a point is convex on it, its halves |
//! | `descent` | Newton's method on the distance within a patch's triangle |
//! | `closest` | the closest point, certified |
//! | `ray` | where a ray meets the surface first |
//! | `mass` | volume, exact; area to a stated accuracy |
//! | `chord` | how finely to sample for a given chord error |
//!
//! Points, derivatives, normals and curvatures at given parameters are methods of [`Surface`] itself and of
//! [`crate::spline::chart::Chart`]; a chart's other questions go to the network of its Bézier pieces
//! ([`crate::spline::chart::Chart::pieces`]), which is the same surface.

mod cell;
mod chord;
mod closest;
mod descent;
mod mass;
mod ray;
mod tree;

pub use closest::ClosestPoint;
pub use ray::SurfaceHit;
pub use tree::SurfaceTree;

use super::bernstein::CONTROL_POINTS;
use super::local_shape::LocalShape;
use super::surface::{Surface, lower};
use crate::Vec3;

/// Point and derivatives of a patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchJet {
    /// The point.
    pub point: Vec3,
    /// Derivatives by u and v (see [`super::bernstein`]).
    pub first: [Vec3; 2],
    /// Derivatives by uu, uv and vv.
    pub second: [Vec3; 3],
}

/// Point and derivatives to second order by one run of de Casteljau's algorithm: a fifth of the cost of six sums over the
/// control points.
pub fn patch_jet(control_points: &[Vec3; CONTROL_POINTS], barycentric: [f64; 3]) -> PatchJet {
    let mut points = *control_points;
    let mut front = |degree: usize| {
        lower(&mut points, degree, barycentric);
        [0, 1, 2, 3, 4, 5].map(|k| points[k])
    };
    front(4);
    front(3);
    let q = front(2);
    let l = front(1);
    let [point, ..] = front(0);
    PatchJet {
        point,
        first: [(l[1] - l[0]) * 5.0, (l[2] - l[0]) * 5.0],
        second: [
            (q[3] - q[1] * 2.0 + q[0]) * 20.0,
            (q[4] - q[1] - q[2] + q[0]) * 20.0,
            (q[5] - q[2] * 2.0 + q[0]) * 20.0,
        ],
    }
}

impl Surface {
    /// Normal and curvatures of patch `face`; `None` where it is not regular.
    ///
    /// # Panics
    /// If `face` is no patch of this surface.
    pub fn local_shape(&self, face: usize, barycentric: [f64; 3]) -> Option<LocalShape> {
        let jet = patch_jet(&self.control_points[face], barycentric);
        LocalShape::new(jet.first, jet.second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shapes;

    #[test]
    fn one_run_gives_what_the_sums_give() {
        let surface = shapes::torus();
        for face in [0, 7] {
            for at in [[0.2, 0.3, 0.5], [1.0, 0.0, 0.0], [0.0, 0.4, 0.6]] {
                let jet = patch_jet(&surface.control_points[face], at);
                assert!((jet.point - surface.point(face, at)).norm() < 1e-14);
                for (found, wanted) in jet.first.iter().zip(surface.first_derivatives(face, at)) {
                    assert!((found - wanted).norm() < 1e-13);
                }
                for (found, wanted) in jet.second.iter().zip(surface.second_derivatives(face, at)) {
                    assert!((found - wanted).norm() < 1e-12);
                }
                let shape = surface.local_shape(face, at).unwrap();
                let [mean, gauss] = surface.curvature(face, at).unwrap();
                assert!((shape.mean - mean).abs() < 1e-11 && (shape.gauss - gauss).abs() < 1e-11);
            }
        }
    }
}
