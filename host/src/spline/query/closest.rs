//! The closest point of a surface, by boxes and Newton's method.
//!
//! Boxes leave a handful of pieces that could hold it; in each, Newton steps on the squared distance run from the
//! piece's middle, held to the patch's triangle. The answer carries its residual: how far it is from a true foot
//! point. Not guaranteed: that no other point of the same piece is closer, where a piece bends by more than its
//! distance allows a single foot point (points near a centre of curvature).

use super::super::bernstein::CONTROL_POINTS;
use super::super::surface::Surface;
use super::patch_jet;
use super::tree::{Piece, SurfaceTree, box_distance2};
use crate::Vec3;
use rayon::prelude::*;

/// The closest point of a surface to a query point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosestPoint {
    /// The patch.
    pub face: u32,
    /// Barycentric coordinates there.
    pub barycentric: [f64; 3],
    /// The point.
    pub point: Vec3,
    /// Distance from the query point.
    pub distance: f64,
    /// Length of the part of (query point - point) that lies in the tangent plane and does not push against the
    /// border of the patch, in the unit of the surface: 0 at a true foot point.
    pub residual: f64,
}

/// Newton steps; quadratic convergence needs three to six, places near a centre of curvature many more.
const STEPS: usize = 200;

impl SurfaceTree {
    /// The closest point of `surface` (the one the tree was built on); `None` without patches or for a point that
    /// is not finite.
    pub fn closest(&self, surface: &Surface, point: &Vec3) -> Option<ClosestPoint> {
        if self.nodes.is_empty() || !point.iter().all(|x| x.is_finite()) {
            return None;
        }
        // First the nearest middle of a piece: from there one run of Newton's method gives a bound that leaves few others.
        let mut nearest = (f64::INFINITY, 0);
        self.visit(point, f64::INFINITY, |number, piece| {
            let distance = (piece.place - point).norm_squared();
            if distance < nearest.0 {
                nearest = (distance, number);
            }
            nearest.0
        });
        let from = |piece: &Piece| {
            let points = &surface.control_points[piece.face as usize];
            foot(points, piece.face, piece.middle, point)
        };
        let mut best = from(&self.pieces[nearest.1]);
        self.visit(point, best.distance * best.distance, |number, piece| {
            if number != nearest.1 {
                let found = from(piece);
                let as_near = found.distance == best.distance && found.face < best.face;
                if found.distance < best.distance || as_near {
                    best = found;
                }
            }
            best.distance * best.distance
        });
        Some(best)
    }

