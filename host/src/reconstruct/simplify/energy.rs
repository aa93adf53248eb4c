//! Hoppe's energy: what a mesh costs that stands for given points.
//!
//! E = E_dist + E_rep + E_spring: the squared distances of all points to the mesh, a price for every
//! vertex, and springs along the edges ("Mesh Optimization" 1993, section 3). For fixed connectivity
//! the first and the last are minimised in turns: foot points for the positions, then a linear
//! least-squares problem for the positions with the foot points' barycentric coordinates held
//! (`Assignment::improve`).
//!
//! Points are the measured ones and, where those are fewer than about 12 to a face, samples of the
//! extracted surface as well: a face without any point would cost nothing but its springs, and the optimization
//! would take it away.

use super::work::Work;
use crate::Vec3;
use crate::cloud::Cloud;
use crate::mesh::{AabbTree, Freedom, closest_on_triangle, sample_by_area};

/// The three terms of the energy, in squared units of the input.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Sum of weighted squared distances of the points to the mesh.
    pub distance: f64,
    /// Price per vertex times the number of vertices.
    pub representation: f64,
    /// Spring constant times the sum of squared edge lengths.
    pub spring: f64,
    /// Vertices of the mesh.
    pub vertices: usize,
}

impl Energy {
    /// What is minimised.
    pub fn total(&self) -> f64 {
        self.distance + self.representation + self.spring
    }
}

/// The points that the mesh is to stand for.
#[derive(Clone, Debug, Default)]
pub(super) struct Targets {
    pub(super) points: Vec<Vec3>,
    normals: Vec<Vec3>,
    pub(super) weights: Vec<f64>,
}

/// Samples of the extracted surface count this much against measured points: they are smoothed already,
/// but where there are measured points those decide.
const SAMPLE_WEIGHT: f64 = 0.5;
/// Points per face below which samples are added.
const POINTS_PER_FACE: usize = 12;

impl Targets {
    pub(super) fn new(work: &Work<'_>, cloud: &Cloud) -> Self {
        let mut out = Self::default();
        for p in &cloud.points {
            if p.position
                .iter()
                .chain(p.normal.iter())
                .all(|x| x.is_finite())
            {
                out.push(p.position, p.normal, 1.0);
            }
        }
        let faces = work.mesh.face_count();
        let mesh = work.reference.mesh;
        let samples = if out.points.len() < 4 * POINTS_PER_FACE * faces {
            POINTS_PER_FACE * faces
        } else {
            0
        };
        for s in sample_by_area(mesh, samples) {
            out.push(s.position, mesh.face_normal(s.face), SAMPLE_WEIGHT);
        }
        out
    }

    fn push(&mut self, p: Vec3, n: Vec3, weight: f64) {
        self.points.push(p);
        self.normals.push(n);
        self.weights.push(weight);
    }
}

/// A foot point in one face.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Foot {
    pub(super) face: u32,
    pub(super) barycentric: [f64; 3],
    pub(super) squared: f64,
}

/// Where every target's foot point lies on the mesh.
#[derive(Clone, Debug)]
pub(super) struct Assignment {
    pub(super) targets: Targets,
    pub(super) feet: Vec<Foot>,
    /// Per face, the targets whose foot point it holds.
    pub(super) of_face: Vec<Vec<u32>>,
}

impl Assignment {
    /// Finds all foot points; a foot point's face must not face away from the target's normal.
    pub(super) fn new(work: &Work<'_>, targets: Targets) -> Self {
        let mut out = Self {
            feet: vec![Foot::default(); targets.points.len()],
            of_face: Vec::new(),
            targets,
        };
        out.project(work);
        out
    }

    pub(super) fn project(&mut self, work: &Work<'_>) {
        let compact = work.mesh.compact();
        let tree = AabbTree::new(&compact.mesh);
        let normals: Vec<Vec3> = (0..compact.mesh.faces.len() as u32)
            .map(|f| compact.mesh.area_vector(f))
            .collect();
        self.of_face = vec![Vec::new(); work.mesh.face_slots()];
        for i in 0..self.targets.points.len() {
            let (p, n) = (self.targets.points[i], self.targets.normals[i]);
            let found = tree
                .closest_where(&compact.mesh, &p, f64::INFINITY, |f| {
                    normals[f as usize].dot(&n) > 0.0
                })
                .or_else(|| tree.closest(&compact.mesh, &p));
            if let Some(foot) = found {
                let face = compact.faces[foot.face as usize];
                self.feet[i] = Foot {
                    face,
                    barycentric: foot.barycentric,
                    squared: foot.distance * foot.distance,
                };
                self.of_face[face as usize].push(i as u32);
            }
        }
    }

