//! A triangle mesh whose connectivity can be changed: every edge knows both its faces.
//!
//! Promise: a [`HalfEdgeMesh`] is always an oriented 2-manifold, with or without borders, in which no two
//! edges share both ends. It is only made from a mesh that is one, and the moves ([`super::moves`]) refuse
//! what would break it ([`super::legal`]).
//!
//! Two structures were weighed. Linked records (vertex, edge, face objects with `next` and `prev`) take
//! faces of any size, at the price of four links per half-edge that must agree. Here all faces are
//! triangles, so half-edge `3 f + k` can run from corner `k` to corner `k + 1` of face `f`: `next`, `prev`
//! and `face` are arithmetic, and only `origin` and `twin` are stored. That one was taken: half the memory,
//! and half of the ways to be inconsistent cannot be written down.
//!
//! Border edges have a half-edge on their one face only, whose twin is [`NONE`]. The half-edge stored
//! for a border vertex is the one that has no twin, so that walking counter-clockwise from it meets all
//! its faces.

use super::TriangleMesh;
use crate::Vec3;
use thiserror::Error;

/// No half-edge, no vertex.
pub const NONE: u32 = u32::MAX;

/// Why a mesh is not an oriented manifold. Indices are those of the mesh that was handed in.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MeshError {
    /// More vertices or faces than 32-bit indices can tell apart.
    #[error(
        "{faces} faces and {vertices} vertices are more than fit 32-bit indices; split the mesh"
    )]
    TooLarge {
        /// Faces of the mesh.
        faces: usize,
        /// Vertices of the mesh.
        vertices: usize,
    },
    /// A face names a vertex that does not exist.
    #[error(
        "face {face} names vertex {vertex}, but there are {count}; drop the face or add the vertex"
    )]
    NoSuchVertex {
        /// The face.
        face: usize,
        /// The index it names.
        vertex: u32,
        /// Number of vertices.
        count: usize,
    },
    /// A face names one vertex twice.
    #[error("face {face} names vertex {vertex} twice; drop the face")]
    RepeatedVertex {
        /// The face.
        face: usize,
        /// The vertex.
        vertex: u32,
    },
    /// A vertex that a face uses has a coordinate that is not a finite number.
    #[error("vertex {vertex} has a coordinate that is not finite; drop its faces")]
    NotFinite {
        /// The vertex.
        vertex: u32,
    },
    /// More than two faces share an edge.
    #[error("edge {a}-{b} has {faces} faces, at most two can share one; cut the mesh along it")]
    NonManifoldEdge {
        /// One end.
        a: u32,
        /// The other end.
        b: u32,
        /// Number of faces at the edge.
        faces: usize,
    },
    /// Two faces run through their edge in the same direction.
    #[error("the two faces at edge {a}-{b} face opposite ways; turn one of them over")]
    Misoriented {
        /// One end.
        a: u32,
        /// The other end.
        b: u32,
    },
    /// The faces of a vertex form more than one fan.
    #[error(
        "the faces at vertex {vertex} touch in that vertex only; give each fan a vertex of its own"
    )]
    NonManifoldVertex {
        /// The vertex.
        vertex: u32,
    },
}

/// An oriented manifold of triangles. Vertices, faces and half-edges are named by index; an index stays
/// valid until a collapse removes what it names. Edges may be tagged as creases, vertices as pinned.
#[derive(Clone, Debug, Default)]
pub struct HalfEdgeMesh {
    pub(super) positions: Vec<Vec3>,
    /// Per vertex a half-edge leaving it, the twinless one at a border; [`NONE`] once removed.
    pub(super) outgoing: Vec<u32>,
    pub(super) pinned: Vec<bool>,
    /// Per half-edge; [`NONE`] in faces that were removed.
    pub(super) origin: Vec<u32>,
    pub(super) twin: Vec<u32>,
    pub(super) crease: Vec<bool>,
    pub(super) live_faces: usize,
    pub(super) live_vertices: usize,
}

