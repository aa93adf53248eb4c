//! Cuts a dense mesh along the lines where sheets meet, and puts its vertices onto sheets, lines and corners.

use super::Creased;
use super::regions::{Regions, SHEET_POINTS};
use super::sheet::{Piece, Sheet, meet};
use crate::Vec3;
use crate::mesh::{HalfEdgeMesh, MeshError, NONE, TriangleMesh};
use crate::reconstruct::extract::Field;
use crate::reconstruct::quadric::Quadric;
use crate::reconstruct::simplify::CreaseLines;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// How far, in typical distances of the points, the extraction rounds a crease off: vertices nearer than this
/// are put back onto their sheet, less and less with the distance.
const ROUNDED: f64 = 2.5;
/// Points among which the sheets near a vertex are looked for.
const NEAREST: usize = 24;

/// What the mesh knows about its vertices while it is cut.
pub(super) struct Cutting<'a, 'b> {
    regions: &'a Regions<'b>,
    /// Pairs of sheets that break, sorted.
    sharp: &'a [[u32; 2]],
    /// The planes and quadrics that are all of a sheet.
    whole: BTreeMap<u32, Quadric>,
    pub(super) mesh: HalfEdgeMesh,
    /// Per vertex, the sheets it belongs to: one, two on a crease, three and more in a corner.
    pub(super) sheets: Vec<Vec<u32>>,
    /// Per vertex near a crease, its sheets there with their normals; empty elsewhere.
    pub(super) near: Vec<Vec<(u32, Piece, Vec3)>>,
}

/// Cuts `mesh` between the `sharp` pairs (sorted) of the sheets of `regions`; the `field` it was extracted from tells the
/// sheet of a place on it and which sheets are one plane or quadric.
///
/// Two ways were weighed to tell the sheet of a vertex: to ask the points near by, which know nothing of a sheet that no track
/// follows up to its edge (half a block's end, 0.25 of its length without a touch, was cut as the side beside it), and to
/// ask the field that the mesh was extracted from. The second is taken, the first stands in for fields without sheets.
pub(super) fn cut(
    regions: &Regions<'_>,
    sharp: &[[u32; 2]],
    mesh: &TriangleMesh,
    field: Option<&Field>,
    turn_min: f64,
) -> Result<Creased, MeshError> {
    let half = HalfEdgeMesh::new(mesh)?;
    let normals = mesh.vertex_normals();
    let mut work = Cutting {
        regions,
        sharp,
        sheets: (0..half.vertex_slots())
            .into_par_iter()
            .map(|v| {
                let p = half.position(v as u32);
                let known = field.and_then(|f| f.sheet(&p));
                vec![known.unwrap_or_else(|| owner(regions, &p, &normals[v]))]
            })
            .collect(),
        whole: (regions.names().into_iter())
            .filter_map(|l| Some((l, field?.whole_sheet(l)?)))
            .collect(),
        mesh: half,
        near: Vec::new(),
    };
    work.smooth_labels();
    work.split_between();
    work.mark_corners();
    work.tag(turn_min);
    work.place();
    let edges: Vec<f64> = work.mesh.edges().map(|h| work.mesh.length(h)).collect();
    work.tidy(edges.iter().sum::<f64>() / edges.len().max(1) as f64);
    Ok(work.finish())
}

/// The sheet that a point of the rounded surface belongs to.
fn owner(regions: &Regions<'_>, p: &Vec3, normal: &Vec3) -> u32 {
    let near = regions.tree.nearest(p, NEAREST);
    let mut labels: Vec<u32> = Vec::new();
    for (j, _) in &near {
        let label = regions.label[*j];
        if label != NONE && regions.points[*j].normal.dot(normal) > 0.0 && !labels.contains(&label)
        {
            labels.push(label);
        }
    }
    let Some(&nearest) = labels.first() else {
        return near
            .iter()
            .map(|(j, _)| regions.label[*j])
            .find(|l| *l != NONE)
            .unwrap_or(NONE);
    };
    if labels.len() == 1 {
        return nearest;
    }
    let sheets: Vec<(u32, Sheet)> = labels
        .iter()
        .filter_map(|l| Some((*l, regions.sheet(*l, p, SHEET_POINTS)?)))
        .collect();
    // The one that wins against every other it breaks with.
    let mut best: Option<(usize, f64, u32)> = None;
    for (l, a) in &sheets {
        let mut wins = 0;
        for (m, b) in sheets.iter().filter(|(m, _)| m != l) {
            let broken = regions.sharp.contains(&[*l.min(m), *l.max(m)]);
            if broken && beats(regions, (*l, a), (*m, b), p) {
                wins += 1;
            }
        }
        let off = a.distance(p).abs();
        if best.is_none_or(|(w, o, _)| wins > w || (wins == w && off < o)) {
            best = Some((wins, off, *l));
        }
    }
    best.map_or(nearest, |(_, _, l)| l)
}

