//! Foot points: where on the network each datum belongs.
//!
//! A foot point must be near and its surface normal must agree with the measured one: on a thin wall the
//! nearest point alone is often on the other side, and one such point is enough to make a fit explode. So
//! candidates are searched among samples in six dimensions, position beside scaled normal, and then improved
//! by Gauss-Newton steps that may cross smooth edges into the neighbour patch (never a crease: which side
//! of a crease a contact belongs to is what its normal says).

use super::{Datum, Kind};
use crate::Vec3;
use crate::spline::bernstein::{CONTROL_POINTS, edge_index};
use crate::spline::{network::Network, point_and_tangents};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Where a datum belongs on the network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// The patch.
    pub face: u32,
    /// Barycentric coordinates there.
    pub barycentric: [f64; 3],
    /// The surface point.
    pub point: Vec3,
    /// Derivatives by u and v there.
    pub tangents: [Vec3; 2],
    /// Unit direction of the line for the foot point of a datum that belongs on a border or crease.
    pub along: Option<Vec3>,
}

impl Foot {
    /// Unit normal of the surface, `None` where it is not regular.
    pub fn normal(&self) -> Option<Vec3> {
        let [du, dv] = self.tangents;
        let cross = du.cross(&dv);
        let scale = du.norm_squared().max(dv.norm_squared());
        (cross.norm() > 1e-9 * scale).then(|| cross.normalize())
    }
}

/// Samples per patch edge in the search: foot points start within a tenth of a patch.
const STEPS: usize = 8;
/// Gauss-Newton steps; they converge quadratically from a start within a tenth of a patch.
const ITERATIONS: usize = 12;
/// A barycentric coordinate below this lies at the edge.
const AT_EDGE: f64 = 0.02;

/// A network with its control points, ready to be searched.
pub struct Finder<'a> {
    network: &'a Network,
    patches: Vec<[Vec3; CONTROL_POINTS]>,
    starts: Vec<(u32, [f64; 3])>,
    tree: Option<ImmutableKdTree<f64, 6>>,
    normal_scale: f64,
}

impl<'a> Finder<'a> {
    /// Samples every patch. `normal_scale` is the distance that counts as much as two normals at 60
    /// degrees (in the unit of the points).
    pub fn new(network: &'a Network, points: &[Vec3], normal_scale: f64) -> Self {
        let known = Self::of_known(network, points);
        let patches = &known.patches;
        let samples: Vec<(u32, [f64; 3], [f64; 6])> = (0..patches.len())
            .into_par_iter()
            .flat_map_iter(|face| {
                let patch = &patches[face];
                let mut out = Vec::with_capacity((STEPS + 1) * (STEPS + 2) / 2);
                for i in 0..=STEPS {
                    for j in 0..=STEPS - i {
                        // Slightly drawn inwards, so that samples of neighbours do not coincide.
                        let at = [i, j, STEPS - i - j]
                            .map(|m| 0.98 * m as f64 / STEPS as f64 + 0.02 / 3.0);
                        let foot = evaluate(patch, face as u32, at);
                        let normal = foot.normal().unwrap_or_else(Vec3::zeros) * normal_scale;
                        let p = foot.point;
                        out.push((
                            face as u32,
                            at,
                            [p.x, p.y, p.z, normal.x, normal.y, normal.z],
                        ));
                    }
                }
                out
            })
            .collect();
        let entries: Vec<[f64; 6]> = samples
            .iter()
            .map(|s| s.2.map(|x| if x.is_finite() { x } else { 0.0 }))
            .collect();
        Self {
            starts: samples.iter().map(|s| (s.0, s.1)).collect(),
            tree: ImmutableKdTree::new_from_slice(&entries).ok(),
            normal_scale,
            ..known
        }
    }

    /// Ready only to improve foot points that are known.
    pub fn of_known(network: &'a Network, points: &[Vec3]) -> Self {
        Self {
            network,
            patches: network.patches(points),
            starts: Vec::new(),
            tree: None,
            normal_scale: 0.0,
        }
    }

