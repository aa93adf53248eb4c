//! The point of a surface closest to a given point.
//!
//! Two steps: the nearest triangle of a fine mesh of the surface (a box tree), then Newton's method on the
//! patch's own polynomial from there, along the border where the foot point leaves the patch and into
//! the neighbour across it. The result is a stationary point of the distance to the last bit or a point on
//! a border, crease or corner; its [`SurfaceFoot::residual`] certifies which. It is the global closest point wherever
//! the fine mesh tells the candidates apart, that is unless two sheets are equally near within the
//! mesh's chord error.

use crate::Vec3;
use crate::mesh::{AabbTree, TriangleMesh};
use crate::spline::edges::EdgeTable;
use crate::spline::{SampledSurface, Surface, SurfaceError};

/// Triangles that the fine mesh has in all, at least and about.
const TRIANGLES: usize = 200_000;
/// Newton steps on one patch. Quadratic convergence needs 4 to 6 from a mesh's foot point; the rest is for
/// foot points at singular places, where it is only linear.
const STEPS: usize = 20;
/// Patches a foot point may cross into.
const CROSSINGS: usize = 6;

/// A foot point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceFoot {
    /// The patch it lies in.
    pub face: usize,
    /// Barycentric coordinates there; they sum to 1 and none is negative.
    pub barycentric: [f64; 3],
    /// The point.
    pub position: Vec3,
    /// Distance from the query point.
    pub distance: f64,
    /// Largest cosine between the way to the query point and a direction in which the foot point could move
    /// within its patch: 0 where the query point lies along the normal, and also where the foot point is held by a
    /// border of the patch and would only get farther by moving inwards.
    pub residual: f64,
}

/// Finds foot points on one surface.
#[derive(Clone, Debug)]
pub struct SurfaceLocator {
    surface: Surface,
    table: EdgeTable,
    sampled: SampledSurface,
    mesh: TriangleMesh,
    tree: AabbTree,
}

impl SurfaceLocator {
    /// Samples the surface and builds the tree.
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn new(surface: Surface) -> Result<Self, SurfaceError> {
        let table = surface.check()?;
        let patches = surface.faces.len().max(1);
        let segments = ((TRIANGLES / patches) as f64)
            .sqrt()
            .ceil()
            .clamp(4.0, 32.0);
        let sampled = surface.sample_per_patch(segments as usize)?;
        let mesh = TriangleMesh {
            positions: sampled.positions.clone(),
            faces: sampled.triangles.clone(),
        };
        let tree = AabbTree::new(&mesh);
        Ok(Self {
            surface,
            table,
            sampled,
            mesh,
            tree,
        })
    }

    /// The surface.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// The fine mesh of the surface.
    pub fn mesh(&self) -> &TriangleMesh {
        &self.mesh
    }

    /// Patch and barycentric coordinates there of a point of the fine mesh's triangle `triangle`.
    pub fn parameters(&self, triangle: usize, weights: [f64; 3]) -> (usize, [f64; 3]) {
        let patch = self.sampled.patches[triangle] as usize;
        let mut sum = [0.0; 3];
        for (corner, weight) in self.sampled.triangles[triangle].iter().zip(weights) {
            let (face, barycentric) = self.sampled.parameters[*corner as usize];
            for (from, share) in barycentric.iter().enumerate() {
                if *share == 0.0 {
                    continue;
                }
                // A point on an edge may be stated in the patch across it: go by the vertex.
                let vertex = self.surface.faces[face as usize][from];
                let to = self.surface.faces[patch].iter().position(|v| *v == vertex);
                sum[to.unwrap_or(from)] += weight * share;
            }
        }
        (patch, sum)
    }

    /// The closest point; `None` on a surface without patches or for a point that is not finite.
    pub fn foot(&self, point: &Vec3) -> Option<SurfaceFoot> {
        let near = self.tree.closest(&self.mesh, point)?;
        let (face, barycentric) = self.parameters(near.face as usize, near.barycentric);
        let mut best = self.descend(face, barycentric, point);
        // Across the border it is held by, as long as that brings it nearer.
        for _ in 0..CROSSINGS {
            let mut better = None;
            for local in 0..3 {
                let opposite = (local + 2) % 3;
                if best.barycentric[opposite] > 0.0 {
                    continue;
                }
                let Some(side) = self.table.across(best.face, local) else {
                    continue;
                };
                let start = side.coordinates(local, &best.barycentric);
                let found = self.descend(side.face as usize, start, point);
                if better.is_none_or(|b: SurfaceFoot| found.distance < b.distance) {
                    better = Some(found);
                }
            }
            match better {
                Some(found) if found.distance < best.distance => best = found,
                _ => break,
            }
        }
        Some(best)
    }