/// A half-edge mesh written out without gaps, and where everything came from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compact {
    /// The mesh. Vertices no face uses are gone.
    pub mesh: TriangleMesh,
    /// Per vertex of `mesh`, its index in the half-edge mesh.
    pub vertices: Vec<u32>,
    /// Per face of `mesh`, its index in the half-edge mesh.
    pub faces: Vec<u32>,
    /// Crease edges by their ends in `mesh`, the lower index first, in rising order.
    pub creases: Vec<[u32; 2]>,
    /// Pinned vertices of `mesh`, in rising order.
    pub pinned: Vec<u32>,
}

impl HalfEdgeMesh {
    /// Takes over an indexed mesh. Vertices that no face uses keep their index and count as removed.
    ///
    /// # Errors
    /// The first reason found why `mesh` is not an oriented manifold.
    pub fn new(mesh: &TriangleMesh) -> Result<Self, MeshError> {
        let (faces, count) = (mesh.faces.len(), mesh.positions.len());
        if faces >= (NONE / 3) as usize || count >= NONE as usize {
            return Err(MeshError::TooLarge {
                faces,
                vertices: count,
            });
        }
        let mut sides = Vec::with_capacity(3 * faces);
        let mut incident = vec![0u32; count];
        let mut origin = Vec::with_capacity(3 * faces);
        for (face, ids) in mesh.faces.iter().enumerate() {
            for k in 0..3 {
                let (v, w) = (ids[k], ids[(k + 1) % 3]);
                let Some(p) = mesh.positions.get(v as usize) else {
                    return Err(MeshError::NoSuchVertex {
                        face,
                        vertex: v,
                        count,
                    });
                };
                if v == w {
                    return Err(MeshError::RepeatedVertex { face, vertex: v });
                }
                if !p.iter().all(|x| x.is_finite()) {
                    return Err(MeshError::NotFinite { vertex: v });
                }
                incident[v as usize] += 1;
                sides.push((v.min(w), v.max(w), origin.len() as u32));
                origin.push(v);
            }
        }
        sides.sort_unstable();
        let mut twin = vec![NONE; 3 * faces];
        let mut start = 0;
        while start < sides.len() {
            let (a, b, h) = sides[start];
            let same = sides[start..]
                .iter()
                .take_while(|s| (s.0, s.1) == (a, b))
                .count();
            if same > 2 {
                return Err(MeshError::NonManifoldEdge { a, b, faces: same });
            }
            if same == 2 {
                let g = sides[start + 1].2;
                if origin[h as usize] == origin[g as usize] {
                    return Err(MeshError::Misoriented { a, b });
                }
                twin[h as usize] = g;
                twin[g as usize] = h;
            }
            start += same;
        }
        let mut outgoing = vec![NONE; count];
        for (h, &v) in origin.iter().enumerate() {
            if outgoing[v as usize] == NONE || twin[h] == NONE {
                outgoing[v as usize] = h as u32;
            }
        }
        let out = Self {
            positions: mesh.positions.clone(),
            live_vertices: outgoing.iter().filter(|h| **h != NONE).count(),
            outgoing,
            pinned: vec![false; count],
            crease: vec![false; 3 * faces],
            origin,
            twin,
            live_faces: faces,
        };
        for v in 0..count as u32 {
            if out.around(v).count() != incident[v as usize] as usize {
                return Err(MeshError::NonManifoldVertex { vertex: v });
            }
        }
        Ok(out)
    }

    /// Writes the mesh out without gaps; vertices and faces keep their order.
    pub fn compact(&self) -> Compact {
        let mut out = Compact::default();
        let mut number = vec![NONE; self.positions.len()];
        for v in self.vertices() {
            number[v as usize] = out.vertices.len() as u32;
            if self.pinned[v as usize] {
                out.pinned.push(number[v as usize]);
            }
            out.vertices.push(v);
            out.mesh.positions.push(self.positions[v as usize]);
        }
        for f in self.faces() {
            out.faces.push(f);
            let ids = self.face_vertices(f).map(|v| number[v as usize]);
            out.mesh.faces.push(ids);
            for k in 0..3 {
                if self.crease[3 * f as usize + k] {
                    let (a, b) = (ids[k], ids[(k + 1) % 3]);
                    out.creases.push([a.min(b), a.max(b)]);
                }
            }
        }
        out.creases.sort_unstable();
        out.creases.dedup();
        out
    }

