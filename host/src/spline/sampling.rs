//! Triangles sampled from a surface: without cracks at any resolution, with exact normals.
//!
//! Points on a shared edge are evaluated once, along the edge itself, so both patches use the same
//! vertex and the same bits. Every edge has its own number of segments; the inside of a patch is a
//! regular grid, joined to its three edges by strips. So neighbours of different fineness still meet.

use super::bernstein::{DEGREE, edge_index};
use super::edges::{EdgeTable, Sectors, Side};
use super::surface::{Surface, SurfaceError};
use crate::Vec3;
use std::collections::BTreeSet;

/// Points sampled from a surface, joined by triangles without cracks: shared vertices on shared edges.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampledSurface {
    /// Sampled points.
    pub positions: Vec<Vec3>,
    /// Exact unit surface normal per point. Points on a crease stand once per side, with the same bits.
    pub normals: Vec<Vec3>,
    /// Standard deviation per point (linear between the vertices' values); empty if unknown.
    pub sigma: Vec<f64>,
    /// Mean and Gaussian curvature per point, where they were asked for ([`Surface::add_curvature`]); else empty.
    pub curvature: Vec<[f64; 2]>,
    /// Triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Patch each triangle came from.
    pub patches: Vec<u32>,
    /// Patch of each point and its barycentric coordinates there (of one of its patches on an edge).
    pub parameters: Vec<(u32, [f64; 3])>,
}

/// Most segments a patch edge is cut into.
pub const MAX_SEGMENTS: usize = 512;

/// How finely a surface is cut into triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fineness {
    /// Every patch edge into so many segments.
    Segments(usize),
    /// Triangles whose edges are about so long, in the unit of the surface.
    Step(f64),
    /// No triangle further than this from the surface, in its unit; each patch only as finely as it needs.
    Chord(f64),
}

/// As many segments as are wanted and can be had.
pub(super) fn segments(wanted: f64) -> usize {
    // A float beyond all integers becomes the largest one.
    (wanted.ceil() as usize).clamp(1, MAX_SEGMENTS)
}

impl Surface {
    /// Samples as finely as asked for, but with at most [`MAX_SEGMENTS`] segments an edge.
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn sample_to(&self, fineness: Fineness) -> Result<SampledSurface, SurfaceError> {
        let table = self.check()?;
        let wanted = self.segments_wanted(&table, fineness);
        let per_edge: Vec<usize> = wanted.into_iter().map(segments).collect();
        Ok(self.sample_edges(&table, &per_edge))
    }

    /// About how many triangles that fineness asks for, without a limit: to be told before any is made.
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn triangles_at(&self, fineness: Fineness) -> Result<f64, SurfaceError> {
        let table = self.check()?;
        let wanted = self.segments_wanted(&table, fineness);
        let finest = |edges: &[u32; 3]| {
            let of_edges = edges.iter().map(|e| wanted[*e as usize]);
            of_edges.fold(1.0, f64::max).powi(2)
        };
        Ok(table.of_face.iter().map(finest).sum())
    }

    /// Segments of every edge.
    fn segments_wanted(&self, table: &EdgeTable, fineness: Fineness) -> Vec<f64> {
        match fineness {
            Fineness::Segments(count) => vec![count as f64; table.edges.len()],
            Fineness::Step(step) => self.segments_by_step(table, step),
            Fineness::Chord(tolerance) => self.segments_by_chord(table, tolerance),
        }
    }

    /// Samples every patch as `segments`^2 triangles (1 ..= [`MAX_SEGMENTS`]).
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn sample_per_patch(&self, segments: usize) -> Result<SampledSurface, SurfaceError> {
        self.sample_to(Fineness::Segments(segments))
    }

    /// Segments of every edge that make the triangles' edges about `step` long.
    fn segments_by_step(&self, table: &EdgeTable, step: f64) -> Vec<f64> {
        let length = |side: &Side| {
            let points = &self.control_points[side.face as usize];
            let local = usize::from(side.local);
            let leg = |k| points[edge_index(local, 0, k + 1)] - points[edge_index(local, 0, k)];
            (0..DEGREE).map(|k| leg(k).norm()).sum::<f64>()
        };
        let sides = table.edges.iter().map(|e| e.sides.iter().flatten().next());
        sides.map(|side| side.map_or(0.0, length) / step).collect()
    }

    /// Fills in mean and Gaussian curvature at the sampled points; 0 where the surface is not regular.
    pub fn add_curvature(&self, sampled: &mut SampledSurface) {
        sampled.curvature = sampled
            .parameters
            .iter()
            .map(|(face, at)| {
                let shape = self.local_shape(*face as usize, *at);
                shape.map_or([0.0; 2], |s| [s.mean, s.gauss])
            })
            .collect();
    }

