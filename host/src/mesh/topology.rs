//! What a triangle mesh is as a topological space: components, borders, genus, manifold or not.
//!
//! Works on any [`TriangleMesh`], also on broken ones read from a file.

use super::TriangleMesh;

/// Counts over a whole mesh. Vertices that no face uses are not counted; neither are faces that name
/// one vertex twice or a vertex that does not exist.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Vertices that a face uses.
    pub vertices: usize,
    /// Edges.
    pub edges: usize,
    /// Faces.
    pub faces: usize,
    /// Sets of faces connected through shared vertices.
    pub components: usize,
    /// Closed loops of edges with one face.
    pub border_loops: usize,
    /// Edges with one face.
    pub border_edges: usize,
    /// Edges with three and more faces.
    pub non_manifold_edges: usize,
    /// Vertices whose faces form more than one fan.
    pub non_manifold_vertices: usize,
    /// Edges whose two faces run through them in the same direction.
    pub misoriented_edges: usize,
    /// Vertices - edges + faces.
    pub euler: i64,
}

impl Topology {
    /// Every edge with one or two faces, every vertex with one fan, all faces facing the same way.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0
            && self.non_manifold_vertices == 0
            && self.misoriented_edges == 0
    }

    /// Sum of the genus over all components, from euler = 2 components - 2 genus - border loops; `None`
    /// where that has no meaning (not manifold).
    pub fn genus(&self) -> Option<usize> {
        if !self.is_manifold() {
            return None;
        }
        let twice = 2 * self.components as i64 - self.border_loops as i64 - self.euler;
        usize::try_from(twice / 2).ok().filter(|_| twice % 2 == 0)
    }
}

/// Counts everything in [`Topology`], in time n log n.
pub fn topology(mesh: &TriangleMesh) -> Topology {
    let n = mesh.positions.len();
    let faces: Vec<[u32; 3]> = mesh
        .faces
        .iter()
        .copied()
        .filter(|[a, b, c]| {
            a != b && b != c && c != a && [a, b, c].iter().all(|v| (**v as usize) < n)
        })
        .collect();
    let mut out = Topology {
        faces: faces.len(),
        ..Topology::default()
    };

    let mut sides: Vec<(u32, u32, u32, bool)> = Vec::with_capacity(3 * faces.len());
    for (f, face) in faces.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            sides.push((a.min(b), a.max(b), f as u32, a < b));
        }
    }
    sides.sort_unstable();

    let mut by_vertex = Union::new(n);
    let mut borders = Union::new(n);
    let mut border_vertices = Vec::new();
    // Fans: corners (face, vertex) joined across the edges that contain the vertex.
    let mut fans = Union::new(3 * faces.len());
    let corner = |f: u32, v: u32| {
        let at = faces[f as usize].iter().position(|x| *x == v);
        3 * f as usize + at.unwrap_or(0)
    };
    let mut start = 0;
    while start < sides.len() {
        let (a, b, first, forward) = sides[start];
        let mut end = start + 1;
        while end < sides.len() && (sides[end].0, sides[end].1) == (a, b) {
            end += 1;
        }
        out.edges += 1;
        by_vertex.join(a as usize, b as usize);
        match end - start {
            1 => {
                out.border_edges += 1;
                borders.join(a as usize, b as usize);
                border_vertices.extend([a, b]);
            }
            2 => {
                if forward == sides[start + 1].3 {
                    out.misoriented_edges += 1;
                }
            }
            _ => out.non_manifold_edges += 1,
        }
        for side in &sides[start + 1..end] {
            fans.join(corner(first, a), corner(side.2, a));
            fans.join(corner(first, b), corner(side.2, b));
        }
        start = end;
    }

    let mut fans_at = vec![0u32; n];
    let mut used = vec![false; n];
    for (f, face) in faces.iter().enumerate() {
        for k in 0..3 {
            used[face[k] as usize] = true;
            if fans.root(3 * f + k) == 3 * f + k {
                fans_at[face[k] as usize] += 1;
            }
        }
    }
    out.vertices = used.iter().filter(|u| **u).count();
    out.non_manifold_vertices = fans_at.iter().filter(|c| **c > 1).count();
    out.components = (0..n)
        .filter(|&v| used[v] && by_vertex.root(v) == v)
        .count();
    border_vertices.sort_unstable();
    border_vertices.dedup();
    out.border_loops = border_vertices
        .iter()
        .filter(|&&v| borders.root(v as usize) == v as usize)
        .count();
    out.euler = out.vertices as i64 - out.edges as i64 + out.faces as i64;
    out
}

