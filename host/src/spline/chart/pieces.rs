//! A chart as Bézier triangles: one polynomial per piece, exact.
//!
//! Between knot lines a chart is one polynomial of degree n. The region is cut along all knot lines and its
//! border ([`super::partition`]); each piece is interpolated at the (n + 1)(n + 2) / 2 domain points of its
//! Bernstein form, which gives its polynomial up to rounding, and raised to degree 5. Points on a common
//! edge are evaluated once, so neighbours share their control points to the last bit.
//!
//! Vertices within [`snap`] of a knot line count as lying on it. Two polynomials that meet with n - 1
//! derivatives differ at distance d from their line by the jump of the n-th derivative times d^n / n!, so what is
//! given away is below 1e-12 of the surface's size, and no sliver gets thinner than OpenCASCADE can take.

use super::super::bernstein::{CONTROL_POINTS, DEGREE, edge_index, index};
use super::super::edges::EdgeTable;
use super::super::simplex::{Vec2, Workspace, exponents};
use super::super::surface::Surface;
use super::partition::Partition;
use super::{Chart, ChartError, inside};
use crate::Vec3;
use nalgebra::DMatrix;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Bézier pieces of a chart and where they lie.
#[derive(Clone, Debug)]
pub struct Pieces {
    /// The pieces as a network of degree 5.
    pub surface: Surface,
    /// Vertices of the pieces in the parameter plane.
    pub parameters: Vec<Vec2>,
    /// The chart's triangle behind each piece.
    pub origin: Vec<u32>,
}

/// Distance within which a vertex counts as lying on a knot line, as a share of the triangles' edges: its n-th
/// power is below 1e-15, for derivatives of the highest degree jump by hundreds where clouds are small (a thousandth was
/// too much for degree 5).
fn snap(degree: usize) -> f64 {
    1e-15_f64.powf(1.0 / degree as f64).min(1e-4)
}

impl Chart {
    /// The chart as Bézier triangles of degree 5 over the cells of its knot lines.
    ///
    /// # Errors
    /// [`ChartError::Pieces`] if cutting left no proper triangulation.
    pub fn pieces(&self) -> Result<Pieces, ChartError> {
        let (parameters, faces, origin) = self.cells();
        let table = EdgeTable::new(parameters.len(), &faces)
            .map_err(|e| ChartError::Pieces(e.to_string()))?;
        let n = self.degree();
        let vertices = self.points(&parameters)?;
        // Points inside each edge, from its lower to its higher vertex.
        let on_edges: Vec<Vec2> = table
            .edges
            .iter()
            .flat_map(|edge| {
                let [a, b] = edge.vertices.map(|v| parameters[v as usize]);
                (1..n).map(move |k| a + (b - a) * (k as f64 / n as f64))
            })
            .collect();
        let edge_values = self.points(&on_edges)?;
        let inner: Vec<[usize; 3]> = exponents(n).filter(|e| !e.contains(&0)).collect();
        let in_faces: Vec<Vec2> = faces
            .iter()
            .flat_map(|face| {
                let [a, b, c] = face.map(|v| parameters[v as usize]);
                inner
                    .iter()
                    .map(move |e| (a * e[0] as f64 + b * e[1] as f64 + c * e[2] as f64) / n as f64)
            })
            .collect();
        let inner_values = self.points(&in_faces)?;
        let curve = curve_matrix(n)?;
        let edge_points: Vec<[Vec3; DEGREE + 1]> = table
            .edges
            .iter()
            .enumerate()
            .map(|(number, edge)| {
                let [a, b] = edge.vertices.map(|v| vertices[v as usize]);
                let mut values = vec![a];
                values.extend(&edge_values[number * (n - 1)..(number + 1) * (n - 1)]);
                values.push(b);
                let mut points: [Vec3; DEGREE + 1] =
                    std::array::from_fn(|row| combine(&curve, row, &values));
                (points[0], points[DEGREE]) = (a, b);
                points
            })
            .collect();
        let triangle = triangle_matrix(n)?;
        let control_points = faces
            .par_iter()
            .enumerate()
            .map(|(number, face)| {
                let own = &inner_values[number * inner.len()..(number + 1) * inner.len()];
                let mut own = own.iter();
                let values: Vec<Vec3> = exponents(n)
                    .map(|e| {
                        if let Some(corner) = e.iter().position(|k| *k == n) {
                            return vertices[face[corner] as usize];
                        }
                        if let Some(opposite) = e.iter().position(|k| *k == 0) {
                            let local = (opposite + 1) % 3;
                            let edge = table.of_face[number][local] as usize;
                            let forward = table.edges[edge].vertices[0] == face[local];
                            let along = e[(local + 1) % 3];
                            let step = if forward { along } else { n - along };
                            return edge_values[edge * (n - 1) + step - 1];
                        }
                        own.next().copied().unwrap_or_else(Vec3::zeros)
                    })
                    .collect();
                let mut points: [Vec3; CONTROL_POINTS] =
                    std::array::from_fn(|row| combine(&triangle, row, &values));
                for local in 0..3 {
                    let edge = table.of_face[number][local] as usize;
                    let forward = table.edges[edge].vertices[0] == face[local];
                    for along in 0..=DEGREE {
                        let step = if forward { along } else { DEGREE - along };
                        points[edge_index(local, 0, along)] = edge_points[edge][step];
                    }
                }
                points
            })
            .collect();
        let sigma: Vec<f64> = if self.sigma().is_empty() {
            Vec::new()
        } else {
            parameters
                .iter()
                .map(|u| self.sigma_at(*u).unwrap_or(0.0))
                .collect()
        };
        let surface = Surface {
            vertices,
            faces,
            control_points,
            creases: Vec::new(),
            sigma,
        };
        surface
            .check()
            .map_err(|e| ChartError::Pieces(e.to_string()))?;
        Ok(Pieces {
            surface,
            parameters,
            origin,
        })
    }

