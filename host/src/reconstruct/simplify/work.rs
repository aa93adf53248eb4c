//! The mesh under work: connectivity, and at every vertex the surface's normals, the edge length asked
//! for and the line it lies on. Decides whether a face is fit to stay.

use super::energy::Energy;
use super::reference::Reference;
use super::sizing::{Sizing, faces_asked};
use super::{Options, Shape, Simplified};
use crate::Vec3;
use crate::mesh::{Freedom, HalfEdgeMesh, NONE, unit_or_zero};

/// A mesh on its way from dense to simple.
pub(super) struct Work<'a> {
    pub(super) reference: &'a Reference<'a>,
    pub(super) mesh: HalfEdgeMesh,
    /// Per vertex, the surface normal in every region that touches it.
    normals: Vec<Vec<(u32, Vec3)>>,
    /// Per vertex, the edges asked for.
    sizing: Vec<Sizing>,
    /// Per vertex, the line it lies on, if it may slide along one.
    pub(super) line: Vec<u32>,
    /// Per face, its region between creases.
    pub(super) region: Vec<u32>,
    limits: Limits,
}

/// Least fitness a vertex may leave its faces with on its own way, unless they were poorer.
const FLOAT_FITNESS: f64 = 0.45;

/// What a face must hold to. Cosines.
#[derive(Clone, Copy, Debug)]
struct Limits {
    /// Between the normals at two corners.
    corners: f64,
    /// Between the face's normal and that at a corner.
    face: f64,
}

/// A face as it would be after a move.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) ids: [u32; 3],
    pub(super) region: u32,
}

/// What belongs to one vertex.
#[derive(Clone, Debug)]
pub(super) struct Attributes {
    position: Vec3,
    normals: Vec<(u32, Vec3)>,
    sizing: Sizing,
    line: u32,
}

impl<'a> Work<'a> {
    pub(super) fn new(reference: &'a Reference<'a>, options: &Options) -> Self {
        let mesh = reference.half.clone();
        let mut normals: Vec<Vec<(u32, Vec3)>> = vec![Vec::new(); mesh.vertex_slots()];
        for f in mesh.faces() {
            let region = reference.region[f as usize];
            for (k, v) in mesh.face_vertices(f).into_iter().enumerate() {
                let n = reference.normals[f as usize][k];
                let list = &mut normals[v as usize];
                match list.iter_mut().find(|(r, _)| *r == region) {
                    None => list.push((region, n)),
                    // Both sides of a dart lie in one region: no single normal there.
                    Some((_, m)) if m.dot(&n) < 0.9 => *m = Vec3::zeros(),
                    Some(_) => {}
                }
            }
        }
        let turn = options.turn_max_degrees.to_radians();
        Self {
            reference,
            normals,
            sizing: reference.sizing.clone(),
            line: reference.line_of_vertices(),
            region: reference.region.clone(),
            mesh,
            limits: Limits {
                corners: (1.35 * turn).min(1.6).cos(),
                face: turn.min(1.3).cos(),
            },
        }
    }

    /// Number of faces the sizing field asks for.
    pub(super) fn target_faces(&self) -> usize {
        faces_asked(&self.reference.half, &self.reference.sizing).round() as usize
    }

    /// The surface normal at `v` as seen from `region`; zero if it has none there.
    pub(super) fn normal(&self, v: u32, region: u32) -> Vec3 {
        self.normals[v as usize]
            .iter()
            .find(|(r, _)| *r == region)
            .map_or_else(Vec3::zeros, |(_, n)| *n)
    }

    /// The normal of a vertex off all creases; zero on them.
    pub(super) fn single_normal(&self, v: u32) -> Vec3 {
        match self.normals[v as usize].as_slice() {
            [(_, n)] => *n,
            _ => Vec3::zeros(),
        }
    }

    /// How well a face would do: 1 for an equilateral triangle in the metric of the sizing field, 0 for a
    /// needle; `None` if it folds or
    /// turns too far from the surface it stands for.
    pub(super) fn fitness(&self, face: &Candidate) -> Option<f64> {
        self.fitness_with(face, NONE, Vec3::zeros())
    }