    /// Hands over every piece whose box is within a squared distance of a point; `see` returns the new bound.
    fn visit(&self, point: &Vec3, bound: f64, mut see: impl FnMut(usize, &Piece) -> f64) {
        let mut bound = bound;
        let reach = |node: u32| {
            let node = &self.nodes[node as usize];
            box_distance2(&node.low, &node.high, point)
        };
        let mut stack = vec![(0u32, reach(0))];
        while let Some((at, distance)) = stack.pop() {
            if distance > bound {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count == 0 {
                let mut children = [(at + 1, reach(at + 1)), (node.link, reach(node.link))];
                if children[0].1 < children[1].1 {
                    children.swap(0, 1);
                }
                stack.extend(children);
                continue;
            }
            let first = node.link as usize;
            for number in first..first + node.count as usize {
                let piece = &self.pieces[number];
                if box_distance2(&piece.low, &piece.high, point) <= bound {
                    bound = see(number, piece);
                }
            }
        }
    }

    /// Closest points to many, in order, in parallel.
    pub fn closest_all(&self, surface: &Surface, points: &[Vec3]) -> Vec<Option<ClosestPoint>> {
        points
            .par_iter()
            .map(|point| self.closest(surface, point))
            .collect()
    }
}

/// Newton's method on half the squared distance over one patch, from a start, held to the triangle.
fn foot(
    points: &[Vec3; CONTROL_POINTS],
    face: u32,
    start: [f64; 3],
    target: &Vec3,
) -> ClosestPoint {
    let mut at = start;
    let mut jet = patch_jet(points, at);
    let mut value = (jet.point - target).norm_squared();
    let mut residual = f64::INFINITY;
    for _ in 0..STEPS {
        let away = jet.point - target;
        let gradient = jet.first.map(|d| d.dot(&away));
        let (a, b, c) = (
            jet.first[0].norm_squared(),
            jet.first[0].dot(&jet.first[1]),
            jet.first[1].norm_squared(),
        );
        let held = held(at, gradient);
        residual = match held {
            Held::Free => {
                let det = (a * c - b * b).max(1e-300);
                let [r, s] = gradient;
                ((c * r * r - 2.0 * b * r * s + a * s * s) / det)
                    .max(0.0)
                    .sqrt()
            }
            Held::Along([du, dv]) => {
                let slope = gradient[0] * du + gradient[1] * dv;
                let length = (a * du * du + 2.0 * b * du * dv + c * dv * dv).sqrt();
                slope.abs() / length.max(1e-300)
            }
            Held::Fixed => 0.0,
        };
        // Rounding in the point itself leaves about this much.
        if residual <= 1e-15 * (1.0 + value.sqrt() + jet.point.norm()) {
            break;
        }
        let h = [
            a + away.dot(&jet.second[0]),
            b + away.dot(&jet.second[1]),
            c + away.dot(&jet.second[2]),
        ];
        let [su, sv] = match held {
            Held::Free => {
                // Where the distance is not convex, Gauss and Newton's form is.
                let det = h[0] * h[2] - h[1] * h[1];
                let [p, q, s, det] = if h[0] > 0.0 && det > 1e-6 * (a * c - b * b) {
                    [h[0], h[1], h[2], det]
                } else {
                    [a, b, c, (a * c - b * b).max(1e-300)]
                };
                [
                    -(s * gradient[0] - q * gradient[1]) / det,
                    -(p * gradient[1] - q * gradient[0]) / det,
                ]
            }
            Held::Along([du, dv]) => {
                let slope = gradient[0] * du + gradient[1] * dv;
                let bend = h[0] * du * du + 2.0 * h[1] * du * dv + h[2] * dv * dv;
                let flat = a * du * du + 2.0 * b * du * dv + c * dv * dv;
                let step = -slope
                    / if bend > 1e-6 * flat {
                        bend
                    } else {
                        flat.max(1e-300)
                    };
                [du * step, dv * step]
            }
            Held::Fixed => break,
        };
        let step = [-su - sv, su, sv];
        // Up to the triangle's border, and shorter while it does not come closer.
        let mut reach = 1.0_f64;
        for m in 0..3 {
            if step[m] < 0.0 {
                reach = reach.min(at[m] / -step[m]);
            }
        }
        let mut share = reach.min(1.0);
        let mut moved = false;
        for _ in 0..12 {
            let mut next: [f64; 3] = std::array::from_fn(|m| (at[m] + step[m] * share).max(0.0));
            for m in 0..3 {
                // What was cut off at the border lies on it.
                if step[m] < 0.0 && share == reach && at[m] <= -step[m] * reach * (1.0 + 1e-12) {
                    next[m] = 0.0;
                }
            }
            let sum: f64 = next.iter().sum();
            let next = next.map(|x| x / sum);
            let trial = patch_jet(points, next);
            let distance = (trial.point - target).norm_squared();
            if distance <= value {
                moved = next != at;
                (at, jet, value) = (next, trial, distance);
                break;
            }
            share *= 0.5;
        }
        if !moved {
            break;
        }
    }
    ClosestPoint {
        face,
        barycentric: at,
        point: jet.point,
        distance: value.sqrt(),
        residual,
    }
}

/// How the triangle's border holds a point against the descent.
enum Held {
    Free,
    /// Only along this direction (in u, v).
    Along([f64; 2]),
    Fixed,
}

fn held(at: [f64; 3], gradient: [f64; 2]) -> Held {
    // The descent in barycentric coordinates: the derivative by coordinate 0 is taken as zero.
    let slope = [0.0, gradient[0], gradient[1]];
    let edges: Vec<usize> = (0..3).filter(|m| at[*m] <= 0.0).collect();
    match edges[..] {
        [] => Held::Free,
        [m] => {
            // Away from the edge, along the mean of the other two.
            let inwards = slope[m] - 0.5 * (slope[(m + 1) % 3] + slope[(m + 2) % 3]);
            if inwards < 0.0 {
                return Held::Free;
            }
            let mut along = [0.0; 3];
            along[(m + 1) % 3] = -1.0;
            along[(m + 2) % 3] = 1.0;
            Held::Along([along[1], along[2]])
        }
        _ => {
            let corner = (0..3).max_by(|a, b| at[*a].total_cmp(&at[*b])).unwrap_or(0);
            let ways = [(corner + 1) % 3, (corner + 2) % 3];
            let open: Vec<usize> = ways
                .into_iter()
                .filter(|m| slope[*m] < slope[corner])
                .collect();
            match open[..] {
                [] => Held::Fixed,
                [m] => {
                    let mut along = [0.0; 3];
                    along[corner] = -1.0;
                    along[m] = 1.0;
                    Held::Along([along[1], along[2]])
                }
                _ => Held::Free,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shapes;

    #[test]
    fn closest_points_are_no_farther_than_any_sample_and_certified() {
        for surface in [
            shapes::torus(),
            shapes::lumpy_sphere(),
            shapes::cube(),
            shapes::sheet(),
        ] {
            let tree = SurfaceTree::new(&surface);
            let (low, high) = tree.bounding_box().unwrap();
            let size = (high - low).norm();
            let sampled = surface.sample_per_patch(12).unwrap();
            let mut state = 3_u64;
            let mut next = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                (state >> 40) as f64 / (1_u64 << 24) as f64
            };
            for _ in 0..200 {
                let query = low
                    + (high - low)
                        .component_mul(&Vec3::new(next(), next(), next()).map(|x| 1.6 * x - 0.3));
                let found = tree.closest(&surface, &query).unwrap();
                assert!(
                    (surface.point(found.face as usize, found.barycentric) - found.point).norm()
                        < 1e-13 * size
                );
                assert!(found.residual < 1e-7 * size, "{found:?}");
                let nearest = sampled
                    .positions
                    .iter()
                    .map(|p| (p - query).norm())
                    .fold(f64::INFINITY, f64::min);
                assert!(
                    found.distance <= nearest + 1e-12 * size,
                    "{found:?} {nearest}"
                );
            }
            assert!(tree.closest(&surface, &Vec3::repeat(f64::NAN)).is_none());
        }
    }
}
