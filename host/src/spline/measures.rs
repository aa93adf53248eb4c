//! What must be observable of a finished surface: continuity, regularity, topology. Measured, never assumed.

use super::bernstein::CONTROL_POINTS;
use super::edges::{EdgeTable, Sectors};
use super::surface::{Surface, SurfaceError, point_and_tangents};
use crate::Vec3;

/// Figures measured on a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Measures {
    /// Largest angle between the normals of both sides, degrees, at [`PLACES`] places on every smooth edge
    /// and between all patches that meet at a smooth vertex.
    pub g1_max_degrees: f64,
    /// Where that is: the edge's vertices.
    pub g1_worst_edge: [u32; 2],
    /// Smallest |S_u x S_v| over the patches' samples, relative to twice the patch's mean area element.
    pub min_jacobian: f64,
    /// Samples whose normal turns more than 90 degrees away from the patch's mean normal: fold-over.
    pub folded_patches: usize,
    /// Largest jump of the mean curvature across smooth edges, 1 / length, at the places between their ends.
    pub curvature_jump_max: f64,
    /// Root of its mean square.
    pub curvature_jump_rms: f64,
    /// Topology of the network.
    pub topology: Topology,
}

/// Topology of a triangulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Faces.
    pub faces: usize,
    /// Vertices that a face uses.
    pub vertices: usize,
    /// Edges.
    pub edges: usize,
    /// Vertices - edges + faces.
    pub euler: i64,
    /// Connected components.
    pub components: usize,
    /// Border loops.
    pub borders: usize,
    /// Sum of the components' genus: (2 components - borders - euler) / 2.
    pub genus: i64,
}

/// Places per edge at which continuity is measured, ends included.
pub const PLACES: usize = 11;

impl Topology {
    /// Counts the topology of `faces`.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]], table: &EdgeTable) -> Self {
        let mut parent: Vec<u32> = (0..vertex_count as u32).collect();
        fn root(parent: &mut [u32], mut node: u32) -> u32 {
            while parent[node as usize] != node {
                parent[node as usize] = parent[parent[node as usize] as usize];
                node = parent[node as usize];
            }
            node
        }
        let mut used = vec![false; vertex_count];
        for face in faces {
            for corner in 0..3 {
                used[face[corner] as usize] = true;
                let a = root(&mut parent, face[corner]);
                let b = root(&mut parent, face[(corner + 1) % 3]);
                parent[a.max(b) as usize] = a.min(b);
            }
        }
        let components = (0..vertex_count as u32)
            .filter(|v| used[*v as usize] && root(&mut parent, *v) == *v)
            .count();
        let mut border_parent: Vec<u32> = (0..vertex_count as u32).collect();
        let mut on_border = vec![false; vertex_count];
        for edge in table.edges.iter().filter(|e| e.is_border()) {
            let [a, b] = edge.vertices;
            on_border[a as usize] = true;
            on_border[b as usize] = true;
            let (a, b) = (root(&mut border_parent, a), root(&mut border_parent, b));
            border_parent[a.max(b) as usize] = a.min(b);
        }
        let borders = (0..vertex_count as u32)
            .filter(|v| on_border[*v as usize] && root(&mut border_parent, *v) == *v)
            .count();
        let vertices = used.iter().filter(|u| **u).count();
        let euler = vertices as i64 - table.edges.len() as i64 + faces.len() as i64;
        Self {
            faces: faces.len(),
            vertices,
            edges: table.edges.len(),
            euler,
            components,
            borders,
            genus: (2 * components as i64 - borders as i64 - euler) / 2,
        }
    }
}

impl Surface {
    /// Measures continuity, regularity and topology.
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn measure(&self) -> Result<Measures, SurfaceError> {
        let table = self.check()?;
        let (g1_max_degrees, g1_worst_edge) = self.continuity(&table);
        let (min_jacobian, folded_patches) = self.regularity();
        let [curvature_jump_max, curvature_jump_rms] = self.curvature_jump(&table);
        Ok(Measures {
            g1_max_degrees,
            g1_worst_edge,
            min_jacobian,
            folded_patches,
            curvature_jump_max,
            curvature_jump_rms,
            topology: Topology::new(self.vertices.len(), &self.faces, &table),
        })
    }