    /// As [`Self::fitness`] with vertex `moved` at `at`, its normals unchanged.
    pub(super) fn fitness_with(&self, face: &Candidate, moved: u32, at: Vec3) -> Option<f64> {
        let p = face.ids.map(|v| {
            if v == moved {
                at
            } else {
                self.mesh.position(v)
            }
        });
        let area = (p[1] - p[0]).cross(&(p[2] - p[0])) * 0.5;
        let quality = self.metric_shape(face.ids, &p).0;
        let n = unit_or_zero(area);
        if n == Vec3::zeros() {
            return None;
        }
        let corners = face.ids.map(|v| self.normal(v, face.region));
        for k in 0..3 {
            let (m, next) = (corners[k], corners[(k + 1) % 3]);
            if m == Vec3::zeros() {
                continue;
            }
            if n.dot(&m) < self.limits.face {
                return None;
            }
            if next != Vec3::zeros() && m.dot(&next) < self.limits.corners {
                return None;
            }
        }
        Some(quality)
    }

    /// Shape (1: equilateral) and area (unit: the squared length asked for) of a triangle in the metric.
    pub(super) fn metric_shape(&self, ids: [u32; 3], p: &[Vec3; 3]) -> (f64, f64) {
        let mut squared = [0.0; 3];
        for k in 0..3 {
            let d = p[(k + 1) % 3] - p[k];
            squared[k] = ids
                .iter()
                .map(|v| self.sizing[*v as usize].squared(&d))
                .sum::<f64>()
                / 3.0;
        }
        let [a, b, c] = squared;
        let sum = a + b + c;
        // Heron's formula in squared lengths: 16 area^2.
        let area = 0.25
            * (2.0 * (a * b + b * c + c * a) - (a * a + b * b + c * c))
                .max(0.0)
                .sqrt();
        (4.0 * 3f64.sqrt() * area / sum.max(f64::MIN_POSITIVE), area)
    }

    /// A face as it is.
    pub(super) fn face(&self, f: u32) -> Candidate {
        Candidate {
            ids: self.mesh.face_vertices(f),
            region: self.region[f as usize],
        }
    }

    /// Lowest fitness in the star of `v` as it is; 0 if a face does not hold at all.
    pub(super) fn star_fitness(&self, v: u32) -> f64 {
        self.mesh
            .around(v)
            .map(|h| self.fitness(&self.face(h / 3)).unwrap_or(0.0))
            .fold(1.0, f64::min)
    }

    /// Length of the edge of `h` over the length asked for there.
    pub(super) fn stretch(&self, h: u32) -> f64 {
        self.stretch_between(self.mesh.origin(h), self.mesh.destination(h))
    }

    pub(super) fn stretch_between(&self, a: u32, b: u32) -> f64 {
        let d = self.mesh.position(a) - self.mesh.position(b);
        let both = self.sizing[a as usize].squared(&d) + self.sizing[b as usize].squared(&d);
        (0.5 * both).sqrt()
    }

    /// Lowest fitness of the faces that remain if `a` is collapsed into `b` where `b` is, with no new
    /// edge stretched beyond `longest`; `None` if one does not hold.
    pub(super) fn collapse_fitness(&self, a: u32, b: u32, longest: f64) -> Option<f64> {
        let mut lowest = 1f64;
        for h in self.mesh.around(a) {
            let f = h / 3;
            let ids = self.mesh.face_vertices(f);
            if ids.contains(&b) {
                continue;
            }
            let candidate = Candidate {
                ids: ids.map(|v| if v == a { b } else { v }),
                region: self.region[f as usize],
            };
            lowest = lowest.min(self.fitness(&candidate)?);
        }
        for v in self.mesh.neighbours(a) {
            if v != b && self.stretch_between(v, b) > longest {
                return None;
            }
        }
        Some(lowest)
    }

