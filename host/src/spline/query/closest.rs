//! The closest point of a surface: certified, by branch and bound.
//!
//! A first Newton run from the nearest middle of a piece gives a bound that few pieces' boxes come under. Such a piece is
//! done with as soon as one of these holds: its control points lie beyond a plane at the bound; the squared distance
//! is convex on it ([`super::cell`]), so that a descent within it finds its closest point or stops at a tangent plane above the
//! bound. What is left is halved, breadth first, until nothing is. The answer says what that proved:
//! [`ClosestPoint::gap`].

use super::super::surface::Surface;
use super::cell::{Bend, Cell};
use super::descent::descend;
use super::tree::{SurfaceTree, box_distance2};
use crate::Vec3;
use rayon::prelude::*;
use std::collections::VecDeque;

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
    /// How far the point would slide in its tangent plane to come closest to the query point, held by the patch's edges,
    /// in the unit of the surface: 0 at a foot point and at a point of a border or crease that nothing beside it undercuts.
    pub residual: f64,
    /// No point of the surface is closer than `distance - gap`: 1e-12 of the sizes involved at most, except beside a place
    /// from which a whole stretch of the surface is equally far (the middle of a sphere), where halving is given up.
    pub gap: f64,
}

/// What is certified, relative to the size of the surface and the distance.
const CERTIFIED: f64 = 1e-12;
/// Parts halved per query before it is given up: some milliseconds.
const HALVINGS: usize = 2000;
/// Halvings of a part in which its own foot point is sought whatever its distance.
const SOUGHT: u32 = 2;

/// One query under way.
struct Search<'a> {
    surface: &'a Surface,
    target: Vec3,
    tolerance: f64,
    best: Best,
    /// Squared distance below which a part is of interest: the best distance less the tolerance.
    enough2: f64,
    /// Least squared distance that what was put aside may have.
    floor2: f64,
}

struct Best {
    face: u32,
    barycentric: [f64; 3],
    point: Vec3,
    distance2: f64,
    residual: f64,
}

impl Search<'_> {
    /// Descends on the whole patch from a place on it.
    fn seek(&mut self, face: u32, start: [f64; 3]) {
        let points = &self.surface.control_points[face as usize];
        let foot = descend(points, start, &self.target, 0.0);
        self.take(Best {
            face,
            barycentric: foot.at,
            point: foot.point,
            distance2: foot.distance2,
            residual: foot.residual,
        });
    }

    fn take(&mut self, found: Best) {
        // Equal distances: the lower patch, whatever the order of the search.
        let order = found.distance2.total_cmp(&self.best.distance2);
        if order.then(found.face.cmp(&self.best.face)).is_lt() {
            self.best = found;
            let certain = (self.best.distance2.sqrt() - self.tolerance).max(0.0);
            self.enough2 = certain * certain;
        }
    }

    /// Whether nothing of interest below this squared distance is left; what is put aside by it is kept in mind.
    fn done(&mut self, least2: f64) -> bool {
        let done = least2 >= self.enough2;
        if done {
            self.floor2 = self.floor2.min(least2);
        }
        done
    }

    /// Whether a part is done with, its closest point found if it matters. If not: what it does not undercut. `bend` is
    /// worked out where it is not known.
    fn settle(&mut self, cell: &Cell, bend: Option<&Bend>, least2: f64) -> Option<f64> {
        let least2 = least2.max(cell.beyond(&self.target));
        if self.done(least2) {
            return None;
        }
        let convex = match bend {
            Some(bend) => bend.convex(cell, &self.target),
            None => Bend::new(cell).convex(cell, &self.target),
        };
        if !convex {
            return Some(least2);
        }
        let start = if cell.face == self.best.face {
            cell.local(self.best.barycentric)
        } else {
            [1.0 / 3.0; 3]
        };
        let foot = descend(&cell.points, start, &self.target, self.enough2);
        if foot.distance2 < self.best.distance2 {
            // In the patch's own coordinates, to the last digit.
            self.seek(cell.face, cell.of_patch(foot.at));
        }
        (!self.done(foot.least2.max(least2))).then_some(least2)
    }
}