    /// Segments between knots across which the n-th derivative may jump, in a fixed order.
    pub(super) fn knot_segments(&self) -> Vec<[Vec2; 2]> {
        let net = self.spline().net();
        let n = net.degree();
        let mut pairs: BTreeSet<[u32; 2]> = BTreeSet::new();
        let mut near: BTreeSet<u32> = BTreeSet::new();
        // Knots of triangles of the ring reach into the region, too.
        for corners in net.triangles() {
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                pairs.insert([a.min(b), a.max(b)]);
                near.insert(a);
            }
        }
        let mut segments = Vec::new();
        for [a, b] in pairs {
            let (first, second) = (net.cloud(a as usize), net.cloud(b as usize));
            for (i, p) in first.iter().enumerate() {
                // Two knots meet in one basis function if their numbers add up to no more than the degree.
                segments.extend(second[..=n - i].iter().map(|q| [*p, *q]));
            }
        }
        for vertex in near {
            let cloud = net.cloud(vertex as usize);
            for (i, p) in cloud.iter().enumerate() {
                segments.extend(cloud[i + 1..].iter().map(|q| [*p, *q]));
            }
        }
        segments
    }

    /// The region cut along its border and all knot lines: points, triangles, and the chart's triangle of each.
    fn cells(&self) -> (Vec<Vec2>, Vec<[u32; 3]>, Vec<u32>) {
        let snap = snap(self.degree()) * self.edge_length();
        let net = self.spline().net();
        let points: Vec<Vec2> = (0..net.vertices()).map(|v| net.cloud(v)[0]).collect();
        let inner = self.inner_triangles();
        let triangles: Vec<[u32; 3]> = inner.iter().map(|t| net.triangles()[*t as usize]).collect();
        let mut partition = Partition::new(points, &triangles);
        let border = self.border();
        for (k, from) in border.iter().enumerate() {
            partition.cut(*from, border[(k + 1) % border.len()], snap);
        }
        // Cells outside go first: no need to cut them further.
        let mut partition = partition.kept(|p, face| inside(border, p.centre(face)));
        for [from, to] in self.knot_segments() {
            partition.cut(from, to, snap);
        }
        let (faces, cut_from) = partition.triangulate(|_, _| true);
        let origin = cut_from.iter().map(|t| inner[*t as usize]).collect();
        compact(&partition.points, &faces, origin)
    }

    fn points(&self, parameters: &[Vec2]) -> Result<Vec<Vec3>, ChartError> {
        parameters
            .par_iter()
            .map_init(Workspace::default, |workspace, u| {
                self.spline()
                    .value(*u, workspace)
                    .ok_or(ChartError::Uncovered { x: u.x, y: u.y })
            })
            .collect()
    }
}