/// Whether `p` lies on the side of sheet `a` of the line where both sheets meet. Where the solid lies
/// behind both sheets (an outer edge) the surface follows the one that is nearer to being left; where it
/// lies behind either (an inner edge) the other.
fn beats(regions: &Regions<'_>, a: (u32, &Sheet), b: (u32, &Sheet), p: &Vec3) -> bool {
    let side = |of: u32, sheet: &Sheet| {
        let mut sum = 0.0;
        for (j, _) in regions.tree.nearest(p, 2 * NEAREST) {
            if regions.label[j] == of {
                sum += sheet.distance(&regions.points[j].position);
            }
        }
        sum
    };
    let outer = side(a.0, b.1) + side(b.0, a.1) < 0.0;
    let (da, db) = (a.1.distance(p), b.1.distance(p));
    if outer { da >= db } else { da <= db }
}

impl Cutting<'_, '_> {
    fn label(&self, v: u32) -> u32 {
        self.sheets[v as usize].first().copied().unwrap_or(NONE)
    }

    /// Single vertices labelled otherwise than all but one of their neighbours follow those.
    fn smooth_labels(&mut self) {
        for _ in 0..3 {
            let mut changed = false;
            for v in self.mesh.vertices().collect::<Vec<_>>() {
                let mut count: BTreeMap<u32, usize> = BTreeMap::new();
                let mut all = 0;
                for w in self.mesh.neighbours(v) {
                    *count.entry(self.label(w)).or_default() += 1;
                    all += 1;
                }
                let own = count.get(&self.label(v)).copied().unwrap_or(0);
                let most = count
                    .iter()
                    .max_by_key(|(l, n)| (**n, std::cmp::Reverse(**l)));
                if let Some((l, n)) = most
                    && own <= 1
                    && n + 1 >= all
                    && *l != NONE
                    && *l != self.label(v)
                {
                    self.sheets[v as usize] = vec![*l];
                    changed = true;
                }
            }
            if !changed {
                break;
            }
        }
    }

    fn broken(&self, a: u32, b: u32) -> bool {
        self.sharp.binary_search(&[a.min(b), a.max(b)]).is_ok()
    }

    /// Splits every edge whose ends lie on different sheets that break with one another.
    fn split_between(&mut self) {
        // A split moves the neighbouring half-edges of its faces to new places: what a pass misses for that,
        // the next one meets. New vertices carry two sheets, so the passes end.
        let mut before = usize::MAX;
        while self.sheets.len() != before {
            before = self.sheets.len();
            self.split_once();
        }
    }

    fn split_once(&mut self) {
        for h in self.mesh.edges().collect::<Vec<_>>() {
            let (v, w) = (self.mesh.origin(h), self.mesh.destination(h));
            // Ends that are themselves new carry two sheets; edges between those are the crease.
            if self.sheets[v as usize].len() != 1 || self.sheets[w as usize].len() != 1 {
                continue;
            }
            let (a, b) = (self.label(v), self.label(w));
            if a == b || !self.broken(a, b) {
                continue;
            }
            let (p, q) = (self.mesh.position(v), self.mesh.position(w));
            let middle = (p + q) * 0.5;
            let at = self
                .near_by(a, &middle)
                .zip(self.near_by(b, &middle))
                .map_or(0.5, |(a, b)| {
                    // Where both sheets are equally far, between the ends.
                    let (s, t) = (
                        a.distance(&p) - b.distance(&p),
                        a.distance(&q) - b.distance(&q),
                    );
                    let t = s / (s - t);
                    if t.is_finite() {
                        t.clamp(0.1, 0.9)
                    } else {
                        0.5
                    }
                });
            if let Ok(m) = self.mesh.split(h, p + (q - p) * at) {
                debug_assert_eq!(m as usize, self.sheets.len());
                self.sheets.push(vec![a.min(b), a.max(b)]);
            }
        }
    }

    /// Puts a vertex into every face between three creases of three sheets, joined to all three.
    fn mark_corners(&mut self) {
        for f in self.mesh.faces().collect::<Vec<_>>() {
            let ids = self.mesh.face_vertices(f);
            let mut all: Vec<u32> = Vec::new();
            for v in ids {
                for &l in &self.sheets[v as usize] {
                    if !all.contains(&l) {
                        all.push(l);
                    }
                }
            }
            if all.len() < 3 {
                continue;
            }
            all.sort_unstable();
            // After the splits such a face holds two crease vertices of different pairs; the edge between
            // the first and the old vertex opposite to it runs through the corner.
            for k in 0..3 {
                let h = 3 * f + k;
                let (v, w) = (self.mesh.origin(h), self.mesh.destination(h));
                let (s, t) = (&self.sheets[v as usize], &self.sheets[w as usize]);
                let through = (s.len() == 2 && t.len() == 1 && !s.contains(&t[0]))
                    || (t.len() == 2 && s.len() == 1 && !t.contains(&s[0]));
                if through {
                    let middle = (self.mesh.position(v) + self.mesh.position(w)) * 0.5;
                    if self.mesh.split(h, middle).is_ok() {
                        self.sheets.push(all.clone());
                    }
                    break;
                }
            }
        }
    }

