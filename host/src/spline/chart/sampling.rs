//! Triangles of a chart for viewers and printers, up to the border of its region.

use super::super::sampling::{Fineness, MAX_SEGMENTS, SampledSurface, segments};
use super::super::simplex::{Vec2, Workspace};
use super::partition::{Partition, quality};
use super::pieces::compact;
use super::{Chart, inside, nearest_on_border};
use crate::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Vertices of the grid this near to the border (in grid steps) are moved onto it, so that no slivers arise.
const ONTO_BORDER: f64 = 0.3;

impl Chart {
    /// Samples as finely as asked for, but with at most [`MAX_SEGMENTS`] segments an edge of the net.
    pub fn sample_to(&self, fineness: Fineness) -> SampledSurface {
        self.sample_per_patch(segments(self.segments_wanted(fineness)))
    }

    /// About how many triangles that fineness asks for, without a limit: to be told before any is made.
    pub fn triangles_at(&self, fineness: Fineness) -> f64 {
        let per_edge = self.segments_wanted(fineness).max(1.0);
        self.inner_triangles().len() as f64 * per_edge.powi(2)
    }

    fn segments_wanted(&self, fineness: Fineness) -> f64 {
        match fineness {
            Fineness::Segments(count) => count as f64,
            Fineness::Step(step) => self.segments_by_step(step),
            Fineness::Chord(tolerance) => self.segments_by_chord(tolerance),
        }
    }

    /// Samples every triangle of the net as `segments`^2 triangles, cut along the border of the region. Normals are
    /// exact.
    pub fn sample_per_patch(&self, segments: usize) -> SampledSurface {
        let segments = segments.clamp(1, MAX_SEGMENTS);
        let (points, triangles, patches) = self.grid(segments);
        let evaluated: Vec<(Vec3, Vec3)> = points
            .par_iter()
            .map_init(Workspace::default, |workspace, u| {
                let jet = self.jet(*u, workspace);
                jet.map_or((Vec3::zeros(), Vec3::z()), |jet| {
                    let [du, dv] = jet.gradient;
                    let normal = du.cross(&dv).try_normalize(0.0);
                    (jet.value, normal.unwrap_or_else(Vec3::z))
                })
            })
            .collect();
        let mut place: Vec<(u32, [f64; 3])> = vec![(0, [0.0; 3]); points.len()];
        for (triangle, patch) in triangles.iter().zip(&patches) {
            let [a, b, c] = self.corners(*patch as usize);
            let area = (b - a).perp(&(c - a));
            for v in triangle {
                let u = points[*v as usize];
                let at = [
                    (b - u).perp(&(c - u)) / area,
                    (c - u).perp(&(a - u)) / area,
                    (a - u).perp(&(b - u)) / area,
                ];
                place[*v as usize] = (*patch, at);
            }
        }
        let sigma = if self.sigma().is_empty() {
            Vec::new()
        } else {
            let net = self.spline().net();
            place
                .iter()
                .map(|(triangle, at)| {
                    let corners = net.triangles()[*triangle as usize];
                    (0..3)
                        .map(|k| at[k].max(0.0) * self.sigma()[corners[k] as usize])
                        .sum()
                })
                .collect()
        };
        SampledSurface {
            positions: evaluated.iter().map(|e| e.0).collect(),
            normals: evaluated.iter().map(|e| e.1).collect(),
            sigma,
            curvature: Vec::new(),
            triangles,
            patches,
            parameters: place,
        }
    }

    /// Fills in mean and Gaussian curvature at the sampled points; 0 where the chart is not regular.
    pub fn add_curvature(&self, sampled: &mut SampledSurface) {
        sampled.curvature = sampled
            .parameters
            .par_iter()
            .map_init(Workspace::default, |workspace, (triangle, at)| {
                let corners = self.corners(*triangle as usize);
                let u = (0..3).map(|k| corners[k] * at[k]).sum();
                let shape = self.local_shape(u, workspace);
                shape.map_or([0.0; 2], |s| [s.mean, s.gauss])
            })
            .collect();
    }

    /// Segments that make the triangles' edges about `step` long.
    fn segments_by_step(&self, step: f64) -> f64 {
        let mut workspace = Workspace::default();
        let mut longest = 0.0_f64;
        for triangle in self.inner_triangles() {
            let corners = self.corners(*triangle as usize);
            for k in 0..3 {
                let ends = [corners[k], corners[(k + 1) % 3]];
                let [a, b] = ends.map(|u| self.spline().value(u, &mut workspace));
                if let (Some(a), Some(b)) = (a, b) {
                    longest = longest.max((b - a).norm());
                }
            }
        }
        longest / step
    }