    pub(super) fn distance_energy(&self) -> f64 {
        self.feet
            .iter()
            .zip(&self.targets.weights)
            .map(|(f, w)| w * f.squared)
            .sum()
    }

    pub(super) fn energy(&self, work: &Work<'_>, price: f64, spring: f64) -> Energy {
        let edges: f64 = work.mesh.edges().map(|h| work.mesh.length(h).powi(2)).sum();
        let vertices = work.mesh.vertex_count();
        Energy {
            distance: self.distance_energy(),
            representation: price * vertices as f64,
            spring: spring * edges,
            vertices,
        }
    }

    /// Moves all vertices that are free on the surface to the least-squares positions for the foot
    /// points as they are, and finds the foot points anew; `rounds` times. A vertex whose faces would no
    /// longer hold to the limits there stays where it is.
    ///
    /// The normal equations (weights of the foot points plus springs) are positive definite as soon as
    /// one vertex is held or a spring constant is positive; conjugate gradients with the diagonal as
    /// preconditioner, as in the source, solve them to 1e-6 in a few dozen steps.
    pub(super) fn improve(&mut self, work: &mut Work<'_>, spring: f64, rounds: usize) {
        for _ in 0..rounds {
            let system = System::new(work, self, spring);
            for (v, p) in system.solve(work) {
                work.float(v, &p);
            }
            self.project(work);
        }
    }
}

/// Normal equations over the free vertices; one matrix for all three coordinates.
struct System {
    free: Vec<u32>,
    diagonal: Vec<f64>,
    /// Off-diagonal entries as (row, column, value), each pair in both orders.
    entries: Vec<(u32, u32, f64)>,
    right: Vec<Vec3>,
}

impl System {
    fn new(work: &Work<'_>, assignment: &Assignment, spring: f64) -> Self {
        let mesh = &work.mesh;
        let mut row = vec![u32::MAX; mesh.vertex_slots()];
        let mut free = Vec::new();
        for v in mesh
            .vertices()
            .filter(|v| mesh.freedom(*v) == Freedom::Surface)
        {
            row[v as usize] = free.len() as u32;
            free.push(v);
        }
        let mut out = Self {
            diagonal: vec![0.0; free.len()],
            right: vec![Vec3::zeros(); free.len()],
            entries: Vec::new(),
            free,
        };
        // One entry per half-edge and direction: sums over the foot points of its face.
        for f in mesh.faces() {
            let ids = mesh.face_vertices(f);
            let mut gram = [[0.0; 3]; 3];
            let mut pull = [Vec3::zeros(); 3];
            for &i in &assignment.of_face[f as usize] {
                let w = assignment.targets.weights[i as usize];
                let b = assignment.feet[i as usize].barycentric;
                for k in 0..3 {
                    pull[k] += assignment.targets.points[i as usize] * (w * b[k]);
                    for l in 0..3 {
                        gram[k][l] += w * b[k] * b[l];
                    }
                }
            }
            for k in 0..3 {
                let r = row[ids[k] as usize];
                if r == u32::MAX {
                    continue;
                }
                out.diagonal[r as usize] += gram[k][k];
                out.right[r as usize] += pull[k];
                for l in (0..3).filter(|l| *l != k) {
                    out.couple(&row, work, r, ids[l], gram[k][l]);
                }
            }
        }
        for h in mesh.edges() {
            for (v, w) in [
                (mesh.origin(h), mesh.destination(h)),
                (mesh.destination(h), mesh.origin(h)),
            ] {
                let r = row[v as usize];
                if r != u32::MAX {
                    out.diagonal[r as usize] += spring;
                    out.couple(&row, work, r, w, -spring);
                }
            }
        }
        out
    }

    fn couple(&mut self, row: &[u32], work: &Work<'_>, r: u32, other: u32, value: f64) {
        let c = row[other as usize];
        if c == u32::MAX {
            self.right[r as usize] -= work.mesh.position(other) * value;
        } else {
            self.entries.push((r, c, value));
        }
    }

    fn times(&self, x: &[Vec3]) -> Vec<Vec3> {
        let mut out: Vec<Vec3> = x.iter().zip(&self.diagonal).map(|(x, d)| x * *d).collect();
        for &(r, c, value) in &self.entries {
            out[r as usize] += x[c as usize] * value;
        }
        out
    }