    pub(super) fn sample_edges(&self, table: &EdgeTable, segments: &[usize]) -> SampledSurface {
        let creases: BTreeSet<[u32; 2]> = self.creases.iter().copied().collect();
        let smooth: Vec<bool> = table
            .edges
            .iter()
            .map(|edge| !creases.contains(&edge.vertices))
            .collect();
        let sectors = Sectors::new(&self.faces, table, |e| smooth[e]);
        let mut out = SampledSurface::default();
        let mut sector_point = vec![u32::MAX; sectors.vertex.len()];
        // First point of each edge's inner row, per side; both the same on a smooth edge.
        let mut edge_points = vec![[u32::MAX; 2]; table.edges.len()];
        for face in 0..self.faces.len() {
            let mut sides: [Vec<u32>; 3] = Default::default();
            for corner in 0..3 {
                let slot = &mut sector_point[sectors.of_corner[face][corner] as usize];
                if *slot == u32::MAX {
                    *slot = out.positions.len() as u32;
                    let mut at = [0.0; 3];
                    at[corner] = 1.0;
                    let point = self.vertices[self.faces[face][corner] as usize];
                    self.push(&mut out, face, at, Some(point));
                }
                sides[corner].push(*slot);
            }
            let corners = sides.clone();
            for local in 0..3 {
                let number = table.of_face[face][local] as usize;
                let edge = &table.edges[number];
                let count = segments[number];
                let forward = self.faces[face][local] == edge.vertices[0];
                let way = if smooth[number] {
                    0
                } else {
                    usize::from(!forward)
                };
                if edge_points[number][way] == u32::MAX {
                    edge_points[number][way] = out.positions.len() as u32;
                    for step in 1..count {
                        // t runs from the lower to the higher vertex, so both sides get the same bits.
                        let t = step as f64 / count as f64;
                        let point = self.edge_point(face, local, forward, t);
                        let mut at = [0.0; 3];
                        at[local] = if forward { 1.0 - t } else { t };
                        at[(local + 1) % 3] = 1.0 - at[local];
                        self.push(&mut out, face, at, Some(point));
                    }
                }
                let first = edge_points[number][way];
                let inner = first..first + count as u32 - 1;
                if forward {
                    sides[local].extend(inner);
                } else {
                    sides[local].extend(inner.rev());
                }
                sides[local].push(corners[(local + 1) % 3][0]);
            }
            self.fill(&mut out, face, &sides);
        }
        out
    }

    /// Point of a patch's edge at `t` from the edge's lower to its higher vertex.
    fn edge_point(&self, face: usize, local: usize, forward: bool, t: f64) -> Vec3 {
        let mut points: [Vec3; DEGREE + 1] = std::array::from_fn(|k| {
            let along = if forward { k } else { DEGREE - k };
            self.control_points[face][edge_index(local, 0, along)]
        });
        for level in (0..DEGREE).rev() {
            for k in 0..=level {
                points[k] = points[k] * (1.0 - t) + points[k + 1] * t;
            }
        }
        points[0]
    }

    fn push(
        &self,
        out: &mut SampledSurface,
        face: usize,
        at: [f64; 3],
        known: Option<Vec3>,
    ) -> u32 {
        out.positions
            .push(known.unwrap_or_else(|| self.point(face, at)));
        out.normals.push(self.normal(face, at));
        out.parameters.push((face as u32, at));
        if !self.sigma.is_empty() {
            let corners = self.faces[face];
            out.sigma.push(
                (0..3)
                    .map(|m| at[m] * self.sigma[corners[m] as usize])
                    .sum(),
            );
        }
        out.positions.len() as u32 - 1
    }