    /// All of a sheet where one plane or quadric is, or what its points near `at` show.
    fn near_by(&self, label: u32, at: &Vec3) -> Option<Piece> {
        let whole = self.whole.get(&label).copied().map(Piece::Whole);
        whole.or_else(|| Some(Piece::Near(self.regions.sheet(label, at, SHEET_POINTS)?)))
    }

    /// The same from as many points as one height field explains.
    fn far_off(&self, label: u32, at: &Vec3) -> Option<Piece> {
        let whole = self.whole.get(&label).copied().map(Piece::Whole);
        whole.or_else(|| Some(Piece::Near(self.regions.wide_sheet(label, at)?)))
    }

    /// The nearest point to `p` on all sheets of vertex `v`. Of sheets that do not break with one another (pieces of one face)
    /// the first counts: they meet anywhere.
    pub(super) fn on_sheets(&self, v: u32, p: &Vec3) -> Option<Vec3> {
        let known = self.near.get(v as usize).filter(|list| !list.is_empty());
        let mut labels: Vec<u32> = Vec::new();
        let mut pieces = Vec::new();
        for &label in &self.sheets[v as usize] {
            if pieces.len() == 3 || !labels.iter().all(|l| self.broken(*l, label)) {
                continue;
            }
            let piece = match known {
                Some(list) => list.iter().find(|(l, _, _)| *l == label).map(|n| n.1),
                None => self.far_off(label, p),
            };
            if let Some(piece) = piece {
                labels.push(label);
                pieces.push(piece);
            }
        }
        if pieces.is_empty() {
            return None;
        }
        meet(&pieces, p, ROUNDED * self.regions.spacing)
    }

    /// Puts crease vertices and corners where their sheets meet, and the rounded strip beside them back
    /// onto its sheet; notes the sheets' normals at all of them.
    fn place(&mut self) {
        let reach = ROUNDED * self.regions.spacing;
        let mut way = vec![f64::INFINITY; self.mesh.vertex_slots()];
        let mut queue: Vec<u32> = Vec::new();
        for v in self.mesh.vertices().collect::<Vec<_>>() {
            if self.sheets[v as usize].len() < 2 {
                continue;
            }
            way[v as usize] = 0.0;
            queue.push(v);
            if let Some(x) = self.on_sheets(v, &self.mesh.position(v)) {
                self.mesh.set_position(v, x);
            }
        }
        // Distances along the mesh from the creases, by relaxation: few rings are reached.
        let mut at = 0;
        while at < queue.len() {
            let v = queue[at];
            at += 1;
            let p = self.mesh.position(v);
            for w in self.mesh.neighbours(v).collect::<Vec<_>>() {
                let reached = way[v as usize] + (self.mesh.position(w) - p).norm();
                if reached < reach && reached < way[w as usize] - 1e-12 * reach {
                    way[w as usize] = reached;
                    queue.push(w);
                }
            }
        }
        self.near = vec![Vec::new(); self.mesh.vertex_slots()];
        for v in self.mesh.vertices().collect::<Vec<_>>() {
            let d = way[v as usize];
            if !d.is_finite() {
                continue;
            }
            let p = self.mesh.position(v);
            for l in self.sheets[v as usize].clone() {
                let Some(sheet) = self.far_off(l, &p) else {
                    continue;
                };
                self.near[v as usize].push((l, sheet, sheet.normal(&p)));
                // Whole over the first half of the way, then fading.
                let share = (2.0 * (1.0 - d / reach)).min(1.0);
                let step = sheet.distance(&p) * share;
                if d > 0.0 && step.abs() < reach {
                    self.mesh.set_position(v, p - sheet.normal(&p) * step);
                }
            }
        }
    }

    /// Tags the edges between crease vertices whose sheets meet at an angle there.
    fn tag(&mut self, turn_min: f64) {
        for h in self.mesh.edges().collect::<Vec<_>>() {
            if self.mesh.is_border(h) {
                continue;
            }
            let (v, w) = (self.mesh.origin(h), self.mesh.destination(h));
            let both: Vec<u32> = self.sheets[v as usize]
                .iter()
                .copied()
                .filter(|l| self.sheets[w as usize].contains(l))
                .collect();
            let [a, b] = both.as_slice() else {
                continue;
            };
            let middle = (self.mesh.position(v) + self.mesh.position(w)) * 0.5;
            let sheets = [*a, *b].map(|l| self.near_by(l, &middle));
            let [Some(a), Some(b)] = sheets else {
                continue;
            };
            if a.normal(&middle).dot(&b.normal(&middle)) < (0.5 * turn_min).cos() {
                self.mesh.set_crease(h, true);
            }
        }
    }

    fn finish(self) -> Creased {
        let compact = self.mesh.compact();
        Creased {
            lines: CreaseLines {
                edges: compact.creases,
                corners: Vec::new(),
            },
            mesh: compact.mesh,
            ..Creased::default()
        }
    }
}