    /// Valence a vertex should have: 6 inside, 4 on a border; at fixed vertices what the angles around it
    /// ask for, one face per 60 degrees in every sector between features.
    pub(super) fn ideal_valence(&self, v: u32) -> i64 {
        let border = self.mesh.is_border_vertex(v);
        match self.mesh.freedom(v) {
            Freedom::Surface => 6,
            Freedom::Curve if border => 4,
            Freedom::Curve => 6,
            Freedom::Fixed => {
                let (mut sum, mut faces) = (0.0, 0);
                for h in self.mesh.around(v) {
                    let (o, p) = (
                        self.mesh.position(v),
                        self.mesh.position(self.mesh.destination(h)),
                    );
                    let (u, w) = (p - o, self.mesh.position(self.mesh.apex(h)) - o);
                    sum += u.cross(&w).norm().atan2(u.dot(&w));
                    faces += 1;
                }
                let sectors = self.mesh.features_at(v).count().max(1) - usize::from(border);
                let asked = (sum / 60f64.to_radians()).round().max(sectors as f64);
                if faces == 0 {
                    0
                } else {
                    asked as i64 + i64::from(border)
                }
            }
        }
    }

    /// Gives a vertex that lies off all lines a place on the surface near `p`; `false` if there is none.
    pub(super) fn settle(&mut self, v: u32, p: &Vec3, fine: bool) -> bool {
        let Some(&(region, n)) = self.normals[v as usize].first() else {
            return false;
        };
        let foot = if fine {
            self.reference.fine_foot(p, region, &n)
        } else {
            self.reference.foot(p, region, &n)
        };
        let Some(foot) = foot else {
            return false;
        };
        self.mesh.set_position(v, foot.position);
        self.sizing[v as usize] = foot.sizing;
        self.normals[v as usize] = vec![(region, foot.normal)];
        true
    }

    /// Moves a vertex that lies off all lines to `p`, on the surface or beside it, with what belongs to
    /// the surface there; back again if its faces then break a limit that they kept before.
    pub(super) fn float(&mut self, v: u32, p: &Vec3) -> bool {
        let kept = self.attributes(v);
        let before = self.star_fitness(v);
        let mut moved = self.settle(v, p, false);
        if moved {
            self.mesh.set_position(v, *p);
            let after = self.star_fitness(v);
            moved = after > 0.0 && after >= before.min(FLOAT_FITNESS);
        }
        if !moved {
            self.restore(v, &kept);
        }
        moved
    }

    /// Moves a vertex along its line to the point closest to `p`; `false` if it lies on none.
    pub(super) fn slide(&mut self, v: u32, p: &Vec3) -> bool {
        let line = self.line[v as usize];
        if line == NONE {
            return false;
        }
        let Some(foot) = self.reference.line_foot(p, line) else {
            return false;
        };
        self.mesh.set_position(v, foot.position);
        self.sizing[v as usize] = foot.sizing;
        self.renew_normals(v);
        true
    }

    /// Looks up the normals of a vertex anew in every region that touches it.
    fn renew_normals(&mut self, v: u32) {
        let p = self.mesh.position(v);
        let mut list: Vec<(u32, Vec3)> = Vec::new();
        for h in self.mesh.around(v) {
            let region = self.region[(h / 3) as usize];
            if !list.iter().any(|(r, _)| *r == region) {
                let old = self.normal(v, region);
                let n = self
                    .reference
                    .foot(&p, region, &old)
                    .map_or(old, |foot| foot.normal);
                list.push((region, n));
            }
        }
        // In a region that lies on both sides of a crease the normal is not single.
        if self.mesh.features_at(v).any(|h| {
            self.mesh.is_crease(h)
                && self.region[(h / 3) as usize] == self.region[(self.mesh.twin(h) / 3) as usize]
        }) {
            for entry in &mut list {
                entry.1 = Vec3::zeros();
            }
        }
        self.normals[v as usize] = list;
    }