/// The component of every face, numbered from 0 in the order of their first face. Faces connect through
/// shared vertices.
pub fn face_components(mesh: &TriangleMesh) -> Vec<u32> {
    let n = mesh.positions.len();
    let mut sets = Union::new(n);
    for face in &mesh.faces {
        for k in 1..3 {
            if (face[0] as usize) < n && (face[k] as usize) < n {
                sets.join(face[0] as usize, face[k] as usize);
            }
        }
    }
    let mut number = vec![u32::MAX; n + 1];
    let mut next = 0;
    mesh.faces
        .iter()
        .map(|face| {
            let root = if (face[0] as usize) < n {
                sets.root(face[0] as usize)
            } else {
                n
            };
            if number[root] == u32::MAX {
                number[root] = next;
                next += 1;
            }
            number[root]
        })
        .collect()
}

/// Disjoint sets; the root of a set is its smallest member.
#[derive(Clone, Debug)]
pub(crate) struct Union {
    parent: Vec<usize>,
}

impl Union {
    pub(crate) fn new(n: usize) -> Self {
        Self {
            parent: (0..n).collect(),
        }
    }

    pub(crate) fn root(&mut self, mut x: usize) -> usize {
        while self.parent[x] != x {
            self.parent[x] = self.parent[self.parent[x]];
            x = self.parent[x];
        }
        x
    }

    pub(crate) fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b)] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;
    use crate::mesh::shapes;

    #[test]
    fn known_shapes() {
        let sphere = topology(&shapes::icosphere(2));
        assert_eq!(
            (sphere.euler, sphere.genus(), sphere.components),
            (2, Some(0), 1)
        );
        let torus = topology(&shapes::torus(1.0, 0.3, 12, 8));
        assert_eq!(
            (torus.euler, torus.genus(), torus.border_loops),
            (0, Some(1), 0)
        );
        let disk = topology(&shapes::grid(5, 4));
        assert_eq!(
            (disk.euler, disk.genus(), disk.border_loops),
            (1, Some(0), 1)
        );
        let tube = topology(&shapes::open_cylinder(1.0, 2.0, 12, 5));
        assert_eq!(
            (tube.euler, tube.genus(), tube.border_loops),
            (0, Some(0), 2)
        );
    }

    #[test]
    fn two_components_add_up() {
        let mut mesh = shapes::torus(1.0, 0.3, 12, 8);
        let other = shapes::icosphere(1);
        let shift = mesh.positions.len() as u32;
        mesh.positions
            .extend(other.positions.iter().map(|p| p + Vec3::x() * 5.0));
        mesh.faces
            .extend(other.faces.iter().map(|f| f.map(|v| v + shift)));
        mesh.positions.push(Vec3::zeros()); // used by nobody
        let got = topology(&mesh);
        assert_eq!((got.components, got.genus(), got.euler), (2, Some(1), 2));
        let parts = face_components(&mesh);
        assert_eq!((parts[0], *parts.last().unwrap()), (0, 1));
    }

    #[test]
    fn faults_are_counted() {
        // Two triangles touching in one vertex only.
        let mut bow = TriangleMesh {
            positions: (0..5)
                .map(|i| Vec3::new(f64::from(i), f64::from(i * i), 0.0))
                .collect(),
            faces: vec![[0, 1, 2], [2, 3, 4]],
        };
        assert_eq!(topology(&bow).non_manifold_vertices, 1);
        bow.faces = vec![[0, 1, 2], [1, 0, 3], [0, 1, 4]];
        assert_eq!(topology(&bow).non_manifold_edges, 1);
        bow.faces = vec![[0, 1, 2], [0, 1, 3]];
        let got = topology(&bow);
        assert_eq!((got.misoriented_edges, got.genus()), (1, None));
        bow.faces = vec![[0, 0, 1], [7, 8, 9]];
        assert_eq!(topology(&bow).faces, 0);
    }
}
