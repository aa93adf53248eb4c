//! Marching cubes on a sparse lattice that follows the zero set outward from the contacts.
//!
//! Only cubes the zero set passes through are kept, so time and memory grow with the surface's area over the
//! square of the spacing, not with the volume. Values are computed once per lattice point, in batches; batches and
//! results are in the order of the lattice, so the mesh does not depend on the number of threads.

use std::collections::{HashMap, HashSet};

use rayon::prelude::*;

use super::cube::{self, Corner};
use crate::{Vec3, mesh::TriangleMesh};

/// Values closer to zero than this share of the spacing are moved there, so that no sliver triangles arise. The
/// vertices are moved onto the zero set afterwards, so this costs no accuracy.
const SNAP: f64 = 0.06;

/// A cubic lattice through the origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    pub spacing: f64,
}

type Node = [i32; 3];

/// The mesh and how much of the lattice it took.
pub(super) struct Marched {
    pub mesh: TriangleMesh,
    /// Cubes the zero set passes through.
    pub cubes: usize,
    /// Whether the limit on cubes was hit and the mesh is cut off.
    pub truncated: bool,
}

impl Lattice {
    fn cube_at(&self, x: &Vec3) -> Node {
        std::array::from_fn(|a| (x[a] / self.spacing).floor() as i32)
    }

    fn position(&self, node: Node) -> Vec3 {
        Vec3::new(f64::from(node[0]), f64::from(node[1]), f64::from(node[2])) * self.spacing
    }

    /// Follows the zero set of `value` from the cubes at `seeds` through all cubes for which `wanted` (given the
    /// cube's centre) holds, at most `limit` of them. A cube with a value that is not finite is left out.
    pub(super) fn march(
        &self,
        value: impl Fn(&Vec3) -> f64 + Sync,
        seeds: &[Vec3],
        wanted: impl Fn(&Vec3) -> bool + Sync,
        limit: usize,
    ) -> Marched {
        let mut values: HashMap<Node, f64> = HashMap::new();
        let mut queued: HashSet<Node> = HashSet::new();
        let mut crossed: Vec<(Node, [f64; 8])> = Vec::new();
        let mut front: Vec<Node> = seeds.iter().map(|s| self.cube_at(s)).collect();
        front.sort_unstable();
        front.dedup();
        queued.extend(front.iter().copied());
        let mut truncated = false;
        while !front.is_empty() {
            let half = Vec3::repeat(0.5 * self.spacing);
            front = front
                .into_par_iter()
                .filter(|&c| wanted(&(self.position(c) + half)))
                .collect();
            let mut missing: Vec<Node> = front
                .iter()
                .flat_map(|&c| (0..8).map(move |k| corner(c, k)))
                .filter(|n| !values.contains_key(n))
                .collect();
            missing.sort_unstable();
            missing.dedup();
            let fresh: Vec<f64> = missing
                .par_iter()
                .map(|&n| self.snapped(value(&self.position(n))))
                .collect();
            values.extend(missing.into_iter().zip(fresh));
            let mut reached = Vec::new();
            for &c in &front {
                let v: [f64; 8] =
                    std::array::from_fn(|k| values.get(&corner(c, k)).copied().unwrap_or(f64::NAN));
                let positive = v.iter().filter(|&&x| x >= 0.0).count();
                if positive == 0 || positive == 8 || !v.iter().all(|x| x.is_finite()) {
                    continue;
                }
                crossed.push((c, v));
                for axis in 0..3 {
                    for (side, step) in [(0, -1), (1, 1)] {
                        let on_face = (0..8).filter(|k| k >> axis & 1 == side);
                        let above = on_face.filter(|&k| v[k] >= 0.0).count();
                        if above == 0 || above == 4 {
                            continue;
                        }
                        let mut other = c;
                        other[axis] += step;
                        if queued.insert(other) {
                            reached.push(other);
                        }
                    }
                }
            }
            if crossed.len() > limit {
                truncated = true;
                break;
            }
            reached.sort_unstable();
            front = reached;
        }
        crossed.sort_unstable_by_key(|(c, _)| *c);
        Marched {
            mesh: self.polygonise(&crossed),
            cubes: crossed.len(),
            truncated,
        }
    }

    fn snapped(&self, value: f64) -> f64 {
        let least = SNAP * self.spacing;
        if value.abs() < least {
            if value >= 0.0 { least } else { -least }
        } else {
            value
        }
    }

    fn polygonise(&self, crossed: &[(Node, [f64; 8])]) -> TriangleMesh {
        let cuts: Vec<cube::Cut> = crossed.par_iter().map(|(_, v)| cube::cut(v)).collect();
        let mut mesh = TriangleMesh::default();
        let mut on_edge: HashMap<(Node, u8), u32> = HashMap::new();
        for ((node, values), cut) in crossed.iter().zip(&cuts) {
            let base = self.position(*node);
            let inside: Vec<u32> = cut
                .inside
                .iter()
                .map(|x| {
                    mesh.positions.push(base + x * self.spacing);
                    mesh.positions.len() as u32 - 1
                })
                .collect();
            for triangle in &cut.triangles {
                mesh.faces.push(triangle.map(|c| match c {
                    Corner::Inside(i) => inside[i as usize],
                    Corner::Edge(e) => {
                        let (k, axis) = cube::EDGES[e as usize];
                        *on_edge
                            .entry((corner(*node, k as usize), axis))
                            .or_insert_with(|| {
                                mesh.positions
                                    .push(base + cube::crossing(values, e) * self.spacing);
                                mesh.positions.len() as u32 - 1
                            })
                    }
                }));
            }
        }
        mesh
    }
}

fn corner(cube: Node, k: usize) -> Node {
    std::array::from_fn(|a| cube[a] + (k >> a & 1) as i32)
}