    /// The foot point on the other side of the crease at which `foot` lies, if the position is at least twice as near to it.
    pub fn across_crease(&self, position: Vec3, foot: &Foot) -> Option<Foot> {
        let face = foot.face as usize;
        let distance = |foot: &Foot| (position - foot.point).norm();
        let held = |local: usize| foot.barycentric[(local + 2) % 3] < AT_EDGE;
        let is_crease =
            |local: usize| !self.network.smooth[self.network.table.of_face[face][local] as usize];
        let others = (0..3).filter(|local| held(*local) && is_crease(*local));
        others
            .filter_map(|local| {
                let side = self.network.table.across(face, local)?;
                let there = normalised(side.coordinates(local, &foot.barycentric));
                Some(self.improve(position, side.face, there))
            })
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .filter(|other| 2.0 * distance(other) < distance(foot))
    }

    /// The foot point of a position with a measured normal.
    pub fn find(&self, position: Vec3, normal: Vec3) -> Option<Foot> {
        let n = normal * self.normal_scale;
        let query = [position.x, position.y, position.z, n.x, n.y, n.z];
        if query.iter().any(|x| !x.is_finite()) {
            return None;
        }
        let nearest = self
            .tree
            .as_ref()?
            .query(&query)
            .nearest_one::<SquaredEuclidean<f64>>()
            .execute();
        let (face, at) = *self.starts.get(nearest.item as usize)?;
        Some(self.improve(position, face, at))
    }

    /// Foot points of many, in order.
    pub fn find_all(&self, data: &[Datum]) -> Vec<Option<Foot>> {
        data.par_iter()
            .map(|d| match d.kind {
                Kind::Line => self.find_on_line(d.position),
                Kind::Measured | Kind::Field => self.find(d.position, d.normal),
            })
            .collect()
    }

    /// The foot point of a position on the borders and creases alone.
    pub fn find_on_line(&self, position: Vec3) -> Option<Foot> {
        let mut best: Option<(f64, Foot)> = None;
        for (number, edge) in self.network.table.edges.iter().enumerate() {
            if self.network.smooth[number] {
                continue;
            }
            let side = edge.sides.iter().flatten().next()?;
            let (face, local) = (side.face, usize::from(side.local));
            let at = |t: f64| {
                let mut at = [0.0; 3];
                at[local] = 1.0 - t;
                at[(local + 1) % 3] = t;
                at
            };
            let patch = &self.patches[face as usize];
            // Control points bound the edge: skip it if even their box is farther than the best so far.
            if let Some((distance, _)) = best {
                let (mut low, mut high) = (
                    patch[edge_index(local, 0, 0)],
                    patch[edge_index(local, 0, 0)],
                );
                for along in 1..=5 {
                    let p = patch[edge_index(local, 0, along)];
                    low = low.inf(&p);
                    high = high.sup(&p);
                }
                if (position.sup(&low).inf(&high) - position).norm_squared() > distance {
                    continue;
                }
            }
            let mut t = 0.0;
            let mut nearest = f64::INFINITY;
            for step in 0..=2 * STEPS {
                let s = step as f64 / (2 * STEPS) as f64;
                let d = (position - evaluate(patch, face, at(s)).point).norm_squared();
                if d < nearest {
                    (nearest, t) = (d, s);
                }
            }
            let tangent = |foot: &Foot| {
                let [du, dv] = foot.tangents;
                let of = |corner: usize| [Vec3::zeros(), du, dv][corner];
                of((local + 1) % 3) - of(local)
            };
            let mut foot = evaluate(patch, face, at(t));
            for _ in 0..ITERATIONS / 2 {
                let along = tangent(&foot);
                let step = along.dot(&(position - foot.point)) / along.norm_squared().max(1e-300);
                let next = (t + step).clamp(0.0, 1.0);
                if (next - t).abs() < 1e-12 {
                    break;
                }
                t = next;
                foot = evaluate(patch, face, at(t));
            }
            foot.along = tangent(&foot).try_normalize(0.0);
            let distance = (position - foot.point).norm_squared();
            if best.as_ref().is_none_or(|(d, _)| distance < *d) {
                best = Some((distance, foot));
            }
        }
        best.map(|(_, foot)| foot)
    }