    /// Segments with which no triangle of the net bends away from its samples by more than `tolerance`: the second
    /// derivatives at a grid over the net give the bound of Filip, Magedson and Markot (1986), with a half to spare for
    /// what lies between the grid's points.
    fn segments_by_chord(&self, tolerance: f64) -> f64 {
        const GRID: usize = 12;
        const SPARE: f64 = 1.5;
        let most = self
            .inner_triangles()
            .par_iter()
            .map_init(Workspace::default, |workspace, triangle| {
                let [a, b, c] = self.corners(*triangle as usize);
                let (p, q) = (b - a, c - a);
                let mut most = 0.0_f64;
                for i in 0..=GRID {
                    for j in 0..=GRID - i {
                        let u = a + p * (i as f64 / GRID as f64) + q * (j as f64 / GRID as f64);
                        let Some(jet) = self.jet(u, workspace) else {
                            continue;
                        };
                        let [xx, xy, yy] = jet.hessian;
                        let along = |s: Vec2, t: Vec2| {
                            (xx * (s.x * t.x) + xy * (s.x * t.y + s.y * t.x) + yy * (s.y * t.y))
                                .norm()
                        };
                        most = most.max(along(p, p) + 2.0 * along(p, q) + along(q, q));
                    }
                }
                most
            })
            .reduce(|| 0.0, f64::max);
        (SPARE * most / (8.0 * tolerance)).sqrt()
    }

    /// Points, triangles and the net's triangle of each.
    fn grid(&self, segments: usize) -> (Vec<Vec2>, Vec<[u32; 3]>, Vec<u32>) {
        let net = self.spline().net();
        let mut known: BTreeMap<[(u32, usize); 3], u32> = BTreeMap::new();
        let mut points: Vec<Vec2> = Vec::new();
        let mut small: Vec<[u32; 3]> = Vec::new();
        let mut of: Vec<u32> = Vec::new();
        for triangle in self.inner_triangles() {
            let corners = net.triangles()[*triangle as usize];
            let at = self.corners(*triangle as usize);
            let mut number = |e: [usize; 3]| {
                let mut key =
                    [0, 1, 2].map(|k| (if e[k] == 0 { u32::MAX } else { corners[k] }, e[k]));
                key.sort_unstable();
                *known.entry(key).or_insert_with(|| {
                    // Summed in the order of the key: the same bits from both sides of an edge.
                    let mut u = Vec2::zeros();
                    for (vertex, weight) in key.iter().filter(|k| k.1 > 0) {
                        let corner = corners.iter().position(|c| c == vertex).unwrap_or(0);
                        u += at[corner] * (*weight as f64 / segments as f64);
                    }
                    points.push(u);
                    points.len() as u32 - 1
                })
            };
            for i in 0..segments {
                for j in 0..segments - i {
                    let k = segments - 1 - i - j;
                    small.push([
                        number([i + 1, j, k]),
                        number([i, j + 1, k]),
                        number([i, j, k + 1]),
                    ]);
                    of.push(*triangle);
                    if i > 0 {
                        small.push([
                            number([i - 1, j + 1, k + 1]),
                            number([i, j, k + 1]),
                            number([i, j + 1, k]),
                        ]);
                        of.push(*triangle);
                    }
                }
            }
        }
        self.draw_onto_border(&mut points, &small);
        let border = self.border();
        let mut partition = Partition::new(points, &small);
        let tiny = 1e-7 * self.edge_length() / segments as f64;
        for (k, from) in border.iter().enumerate() {
            partition.cut(*from, border[(k + 1) % border.len()], tiny);
        }
        let (triangles, origin) = partition.triangulate(|p, f| inside(border, p.centre(f)));
        let origin = origin.iter().map(|t| of[*t as usize]).collect();
        compact(&partition.points, &triangles, origin)
    }

    /// Moves grid points near the border onto it, as far as no triangle becomes thin by it.
    fn draw_onto_border(&self, points: &mut [Vec2], triangles: &[[u32; 3]]) {
        let mut around: Vec<Vec<u32>> = vec![Vec::new(); points.len()];
        for (number, corners) in triangles.iter().enumerate() {
            for v in corners {
                around[*v as usize].push(number as u32);
            }
        }
        for v in 0..points.len() {
            let Some(first) = around[v].first() else {
                continue;
            };
            let [a, b, c] = triangles[*first as usize].map(|v| points[v as usize]);
            let step = ((b - a).norm() + (c - b).norm() + (a - c).norm()) / 3.0;
            let (_, _, onto) = nearest_on_border(self.border(), points[v]);
            if (onto - points[v]).norm() > ONTO_BORDER * step {
                continue;
            }
            let before = std::mem::replace(&mut points[v], onto);
            let fine = around[v].iter().all(|t| {
                let [a, b, c] = triangles[*t as usize].map(|v| points[v as usize]);
                quality(a, b, c) > 0.1
            });
            if !fine {
                points[v] = before;
            }
        }
    }
}