impl SurfaceTree {
    /// The closest point of `surface` (the one the tree was built on); `None` without patches or for a point that
    /// is not finite.
    pub fn closest(&self, surface: &Surface, point: &Vec3) -> Option<ClosestPoint> {
        if self.nodes.is_empty() || !point.iter().all(|x| x.is_finite()) {
            return None;
        }
        // First the nearest middle of a piece: from there one run of Newton's method gives a bound that leaves few others.
        let mut nearest = (f64::INFINITY, 0);
        self.visit(point, f64::INFINITY, |number| {
            let distance2 = (self.pieces[number].cell.place - point).norm_squared();
            if distance2 < nearest.0 {
                nearest = (distance2, number);
            }
            nearest.0
        });
        let first = &self.pieces[nearest.1];
        let (low, high) = self.bounding_box()?;
        let mut search = Search {
            surface,
            target: *point,
            tolerance: CERTIFIED
                * ((high - low).norm() + low.abs().max() + high.abs().max() + nearest.0.sqrt()),
            best: Best {
                face: u32::MAX,
                barycentric: [1.0 / 3.0; 3],
                point: first.cell.place,
                distance2: f64::INFINITY,
                residual: f64::INFINITY,
            },
            enough2: f64::INFINITY,
            floor2: f64::INFINITY,
        };
        search.seek(first.cell.face, first.middle);
        let mut open: VecDeque<(f64, u32, Cell)> = VecDeque::new();
        self.visit(point, search.enough2, |number| {
            let piece = &self.pieces[number];
            let least2 = box_distance2(&piece.low, &piece.high, point);
            if let Some(least2) = search.settle(&piece.cell, Some(&piece.bend), least2) {
                search.seek(piece.cell.face, piece.middle);
                open.push_back((least2, 0, piece.cell.clone()));
            }
            search.enough2
        });
        let mut halvings = 0;
        while let Some((least2, depth, cell)) = open.pop_front() {
            if search.done(least2) {
                continue;
            }
            if halvings == HALVINGS {
                search.floor2 = search.floor2.min(least2);
                continue;
            }
            halvings += 1;
            for half in cell.halves() {
                let Some(least2) = search.settle(&half, None, least2) else {
                    continue;
                };
                let near = (half.place - point).norm_squared() < search.best.distance2;
                if near || depth < SOUGHT {
                    search.seek(half.face, half.of_patch([1.0 / 3.0; 3]));
                }
                open.push_back((least2, depth + 1, half));
            }
        }
        let best = search.best;
        let distance = best.distance2.sqrt();
        let gap = (distance - search.floor2.sqrt()).max(search.tolerance);
        Some(ClosestPoint {
            face: best.face,
            barycentric: best.barycentric,
            point: best.point,
            distance,
            residual: best.residual,
            gap: gap.min(distance),
        })
    }

    /// Hands over every piece whose box is within a squared distance of a point; `see` returns the new bound.
    fn visit(&self, point: &Vec3, bound: f64, mut see: impl FnMut(usize) -> f64) {
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
                    bound = see(number);
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
                assert!(found.residual < 1e-8 * size, "{found:?}");
                assert!(found.gap < 1e-11 * size, "{found:?}");
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

    #[test]
    fn where_much_of_the_surface_is_as_far_the_answer_says_what_is_certain() {
        // The axis and the core of a torus, the middle of a nearly round body, beside it.
        for (surface, queries) in [
            (
                shapes::torus(),
                [Vec3::zeros(), Vec3::new(0.0, 1.0, 0.0), Vec3::z() * 0.5],
            ),
            (
                shapes::lumpy_sphere(),
                [Vec3::zeros(), Vec3::x() * 0.02, Vec3::y() * 0.1],
            ),
        ] {
            let tree = SurfaceTree::new(&surface);
            let sampled = surface.sample_per_patch(24).unwrap();
            for query in queries {
                let found = tree.closest(&surface, &query).unwrap();
                let nearest = sampled
                    .positions
                    .iter()
                    .map(|p| (p - query).norm())
                    .fold(f64::INFINITY, f64::min);
                assert!(found.distance <= nearest + 1e-12, "{found:?} {nearest}");
                assert!(found.gap < 1e-3 && found.gap > 0.0, "{found:?}");
            }
        }
    }

    #[test]
    fn points_on_the_surface_are_their_own_closest_points() {
        let surface = shapes::torus();
        let tree = SurfaceTree::new(&surface);
        for face in 0..surface.faces.len() {
            let point = surface.point(face, [0.25, 0.35, 0.4]);
            let found = tree.closest(&surface, &point).unwrap();
            assert!(
                found.distance < 1e-14 && found.gap <= found.distance,
                "{found:?}"
            );
        }
    }
}
