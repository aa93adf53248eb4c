//! Who meets whom: edges and vertices of the triangulation that carries the patches.
//!
//! Local edge l of a face runs from its corner l to its corner l + 1 (modulo 3); the corner opposite is
//! l + 2. Edges are numbered by (lower, higher) vertex in rising order, so numbering depends on nothing
//! but the faces.

use std::collections::BTreeMap;

/// Why a list of faces can carry no network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EdgeError {
    /// More than two faces, or two faces of the same direction, meet at an edge.
    #[error(
        "edge {0}-{1} is not manifold: more than two faces meet there, or two with opposite orientation; mend the mesh first"
    )]
    NotManifold(u32, u32),
    /// A face names a vertex that does not exist, or one twice.
    #[error(
        "face {face} names vertices {vertices:?}; a face needs three different ones below {count}"
    )]
    BadFace {
        /// Number of the face.
        face: usize,
        /// The vertices it names.
        vertices: [u32; 3],
        /// How many vertices there are.
        count: usize,
    },
}

/// One side of an edge: a face and the number of the edge in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    /// The face.
    pub face: u32,
    /// Local edge of that face.
    pub local: u8,
}

impl Side {
    /// Barycentric coordinates in this side's face of a place on the edge, given by those in the face across, of which the edge
    /// is number `local`; the coordinate off the edge is dropped.
    pub fn coordinates(&self, local: usize, across: &[f64; 3]) -> [f64; 3] {
        let own = usize::from(self.local);
        let mut here = [0.0; 3];
        here[own] = across[(local + 1) % 3];
        here[(own + 1) % 3] = across[local];
        here
    }
}

/// An edge of the triangulation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Lower and higher vertex.
    pub vertices: [u32; 2],
    /// The first side's face runs from the lower to the higher vertex where there is such a face.
    pub sides: [Option<Side>; 2],
}

impl Edge {
    /// Both sides of an inner edge: first the one that runs from the lower to the higher vertex.
    pub fn both(&self) -> Option<[Side; 2]> {
        Some([self.sides[0]?, self.sides[1]?])
    }

    /// Whether only one face meets here.
    pub fn is_border(&self) -> bool {
        self.both().is_none()
    }
}

/// All edges of a triangulation.
#[derive(Clone, Debug, Default)]
pub struct EdgeTable {
    /// Edges, rising by (lower, higher) vertex.
    pub edges: Vec<Edge>,
    /// Per face the numbers of its three local edges.
    pub of_face: Vec<[u32; 3]>,
}

impl EdgeTable {
    /// Finds all edges of `faces` over `vertex_count` vertices.
    ///
    /// # Errors
    /// A face that is not a proper triangle, or an edge that is not manifold or not consistently oriented.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Result<Self, EdgeError> {
        let mut found: BTreeMap<[u32; 2], [Option<Side>; 2]> = BTreeMap::new();
        for (number, face) in faces.iter().enumerate() {
            let [a, b, c] = *face;
            if a == b || b == c || c == a || face.iter().any(|v| *v as usize >= vertex_count) {
                return Err(EdgeError::BadFace {
                    face: number,
                    vertices: *face,
                    count: vertex_count,
                });
            }
            for local in 0..3 {
                let (from, to) = (face[local], face[(local + 1) % 3]);
                let way = usize::from(from > to);
                let sides = found.entry([from.min(to), from.max(to)]).or_default();
                if sides[way].is_some() {
                    return Err(EdgeError::NotManifold(from, to));
                }
                sides[way] = Some(Side {
                    face: number as u32,
                    local: local as u8,
                });
            }
        }
        let mut of_face = vec![[0; 3]; faces.len()];
        let mut edges = Vec::with_capacity(found.len());
        for (number, (vertices, sides)) in found.into_iter().enumerate() {
            for side in sides.iter().flatten() {
                of_face[side.face as usize][usize::from(side.local)] = number as u32;
            }
            edges.push(Edge { vertices, sides });
        }
        Ok(Self { edges, of_face })
    }

    /// Number of the edge between two vertices, if there is one.
    pub fn find(&self, a: u32, b: u32) -> Option<usize> {
        let key = [a.min(b), a.max(b)];
        self.edges.binary_search_by_key(&key, |e| e.vertices).ok()
    }

    /// The face across local edge `local` of `face` and the edge's number there.
    pub fn across(&self, face: usize, local: usize) -> Option<Side> {
        let edge = &self.edges[self.of_face[face][local] as usize];
        let both = edge.both()?;
        Some(
            if both[0].face as usize == face && usize::from(both[0].local) == local {
                both[1]
            } else {
                both[0]
            },
        )
    }
}

