//! Newton's method on the squared distance from a patch, within the patch's triangle.
//!
//! Every step minimises the quadratic model over the whole triangle, so it ends on the right edges and corners by
//! itself; it is shortened while the distance grows. Where the distance is not convex, the model is lifted until it is.

use super::super::bernstein::CONTROL_POINTS;
use super::patch_jet;
use crate::Vec3;

/// Steps at most; from a good start three to six are needed.
const STEPS: usize = 60;
/// Steps that neither come closer nor halve the residual, until it is taken to be rounding.
const STALLS: u32 = 3;
/// Times a step is halved.
const HALVINGS: usize = 40;

/// Where a descent ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Foot {
    /// Barycentric coordinates in the patch it ran on.
    pub at: [f64; 3],
    pub point: Vec3,
    /// Squared distance.
    pub distance2: f64,
    /// How far the point would move along the tangent plane within the triangle to come closest: 0 at a foot point.
    pub residual: f64,
    /// If the squared distance is convex on the patch: what no point of it undercuts.
    pub least2: f64,
}

/// Descends from `start`; a convex descent stops as soon as nothing below `enough2` can be there.
pub(super) fn descend(
    points: &[Vec3; CONTROL_POINTS],
    start: [f64; 3],
    target: &Vec3,
    enough2: f64,
) -> Foot {
    let mut at = start;
    let mut jet = patch_jet(points, at);
    let mut distance2 = (jet.point - target).norm_squared();
    let mut foot;
    let (mut steps, mut stalls) = (0, 0);
    let (mut stalled, mut last) = (false, f64::INFINITY);
    loop {
        let away = jet.point - target;
        let slope = jet.first.map(|d| d.dot(&away));
        let metric = [
            jet.first[0].norm_squared(),
            jet.first[0].dot(&jet.first[1]),
            jet.first[1].norm_squared(),
        ];
        let moved = |step: [f64; 2]| along(&metric, step, step).max(0.0).sqrt();
        // A convex function lies above its tangent plane, which is lowest in a corner.
        let here = at[1] * slope[0] + at[2] * slope[1];
        let fall = 0.0_f64.min(slope[0]).min(slope[1]) - here;
        let flat = lowest(&metric, slope, at);
        foot = Foot {
            at,
            point: jet.point,
            distance2,
            residual: moved(flat),
            least2: (distance2 + 2.0 * fall).max(0.0),
        };
        let rounding = 4.0 * f64::EPSILON * (jet.point.norm() + target.norm());
        let noise = rounding * distance2.sqrt() + rounding * rounding;
        stalls += u32::from(stalled && foot.residual > 0.5 * last);
        if foot.residual <= rounding || foot.least2 >= enough2 || steps == STEPS || stalls == STALLS
        {
            return foot;
        }
        steps += 1;
        last = foot.residual;
        stalled = false;
        let mut model = [0, 1, 2].map(|m| metric[m] + away.dot(&jet.second[m]));
        // The least eigenvalue of the model, in the surface's own metric.
        let (det, area) = (determinant(&model), determinant(&metric).max(1e-300));
        let half =
            0.5 * (model[0] * metric[2] - 2.0 * model[1] * metric[1] + model[2] * metric[0]) / area;
        let least = half - (half * half - det / area).max(0.0).sqrt();
        if least < LIFTED {
            let lift = least.abs().max(LIFTED) - least;
            for m in 0..3 {
                model[m] += lift * metric[m];
            }
        }
        let step = lowest(&model, slope, at);
        let mut share = 1.0;
        let mut advanced = false;
        for _ in 0..HALVINGS {
            let mut next = [
                at[0] - (step[0] + step[1]) * share,
                at[1] + step[0] * share,
                at[2] + step[1] * share,
            ]
            .map(|x| if x < EDGE { 0.0 } else { x });
            let sum: f64 = next.iter().sum();
            next = next.map(|x| x / sum);
            let trial = patch_jet(points, next);
            let found = (trial.point - target).norm_squared();
            // Near the foot the distance is flat to the last digits while the step still counts.
            if found <= distance2 + noise {
                advanced = next != at;
                stalled = found >= distance2 - noise;
                (at, jet, distance2) = (next, trial, found);
                break;
            }
            share *= 0.5;
        }
        if !advanced {
            return foot;
        }
    }
}

/// Least eigenvalue of the model relative to the surface's metric.
const LIFTED: f64 = 1e-3;
/// Coordinates below this lie on the edge.
const EDGE: f64 = 1e-16;

fn determinant(m: &[f64; 3]) -> f64 {
    m[0] * m[2] - m[1] * m[1]
}

fn along(m: &[f64; 3], a: [f64; 2], b: [f64; 2]) -> f64 {
    m[0] * a[0] * b[0] + m[1] * (a[0] * b[1] + a[1] * b[0]) + m[2] * a[1] * b[1]
}

/// The step (u, v) from `at` to where slope . step + step . model step / 2 is least within the triangle.
fn lowest(model: &[f64; 3], slope: [f64; 2], at: [f64; 3]) -> [f64; 2] {
    let det = determinant(model);
    if det > 0.0 {
        let step = [
            (model[1] * slope[1] - model[2] * slope[0]) / det,
            (model[1] * slope[0] - model[0] * slope[1]) / det,
        ];
        if at[1] + step[0] >= 0.0 && at[2] + step[1] >= 0.0 && at[0] >= step[0] + step[1] {
            return step;
        }
    }
    const CORNERS: [[f64; 2]; 3] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let mut best = ([0.0; 2], 0.0);
    for edge in 0..3 {
        let (from, to) = (CORNERS[edge], CORNERS[(edge + 1) % 3]);
        let start = [from[0] - at[1], from[1] - at[2]];
        let way = [to[0] - from[0], to[1] - from[1]];
        let rise = slope[0] * way[0] + slope[1] * way[1] + along(model, start, way);
        let bend = along(model, way, way);
        let share = if bend > 0.0 {
            (-rise / bend).clamp(0.0, 1.0)
        } else if rise > 0.0 {
            0.0
        } else {
            1.0
        };
        let step = [start[0] + share * way[0], start[1] + share * way[1]];
        let value = slope[0] * step[0] + slope[1] * step[1] + 0.5 * along(model, step, step);
        if value < best.1 {
            best = (step, value);
        }
    }
    best.0
}
