//! What must be observable of a chart: continuity of normal and curvature, regularity.

use super::super::local_shape::LocalShape;
use super::super::measures::angle_degrees;
use super::super::simplex::{Approach, Jet, Vec2, Workspace};
use super::Chart;
use crate::Vec3;
use rayon::prelude::*;

/// Figures measured on a chart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChartMeasures {
    /// Largest angle between the normals of both sides, degrees, on the triangles' edges and on all knot lines.
    pub g1_max_degrees: f64,
    /// Largest jump of the mean curvature there, 1 / length.
    pub curvature_jump_max: f64,
    /// Root of its mean square.
    pub curvature_jump_rms: f64,
    /// Smallest |S_u x S_v| over a triangle's samples, relative to the mean over the triangle.
    pub min_jacobian: f64,
    /// Triangles with a sample whose normal turns more than 90 degrees away from their mean normal.
    pub folded: usize,
}

/// Places along each triangle edge, and along each knot line.
const EDGE_PLACES: usize = 9;
const LINE_PLACES: usize = 2;

impl Chart {
    /// Measures continuity from both sides of edges and knot lines, and regularity inside the triangles.
    pub fn measure(&self) -> ChartMeasures {
        let net = self.spline().net();
        let mut places: Vec<(Vec2, Vec2)> = Vec::new();
        let mut along = |a: Vec2, b: Vec2, count: usize| {
            let way = b - a;
            let across = Vec2::new(-way.y, way.x);
            places.extend(
                (0..count).map(|k| (a + way * ((k + 1) as f64 / (count + 1) as f64), across)),
            );
        };
        for triangle in self.inner_triangles() {
            let corners = net.triangles()[*triangle as usize];
            for k in 0..3 {
                // Each inner edge is met from both triangles; once is enough.
                if corners[k] < corners[(k + 1) % 3] {
                    let at = self.corners(*triangle as usize);
                    along(at[k], at[(k + 1) % 3], EDGE_PLACES);
                }
            }
        }
        for [a, b] in self.knot_segments() {
            along(a, b, LINE_PLACES);
        }
        let jumps: Vec<(f64, f64)> = places
            .par_iter()
            .map_init(Workspace::default, |workspace, (u, across)| {
                if !self.contains(*u) {
                    return None;
                }
                let [left, right] = [*across, -across].map(|side| {
                    let jet = self.one_sided(*u, Approach::from_side(side), workspace)?;
                    LocalShape::new(jet.gradient, jet.hessian)
                });
                let (left, right) = (left?, right?);
                Some((
                    angle_degrees(left.normal, right.normal),
                    (left.mean - right.mean).abs(),
                ))
            })
            .filter_map(|jump| jump)
            .collect();
        let square: f64 = jumps.iter().map(|j| j.1 * j.1).sum();
        let (min_jacobian, folded) = self.regularity();
        ChartMeasures {
            g1_max_degrees: jumps.iter().map(|j| j.0).fold(0.0, f64::max),
            curvature_jump_max: jumps.iter().map(|j| j.1).fold(0.0, f64::max),
            curvature_jump_rms: (square / jumps.len().max(1) as f64).sqrt(),
            min_jacobian,
            folded,
        }
    }

    /// Jet at `u` in the limit from one side.
    fn one_sided(
        &self,
        u: Vec2,
        approach: Approach,
        workspace: &mut Workspace,
    ) -> Option<Jet<Vec3>> {
        let net = self.spline().net();
        let per = net.functions_per_triangle();
        let mut sum: Option<Jet<Vec3>> = None;
        for triangle in net.triangles_at(u) {
            let control = &self.spline().control_points()[triangle * per..];
            let sum = sum.get_or_insert(Jet {
                value: Vec3::zeros(),
                gradient: [Vec3::zeros(); 2],
                hessian: [Vec3::zeros(); 3],
            });
            for (jet, point) in net
                .jets(triangle, u, approach, workspace)
                .iter()
                .zip(control)
            {
                sum.value += point * jet.value;
                for k in 0..2 {
                    sum.gradient[k] += point * jet.gradient[k];
                }
                for k in 0..3 {
                    sum.hessian[k] += point * jet.hessian[k];
                }
            }
        }
        sum
    }

    /// Triangles with a sample whose normal turns more than 90 degrees away from their mean normal.
    pub fn folded_triangles(&self) -> Vec<u32> {
        self.inner_triangles()
            .iter()
            .zip(self.elements())
            .filter(|(_, (_, folds))| *folds)
            .map(|(triangle, _)| *triangle)
            .collect()
    }

    /// Smallest area element over the mean, and whether it turns over, of each triangle that meets the region.
    fn elements(&self) -> Vec<(f64, bool)> {
        const STEPS: usize = 6;
        self.inner_triangles()
            .par_iter()
            .map_init(Workspace::default, |workspace, triangle| {
                let corners = self.corners(*triangle as usize);
                let mut elements: Vec<Vec3> = Vec::new();
                for i in 0..=STEPS {
                    for j in 0..=STEPS - i {
                        let k = STEPS - i - j;
                        let u =
                            (corners[0] * i as f64 + corners[1] * j as f64 + corners[2] * k as f64)
                                / STEPS as f64;
                        if self.contains(u)
                            && let Some(jet) = self.jet(u, workspace)
                        {
                            elements.push(jet.gradient[0].cross(&jet.gradient[1]));
                        }
                    }
                }
                let sum: Vec3 = elements.iter().sum();
                let norms = elements.iter().map(Vec3::norm);
                let mean = norms.clone().sum::<f64>() / elements.len().max(1) as f64;
                let least = norms.fold(f64::INFINITY, f64::min);
                let folds = elements.iter().any(|e| e.dot(&sum) <= 0.0);
                let share = if mean > 0.0 {
                    least / mean
                } else {
                    f64::INFINITY
                };
                (share, folds)
            })
            .collect()
    }

    fn regularity(&self) -> (f64, usize) {
        let of_triangles = self.elements();
        let least = of_triangles
            .iter()
            .map(|t| t.0)
            .fold(f64::INFINITY, f64::min);
        let folded = of_triangles.iter().filter(|t| t.1).count();
        (if least.is_finite() { least } else { 0.0 }, folded)
    }
}