    fn continuity(&self, table: &EdgeTable) -> (f64, [u32; 2]) {
        let creases: std::collections::BTreeSet<_> = self.creases.iter().copied().collect();
        let smooth = |e: usize| !creases.contains(&table.edges[e].vertices);
        let mut worst = (0.0, [0, 0]);
        for (number, edge) in table.edges.iter().enumerate() {
            let (Some(sides), true) = (edge.both(), smooth(number)) else {
                continue;
            };
            for place in 0..PLACES {
                let t = place as f64 / (PLACES - 1) as f64;
                let [p, q] = [(sides[0], t), (sides[1], 1.0 - t)].map(|(side, t)| {
                    let mut at = [0.0; 3];
                    at[usize::from(side.local)] = 1.0 - t;
                    at[(usize::from(side.local) + 1) % 3] = t;
                    self.normal(side.face as usize, at)
                });
                let angle = angle_degrees(p, q);
                if angle > worst.0 {
                    worst = (angle, edge.vertices);
                }
            }
        }
        let sectors = Sectors::new(&self.faces, table, smooth);
        let mut first: Vec<Option<Vec3>> = vec![None; sectors.vertex.len()];
        for face in 0..self.faces.len() {
            for corner in 0..3 {
                let mut at = [0.0; 3];
                at[corner] = 1.0;
                let normal = self.normal(face, at);
                let sector = sectors.of_corner[face][corner] as usize;
                let angle = first[sector].map_or(0.0, |other| angle_degrees(normal, other));
                if angle > worst.0 {
                    worst = (angle, [sectors.vertex[sector]; 2]);
                }
                first[sector].get_or_insert(normal);
            }
        }
        worst
    }

    /// Largest jump of the mean curvature across smooth edges, and the root of its mean square.
    fn curvature_jump(&self, table: &EdgeTable) -> [f64; 2] {
        let creases: std::collections::BTreeSet<_> = self.creases.iter().copied().collect();
        let (mut worst, mut square, mut count) = (0.0_f64, 0.0, 0usize);
        for edge in table
            .edges
            .iter()
            .filter(|e| !creases.contains(&e.vertices))
        {
            let Some(sides) = edge.both() else { continue };
            for place in 1..PLACES - 1 {
                let t = place as f64 / (PLACES - 1) as f64;
                let [p, q] = [(sides[0], t), (sides[1], 1.0 - t)].map(|(side, t)| {
                    let mut at = [0.0; 3];
                    at[usize::from(side.local)] = 1.0 - t;
                    at[(usize::from(side.local) + 1) % 3] = t;
                    self.curvature(side.face as usize, at)
                });
                if let (Some(p), Some(q)) = (p, q) {
                    let jump = (p[0] - q[0]).abs();
                    worst = worst.max(jump);
                    square += jump * jump;
                    count += 1;
                }
            }
        }
        [worst, (square / count.max(1) as f64).sqrt()]
    }

    /// Smallest area element relative to its patch's mean, and how many patches fold.
    fn regularity(&self) -> (f64, usize) {
        let patches: Vec<(f64, bool)> = self.control_points.iter().map(patch_regularity).collect();
        let smallest = patches.iter().map(|p| p.0).fold(f64::INFINITY, f64::min);
        let folded = patches.iter().filter(|p| p.1).count();
        (if smallest.is_finite() { smallest } else { 0.0 }, folded)
    }

    /// Patches whose normal turns more than 90 degrees away from their mean normal.
    pub fn folded_patches(&self) -> Vec<usize> {
        (0..self.faces.len())
            .filter(|face| patch_regularity(&self.control_points[*face]).1)
            .collect()
    }
}

/// Smallest area element of a patch relative to its mean, and whether the patch folds: whether its normal
/// turns more than 90 degrees away from its mean somewhere.
pub fn patch_regularity(control_points: &[Vec3; CONTROL_POINTS]) -> (f64, bool) {
    const STEPS: usize = 6;
    let mut elements = Vec::with_capacity(28);
    for i in 0..=STEPS {
        for j in 0..=STEPS - i {
            let at = [i, j, STEPS - i - j].map(|m| m as f64 / STEPS as f64);
            let (_, [du, dv]) = point_and_tangents(control_points, at);
            elements.push(du.cross(&dv));
        }
    }
    let sum: Vec3 = elements.iter().sum();
    let mean = elements.iter().map(Vec3::norm).sum::<f64>() / elements.len() as f64;
    let least = elements
        .iter()
        .map(Vec3::norm)
        .fold(f64::INFINITY, f64::min);
    let folds = elements.iter().any(|e| e.dot(&sum) <= 0.0);
    (if mean > 0.0 { least / mean } else { 0.0 }, folds)
}

/// Angle between two unit vectors, degrees; accurate for small angles.
pub fn angle_degrees(a: Vec3, b: Vec3) -> f64 {
    a.cross(&b).norm().atan2(a.dot(&b)).to_degrees()
}
