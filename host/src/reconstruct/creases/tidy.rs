//! After the cut: short edges and thin or folded triangles along the creases are removed, so that what
//! follows can rely on the normals of the faces there.

use super::cut::Cutting;
use crate::Vec3;
use crate::mesh::{CollapseTo, Freedom, HalfEdgeMesh, NONE, unit_or_zero};

/// Edges shorter than this share of the mean edge are collapsed.
const SHORT: f64 = 0.45;
/// Triangles poorer than this (1: equilateral) are worked on.
const POOR: f64 = 0.35;
/// Least cosine between a face and the sheet it stands for.
const UPRIGHT: f64 = 0.5;

impl Cutting<'_, '_> {
    /// Works on all faces that touch a vertex near a crease.
    pub(super) fn tidy(&mut self, mean_edge: f64) {
        for _ in 0..3 {
            self.collapse_short(SHORT * mean_edge);
            self.mend_poor();
            self.even_out();
        }
        self.collapse_short(SHORT * mean_edge);
        self.mend_poor();
    }

    fn is_near(&self, v: u32) -> bool {
        !self.near[v as usize].is_empty()
    }

    fn normal(&self, v: u32, label: u32) -> Option<Vec3> {
        let list = &self.near[v as usize];
        list.iter()
            .find(|(l, _, _)| *l == label)
            .map(|(_, _, n)| *n)
    }

    /// Shape of a face with the given corners; 0 or less if it does not stand for its sheet.
    fn worth(&self, ids: [u32; 3], label: u32) -> f64 {
        let p = ids.map(|v| self.mesh.position(v));
        let area = (p[1] - p[0]).cross(&(p[2] - p[0])) * 0.5;
        let sides: f64 = (0..3).map(|k| (p[(k + 1) % 3] - p[k]).norm_squared()).sum();
        let n = unit_or_zero(area);
        let upright = ids
            .iter()
            .filter_map(|v| self.normal(*v, label))
            .map(|m| m.dot(&n))
            .fold(1.0, f64::min);
        if upright < UPRIGHT {
            return upright - 1.0;
        }
        4.0 * 3f64.sqrt() * area.norm() / sides.max(f64::MIN_POSITIVE)
    }

    fn face_worth(&self, f: u32) -> f64 {
        self.worth(self.mesh.face_vertices(f), self.face_label(f))
    }

    /// The sheet a face lies on: the one all its corners share.
    pub(super) fn face_label(&self, f: u32) -> u32 {
        let [a, b, c] = self.mesh.face_vertices(f).map(|v| &self.sheets[v as usize]);
        let shared = a.iter().find(|l| b.contains(l) && c.contains(l));
        shared.or(a.first()).copied().unwrap_or(NONE)
    }