    /// Splits the edge of `h` at the surface (or on its line) near its middle; `None` if that cannot be.
    pub(super) fn split(&mut self, h: u32) -> Option<u32> {
        let (a, b) = (self.mesh.origin(h), self.mesh.destination(h));
        let middle = (self.mesh.position(a) + self.mesh.position(b)) * 0.5;
        let feature = self.mesh.is_feature(h);
        let region = self.region[(h / 3) as usize];
        let twin = self.mesh.twin(h);
        let (position, sizing, line, normal);
        if feature {
            let line_a = self.line[a as usize];
            let known = if line_a == NONE {
                self.line[b as usize]
            } else {
                line_a
            };
            let foot = self.reference.line_foot(&middle, known)?;
            (position, sizing, line, normal) =
                (foot.position, foot.sizing, foot.line, Vec3::zeros());
        } else {
            let toward = self.normal(a, region) + self.normal(b, region);
            let foot = self.reference.foot(&middle, region, &toward)?;
            (position, sizing, line, normal) = (foot.position, foot.sizing, NONE, foot.normal);
        }
        let faces = self.mesh.face_slots();
        let v = self.mesh.split(h, position).ok()?;
        self.sizing.push(sizing);
        self.line.push(line);
        self.normals.push(vec![(region, normal)]);
        self.region.resize(self.mesh.face_slots(), region);
        if twin != NONE {
            // The face cut from the twin's side is the second new one.
            self.region[faces + 1] = self.region[(twin / 3) as usize];
        }
        if feature {
            self.renew_normals(v);
        }
        Some(v)
    }

    /// Gives vertex `to` what belongs to `from` beside its position.
    pub(super) fn copy_attributes(&mut self, from: u32, to: u32) {
        let kept = self.attributes(from);
        self.restore(to, &kept);
    }

    /// Everything that moving a vertex changes.
    pub(super) fn attributes(&self, v: u32) -> Attributes {
        Attributes {
            position: self.mesh.position(v),
            normals: self.normals[v as usize].clone(),
            sizing: self.sizing[v as usize],
            line: self.line[v as usize],
        }
    }

    /// Puts a vertex back.
    pub(super) fn restore(&mut self, v: u32, kept: &Attributes) {
        self.mesh.set_position(v, kept.position);
        self.normals[v as usize].clone_from(&kept.normals);
        self.sizing[v as usize] = kept.sizing;
        self.line[v as usize] = kept.line;
    }

    /// Writes the result out.
    pub(super) fn finish(self, energy: Option<[Energy; 2]>) -> Simplified {
        let shape = self.shape();
        let compact = self.mesh.compact();
        let number = |v: u32| compact.vertices.binary_search(&v).unwrap_or_default() as u32;
        let mut border: Vec<[u32; 2]> = self
            .mesh
            .edges()
            .filter(|h| self.mesh.is_border(*h))
            .map(|h| {
                let (a, b) = (
                    number(self.mesh.origin(h)),
                    number(self.mesh.destination(h)),
                );
                [a.min(b), a.max(b)]
            })
            .collect();
        border.sort_unstable();
        let ids = &compact.vertices;
        Simplified {
            border,
            corners: (0..ids.len() as u32)
                .filter(|v| self.mesh.freedom(ids[*v as usize]) == Freedom::Fixed)
                .collect(),
            normals: ids.iter().map(|v| self.single_normal(*v)).collect(),
            sizes: ids.iter().map(|v| self.sizing[*v as usize].size).collect(),
            energy,
            shape,
            creases: compact.creases,
            mesh: compact.mesh,
        }
    }

    fn shape(&self) -> Shape {
        let mut shape = Shape::default();
        let valences: Vec<usize> = self
            .mesh
            .vertices()
            .filter(|v| self.mesh.freedom(*v) == Freedom::Surface)
            .map(|v| self.mesh.valence(v))
            .collect();
        if let (Some(low), Some(high)) = (valences.iter().min(), valences.iter().max()) {
            shape.valence = [*low, *high];
            let good = valences.iter().filter(|n| (5..=7).contains(*n)).count();
            shape.valence_5_to_7 = good as f64 / valences.len() as f64;
        }
        let mut smallest = f64::INFINITY;
        for f in self.mesh.faces() {
            let p = self.mesh.corners(f);
            let n = self
                .mesh
                .face_vertices(f)
                .map(|v| self.normal(v, self.region[f as usize]));
            for k in 0..3 {
                let (u, w) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
                smallest = smallest.min(u.cross(&w).norm().atan2(u.dot(&w)));
                let (m, next) = (n[k], n[(k + 1) % 3]);
                if m != Vec3::zeros() && next != Vec3::zeros() {
                    let turn = m.cross(&next).norm().atan2(m.dot(&next));
                    shape.turn_max_degrees = shape.turn_max_degrees.max(turn.to_degrees());
                }
            }
        }
        shape.angle_min_degrees = smallest.to_degrees();
        shape
    }
}