    /// Fills one patch between its three sampled sides (each from corner l to corner l + 1).
    fn fill(&self, out: &mut SampledSurface, face: usize, sides: &[Vec<u32>; 3]) {
        let finest = sides.iter().map(|s| s.len() - 1).max().unwrap_or(1);
        let even = sides.iter().all(|s| s.len() - 1 == finest);
        let triangle = |out: &mut SampledSurface, corners: [u32; 3]| {
            out.triangles.push(corners);
            out.patches.push(face as u32);
        };
        if even && finest == 1 {
            triangle(out, [sides[0][0], sides[1][0], sides[2][0]]);
            return;
        }
        if even && finest == 2 {
            let [a, b, c] = [sides[0][1], sides[1][1], sides[2][1]];
            triangle(out, [sides[0][0], a, c]);
            triangle(out, [a, sides[1][0], b]);
            triangle(out, [c, b, sides[2][0]]);
            triangle(out, [a, b, c]);
            return;
        }
        // Inner grid: barycentric indices (i, j, k), all at least 1, sum n.
        let n = finest.max(3);
        let first = out.positions.len() as u32;
        let inside = |row: usize, place: usize| first + (row * (row + 1) / 2 + place) as u32;
        for row in 0..=n - 3 {
            for place in 0..=row {
                let (i, j, k) = (n - 2 - row, row - place + 1, place + 1);
                let at = [i, j, k].map(|m| m as f64 / n as f64);
                self.push(out, face, at, None);
            }
        }
        for row in 1..=n - 3 {
            for place in 0..row {
                triangle(
                    out,
                    [
                        inside(row - 1, place),
                        inside(row, place),
                        inside(row, place + 1),
                    ],
                );
                if place + 1 < row {
                    triangle(
                        out,
                        [
                            inside(row - 1, place),
                            inside(row, place + 1),
                            inside(row - 1, place + 1),
                        ],
                    );
                }
            }
        }
        let last = n - 3;
        let inner: [Vec<u32>; 3] = [
            (0..=last).map(|row| inside(row, 0)).collect(),
            (0..=last).map(|place| inside(last, place)).collect(),
            (0..=last).rev().map(|row| inside(row, row)).collect(),
        ];
        for (outer, inner) in sides.iter().zip(&inner) {
            // Walk both rows together, always advancing the one that lags behind.
            let (segments, steps) = (outer.len() - 1, inner.len() - 1);
            let (mut o, mut i) = (0, 0);
            while o < segments || i < steps {
                // Inner point i stands over the place (i + 1) / n of the edge.
                let next_outer = (o as f64 + 0.5) / segments as f64;
                let next_inner = (i as f64 + 1.5) / n as f64;
                if i == steps || (o < segments && next_outer <= next_inner) {
                    triangle(out, [outer[o], outer[o + 1], inner[i]]);
                    o += 1;
                } else {
                    triangle(out, [outer[o], inner[i + 1], inner[i]]);
                    i += 1;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::bernstein::EXPONENTS;

    /// A flat-faced box-like solid with uneven edges: every patch is the plane triangle itself.
    fn flat(vertices: &[Vec3], faces: &[[u32; 3]]) -> Surface {
        Surface {
            vertices: vertices.to_vec(),
            faces: faces.to_vec(),
            control_points: faces
                .iter()
                .map(|face| {
                    EXPONENTS.map(|e| {
                        (0..3)
                            .map(|m| vertices[face[m] as usize] * (f64::from(e[m]) / 5.0))
                            .sum()
                    })
                })
                .collect(),
            ..Surface::default()
        }
    }

    fn tetrahedron() -> Surface {
        let vertices = [
            Vec3::new(0.0, 0.0, 0.0),
            Vec3::new(3.0, 0.0, 0.0),
            Vec3::new(0.0, 1.0, 0.0),
            Vec3::new(0.0, 0.0, 0.4),
        ];
        let mut surface = flat(&vertices, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
        // The shared control points come from different faces' arithmetic: make them the same bits.
        let table = EdgeTable::new(4, &surface.faces).unwrap();
        for edge in &table.edges {
            let [p, q] = edge.both().unwrap();
            for along in 0..=DEGREE {
                let value = surface.control_points[p.face as usize]
                    [edge_index(usize::from(p.local), 0, along)];
                surface.control_points[q.face as usize]
                    [edge_index(usize::from(q.local), 0, DEGREE - along)] = value;
            }
        }
        surface
    }

    fn volume(sampled: &SampledSurface) -> f64 {
        sampled
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| sampled.positions[v as usize]);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum()
    }

    #[test]
    fn uneven_edges_meet_without_cracks() {
        let mut surface = tetrahedron();
        for (step, creased) in [(0.17, false), (0.17, true), (0.9, true), (5.0, false)] {
            surface.creases = if creased {
                vec![[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
            } else {
                Vec::new()
            };
            let sampled = surface.sample_to(Fineness::Step(step)).unwrap();
            assert!((volume(&sampled) - 0.2).abs() < 1e-12);
            // Merge by bits: every edge must then have exactly two sides.
            let mut seen = std::collections::BTreeMap::new();
            let merged: Vec<[u32; 3]> = sampled
                .triangles
                .iter()
                .map(|t| {
                    t.map(|v| {
                        let key = sampled.positions[v as usize].map(f64::to_bits);
                        let next = seen.len() as u32;
                        *seen.entry([key.x, key.y, key.z]).or_insert(next)
                    })
                })
                .collect();
            let table = EdgeTable::new(seen.len(), &merged).unwrap();
            assert!(table.edges.iter().all(|e| !e.is_border()), "step {step}");
        }
        for segments in 1..7 {
            let sampled = surface.sample_per_patch(segments).unwrap();
            assert_eq!(sampled.triangles.len(), 4 * segments * segments);
            assert!((volume(&sampled) - 0.2).abs() < 1e-12);
        }
    }
}