/// Groups of face corners that share one tangent plane: per (face, corner) the number of its sector.
///
/// Two corners at a vertex belong together if the faces share an edge there that is smooth.
#[derive(Clone, Debug, Default)]
pub struct Sectors {
    /// Sector of each corner of each face.
    pub of_corner: Vec<[u32; 3]>,
    /// Vertex of each sector.
    pub vertex: Vec<u32>,
}

impl Sectors {
    /// Groups the corners of `faces`; `is_smooth` says of each edge of `table` whether both sides share a
    /// tangent plane.
    pub fn new(faces: &[[u32; 3]], table: &EdgeTable, is_smooth: impl Fn(usize) -> bool) -> Self {
        let mut parent: Vec<u32> = (0..3 * faces.len() as u32).collect();
        fn root(parent: &mut [u32], mut node: u32) -> u32 {
            while parent[node as usize] != node {
                parent[node as usize] = parent[parent[node as usize] as usize];
                node = parent[node as usize];
            }
            node
        }
        for (number, edge) in table.edges.iter().enumerate() {
            let Some([p, q]) = edge.both() else { continue };
            if !is_smooth(number) {
                continue;
            }
            for (mine, theirs) in [(0, 1), (1, 0)] {
                let a = 3 * p.face + (u32::from(p.local) + mine) % 3;
                let b = 3 * q.face + (u32::from(q.local) + theirs) % 3;
                let (a, b) = (root(&mut parent, a), root(&mut parent, b));
                parent[a.max(b) as usize] = a.min(b);
            }
        }
        let mut sectors = Self {
            of_corner: vec![[0; 3]; faces.len()],
            vertex: Vec::new(),
        };
        for node in 0..parent.len() as u32 {
            let (face, corner) = (node as usize / 3, node as usize % 3);
            let top = root(&mut parent, node);
            sectors.of_corner[face][corner] = if top == node {
                sectors.vertex.push(faces[face][corner]);
                sectors.vertex.len() as u32 - 1
            } else {
                sectors.of_corner[top as usize / 3][top as usize % 3]
            };
        }
        sectors
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_triangles_share_one_edge() {
        let faces = [[0, 1, 2], [2, 1, 3]];
        let table = EdgeTable::new(4, &faces).unwrap();
        assert_eq!(table.edges.len(), 5);
        let shared = table.find(2, 1).unwrap();
        assert!(!table.edges[shared].is_border());
        let across = table.across(0, 1).unwrap();
        assert_eq!(across, Side { face: 1, local: 0 });
        // Vertex 1 counts a quarter, vertex 2 three quarters.
        assert_eq!(across.coordinates(1, &[0.0, 0.25, 0.75]), [0.75, 0.25, 0.0]);
        assert_eq!(Sectors::new(&faces, &table, |_| true).vertex.len(), 4);
        assert_eq!(Sectors::new(&faces, &table, |_| false).vertex.len(), 6);
    }

    #[test]
    fn bad_meshes_are_refused() {
        assert!(EdgeTable::new(3, &[[0, 1, 3]]).is_err());
        assert!(EdgeTable::new(3, &[[0, 1, 1]]).is_err());
        assert!(EdgeTable::new(4, &[[0, 1, 2], [0, 1, 3]]).is_err());
    }
}