    /// Indices of the faces that are there, in rising order.
    pub fn faces(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.origin.len() as u32 / 3).filter(|f| self.origin[3 * *f as usize] != NONE)
    }

    /// Indices of the vertices that are there, in rising order.
    pub fn vertices(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.outgoing.len() as u32).filter(|v| self.outgoing[*v as usize] != NONE)
    }

    /// One half-edge of every edge, the one with the lower index, in rising order.
    pub fn edges(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.origin.len() as u32).filter(|h| self.is_live(*h) && *h < self.twin[*h as usize])
    }

    /// Number of faces that are there.
    pub fn face_count(&self) -> usize {
        self.live_faces
    }

    /// Number of vertices that are there.
    pub fn vertex_count(&self) -> usize {
        self.live_vertices
    }

    /// One more than the highest vertex index ever given out: the length of a table over vertices.
    pub fn vertex_slots(&self) -> usize {
        self.positions.len()
    }

    /// One more than the highest face index ever given out: the length of a table over faces.
    pub fn face_slots(&self) -> usize {
        self.origin.len() / 3
    }

    /// Whether `h` names a half-edge that is there.
    pub fn is_live(&self, h: u32) -> bool {
        self.origin.get(h as usize).is_some_and(|v| *v != NONE)
    }

    /// Whether `v` names a vertex that is there.
    pub fn has_vertex(&self, v: u32) -> bool {
        self.outgoing.get(v as usize).is_some_and(|h| *h != NONE)
    }

    /// The half-edge after `h` in its face.
    pub const fn next(h: u32) -> u32 {
        if h % 3 == 2 { h - 2 } else { h + 1 }
    }

    /// The half-edge before `h` in its face.
    pub const fn prev(h: u32) -> u32 {
        if h.is_multiple_of(3) { h + 2 } else { h - 1 }
    }

    /// The face `h` belongs to.
    pub const fn face_of(h: u32) -> u32 {
        h / 3
    }

    /// The half-edge on the other side; [`NONE`] at a border.
    pub fn twin(&self, h: u32) -> u32 {
        self.twin[h as usize]
    }

    /// The vertex `h` starts from.
    pub fn origin(&self, h: u32) -> u32 {
        self.origin[h as usize]
    }

    /// The vertex `h` leads to.
    pub fn destination(&self, h: u32) -> u32 {
        self.origin[Self::next(h) as usize]
    }

    /// The vertex of the face of `h` that is not an end of `h`.
    pub fn apex(&self, h: u32) -> u32 {
        self.origin[Self::prev(h) as usize]
    }

    /// The three vertices of a face.
    pub fn face_vertices(&self, f: u32) -> [u32; 3] {
        let at = 3 * f as usize;
        [self.origin[at], self.origin[at + 1], self.origin[at + 2]]
    }

    /// Where a vertex is.
    pub fn position(&self, v: u32) -> Vec3 {
        self.positions[v as usize]
    }

    /// Moves a vertex. Nothing about the geometry is checked.
    pub fn set_position(&mut self, v: u32, position: Vec3) {
        self.positions[v as usize] = position;
    }

    /// The three corners of a face.
    pub fn corners(&self, f: u32) -> [Vec3; 3] {
        self.face_vertices(f).map(|v| self.positions[v as usize])
    }

    /// Half the cross product of two edges of a face.
    pub fn area_vector(&self, f: u32) -> Vec3 {
        let [a, b, c] = self.corners(f);
        (b - a).cross(&(c - a)) * 0.5
    }

    /// Length of the edge of `h`.
    pub fn length(&self, h: u32) -> f64 {
        (self.position(self.destination(h)) - self.position(self.origin(h))).norm()
    }

    /// Half-edges leaving `v`, counter-clockwise, one per face. Empty for a vertex that is not there.
    pub fn around(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let first = self.outgoing.get(v as usize).copied().unwrap_or(NONE);
        std::iter::successors((first != NONE).then_some(first), move |&h| {
            let onward = self.twin[Self::prev(h) as usize];
            (onward != NONE && onward != first).then_some(onward)
        })
    }

    /// Vertices joined to `v` by an edge, counter-clockwise.
    pub fn neighbours(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let mut last = NONE;
        let firsts = self.around(v).map(|h| self.destination(h));
        if self.is_border_vertex(v) {
            for h in self.around(v) {
                last = self.apex(h);
            }
        }
        firsts.chain((last != NONE).then_some(last))
    }

    /// Number of edges at `v`.
    pub fn valence(&self, v: u32) -> usize {
        self.around(v).count() + usize::from(self.is_border_vertex(v))
    }

    /// Whether `v` lies on a border.
    pub fn is_border_vertex(&self, v: u32) -> bool {
        self.outgoing
            .get(v as usize)
            .is_some_and(|h| *h != NONE && self.twin[*h as usize] == NONE)
    }

    /// Whether the edge of `h` has one face only.
    pub fn is_border(&self, h: u32) -> bool {
        self.twin[h as usize] == NONE
    }

    /// The half-edge from `a` to `b`, if there is one. At a border the edge may only have the one
    /// from `b` to `a`.
    pub fn find(&self, a: u32, b: u32) -> Option<u32> {
        self.around(a).find(|h| self.destination(*h) == b)
    }

    /// Either half-edge of the edge between `a` and `b`.
    pub fn find_edge(&self, a: u32, b: u32) -> Option<u32> {
        self.find(a, b).or_else(|| self.find(b, a))
    }

    /// Whether the edge of `h` is tagged as a crease.
    pub fn is_crease(&self, h: u32) -> bool {
        self.crease[h as usize]
    }

    /// Tags or untags the edge of `h` as a crease.
    pub fn set_crease(&mut self, h: u32, crease: bool) {
        self.crease[h as usize] = crease;
        let twin = self.twin[h as usize];
        if twin != NONE {
            self.crease[twin as usize] = crease;
        }
    }

    /// Whether the edge of `h` is a crease or a border.
    pub fn is_feature(&self, h: u32) -> bool {
        self.is_crease(h) || self.is_border(h)
    }

    /// Whether `v` must stay where it is.
    pub fn is_pinned(&self, v: u32) -> bool {
        self.pinned[v as usize]
    }

    /// Makes `v` stay where it is, whatever edges meet there (or lets it go).
    pub fn set_pinned(&mut self, v: u32, pinned: bool) {
        self.pinned[v as usize] = pinned;
    }

    /// Half-edges of the crease and border edges at `v`, one per edge, counter-clockwise. They lead
    /// away from `v`, except at the last border edge, whose only half-edge leads to it.
    pub fn features_at(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        self.around(v).flat_map(move |h| {
            let back = Self::prev(h);
            let leaving = self.is_feature(h).then_some(h);
            leaving
                .into_iter()
                .chain(self.is_border(back).then_some(back))
        })
    }

    /// The end of the edge of `h` that is not `v`.
    pub fn other_end(&self, h: u32, v: u32) -> u32 {
        if self.origin(h) == v {
            self.destination(h)
        } else {
            self.origin(h)
        }
    }

    /// Looks at every promise of this type and says which one is broken. For tests.
    ///
    /// # Errors
    /// A sentence naming the first broken promise.
    pub fn sanity_check(&self) -> Result<(), String> {
        let mut incident = vec![0; self.positions.len()];
        let mut pairs = Vec::new();
        for h in (0..self.origin.len() as u32).filter(|h| self.is_live(*h)) {
            let (a, b, t) = (self.origin(h), self.destination(h), self.twin(h));
            incident[a as usize] += 1;
            if a == b {
                return Err(format!("half-edge {h} starts and ends at vertex {a}"));
            }
            if !self.has_vertex(a) {
                return Err(format!(
                    "half-edge {h} starts at vertex {a}, which was removed"
                ));
            }
            if t != NONE {
                if !self.is_live(t) || self.twin(t) != h {
                    return Err(format!(
                        "half-edge {h} has twin {t}, which does not point back"
                    ));
                }
                if self.origin(t) != b || self.destination(t) != a {
                    return Err(format!(
                        "half-edges {h} and {t} are twins between different vertices"
                    ));
                }
                if self.crease[h as usize] != self.crease[t as usize] {
                    return Err(format!("half-edges {h} and {t} disagree about the crease"));
                }
            }
            if t == NONE || h < t {
                pairs.push((a.min(b), a.max(b)));
            }
        }
        pairs.sort_unstable();
        if let Some(twice) = pairs.windows(2).find(|w| w[0] == w[1]) {
            return Err(format!(
                "two edges join vertices {} and {}",
                twice[0].0, twice[0].1
            ));
        }
        for v in 0..self.positions.len() as u32 {
            let start = self.outgoing[v as usize];
            if start == NONE {
                if incident[v as usize] > 0 {
                    return Err(format!("vertex {v} was removed but has faces"));
                }
                continue;
            }
            if !self.is_live(start) || self.origin(start) != v {
                return Err(format!("half-edge {start} does not leave vertex {v}"));
            }
            if self.around(v).count() != incident[v as usize] {
                return Err(format!("the faces at vertex {v} form more than one fan"));
            }
        }
        let (faces, vertices) = (self.faces().count(), self.vertices().count());
        if (faces, vertices) != (self.live_faces, self.live_vertices) {
            return Err(format!(
                "there are {faces} faces and {vertices} vertices, counted otherwise"
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn there_and_back_changes_nothing() {
        for mesh in [
            shapes::torus(1.0, 0.3, 7, 5),
            shapes::grid(3, 4),
            shapes::cube(2),
        ] {
            let half = HalfEdgeMesh::new(&mesh).unwrap();
            half.sanity_check().unwrap();
            assert_eq!(half.compact().mesh, mesh);
        }
    }

    #[test]
    fn stars_are_walked_whole_at_borders_and_inside() {
        let half = HalfEdgeMesh::new(&shapes::grid(2, 2)).unwrap();
        // Vertex 4 is the middle of the 3 x 3 grid, 1 the middle of a side.
        assert_eq!((half.valence(4), half.is_border_vertex(4)), (6, false));
        assert_eq!((half.valence(1), half.is_border_vertex(1)), (4, true));
        let mut around: Vec<u32> = half.neighbours(1).collect();
        around.sort_unstable();
        assert_eq!(around, [0, 2, 4, 5]);
        assert_eq!(half.features_at(1).count(), 2);
        assert_eq!(half.features_at(4).count(), 0);
    }

    #[test]
    fn every_fault_has_its_error() {
        let corner = |i: i32| Vec3::new(f64::from(i), f64::from(i * i), 0.0);
        let mesh = |faces: &[[u32; 3]]| TriangleMesh {
            positions: (0..5).map(corner).collect(),
            faces: faces.to_vec(),
        };
        let error = |faces: &[[u32; 3]]| HalfEdgeMesh::new(&mesh(faces)).unwrap_err();
        assert_eq!(
            error(&[[0, 1, 9]]),
            MeshError::NoSuchVertex {
                face: 0,
                vertex: 9,
                count: 5
            }
        );
        assert_eq!(
            error(&[[0, 1, 1]]),
            MeshError::RepeatedVertex { face: 0, vertex: 1 }
        );
        assert_eq!(
            error(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]]),
            MeshError::NonManifoldEdge {
                a: 0,
                b: 1,
                faces: 3
            }
        );
        assert_eq!(
            error(&[[0, 1, 2], [0, 1, 3]]),
            MeshError::Misoriented { a: 0, b: 1 }
        );
        assert_eq!(
            error(&[[0, 1, 2], [2, 3, 4]]),
            MeshError::NonManifoldVertex { vertex: 2 }
        );
        let mut bad = mesh(&[[0, 1, 2]]);
        bad.positions[1].y = f64::NAN;
        assert_eq!(
            HalfEdgeMesh::new(&bad).unwrap_err(),
            MeshError::NotFinite { vertex: 1 }
        );
        // A vertex nobody uses is no fault.
        assert_eq!(
            HalfEdgeMesh::new(&mesh(&[[0, 1, 2]]))
                .unwrap()
                .vertex_count(),
            3
        );
    }
}
