//! Where a ray meets a surface first, by boxes and Newton's method.
//!
//! In every piece whose box the ray crosses, Newton's method solves S(u, v) = origin + t direction from the piece's
//! middle. A ray that touches a piece without crossing it may be missed.

use super::super::bernstein::CONTROL_POINTS;
use super::super::surface::Surface;
use super::patch_jet;
use super::tree::SurfaceTree;
use crate::Vec3;
use nalgebra::Matrix3;

/// A crossing of a ray with a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceHit {
    /// The patch.
    pub face: u32,
    /// Barycentric coordinates there.
    pub barycentric: [f64; 3],
    /// The point.
    pub point: Vec3,
    /// Distance along the ray in lengths of its direction.
    pub distance: f64,
    /// Distance between the point and the ray's, in the unit of the surface.
    pub residual: f64,
}

/// Newton steps.
const STEPS: usize = 16;
/// Barycentric coordinates this much below 0 still belong to the patch; neighbours then leave no gap between them.
const RIM: f64 = 1e-9;

impl SurfaceTree {
    /// The first crossing at a distance in `(from, to)` of the ray from `origin` along `direction`.
    pub fn ray(
        &self,
        surface: &Surface,
        origin: &Vec3,
        direction: &Vec3,
        from: f64,
        to: f64,
    ) -> Option<SurfaceHit> {
        if self.nodes.is_empty() || !origin.iter().chain(direction.iter()).all(|x| x.is_finite()) {
            return None;
        }
        let mut best: Option<SurfaceHit> = None;
        let mut limit = to;
        let mut stack = vec![0u32];
        while let Some(at) = stack.pop() {
            let node = &self.nodes[at as usize];
            if !crosses(&node.low, &node.high, origin, direction, from, limit) {
                continue;
            }
            if node.count == 0 {
                stack.extend([node.link, at + 1]);
                continue;
            }
            let first = node.link as usize;
            for piece in &self.pieces[first..first + node.count as usize] {
                if !crosses(&piece.low, &piece.high, origin, direction, from, limit) {
                    continue;
                }
                let face = piece.cell.face;
                let points = &surface.control_points[face as usize];
                let Some(hit) = meet(points, face, piece.middle, origin, direction) else {
                    continue;
                };
                if hit.distance > from && hit.distance < limit {
                    limit = hit.distance;
                    best = Some(hit);
                }
            }
        }
        best
    }
}

fn meet(
    points: &[Vec3; CONTROL_POINTS],
    face: u32,
    start: [f64; 3],
    origin: &Vec3,
    direction: &Vec3,
) -> Option<SurfaceHit> {
    let (mut u, mut v) = (start[1], start[2]);
    let size = direction.norm();
    let mut t = (patch_jet(points, start).point - origin).dot(direction) / (size * size);
    for _ in 0..STEPS {
        let jet = patch_jet(points, [1.0 - u - v, u, v]);
        let gap = jet.point - (origin + direction * t);
        if gap.norm() <= 4.0 * f64::EPSILON * (jet.point.norm() + origin.norm() + t.abs() * size) {
            break;
        }
        let step =
            Matrix3::from_columns(&[jet.first[0], jet.first[1], -direction]).try_inverse()? * gap;
        // A step longer than the patch has lost its way; it is shortened once.
        let longest = step.x.abs().max(step.y.abs());
        let share = if longest > 0.5 { 0.5 / longest } else { 1.0 };
        u -= step.x * share;
        v -= step.y * share;
        t -= step.z * share;
    }
    let barycentric = [1.0 - u - v, u, v];
    if barycentric.iter().any(|b| !(-RIM..=1.0 + RIM).contains(b)) {
        return None;
    }
    let point = patch_jet(points, barycentric).point;
    let residual = (point - (origin + direction * t)).norm();
    (residual <= 1e-9 * (point.norm() + origin.norm() + t.abs() * size)).then_some(SurfaceHit {
        face,
        barycentric,
        point,
        distance: t,
        residual,
    })
}

/// Whether a ray crosses a box within a range.
fn crosses(low: &Vec3, high: &Vec3, origin: &Vec3, direction: &Vec3, from: f64, to: f64) -> bool {
    let (mut near, mut far) = (from, to);
    for axis in 0..3 {
        if direction[axis] == 0.0 {
            if origin[axis] < low[axis] || origin[axis] > high[axis] {
                return false;
            }
            continue;
        }
        let a = (low[axis] - origin[axis]) / direction[axis];
        let b = (high[axis] - origin[axis]) / direction[axis];
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    // Rounding must not lose a flat box.
    near <= far + 1e-12 * (1.0 + far.abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shapes;

    #[test]
    fn rays_into_a_cube_hit_its_sides_where_they_are() {
        let surface = shapes::cube();
        let tree = SurfaceTree::new(&surface);
        for (x, y) in [(0.3, 0.4), (0.5, 0.5), (0.9, 0.1), (0.25, 0.75)] {
            let origin = Vec3::new(x, y, -2.0);
            let hit = tree.ray(&surface, &origin, &Vec3::z(), 0.0, 100.0).unwrap();
            assert!((hit.distance - 2.0).abs() < 1e-12 && hit.residual < 1e-12);
            let second = tree.ray(&surface, &origin, &Vec3::z(), 2.5, 100.0).unwrap();
            assert!((second.distance - 3.0).abs() < 1e-12);
            assert!(
                tree.ray(&surface, &origin, &-Vec3::z(), 0.0, 100.0)
                    .is_none()
            );
            assert!(tree.ray(&surface, &origin, &Vec3::z(), 0.0, 1.9).is_none());
        }
    }

    #[test]
    fn rays_from_outside_meet_closed_surfaces_an_even_number_of_times() {
        for surface in [shapes::torus(), shapes::lumpy_sphere()] {
            let tree = SurfaceTree::new(&surface);
            let (low, high) = tree.bounding_box().unwrap();
            let mut met = 0;
            for k in 0..100 {
                let (a, b) = (0.618 * f64::from(k) % 1.0, f64::from(k) / 100.0);
                let origin = Vec3::new(
                    low.x + (high.x - low.x) * a,
                    low.y + (high.y - low.y) * b,
                    low.z - 1.0,
                );
                let mut crossings = 0;
                let mut from = 0.0;
                while let Some(hit) = tree.ray(&surface, &origin, &Vec3::z(), from, 1e3) {
                    crossings += 1;
                    from = hit.distance + 1e-9;
                }
                assert_eq!(crossings % 2, 0, "{k}");
                met += crossings;
            }
            assert!(met > 60);
        }
    }
}
