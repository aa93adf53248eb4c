//! Planar triangulations that carry a chart: an even lattice, split where it has to be.

use super::ChartFitError;
use super::flatten::Flat;
use crate::Vec3;
use crate::reconstruct::refine::templates::{Base, split_faces};
use crate::spline::chart::inside;
use crate::spline::edges::EdgeTable;
use crate::spline::simplex::Vec2;

/// A triangulation that covers a region with a ring to spare.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lattice {
    pub vertices: Vec<Vec2>,
    pub triangles: Vec<[u32; 3]>,
    /// Edge length of the even lattice it began with.
    pub edge: f64,
}

/// Corners of the outline are left out as long as it moves by no more than this share of the tolerance.
const OUTLINE_SHARE: f64 = 0.1;

impl Flat {
    /// The border in the plane as a polygon, without corners that matter less than a tenth of `tolerance`
    /// (Ramer, Douglas, Peucker).
    pub(super) fn outline(&self, tolerance: f64) -> Vec<Vec2> {
        let points: Vec<Vec2> = self
            .border
            .iter()
            .map(|v| self.places[*v as usize])
            .collect();
        let count = points.len();
        let far = (0..count)
            .max_by(|a, b| {
                let d = |k: usize| (points[k] - points[0]).norm_squared();
                d(*a).total_cmp(&d(*b))
            })
            .unwrap_or(0);
        let mut keep = vec![false; count];
        (keep[0], keep[far]) = (true, true);
        let mut open = vec![(0, far), (far, count)];
        while let Some((i, j)) = open.pop() {
            let (a, b) = (points[i], points[j % count]);
            let way = (b - a).try_normalize(0.0);
            let distance = |k: usize| match way {
                Some(way) => (points[k] - a).perp(&way).abs(),
                None => (points[k] - a).norm(),
            };
            let worst = (i + 1..j).max_by(|k, l| distance(*k).total_cmp(&distance(*l)));
            if let Some(k) = worst.filter(|k| distance(*k) > OUTLINE_SHARE * tolerance) {
                keep[k] = true;
                open.extend([(i, k), (k, j)]);
            }
        }
        (0..count).filter(|k| keep[*k]).map(|k| points[k]).collect()
    }
}

impl Lattice {
    /// An even lattice of about `triangles` triangles over the polygon.
    pub fn over(outline: &[Vec2], triangles: usize) -> Self {
        let area: f64 = (0..outline.len())
            .map(|k| outline[k].perp(&outline[(k + 1) % outline.len()]) / 2.0)
            .sum();
        let edge = (4.0 * area / (3.0_f64.sqrt() * triangles.max(1) as f64)).sqrt();
        Self::with_edge(outline, edge)
    }

    /// An even lattice with the given edge: all triangles that meet the polygon, and those that share a vertex
    /// with one of them.
    pub fn with_edge(outline: &[Vec2], edge: f64) -> Self {
        let (low, high) = outline.iter().fold(
            (Vec2::repeat(f64::MAX), Vec2::repeat(f64::MIN)),
            |(low, high), p| (low.inf(p), high.sup(p)),
        );
        let height = edge * 0.75_f64.sqrt();
        let start = low - Vec2::new(3.0 * edge, 2.5 * height);
        let columns = ((high.x - start.x) / edge) as usize + 4;
        let rows = ((high.y - start.y) / height) as usize + 4;
        let at = |row: usize, column: usize| {
            let shift = if row.is_multiple_of(2) { 0.0 } else { 0.5 };
            start + Vec2::new((column as f64 + shift) * edge, row as f64 * height)
        };
        let number = |row: usize, column: usize| (row * columns + column) as u32;
        let mut all = Vec::new();
        for row in 0..rows - 1 {
            for column in 0..columns - 1 {
                let [a, b] = [number(row, column), number(row, column + 1)];
                let [c, d] = [number(row + 1, column), number(row + 1, column + 1)];
                if row.is_multiple_of(2) {
                    all.extend([[a, b, c], [b, d, c]]);
                } else {
                    all.extend([[a, d, c], [a, b, d]]);
                }
            }
        }
        let places: Vec<Vec2> = (0..rows * columns)
            .map(|v| at(v / columns, v % columns))
            .collect();
        let mut inner_vertex = vec![false; places.len()];
        for corners in &all {
            if meets(outline, corners.map(|v| places[v as usize])) {
                for v in corners {
                    inner_vertex[*v as usize] = true;
                }
            }
        }
        all.retain(|corners| corners.iter().any(|v| inner_vertex[*v as usize]));
        let mut renumber = vec![u32::MAX; places.len()];
        let mut vertices = Vec::new();
        for v in all.iter_mut().flatten() {
            let slot = &mut renumber[*v as usize];
            if *slot == u32::MAX {
                *slot = vertices.len() as u32;
                vertices.push(places[*v as usize]);
            }
            *v = *slot;
        }
        Self {
            vertices,
            triangles: all,
            edge,
        }
    }