    /// Gauss-Newton from a start, across smooth edges.
    pub fn improve(&self, position: Vec3, face: u32, at: [f64; 3]) -> Foot {
        let mut foot = evaluate(&self.patches[face as usize], face, at);
        let mut best = foot;
        let mut best_distance = (position - foot.point).norm_squared();
        let mut came_over: Option<u32> = None;
        for _ in 0..ITERATIONS {
            let [du, dv] = foot.tangents;
            let residual = position - foot.point;
            let (a, b, c) = (du.norm_squared(), du.dot(&dv), dv.norm_squared());
            let ridge = 1e-12 * (a + c) + 1e-300;
            let det = (a + ridge) * (c + ridge) - b * b;
            let (r, s) = (du.dot(&residual), dv.dot(&residual));
            let step_u = ((c + ridge) * r - b * s) / det;
            let step_v = ((a + ridge) * s - b * r) / det;
            let step = [-step_u - step_v, step_u, step_v].map(|x| x.clamp(-1.0, 1.0));
            let (next, crossed) = self.walk(&foot, step, [r, s], came_over);
            came_over = crossed;
            let moved = (0..3)
                .map(|m| (next.1[m] - foot.barycentric[m]).abs())
                .sum::<f64>();
            let same = next.0 == foot.face;
            foot = evaluate(&self.patches[next.0 as usize], next.0, next.1);
            let distance = (position - foot.point).norm_squared();
            if distance < best_distance {
                best_distance = distance;
                best = foot;
            }
            if same && moved < 1e-13 {
                break;
            }
        }
        best
    }

    /// One step from a foot point, stopped at the patch's border or carried into the neighbour. `gradient`
    /// is the residual along both tangents. Returns the place and the edge crossed.
    fn walk(
        &self,
        foot: &Foot,
        step: [f64; 3],
        gradient: [f64; 2],
        came_over: Option<u32>,
    ) -> ((u32, [f64; 3]), Option<u32>) {
        let at = foot.barycentric;
        let mut reach = 1.0;
        let mut exit = None;
        for m in 0..3 {
            if step[m] < 0.0 && at[m] + step[m] * reach < 0.0 {
                reach = (at[m] / -step[m]).max(0.0);
                exit = Some(m);
            }
        }
        let mut moved: [f64; 3] = std::array::from_fn(|m| at[m] + step[m] * reach);
        let Some(opposite) = exit else {
            return ((foot.face, normalised(moved)), None);
        };
        moved[opposite] = 0.0;
        moved = normalised(moved);
        let local = (opposite + 1) % 3;
        let edge = self.network.table.of_face[foot.face as usize][local];
        let neighbour = self.network.table.across(foot.face as usize, local);
        match neighbour {
            Some(side)
                if self.network.smooth[edge as usize]
                    && !(came_over == Some(edge) && reach < 1e-9) =>
            {
                let there = side.coordinates(local, &moved);
                ((side.face, there), Some(edge))
            }
            _ if reach < 1e-9 => {
                // Held by the border, or by an edge both of whose sides point across it: slide along.
                let [du, dv] = foot.tangents;
                let barycentric_tangent = |m: usize| match m {
                    0 => Vec3::zeros(),
                    1 => du,
                    _ => dv,
                };
                let along = barycentric_tangent((local + 1) % 3) - barycentric_tangent(local);
                let component = |m: usize| match m {
                    0 => 0.0,
                    1 => gradient[0],
                    _ => gradient[1],
                };
                let slide = (component((local + 1) % 3) - component(local))
                    / along.norm_squared().max(1e-300);
                let to = (moved[(local + 1) % 3] + slide).clamp(0.0, 1.0);
                let mut there = [0.0; 3];
                there[(local + 1) % 3] = to;
                there[local] = 1.0 - to;
                ((foot.face, there), Some(edge))
            }
            _ => ((foot.face, moved), None),
        }
    }
}

fn normalised(at: [f64; 3]) -> [f64; 3] {
    let clipped = at.map(|x| x.max(0.0));
    let sum: f64 = clipped.iter().sum();
    clipped.map(|x| x / sum)
}

/// Point and tangents of one patch.
fn evaluate(patch: &[Vec3; CONTROL_POINTS], face: u32, at: [f64; 3]) -> Foot {
    let (point, tangents) = point_and_tangents(patch, at);
    Foot {
        face,
        barycentric: at,
        point,
        tangents,
        along: None,
    }
}
