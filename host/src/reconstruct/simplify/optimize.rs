//! Hoppe's outer loop: collapses, flips and splits that lower the energy, with falling springs.
//!
//! The price of a vertex, which the source leaves to the user, follows from the number of faces the sizing field asked
//! for. For a smooth surface stood for by m vertices the squared chord error falls like m^-2, so
//! E_dist = C / m^2 and the energy is least where the price is 2 E_dist / m. Measured on the mesh that the
//! decimation leaves, that price makes its number of vertices the best one, and the moves carry vertices
//! from where they are wasted to where they save distance.
//!
//! Beside the source's legal-move tests a move must leave faces that hold to the turn limit and the
//! sizing field, and valences of 4 to 8: the mesh carries curved patches, and what the straight triangles
//! save by becoming thin, those pay for many times over.

use super::energy::{Assignment, Energy, Foot, Targets, Trial, try_faces, try_fan};
use super::work::{Candidate, Work};
use crate::Vec3;
use crate::cloud::Cloud;
use crate::mesh::{CollapseTo, Freedom, HalfEdgeMesh, NONE};

/// First spring constant, in shares of the points' weight per vertex; a tenth of it each round. With 0.1
/// the first round trades distance for short edges and the sum of the other two terms rises on the torus;
/// at 0.02 it falls on all shapes tried (torus, bean, two-holed torus, mug, ellipsoid).
const SPRING: f64 = 0.02;
/// Edges must not be stretched beyond this by a move.
const STRETCH_MAX: f64 = 1.6;
/// Nor faces made poorer than this, unless they were.
const FITNESS_MIN: f64 = 0.45;

/// Runs `rounds` rounds. Returns the energy at the last round's spring constant before any move and after
/// all; `None` without any point.
pub(super) fn optimize(work: &mut Work<'_>, cloud: &Cloud, rounds: usize) -> Option<[Energy; 2]> {
    let targets = Targets::new(work, cloud);
    if targets.points.is_empty() {
        return None;
    }
    let vertices = work.mesh.vertex_count().max(1) as f64;
    let first = SPRING * targets.weights.iter().sum::<f64>() / vertices;
    let mut state = State {
        assignment: Assignment::new(work, targets),
        price: 0.0,
        spring: first,
    };
    state.assignment.improve(work, 0.01 * first, 2);
    // Noise and the sampling of the dense mesh keep a distance that no number of vertices takes away.
    let floor = state.floor(work);
    let chord = (state.assignment.distance_energy() - floor).max(0.0);
    state.price = 2.0 * chord / vertices;
    let last = first * 0.1f64.powi(rounds as i32);
    let before = state.assignment.energy(work, state.price, last);
    for _ in 0..rounds {
        state.assignment.improve(work, state.spring, 1);
        state.sweep(work);
        state.spring *= 0.1;
    }
    state.assignment.improve(work, state.spring, 2);
    let after = state.assignment.energy(work, state.price, last);
    Some([before, after])
}

struct State {
    assignment: Assignment,
    price: f64,
    spring: f64,
}

impl State {
    /// What the points' distance to the dense mesh costs.
    fn floor(&self, work: &Work<'_>) -> f64 {
        let targets = &self.assignment.targets;
        let mut sum = 0.0;
        for (p, w) in targets.points.iter().zip(&targets.weights) {
            if let Some(d) = work.reference.distance(p) {
                sum += w * d * d;
            }
        }
        sum
    }

    /// Tries every edge once: collapse, else flip, else split.
    fn sweep(&mut self, work: &mut Work<'_>) {
        for h in work.mesh.edges().collect::<Vec<_>>() {
            if !work.mesh.is_live(h) {
                continue;
            }
            let moved = self.try_collapse(work, h) || self.try_flip(work, h);
            if !moved {
                self.try_split(work, h);
            }
        }
    }

    fn targets_of(&self, faces: &[u32]) -> Vec<u32> {
        let mut out = Vec::new();
        for &f in faces {
            out.extend_from_slice(&self.assignment.of_face[f as usize]);
        }
        out
    }

    fn distance_of(&self, of: &[u32]) -> f64 {
        of.iter()
            .map(|i| {
                self.assignment.targets.weights[*i as usize]
                    * self.assignment.feet[*i as usize].squared
            })
            .sum()
    }

    /// Takes over the foot points of a trial whose k-th face became `faces[k]`.
    fn adopt(&mut self, work: &Work<'_>, of: &[u32], trial: &Trial, faces: &[u32], gone: &[u32]) {
        self.assignment
            .of_face
            .resize(work.mesh.face_slots(), Vec::new());
        for &f in gone.iter().chain(faces) {
            self.assignment.of_face[f as usize].clear();
        }
        for (&i, foot) in of.iter().zip(&trial.feet) {
            let face = faces[foot.face as usize];
            self.assignment.of_face[face as usize].push(i);
            self.assignment.feet[i as usize] = Foot { face, ..*foot };
        }
    }