    fn collapse_short(&mut self, limit: f64) {
        let mut short: Vec<(f64, u32)> = self
            .mesh
            .edges()
            .filter(|h| {
                self.is_near(self.mesh.origin(*h)) || self.is_near(self.mesh.destination(*h))
            })
            .map(|h| (self.mesh.length(h), h))
            .filter(|(length, _)| *length < limit)
            .collect();
        short.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, h) in short {
            if self.mesh.is_live(h) && self.mesh.length(h) < limit {
                self.collapse(h);
            }
        }
    }

    /// Collapses an edge into the end that leaves the better faces, if they are no poorer than before or
    /// good enough.
    fn collapse(&mut self, h: u32) -> bool {
        let Ok(to) = self.mesh.may_collapse(h) else {
            return false;
        };
        let (a, b) = (self.mesh.origin(h), self.mesh.destination(h));
        let mut best: Option<(f64, u32, u32)> = None;
        for (gone, kept) in [(a, b), (b, a)] {
            if matches!(to, CollapseTo::Vertex(v) if v != kept) {
                continue;
            }
            // What remains must still lie on every sheet of what goes.
            let covers = self.sheets[gone as usize]
                .iter()
                .all(|l| self.sheets[kept as usize].contains(l));
            if !covers {
                continue;
            }
            let (mut before, mut after) = (f64::INFINITY, f64::INFINITY);
            for g in self.mesh.around(gone) {
                let ids = self.mesh.face_vertices(g / 3);
                let label = self.face_label(g / 3);
                before = before.min(self.worth(ids, label));
                if !ids.contains(&kept) {
                    after =
                        after.min(self.worth(ids.map(|v| if v == gone { kept } else { v }), label));
                }
            }
            if after >= before.min(POOR) && best.is_none_or(|(w, _, _)| after > w) {
                best = Some((after, gone, kept));
            }
        }
        let Some((_, gone, kept)) = best else {
            return false;
        };
        let at = self.mesh.position(kept);
        let (Some(g), kept_sheets, kept_near) = (
            self.mesh.find_edge(gone, kept),
            self.sheets[kept as usize].clone(),
            self.near[kept as usize].clone(),
        ) else {
            return false;
        };
        match self.mesh.collapse(g, at) {
            Ok(v) => {
                self.sheets[v as usize] = kept_sheets;
                self.near[v as usize] = kept_near;
                true
            }
            Err(_) => false,
        }
    }

    /// Flips the longest edge of poor faces, or collapses their shortest.
    fn mend_poor(&mut self) {
        for f in self.mesh.faces().collect::<Vec<_>>() {
            if !self.mesh.is_live(3 * f)
                || !self.mesh.face_vertices(f).iter().any(|v| self.is_near(*v))
            {
                continue;
            }
            if self.face_worth(f) >= POOR {
                continue;
            }
            let mut sides = [3 * f, 3 * f + 1, 3 * f + 2];
            sides.sort_by(|a, b| self.mesh.length(*b).total_cmp(&self.mesh.length(*a)));
            if !sides.iter().any(|h| self.flip(*h)) {
                self.collapse(sides[2]);
            }
        }
    }

    fn flip(&mut self, h: u32) -> bool {
        if self.mesh.may_flip(h).is_err() {
            return false;
        }
        let t = self.mesh.twin(h);
        let (a, b, c, d) = (
            self.mesh.origin(h),
            self.mesh.destination(h),
            self.mesh.apex(h),
            self.mesh.apex(t),
        );
        let label = self.face_label(h / 3);
        if label != self.face_label(t / 3) {
            return false;
        }
        let before = self.face_worth(h / 3).min(self.face_worth(t / 3));
        let after = self
            .worth([a, d, c], label)
            .min(self.worth([b, c, d], label));
        after > before + 0.02 && self.mesh.flip(h).is_ok()
    }

    /// Moves vertices on and beside the creases towards the middle of their neighbours, along the line or
    /// the sheet.
    fn even_out(&mut self) {
        for v in self.mesh.vertices().collect::<Vec<_>>() {
            if !self.is_near(v) || self.mesh.is_border_vertex(v) {
                continue;
            }
            let p = self.mesh.position(v);
            let ring: Vec<u32> = match self.mesh.freedom(v) {
                Freedom::Fixed => continue,
                Freedom::Curve => self
                    .mesh
                    .features_at(v)
                    .map(|h| self.mesh.other_end(h, v))
                    .collect(),
                Freedom::Surface => self.mesh.neighbours(v).collect(),
            };
            let mean: Vec3 =
                ring.iter().map(|w| self.mesh.position(*w)).sum::<Vec3>() / ring.len() as f64;
            let step = (mean - p) * 0.7;
            let Some(at) = self.on_sheets(v, &(p + step)) else {
                continue;
            };
            let before = self.star_worth(v);
            self.mesh.set_position(v, at);
            if self.star_worth(v) < before.min(POOR) {
                self.mesh.set_position(v, p);
            }
        }
    }

    fn star_worth(&self, v: u32) -> f64 {
        self.mesh
            .around(v)
            .map(|h: u32| self.face_worth(HalfEdgeMesh::face_of(h)))
            .fold(f64::INFINITY, f64::min)
    }
}