    /// With the marked triangles split in four and their neighbours made to fit (the two templates), then flipped
    /// until every edge is Delaunay.
    pub fn split(&self, marked: &[bool]) -> Result<Self, ChartFitError> {
        let base = Base {
            vertices: self
                .vertices
                .iter()
                .map(|u| Vec3::new(u.x, u.y, 0.0))
                .collect(),
            faces: self.triangles.clone(),
            ..Base::default()
        };
        let none = |e: crate::spline::edges::EdgeError| ChartFitError::NoSurface(e.to_string());
        let split = split_faces(&base, marked, |face, local| {
            let corners = base.faces[face];
            let (a, b) = (corners[local], corners[(local + 1) % 3]);
            (base.vertices[a.min(b) as usize] + base.vertices[a.max(b) as usize]) / 2.0
        })
        .map_err(none)?;
        let mut out = Self {
            vertices: split.vertices.iter().map(|p| p.xy()).collect(),
            triangles: split.faces,
            edge: self.edge,
        };
        out.flip_to_delaunay()?;
        Ok(out)
    }

    /// Lawson's flips.
    fn flip_to_delaunay(&mut self) -> Result<(), ChartFitError> {
        const PASSES: usize = 20;
        for _ in 0..PASSES {
            let table = EdgeTable::new(self.vertices.len(), &self.triangles)
                .map_err(|e| ChartFitError::NoSurface(e.to_string()))?;
            let mut touched = vec![false; self.triangles.len()];
            let mut flips = 0;
            for edge in &table.edges {
                let Some([p, q]) = edge.both() else { continue };
                let (f, g) = (p.face as usize, q.face as usize);
                if touched[f] || touched[g] {
                    continue;
                }
                let local = usize::from(p.local);
                let [a, b] = [self.triangles[f][local], self.triangles[f][(local + 1) % 3]];
                let c = self.triangles[f][(local + 2) % 3];
                let d = self.triangles[g][(usize::from(q.local) + 2) % 3];
                let at = |v: u32| self.vertices[v as usize];
                // Delaunay if the angles opposite sum to less than a half turn.
                let angle = |apex: u32| {
                    let (u, v) = (at(a) - at(apex), at(b) - at(apex));
                    u.perp(&v).abs().atan2(u.dot(&v))
                };
                if angle(c) + angle(d) > std::f64::consts::PI + 1e-9 {
                    self.triangles[f] = [c, a, d];
                    self.triangles[g] = [d, b, c];
                    (touched[f], touched[g]) = (true, true);
                    flips += 1;
                }
            }
            if flips == 0 {
                break;
            }
        }
        Ok(())
    }
}

/// Whether a triangle meets a polygon with an area.
fn meets(outline: &[Vec2], corners: [Vec2; 3]) -> bool {
    if outline.iter().any(|u| inside(&corners, *u)) {
        return true;
    }
    const STEPS: usize = 8;
    (0..=STEPS).any(|i| {
        (0..=STEPS - i).any(|j| {
            let k = STEPS - i - j;
            let u = (corners[0] * i as f64 + corners[1] * j as f64 + corners[2] * k as f64)
                / STEPS as f64;
            inside(outline, u)
        })
    })
}