/// Leaves out points that no triangle uses.
pub(super) fn compact(
    points: &[Vec2],
    faces: &[[u32; 3]],
    origin: Vec<u32>,
) -> (Vec<Vec2>, Vec<[u32; 3]>, Vec<u32>) {
    let mut number = vec![u32::MAX; points.len()];
    let mut used = Vec::new();
    let faces = faces
        .iter()
        .map(|face| {
            face.map(|v| {
                let slot = &mut number[v as usize];
                if *slot == u32::MAX {
                    *slot = used.len() as u32;
                    used.push(points[v as usize]);
                }
                *slot
            })
        })
        .collect();
    (used, faces, origin)
}

fn combine(matrix: &DMatrix<f64>, row: usize, values: &[Vec3]) -> Vec3 {
    values
        .iter()
        .enumerate()
        .map(|(column, value)| value * matrix[(row, column)])
        .sum()
}

fn factorial(n: usize) -> f64 {
    (1..=n).map(|k| k as f64).product()
}

fn invert(matrix: DMatrix<f64>) -> Result<DMatrix<f64>, ChartError> {
    matrix
        .try_inverse()
        .ok_or_else(|| ChartError::Pieces("interpolation matrix is singular".into()))
}

/// From values at k / n to Bézier points of degree 5 of the curve through them.
fn curve_matrix(n: usize) -> Result<DMatrix<f64>, ChartError> {
    let bernstein = |degree: usize, k: usize, t: f64| {
        factorial(degree) / (factorial(k) * factorial(degree - k))
            * t.powi(k as i32)
            * (1.0 - t).powi((degree - k) as i32)
    };
    let values = DMatrix::from_fn(n + 1, n + 1, |r, c| bernstein(n, c, r as f64 / n as f64));
    // Raising the degree: b_j = sum C(n, i) C(5 - n, j - i) / C(5, j) c_i.
    let choose = |n: usize, k: usize| factorial(n) / (factorial(k) * factorial(n - k));
    let raise = DMatrix::from_fn(DEGREE + 1, n + 1, |j, i| {
        if j >= i && j - i <= DEGREE - n {
            choose(n, i) * choose(DEGREE - n, j - i) / choose(DEGREE, j)
        } else {
            0.0
        }
    });
    Ok(raise * invert(values)?)
}

/// From values at the domain points of degree n to the 21 control points of degree 5.
pub(in crate::spline) fn triangle_matrix(n: usize) -> Result<DMatrix<f64>, ChartError> {
    let all: Vec<[usize; 3]> = exponents(n).collect();
    let multinomial = |e: [usize; 3]| {
        factorial(e[0] + e[1] + e[2]) / e.iter().map(|k| factorial(*k)).product::<f64>()
    };
    let values = DMatrix::from_fn(all.len(), all.len(), |r, c| {
        multinomial(all[c])
            * (0..3)
                .map(|k| (all[r][k] as f64 / n as f64).powi(all[c][k] as i32))
                .product::<f64>()
    });
    let mut raise = DMatrix::zeros(CONTROL_POINTS, all.len());
    for (column, from) in all.iter().enumerate() {
        for extra in exponents(DEGREE - n) {
            let to = [0, 1, 2].map(|k| from[k] + extra[k]);
            let row = index(to.map(|k| k as u8));
            raise[(row, column)] = multinomial(*from) * multinomial(extra) / multinomial(to);
        }
    }
    Ok(raise * invert(values)?)
}

