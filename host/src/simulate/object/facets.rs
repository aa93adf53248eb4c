//! A closed triangle mesh as an object: exact distance to its faces, sign from the angle-weighted
//! pseudonormal of the nearest face, edge or vertex (Baerentzen and Aanaes, "Signed distance computation
//! using the angle weighted pseudonormal", 2005).

use super::{Foot, ObjectError};
use crate::Vec3;
use crate::mesh::{AabbTree, TriangleMesh, topology, unit_or_zero};
use std::collections::BTreeMap;

/// A closed mesh with what signed distances need.
#[derive(Clone, Debug)]
pub(super) struct Facets {
    mesh: TriangleMesh,
    tree: AabbTree,
    vertex_normals: Vec<Vec3>,
    /// Sum of the unit normals of the two faces at each edge, by its lower and higher vertex.
    edge_normals: BTreeMap<(u32, u32), Vec3>,
}

impl Facets {
    pub(super) fn new(
        name: &str,
        source: &TriangleMesh,
        longest_side_mm: Option<f64>,
    ) -> Result<Self, ObjectError> {
        let refuse = |reason: String| ObjectError::NotClosed {
            name: name.to_owned(),
            reason,
        };
        let mut mesh = weld(source);
        if let Some(k) = mesh
            .positions
            .iter()
            .position(|p| !p.iter().all(|v| v.is_finite()))
        {
            return Err(refuse(format!("vertex {k} is not finite")));
        }
        let (Some((low, high)), false) = (mesh.bounding_box(), mesh.faces.is_empty()) else {
            return Err(refuse("it has no faces".into()));
        };
        let counted = topology(&mesh);
        for (count, what) in [
            (counted.border_edges, "edges with one face only"),
            (
                counted.non_manifold_edges,
                "edges with three and more faces",
            ),
            (
                counted.non_manifold_vertices,
                "vertices where it touches itself",
            ),
            (
                counted.misoriented_edges,
                "edges where the faces disagree about outside",
            ),
        ] {
            if count > 0 {
                return Err(refuse(format!("{count} {what}")));
            }
        }
        let longest = (high - low).max();
        let scale = longest_side_mm.map_or(1.0, |side| side / longest);
        if !(longest > 0.0 && scale.is_finite() && scale > 0.0) {
            return Err(refuse(format!("its longest side is {longest}")));
        }
        let centre = (low + high) * 0.5;
        for position in &mut mesh.positions {
            *position = (*position - centre) * scale;
        }
        let volume: f64 = (0..mesh.faces.len() as u32)
            .filter_map(|f| mesh.corners(f))
            .map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0)
            .sum();
        if volume.abs() <= 1e-9 * (longest * scale).powi(3) {
            return Err(refuse("it encloses no volume".into()));
        }
        if volume < 0.0 {
            for face in &mut mesh.faces {
                face.swap(1, 2);
            }
        }
        let mut edge_normals: BTreeMap<(u32, u32), Vec3> = BTreeMap::new();
        for (f, face) in mesh.faces.iter().enumerate() {
            let normal = mesh.face_normal(f as u32);
            for k in 0..3 {
                let (a, b) = (face[k], face[(k + 1) % 3]);
                *edge_normals
                    .entry((a.min(b), a.max(b)))
                    .or_insert_with(Vec3::zeros) += normal;
            }
        }
        Ok(Self {
            tree: AabbTree::new(&mesh),
            vertex_normals: mesh.vertex_normals(),
            edge_normals,
            mesh,
        })
    }

    pub(super) fn mesh(&self) -> &TriangleMesh {
        &self.mesh
    }

    pub(super) fn bounding_box_mm(&self) -> (Vec3, Vec3) {
        self.mesh
            .bounding_box()
            .unwrap_or((Vec3::zeros(), Vec3::zeros()))
    }

    pub(super) fn foot(&self, point: &Vec3) -> Foot {
        let Some(foot) = self.tree.closest(&self.mesh, point) else {
            let position_mm = self.mesh.positions.first().copied().unwrap_or_default();
            return Foot {
                position_mm,
                normal: Vec3::zeros(),
                distance_mm: f64::NAN,
            };
        };
        let pseudonormal = unit_or_zero(self.pseudonormal(foot.face, foot.barycentric));
        let out = point - foot.position;
        let sign = if out.dot(&pseudonormal) < 0.0 {
            -1.0
        } else {
            1.0
        };
        // From a micrometre up, the direction to the point is the normal at which a ball touches.
        let normal = if sign > 0.0 && foot.distance > 1e-3 {
            out / foot.distance
        } else {
            pseudonormal
        };
        Foot {
            position_mm: foot.position,
            normal,
            distance_mm: sign * foot.distance,
        }
    }

    fn pseudonormal(&self, face: u32, barycentric: [f64; 3]) -> Vec3 {
        let corners = self.mesh.faces[face as usize];
        let on: Vec<u32> = (0..3)
            .filter(|&k| barycentric[k] > 1e-9)
            .map(|k| corners[k])
            .collect();
        match on[..] {
            [v] => self.vertex_normals[v as usize],
            [a, b] => self
                .edge_normals
                .get(&(a.min(b), a.max(b)))
                .copied()
                .unwrap_or_else(|| self.mesh.face_normal(face)),
            _ => self.mesh.face_normal(face),
        }
    }
}

/// Joins vertices at exactly the same place (STL repeats them for every face) and leaves out faces that this
/// makes degenerate, and vertices no face uses.
fn weld(source: &TriangleMesh) -> TriangleMesh {
    let mut welded = TriangleMesh::default();
    let mut at: BTreeMap<[u64; 3], u32> = BTreeMap::new();
    for face in &source.faces {
        let mut corners = [0; 3];
        for (corner, &v) in corners.iter_mut().zip(face) {
            let Some(p) = source.positions.get(v as usize) else {
                continue;
            };
            // Adding 0 makes -0 and 0 one place.
            let key: [u64; 3] = std::array::from_fn(|k| (p[k] + 0.0).to_bits());
            *corner = *at.entry(key).or_insert_with(|| {
                welded.positions.push(*p);
                welded.positions.len() as u32 - 1
            });
        }
        let [a, b, c] = corners;
        if a != b && b != c && c != a {
            welded.faces.push(corners);
        }
    }
    welded
}