    fn try_collapse(&mut self, work: &mut Work<'_>, h: u32) -> bool {
        let Ok(to) = work.mesh.may_collapse(h) else {
            return false;
        };
        let mesh = &work.mesh;
        let (a, b, t) = (mesh.origin(h), mesh.destination(h), mesh.twin(h));
        let apexes = [h, t].map(|g| if g == NONE { NONE } else { mesh.apex(g) });
        let thinned =
            |v: u32| v != NONE && mesh.freedom(v) == Freedom::Surface && mesh.valence(v) <= 4;
        if apexes.iter().any(|v| thinned(*v)) || mesh.valence(a) + mesh.valence(b) > 12 {
            return false;
        }
        // The vertex whose index and attributes remain is the one with the less freedom.
        let kept = match to {
            CollapseTo::Vertex(v) => v,
            _ => b,
        };
        let gone = if kept == a { b } else { a };
        let mut faces: Vec<u32> = mesh
            .around(a)
            .chain(mesh.around(b))
            .map(|g| g / 3)
            .collect();
        faces.sort_unstable();
        faces.dedup();
        let of = self.targets_of(&faces);
        let stays: Vec<u32> = faces
            .iter()
            .copied()
            .filter(|f| {
                let ids = mesh.face_vertices(*f);
                !(ids.contains(&a) && ids.contains(&b))
            })
            .collect();
        let rim: Vec<[Vec3; 2]> = stays
            .iter()
            .map(|f| rim_of(mesh, *f, a, b).map(|v| mesh.position(v)))
            .collect();
        let mut ring: Vec<u32> = mesh.neighbours(a).chain(mesh.neighbours(b)).collect();
        ring.retain(|v| *v != a && *v != b);
        ring.sort_unstable();
        ring.dedup();
        let spokes: Vec<Vec3> = ring.iter().map(|v| mesh.position(*v)).collect();
        let (start, rounds) = match to {
            CollapseTo::Surface => ((mesh.position(a) + mesh.position(b)) * 0.5, 3),
            _ => (mesh.position(kept), 0),
        };
        let old_springs: f64 = mesh
            .neighbours(a)
            .map(|v| (a, v))
            .chain(mesh.neighbours(b).filter(|v| *v != a).map(|v| (b, v)))
            .map(|(v, w)| (mesh.position(v) - mesh.position(w)).norm_squared())
            .sum();
        let before = self.distance_of(&of) + self.spring * old_springs + self.price;
        let trial = try_fan(
            &self.assignment.targets,
            &of,
            &rim,
            &spokes,
            self.spring,
            start,
            rounds,
        );
        let springs: f64 = spokes
            .iter()
            .map(|p| (p - trial.position).norm_squared())
            .sum();
        if trial.distance + self.spring * springs >= before {
            return false;
        }
        // Would the faces do? Try with the kept vertex's attributes at its new place.
        let attributes = work.attributes(kept);
        if rounds > 0 && !work.settle(kept, &trial.position, false) {
            return false;
        }
        let fits = stays.iter().all(|f| {
            let candidate = Candidate {
                ids: work
                    .mesh
                    .face_vertices(*f)
                    .map(|v| if v == gone { kept } else { v }),
                region: work.region[*f as usize],
            };
            work.fitness(&candidate).is_some_and(|q| q >= FITNESS_MIN)
        }) && ring
            .iter()
            .all(|v| work.stretch_between(*v, kept) <= STRETCH_MAX);
        let at = if rounds > 0 {
            trial.position
        } else {
            attributes_position(work, kept)
        };
        let settled = work.attributes(kept);
        let done = fits
            .then(|| work.mesh.find_edge(gone, kept))
            .flatten()
            .and_then(|g| work.mesh.collapse(g, at).ok());
        let Some(v) = done else {
            work.restore(kept, &attributes);
            return false;
        };
        work.restore(v, &settled);
        work.mesh.set_position(v, at);
        let dead: Vec<u32> = faces
            .iter()
            .copied()
            .filter(|f| !stays.contains(f))
            .collect();
        self.adopt(work, &of, &trial, &stays, &dead);
        true
    }

