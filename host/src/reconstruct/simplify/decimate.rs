//! The bulk of the way down: short edges are collapsed until the sizing field's number of faces is left.
//!
//! Every collapse moves one end into the other, so the vertices stay a subset of the dense mesh's, with
//! their normals known and no projection to compute. Shortest first, measured in the length asked for
//! there: the remaining vertices keep a distance of about that length from one another. Two other
//! orders were weighed: quadric error (Garland and Heckbert 1997) follows the shape better at equal
//! counts but makes thin triangles and valences of 9 to 11, which the patch fit cannot
//! stand; Hoppe's energy is two orders of magnitude slower and is applied afterwards.

use super::work::Work;
use crate::mesh::{CollapseTo, HalfEdgeMesh};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// No new edge may be stretched beyond this: a collapse of an edge of length 1 between neighbours at
/// distance 1 makes edges of up to 1.73.
const STRETCH_MAX: f64 = 1.75;

/// A face may be this poor (1: equilateral) if it was no better before. 0.3 is a right triangle with
/// legs 1 : 6.
const FITNESS_MIN: f64 = 0.3;

#[derive(Clone, Copy, PartialEq)]
struct Entry {
    cost: f64,
    half_edge: u32,
    /// Ends when it was entered; entries whose edge has changed since are skipped.
    ends: [u32; 2],
    stamp: u32,
}

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.cost
            .total_cmp(&other.cost)
            .then(self.ends.cmp(&other.ends))
            .then(self.half_edge.cmp(&other.half_edge))
    }
}

/// Edges by the length asked for, shortest first. Only those that a collapse stretches anew, and those refused before where it
/// changes the star, are entered again: a fourth of the edges around.
struct Queue {
    entries: BinaryHeap<Reverse<Entry>>,
    /// Per half-edge: goes up when its edge is entered, so that earlier entries are skipped.
    stamps: Vec<u32>,
    /// Per half-edge: its collapse was refused, and nothing has changed there since.
    refused: Vec<bool>,
}

/// Collapses until at most `target` faces are left or no collapse holds to the limits.
pub(super) fn decimate(work: &mut Work<'_>, target: usize) {
    let half_edges = 3 * work.mesh.face_slots();
    let mut queue = Queue {
        entries: BinaryHeap::new(),
        stamps: vec![0; half_edges],
        refused: vec![false; half_edges],
    };
    for h in work.mesh.edges() {
        queue.enter(work, h);
    }
    let mut edges: Vec<u32> = Vec::new();
    while work.mesh.face_count() > target.max(4) {
        let Some(Reverse(entry)) = queue.entries.pop() else {
            break;
        };
        let h = entry.half_edge;
        // An edge goes by the lower of its half-edges; collapses beside it may bring a lower one.
        if !work.mesh.is_live(h)
            || work.mesh.twin(h) < h
            || ends(&work.mesh, h) != entry.ends
            || entry.stamp != queue.stamps[h as usize]
        {
            continue;
        }
        let Some(kept) = collapse_best(work, h, STRETCH_MAX, FITNESS_MIN) else {
            queue.refused[h as usize] = true;
            continue;
        };
        // The star has changed: what was refused there may now be allowed, and the other way round.
        edges.clear();
        for v in work.mesh.neighbours(kept).chain([kept]) {
            for g in work.mesh.around(v) {
                edges.extend([g, HalfEdgeMesh::prev(g)]);
            }
        }
        for e in &mut edges {
            let t = work.mesh.twin(*e);
            *e = (*e).min(t);
        }
        edges.sort_unstable();
        edges.dedup();
        for e in &edges {
            if queue.refused[*e as usize] || ends(&work.mesh, *e).contains(&kept) {
                queue.enter(work, *e);
            }
        }
    }
}

fn ends(mesh: &HalfEdgeMesh, h: u32) -> [u32; 2] {
    let (a, b) = (mesh.origin(h), mesh.destination(h));
    [a.min(b), a.max(b)]
}

impl Queue {
    fn enter(&mut self, work: &Work<'_>, h: u32) {
        let ends = ends(&work.mesh, h);
        let cost = work.stretch(h);
        let stamp = &mut self.stamps[h as usize];
        *stamp += 1;
        self.refused[h as usize] = false;
        if cost < STRETCH_MAX {
            self.entries.push(Reverse(Entry {
                cost,
                half_edge: h,
                ends,
                stamp: *stamp,
            }));
        }
    }
}

/// Collapses the edge of `h` into whichever end leaves the better faces, if the rules and limits allow
/// either. Returns the vertex that stays.
pub(super) fn collapse_best(work: &mut Work<'_>, h: u32, longest: f64, least: f64) -> Option<u32> {
    let mesh = &work.mesh;
    let to = mesh.may_collapse(h).ok()?;
    let (a, b) = (mesh.origin(h), mesh.destination(h));
    let mut best: Option<(f64, u32, u32)> = None;
    for (gone, kept) in [(a, b), (b, a)] {
        if let CollapseTo::Vertex(v) = to
            && v != kept
        {
            continue;
        }
        let Some(fitness) = work.collapse_fitness(gone, kept, longest) else {
            continue;
        };
        let enough = least.min(work.star_fitness(gone));
        if fitness >= enough && best.is_none_or(|(f, _, _)| fitness > f) {
            best = Some((fitness, gone, kept));
        }
    }
    let (_, gone, kept) = best?;
    let position = work.mesh.position(kept);
    // The half-edge from the vertex that goes to the one that stays; a border edge may only have the
    // other, and then the other vertex's index stays with this one's attributes.
    if let Some(g) = work.mesh.find(gone, kept) {
        work.mesh.collapse(g, position).ok()
    } else {
        let g = work.mesh.find(kept, gone)?;
        let v = work.mesh.collapse(g, position).ok()?;
        work.copy_attributes(kept, v);
        Some(v)
    }
}