    /// Newton's method within one patch, never farther from the point than the start.
    fn descend(&self, face: usize, start: [f64; 3], point: &Vec3) -> SurfaceFoot {
        let mut at = start;
        let mut position = self.surface.point(face, at);
        let mut best = (position - point).norm_squared();
        for _ in 0..STEPS {
            let Some(direction) = self.step(face, at, point) else {
                break;
            };
            let mut share = 1.0;
            // Up to the border of the patch.
            for k in 0..3 {
                if direction[k] < 0.0 {
                    share = f64::min(share, at[k] / -direction[k]);
                }
            }
            let mut moved = false;
            for _ in 0..12 {
                let next = normalised([0, 1, 2].map(|k| at[k] + share * direction[k]));
                let there = self.surface.point(face, next);
                let squared = (there - point).norm_squared();
                if squared < best {
                    (at, position, best, moved) = (next, there, squared, true);
                    break;
                }
                share *= 0.5;
            }
            if !moved {
                break;
            }
        }
        SurfaceFoot {
            face,
            barycentric: at,
            position,
            distance: best.sqrt(),
            residual: self.residual(face, at, &(point - position)),
        }
    }

    /// Newton's step in barycentric coordinates (sum 0), along the border where it would lead out of the
    /// patch; `None` where no step leads nearer.
    fn step(&self, face: usize, at: [f64; 3], point: &Vec3) -> Option<[f64; 3]> {
        let [du, dv] = self.surface.first_derivatives(face, at);
        let [duu, duv, dvv] = self.surface.second_derivatives(face, at);
        let way = self.surface.point(face, at) - point;
        let (gu, gv) = (way.dot(&du), way.dot(&dv));
        let first = [du.dot(&du), du.dot(&dv), dv.dot(&dv)];
        let second = [way.dot(&duu), way.dot(&duv), way.dot(&dvv)];
        // Free step, with the full Hessian where it is positive definite and Gauss and Newton's elsewhere.
        let solve = |a: f64, b: f64, c: f64| {
            let det = a * c - b * b;
            (a > 0.0 && det > 1e-12 * a * c)
                .then(|| ((b * gv - c * gu) / det, (b * gu - a * gv) / det))
        };
        let free = solve(
            first[0] + second[0],
            first[1] + second[1],
            first[2] + second[2],
        )
        .or_else(|| solve(first[0], first[1], first[2]));
        let held = |step: &[f64; 3]| (0..3).find(|k| at[*k] <= 0.0 && step[*k] < 0.0);
        if let Some((u, v)) = free {
            let step = [-u - v, u, v];
            if held(&step).is_none() {
                return Some(step);
            }
        }
        // Along each border the point lies on: the one-dimensional Newton step that leads nearest.
        let mut best: Option<(f64, [f64; 3])> = None;
        for opposite in (0..3).filter(|k| at[*k] <= 0.0) {
            let mut along = [0.0; 3];
            along[(opposite + 1) % 3] = -1.0;
            along[(opposite + 2) % 3] = 1.0;
            let tangent = du * along[1] + dv * along[2];
            let bend = duu * (along[1] * along[1])
                + duv * (2.0 * along[1] * along[2])
                + dvv * (along[2] * along[2]);
            let slope = way.dot(&tangent);
            let stiff = tangent.dot(&tangent);
            let curved = stiff + way.dot(&bend);
            let divisor = if curved > 1e-3 * stiff { curved } else { stiff };
            if divisor <= 0.0 {
                continue;
            }
            let step = along.map(|a| -a * slope / divisor);
            let gain = slope * slope / divisor;
            if held(&step).is_none() && best.is_none_or(|(g, _)| gain > g) {
                best = Some((gain, step));
            }
        }
        best.filter(|(gain, _)| *gain > 0.0).map(|(_, step)| step)
    }