    fn try_flip(&mut self, work: &mut Work<'_>, h: u32) -> bool {
        if work.mesh.may_flip(h).is_err() {
            return false;
        }
        let mesh = &work.mesh;
        let t = mesh.twin(h);
        let (a, b, c, d) = (
            mesh.origin(h),
            mesh.destination(h),
            mesh.apex(h),
            mesh.apex(t),
        );
        let free = |v: u32| mesh.freedom(v) == Freedom::Surface;
        let low = [a, b].iter().any(|v| free(*v) && mesh.valence(*v) <= 5);
        let high = [c, d].iter().any(|v| free(*v) && mesh.valence(*v) >= 7);
        if low || high || work.stretch_between(c, d) > STRETCH_MAX {
            return false;
        }
        let region = work.region[(h / 3) as usize];
        let fits = |ids: [u32; 3]| {
            work.fitness(&Candidate { ids, region })
                .is_some_and(|q| q >= FITNESS_MIN)
        };
        if !fits([a, d, c]) || !fits([b, c, d]) {
            return false;
        }
        let p = |v: u32| mesh.position(v);
        let of = self.targets_of(&[h / 3, t / 3]);
        // As `flip` leaves them: the face of h is (d, c, a), that of its twin (c, d, b).
        let first = rotated([p(d), p(c), p(a)], h);
        let second = rotated([p(c), p(d), p(b)], t);
        let trial = try_faces(&self.assignment.targets, &of, &[first, second]);
        let springs = (p(c) - p(d)).norm_squared() - (p(a) - p(b)).norm_squared();
        if trial.distance + self.spring * springs >= self.distance_of(&of)
            || work.mesh.flip(h).is_err()
        {
            return false;
        }
        self.adopt(work, &of, &trial, &[h / 3, t / 3], &[]);
        true
    }

    fn try_split(&mut self, work: &mut Work<'_>, h: u32) -> bool {
        let mesh = &work.mesh;
        let t = mesh.twin(h);
        let sides: Vec<u32> = [h, t].into_iter().filter(|g| *g != NONE).collect();
        let full = |v: u32| mesh.freedom(v) == Freedom::Surface && mesh.valence(v) >= 7;
        // Halves shorter than the shortest edge wanted would be collapsed again by the relaxation.
        if mesh.is_feature(h) || work.stretch(h) < 1.2 || sides.iter().any(|g| full(mesh.apex(*g)))
        {
            return false;
        }
        let (a, b) = (mesh.origin(h), mesh.destination(h));
        let p = |v: u32| mesh.position(v);
        let of = self.targets_of(&sides.iter().map(|g| g / 3).collect::<Vec<_>>());
        let mut rim = Vec::new();
        let mut spokes = vec![p(a), p(b)];
        for &g in &sides {
            let (from, to, apex) = (p(mesh.origin(g)), p(mesh.destination(g)), p(mesh.apex(g)));
            rim.extend([[apex, from], [to, apex]]);
            spokes.push(apex);
        }
        let middle = (p(a) + p(b)) * 0.5;
        let trial = try_fan(
            &self.assignment.targets,
            &of,
            &rim,
            &spokes,
            self.spring,
            middle,
            3,
        );
        let springs: f64 = spokes
            .iter()
            .map(|q| (q - trial.position).norm_squared())
            .sum();
        let change = self.spring * (springs - (p(a) - p(b)).norm_squared()) + self.price;
        if trial.distance + change >= self.distance_of(&of) {
            return false;
        }
        let Some(v) = work.split(h) else {
            return false;
        };
        let star: Vec<u32> = work.mesh.around(v).map(|g| g / 3).collect();
        self.assignment
            .of_face
            .resize(work.mesh.face_slots(), Vec::new());
        work.mesh.set_position(v, trial.position);
        // Foot points on the fan as it now stands, in the mesh's own order.
        let faces: Vec<[Vec3; 3]> = star.iter().map(|f| work.mesh.corners(*f)).collect();
        let trial = try_faces(&self.assignment.targets, &of, &faces);
        self.adopt(work, &of, &trial, &star, &[]);
        true
    }
}

fn attributes_position(work: &Work<'_>, v: u32) -> Vec3 {
    work.mesh.position(v)
}

/// The two vertices of face `f` that are neither `a` nor `b`, in the face's order after the one that is.
fn rim_of(mesh: &HalfEdgeMesh, f: u32, a: u32, b: u32) -> [u32; 2] {
    let ids = mesh.face_vertices(f);
    let at = ids.iter().position(|v| *v == a || *v == b).unwrap_or(0);
    [ids[(at + 1) % 3], ids[(at + 2) % 3]]
}

/// Corners listed from slot 0 of the face, given from the slot of half-edge `h` on.
fn rotated(mut corners: [Vec3; 3], h: u32) -> [Vec3; 3] {
    corners.rotate_right((h % 3) as usize);
    corners
}
