//! Phases 3 and 4 for a chart, as the driver runs them, with their figures.

use super::{ChartOptions, FittedChart, fit_chart, refine_chart};
use crate::mesh::TriangleMesh;
use crate::reconstruct::driver::{ReconstructError, count_beyond, figures, judge, level_figures};
use crate::reconstruct::extract::Extracted;
use crate::reconstruct::fit::{Datum, Kind};
use crate::reconstruct::frame::Frame;
use crate::reconstruct::surfacing::{distances, normal_angles};
use crate::reconstruct::{Progress, Reconstruction, Stage};
use crate::report::{NormalFigures, PhaseFigures, SurfaceFigures};
use std::time::Instant;

/// What the phases before have made.
pub(in crate::reconstruct) struct Prepared<'a> {
    pub frame: &'a Frame,
    pub extracted: &'a Extracted,
    pub mesh: &'a TriangleMesh,
    pub data: &'a [Datum],
    /// Number of the input point behind each measured datum.
    pub numbers: &'a [usize],
    pub tolerance: f64,
    pub tolerance_from: &'a str,
    pub stop_after: Stage,
}

/// Fits and refines a chart and fills the report.
pub(in crate::reconstruct) fn chart_phases(
    out: &mut Reconstruction,
    from: &Prepared,
    options: &ChartOptions,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<(), ReconstructError> {
    let scale = from.frame.scale;
    let phase = |name: &str, started: Instant, fitted: &FittedChart, rounds, levels| {
        let figures = figures(distances(from.data, &fitted.feet).map(|d| d * scale));
        PhaseFigures {
            name: name.into(),
            seconds: started.elapsed().as_secs_f64(),
            triangles: None,
            patches: Some(fitted.chart.inner_triangles().len()),
            rounds,
            levels,
            error_sum: Some(figures.sum),
            error_abs_sum: Some(figures.abs_sum),
            error_rms: Some(figures.rms),
            error_max: Some(figures.max),
            by_level: Vec::new(),
        }
    };
    let level_of = |level, fitted: &FittedChart| {
        let patches = fitted.chart.inner_triangles().len();
        let distances = distances(from.data, &fitted.feet).map(|d| d * scale);
        level_figures(level, patches, distances)
    };
    progress(Progress::Phase("fit"));
    let started = Instant::now();
    let (mut last, state) = fit_chart(from.mesh, from.data, options)?;
    out.report
        .phases
        .push(phase("fit", started, &last, Some(options.rounds), None));
    let mut end = None;
    if from.stop_after == Stage::Refine {
        progress(Progress::Phase("refine"));
        let started = Instant::now();
        let mut by_level = vec![level_of(0, &last)];
        let (refined, levels, why) =
            refine_chart(last, state, from.mesh, options, |level, fitted| {
                let figures = level_of(level, fitted);
                progress(Progress::Level(level, figures.patches));
                by_level.push(figures);
            })?;
        out.report.phases.push(PhaseFigures {
            by_level,
            ..phase("refine", started, &refined, None, Some(levels))
        });
        end = Some(why);
        last = refined;
    }
    let outside = from
        .data
        .iter()
        .zip(&last.feet)
        .zip(&last.on_border)
        .filter(|((datum, foot), on_border)| {
            let foot = foot.filter(|_| datum.kind == Kind::Measured && **on_border);
            foot.is_some_and(|f| (f.point - datum.position).norm() > from.tolerance)
        })
        .count();
    let asked = from.tolerance * scale;
    let beyond = count_beyond(distances(from.data, &last.feet).map(|d| d * scale), asked);
    finish(out, from, last)?;
    judge(
        &mut out.report,
        asked,
        from.tolerance_from,
        end,
        beyond,
        &from.extracted.outliers,
    );
    if outside > 0 {
        out.report.notes.push(format!(
            "chart: {outside} of the points beyond the tolerance lie outside of the border of the extracted surface"
        ));
    }
    Ok(())
}

fn finish(
    out: &mut Reconstruction,
    from: &Prepared,
    last: FittedChart,
) -> Result<(), ReconstructError> {
    let scale = from.frame.scale;
    let sigma = last
        .vertex_points()
        .iter()
        .map(|point| from.extracted.field.confidence(point))
        .collect();
    let measures = last.chart.measure();
    let mut used: Vec<u32> = last
        .chart
        .inner_triangles()
        .iter()
        .flat_map(|t| last.chart.spline().net().triangles()[*t as usize])
        .collect();
    used.sort_unstable();
    used.dedup();
    out.report.surface = Some(SurfaceFigures {
        patches: last.chart.inner_triangles().len(),
        degree: last.chart.degree(),
        vertices: used.len(),
        degrees_of_freedom: 3 * last.functions,
        euler: 1,
        components: 1,
        borders: 1,
        g1_max_degrees: measures.g1_max_degrees,
        min_jacobian: measures.min_jacobian,
        folded_patches: measures.folded,
        curvature_jump_max: Some(measures.curvature_jump_max / scale),
        curvature_jump_rms: Some(measures.curvature_jump_rms / scale),
        ..SurfaceFigures::default()
    });
    out.report.notes.push(format!(
        "chart: knot clouds of {:.2} of the smallest height around their vertices, lines through two knots at least {:.1} degrees off the ways to neighbouring vertices; lengths stretched {:.2} to {:.2} times in the plane",
        last.bounds.radius_share,
        last.bounds.least_turn_degrees,
        last.stretch[1],
        last.stretch[0]
    ));
    // The border's points of the chart come after the measured ones, as in the driver's data.
    out.report.error = Some(figures(distances(from.data, &last.feet).map(|d| d * scale)));
    let (mut sum, mut max, mut count) = (0.0, 0.0_f64, 0usize);
    for angle in normal_angles(from.data, &last.feet) {
        sum += angle;
        max = max.max(angle);
        count += 1;
    }
    out.report.normals = Some(NormalFigures {
        mean_degrees: sum / f64::max(count as f64, 1.0),
        max_degrees: max,
    });
    let feet = from
        .data
        .iter()
        .zip(&last.feet)
        .filter(|(d, _)| d.kind == Kind::Measured);
    for (number, (datum, foot)) in from.numbers.iter().zip(feet) {
        if let Some(foot) = foot {
            out.distances[*number] = (datum.position - foot.point).norm() * scale;
        }
    }
    let chart = last
        .chart
        .with_sigma(sigma)
        .map_err(super::ChartFitError::Chart)?;
    out.chart = Some(chart.mapped(scale, |p| from.frame.leave(p)));
    Ok(())
}