    /// See [`SurfaceFoot::residual`].
    fn residual(&self, face: usize, at: [f64; 3], way: &Vec3) -> f64 {
        let Some(way) = way.try_normalize(0.0) else {
            return 0.0;
        };
        let [du, dv] = self.surface.first_derivatives(face, at);
        // Directions along the edges; on a border only those that stay inside.
        let directions = [
            ([0.0, -1.0, 1.0], dv - du),
            ([1.0, 0.0, -1.0], -dv),
            ([-1.0, 1.0, 0.0], du),
        ];
        let mut worst: f64 = 0.0;
        for (step, tangent) in directions {
            for sign in [1.0, -1.0] {
                let allowed = (0..3).all(|k| at[k] > 0.0 || sign * step[k] >= 0.0);
                if let (true, Some(tangent)) = (allowed, tangent.try_normalize(0.0)) {
                    worst = worst.max(sign * tangent.dot(&way));
                }
            }
        }
        worst
    }
}

/// Barycentric coordinates with rounding errors taken out: none negative, sum 1.
fn normalised(at: [f64; 3]) -> [f64; 3] {
    let kept = at.map(|b| if b < 1e-14 { 0.0 } else { b });
    let sum: f64 = kept.iter().sum();
    kept.map(|b| b / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shapes;

    #[test]
    fn points_off_along_the_normal_come_back() {
        let surface = shapes::torus();
        let locator = SurfaceLocator::new(surface).unwrap();
        let surface = locator.surface();
        let mut worst: (f64, f64) = (0.0, 0.0);
        for face in 0..surface.faces.len() {
            for at in [
                [0.2, 0.3, 0.5],
                [0.01, 0.02, 0.97],
                [0.001, 0.5, 0.499],
                [1.0 / 3.0; 3],
            ] {
                for height in [-0.05, 0.0, 0.02] {
                    let point = surface.point(face, at) + surface.normal(face, at) * height;
                    let foot = locator.foot(&point).unwrap();
                    worst.0 = worst.0.max((foot.distance - f64::abs(height)).max(0.0));
                    if foot.distance > 1e-6 {
                        worst.1 = worst.1.max(foot.residual);
                    }
                }
            }
        }
        assert!(worst.0 < 1e-14, "{worst:?}");
        assert!(worst.1 < 1e-8, "{worst:?}");
    }

    #[test]
    fn no_sample_is_nearer_than_the_foot() {
        for surface in [shapes::lumpy_sphere(), shapes::cube(), shapes::sheet()] {
            let fine = surface.sample_per_patch(40).unwrap();
            let locator = SurfaceLocator::new(surface).unwrap();
            for k in 0..200 {
                let t = f64::from(k);
                let point = Vec3::new((t * 0.7).sin(), (t * 1.3).cos(), (t * 0.37).sin()) * 1.4;
                let foot = locator.foot(&point).unwrap();
                let nearest = fine
                    .positions
                    .iter()
                    .map(|p| (p - point).norm())
                    .fold(f64::INFINITY, f64::min);
                assert!(foot.distance <= nearest + 1e-12, "{foot:?} {nearest}");
                let position = locator.surface().point(foot.face, foot.barycentric);
                assert!((position - foot.position).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn corners_and_borders_hold_the_foot() {
        let locator = SurfaceLocator::new(shapes::cube()).unwrap();
        let corner = locator.foot(&Vec3::new(1.5, 1.5, 1.5)).unwrap();
        assert!((corner.position - Vec3::repeat(1.0)).norm() < 1e-12);
        assert!(corner.residual <= 1e-12);
        let edge = locator.foot(&Vec3::new(0.3, -1.0, -1.0)).unwrap();
        assert!(
            (edge.position - Vec3::new(0.3, 0.0, 0.0)).norm() < 1e-9,
            "{edge:?}"
        );
        let inside = locator.foot(&Vec3::new(0.3, 0.4, 0.9)).unwrap();
        assert!((inside.distance - 0.1).abs() < 1e-12);
        assert!(locator.foot(&Vec3::repeat(f64::NAN)).is_none());
        let empty = SurfaceLocator::new(Surface::default()).unwrap();
        assert!(empty.foot(&Vec3::zeros()).is_none());
    }
}