    /// New positions of the free vertices that any equation holds; the others are left out.
    fn solve(&self, work: &Work<'_>) -> Vec<(u32, Vec3)> {
        let n = self.free.len();
        let mut x: Vec<Vec3> = self.free.iter().map(|v| work.mesh.position(*v)).collect();
        let inverse: Vec<f64> = self
            .diagonal
            .iter()
            .map(|d| if *d > 0.0 { 1.0 / d } else { 0.0 })
            .collect();
        let dot = |a: &[Vec3], b: &[Vec3]| -> Vec3 {
            a.iter()
                .zip(b)
                .fold(Vec3::zeros(), |s, (a, b)| s + a.component_mul(b))
        };
        let ax = self.times(&x);
        let mut r: Vec<Vec3> = (0..n).map(|i| self.right[i] - ax[i]).collect();
        let mut z: Vec<Vec3> = (0..n).map(|i| r[i] * inverse[i]).collect();
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        let start = rz;
        for _ in 0..60 {
            let ap = self.times(&p);
            let pap = dot(&p, &ap);
            let alpha = rz.zip_map(&pap, |a, b| if b > 0.0 { a / b } else { 0.0 });
            for i in 0..n {
                x[i] += p[i].component_mul(&alpha);
                r[i] -= ap[i].component_mul(&alpha);
                z[i] = r[i] * inverse[i];
            }
            let next = dot(&r, &z);
            let beta = next.zip_map(&rz, |a, b| if b > 0.0 { a / b } else { 0.0 });
            for i in 0..n {
                p[i] = z[i] + p[i].component_mul(&beta);
            }
            rz = next;
            if (0..3).all(|k| rz[k] <= 1e-12 * start[k]) {
                break;
            }
        }
        self.free
            .iter()
            .zip(&x)
            .filter(|(_, p)| p.iter().all(|c| c.is_finite()))
            .map(|(v, p)| (*v, *p))
            .collect()
    }
}

/// Outcome of trying out a few faces for a set of targets.
#[derive(Clone, Debug, Default)]
pub(super) struct Trial {
    /// Weighted sum of squared distances.
    pub(super) distance: f64,
    /// Where the free vertex ended.
    pub(super) position: Vec3,
    /// Foot points; `face` counts the faces tried.
    pub(super) feet: Vec<Foot>,
}

/// Foot points of some targets on some triangles.
pub(super) fn try_faces(targets: &Targets, of: &[u32], faces: &[[Vec3; 3]]) -> Trial {
    let mut out = Trial::default();
    for &i in of {
        let p = targets.points[i as usize];
        let mut best = Foot {
            squared: f64::INFINITY,
            ..Foot::default()
        };
        for (k, [a, b, c]) in faces.iter().enumerate() {
            let w = closest_on_triangle(&p, a, b, c);
            let squared = (p - (a * w[0] + b * w[1] + c * w[2])).norm_squared();
            if squared < best.squared {
                best = Foot {
                    face: k as u32,
                    barycentric: w,
                    squared,
                };
            }
        }
        out.distance += targets.weights[i as usize] * best.squared;
        out.feet.push(best);
    }
    out
}

/// Tries a fan of faces (centre, p, q) whose centre is free to move, unless `fixed`: the centre is put at
/// its least-squares place for foot points and springs (to `spokes`), `rounds` times.
pub(super) fn try_fan(
    targets: &Targets,
    of: &[u32],
    rim: &[[Vec3; 2]],
    spokes: &[Vec3],
    spring: f64,
    start: Vec3,
    rounds: usize,
) -> Trial {
    let fan =
        |centre: Vec3| -> Vec<[Vec3; 3]> { rim.iter().map(|[p, q]| [centre, *p, *q]).collect() };
    let mut centre = start;
    let mut trial = try_faces(targets, of, &fan(centre));
    for _ in 0..rounds {
        let mut weight = spring * spokes.len() as f64;
        let mut pull: Vec3 = spokes.iter().sum::<Vec3>() * spring;
        for (foot, &i) in trial.feet.iter().zip(of) {
            let w = targets.weights[i as usize];
            let [b, s, t] = foot.barycentric;
            let [p, q] = rim[foot.face as usize];
            pull += (targets.points[i as usize] - p * s - q * t) * (w * b);
            weight += w * b * b;
        }
        if weight.is_nan() || weight <= 0.0 {
            break;
        }
        centre = pull / weight;
        trial = try_faces(targets, of, &fan(centre));
    }
    trial.position = centre;
    trial
}