#[cfg(test)]
mod tests {
    use super::super::shapes::saddle;
    use super::*;

    #[test]
    fn pieces_are_the_chart_and_as_smooth_as_it_is() {
        for degree in 2..=5 {
            let chart = saddle(degree);
            let pieces = chart.pieces().unwrap();
            let mut workspace = Workspace::default();
            // At degree 5 the interpolation multiplies the rounding of the spline's value by its condition, some
            // hundreds.
            let rounding = if degree == 5 { 1e-10 } else { 1e-12 };
            let mut area = 0.0;
            for (number, face) in pieces.surface.faces.iter().enumerate() {
                let [a, b, c] = face.map(|v| pieces.parameters[v as usize]);
                area += (b - a).perp(&(c - a)) / 2.0;
                for at in [[0.3, 0.3, 0.4], [0.8, 0.1, 0.1], [0.5, 0.5, 0.0]] {
                    let u = a * at[0] + b * at[1] + c * at[2];
                    let wanted = chart.spline().value(u, &mut workspace).unwrap();
                    let found = pieces.surface.point(number, at);
                    let off = (found - wanted).norm();
                    assert!(off < rounding, "{degree}: {number} {off:e}");
                }
            }
            let border = chart.border();
            let wanted: f64 = (0..4)
                .map(|k| border[k].perp(&border[(k + 1) % 4]) / 2.0)
                .sum();
            assert!((area - wanted).abs() < 3e-3 * wanted, "{area} {wanted}");
            let topology = pieces.surface.measure().unwrap().topology;
            assert_eq!(
                (topology.euler, topology.borders, topology.components),
                (1, 1, 1)
            );
            let measures = chart.measure();
            assert!(measures.g1_max_degrees < 1e-9, "{degree}: {measures:?}");
            assert_eq!(measures.folded, 0);
            if degree > 2 {
                assert!(measures.curvature_jump_max < 1e-9, "{degree}: {measures:?}");
            } else {
                // Across knot lines the second derivatives of degree 2 do jump.
                assert!(measures.curvature_jump_max > 1e-3, "{measures:?}");
            }
        }
    }

    #[test]
    fn sampled_triangles_cover_the_region_up_to_its_border() {
        let chart = saddle(3);
        let mut workspace = Workspace::default();
        for segments in [2, 7] {
            let mut sampled = chart.sample_per_patch(segments);
            chart.add_curvature(&mut sampled);
            let table = EdgeTable::new(sampled.positions.len(), &sampled.triangles).unwrap();
            let place = |v: u32| {
                let (triangle, at) = sampled.parameters[v as usize];
                let corners = chart.corners(triangle as usize);
                (0..3).map(|k| corners[k] * at[k]).sum::<Vec2>()
            };
            let mut area = 0.0;
            for triangle in &sampled.triangles {
                let [a, b, c] = triangle.map(place);
                area += (b - a).perp(&(c - a)) / 2.0;
            }
            let border = chart.border();
            let wanted: f64 = (0..4)
                .map(|k| border[k].perp(&border[(k + 1) % 4]) / 2.0)
                .sum();
            assert!((area - wanted).abs() < 1e-6, "{area} {wanted}");
            for edge in table.edges.iter().filter(|e| e.is_border()) {
                for v in edge.vertices {
                    let u = place(v);
                    let (_, _, nearest) = super::super::nearest_on_border(border, u);
                    assert!((u - nearest).norm() < 1e-6);
                    let jet = chart.jet(u, &mut workspace).unwrap();
                    assert!((jet.value - sampled.positions[v as usize]).norm() < 1e-12);
                }
            }
            assert!(sampled.curvature.iter().all(|c| c[0].is_finite()));
        }
    }
}
