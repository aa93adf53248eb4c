//! Charts of the report page as plain SVG: histograms of the residuals, errors from phase to phase and from level to
//! level of refinement.

use std::fmt::Write as _;

use super::super::lettering::{round_length, short_number};
use super::super::stages::{Foot, quantile};
use super::super::web::escaped;
use super::Page;
use crate::mesh::{AabbTree, TriangleMesh};
use crate::report::{LevelFigures, Report};

const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 200.0;
const LEFT: f64 = 42.0;
const BASE: f64 = 168.0;
const TOP: f64 = 14.0;

/// All charts there are data for, in one row; empty without data.
pub(super) fn charts(page: &Page<'_>, feet: &[Foot]) -> String {
    let mut out = String::new();
    let tolerance = page.tolerance();
    let in_unit = |meaning: &str| match page.unit() {
        "" => meaning.to_owned(),
        unit => format!("{meaning}, {unit}"),
    };
    let distances: Vec<f64> = feet
        .iter()
        .map(|foot| foot.distance)
        .filter(|x| x.is_finite())
        .collect();
    if !distances.is_empty() {
        out.push_str(&histogram(
            "Distances of the points",
            &in_unit("how many points lie how far from the surface"),
            &distances,
            tolerance.map(|tolerance| (tolerance, "tolerance")),
        ));
        let angles: Vec<f64> = feet
            .iter()
            .map(|foot| foot.angle_degrees)
            .filter(|x| x.is_finite())
            .collect();
        out.push_str(&histogram(
            "Angles between normals",
            "degrees between measured and surface normals",
            &angles,
            None,
        ));
    }
    if let Some(report) = page.report {
        let errors = phase_errors(page, report);
        if errors.len() > 1 {
            out.push_str(&bars(
                "Error from phase to phase",
                &in_unit("root mean square distance of the points"),
                &errors,
            ));
        }
        for phase in report.phases.iter().filter(|p| !p.by_level.is_empty()) {
            out.push_str(&levels(
                &in_unit("distances of the points"),
                &phase.by_level,
                phase.levels,
                tolerance,
            ));
        }
        let seconds: Vec<(&str, f64)> = report
            .phases
            .iter()
            .map(|phase| (phase.name.as_str(), phase.seconds))
            .collect();
        if seconds.len() > 1 {
            out.push_str(&bars("Time per phase", "seconds", &seconds));
        }
    }
    if out.is_empty() {
        return out;
    }
    format!("<div class=\"charts\">{out}</div>")
}

/// The error after each phase: as reported, or, for the two meshes, taken here from the same points.
fn phase_errors<'a>(page: &Page<'_>, report: &'a Report) -> Vec<(&'a str, f64)> {
    let of_mesh = |mesh: Option<&TriangleMesh>| {
        let (mesh, cloud) = (mesh?, page.cloud?);
        let outliers = report.error.as_ref().map(|e| e.outlier_points.as_slice());
        let tree = AabbTree::new(mesh);
        let squares: Vec<f64> = (0..)
            .zip(&cloud.points)
            .filter(|(number, _)| outliers.is_none_or(|o| o.binary_search(number).is_err()))
            .filter_map(|(_, point)| Some(tree.closest(mesh, &point.position)?.distance.powi(2)))
            .collect();
        let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        rms.is_finite().then_some(rms)
    };
    let error = |name: &str| match name {
        "extract" => of_mesh(page.extracted),
        "simplify" => of_mesh(page.simplified),
        _ => None,
    };
    let phases = report.phases.iter().filter_map(|phase| {
        let rms = phase.error_rms.or_else(|| error(&phase.name))?;
        Some((phase.name.as_str(), rms))
    });
    phases.collect()
}

fn open(title: &str, meaning: &str, label: &str) -> String {
    format!(
        "<figure><figcaption>{} <small>{}</small></figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
        escaped(title),
        escaped(meaning),
        escaped(label)
    )
}

/// Counts in about 24 equal classes from 0; the farthest half per cent is put into the last.
fn histogram(title: &str, meaning: &str, values: &[f64], mark: Option<(f64, &str)>) -> String {
    let largest = values.iter().copied().fold(0.0, f64::max);
    let end = quantile(values, 0.995).max(mark.map_or(0.0, |(at, _)| {
        if at <= 3.0 * largest { 1.1 * at } else { 0.0 }
    }));
    let end = if end > 0.0 { end } else { 1.0 };
    let classes = 24;
    let mut counts = vec![0_usize; classes];
    for value in values {
        let class = (value / end * classes as f64) as usize;
        counts[class.min(classes - 1)] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or(1).max(1);
    let x = |value: f64| LEFT + value / end * (WIDTH - LEFT - 14.0);
    let label = format!(
        "{title}: {} values, largest {}",
        values.len(),
        short_number(largest)
    );
    let mut out = open(title, meaning, &label);
    for (class, count) in counts.iter().enumerate() {
        let (from, to) = (
            x(end * class as f64 / classes as f64),
            x(end * (class + 1) as f64 / classes as f64),
        );
        let height = (BASE - TOP) * *count as f64 / most as f64;
        let _ = write!(
            out,
            "<rect class=\"bar\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\"/>",
            from + 0.5,
            BASE - height,
            to - from - 1.0
        );
    }
    let _ = write!(
        out,
        "<path class=\"axis\" d=\"M{LEFT} {TOP}V{BASE}H{}\" fill=\"none\"/><text x=\"{}\" y=\"{}\" text-anchor=\"end\">{most}</text><text x=\"{}\" y=\"{BASE}\" text-anchor=\"end\">0</text>",
        WIDTH - 14.0,
        LEFT - 6.0,
        TOP + 8.0,
        LEFT - 6.0
    );
    let step = round_length(end / 3.0);
    let mut tick = 0.0;
    while tick <= end * 1.000_001 {
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            x(tick),
            BASE + 18.0,
            short_number(tick)
        );
        tick += step;
    }
    if let Some((at, name)) = mark.filter(|(at, _)| *at <= end) {
        let place = x(at);
        let _ = write!(
            out,
            "<path class=\"mark\" d=\"M{place:.1} {TOP}V{BASE}\"/><text x=\"{:.1}\" y=\"{}\" text-anchor=\"end\">{}</text>",
            place - 5.0,
            TOP + 8.0,
            escaped(name)
        );
    }
    out.push_str("</svg></figure>");
    out
}

/// One bar per named number, from 0.
fn bars(title: &str, meaning: &str, values: &[(&str, f64)]) -> String {
    let most = values
        .iter()
        .map(|(_, value)| *value)
        .filter(|x| x.is_finite())
        .fold(0.0, f64::max);
    let most = if most > 0.0 { most } else { 1.0 };
    let label: Vec<String> = values
        .iter()
        .map(|(name, value)| format!("{name} {}", short_number(*value)))
        .collect();
    let mut out = open(title, meaning, &format!("{title}: {}", label.join(", ")));
    let slot = (WIDTH - LEFT - 14.0) / values.len() as f64;
    for (number, (name, value)) in values.iter().enumerate() {
        let height = (BASE - TOP - 14.0) * (if value.is_finite() { *value } else { 0.0 }) / most;
        let left = LEFT + slot * number as f64;
        let middle = left + slot / 2.0;
        let _ = write!(
            out,
            "<rect class=\"bar\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\"/><text x=\"{middle:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text x=\"{middle:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            left + 0.15 * slot,
            BASE - height,
            0.7 * slot,
            BASE - height - 4.0,
            short_number(*value),
            BASE + 18.0,
            escaped(name)
        );
    }
    let _ = write!(
        out,
        "<path class=\"axis\" d=\"M{LEFT} {BASE}H{}\"/>",
        WIDTH - 14.0
    );
    out.push_str("</svg></figure>");
    out
}

/// One line of a chart over levels.
struct Series {
    name: &'static str,
    /// What the style sheet calls it.
    class: &'static str,
    value: fn(&LevelFigures) -> f64,
}

/// Root mean square and largest distance of every level on a logarithmic scale; the level that is `kept` is filled.
fn levels(
    meaning: &str,
    levels: &[LevelFigures],
    kept: Option<usize>,
    tolerance: Option<f64>,
) -> String {
    const RIGHT: f64 = 62.0;
    const FLOOR: f64 = BASE - 16.0;
    let series = [
        Series {
            name: "largest",
            class: "most",
            value: |level| level.error_max,
        },
        Series {
            name: "rms",
            class: "rms",
            value: |level| level.error_rms,
        },
    ];
    let values = series
        .iter()
        .flat_map(|one| levels.iter().map(one.value))
        .chain(tolerance)
        .filter(|value| value.is_finite() && *value > 0.0);
    let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    // Whole decades and their halves would waste room: a tenth of a decade around what there is.
    let (low, high) = if low <= high {
        (low.log10() - 0.1, high.log10() + 0.1)
    } else {
        (-1.0, 1.0)
    };
    let y = |value: f64| {
        let share = ((value.max(1e-300).log10() - low) / (high - low)).clamp(0.0, 1.0);
        FLOOR - share * (FLOOR - TOP)
    };
    let slot = (WIDTH - LEFT - RIGHT) / levels.len() as f64;
    let x = |number: usize| LEFT + slot * (number as f64 + 0.5);
    let said: Vec<String> = levels
        .iter()
        .map(|level| {
            format!(
                "level {} with {} patches rms {}, largest {}{}",
                level.level,
                level.patches,
                short_number(level.error_rms),
                short_number(level.error_max),
                if kept == Some(level.level) {
                    ", kept"
                } else {
                    ""
                }
            )
        })
        .collect();
    let title = "Error from level to level";
    let mut out = open(
        title,
        &format!("{meaning}, by level of refinement and its patches; filled: the level kept"),
        &format!("{title}: {}", said.join("; ")),
    );
    for decade in low.floor() as i32..=high.ceil() as i32 {
        for step in [1.0, 2.0, 5.0] {
            let value = step * 10_f64.powi(decade);
            if (low..=high).contains(&value.log10()) && (step == 1.0 || high - low < 1.5) {
                let _ = write!(
                    out,
                    "<path class=\"axis\" d=\"M{LEFT} {at:.1}H{}\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                    WIDTH - RIGHT,
                    LEFT - 5.0,
                    y(value) + 4.0,
                    short_number(value),
                    at = y(value)
                );
            }
        }
    }
    let _ = write!(
        out,
        "<path class=\"axis\" d=\"M{LEFT} {TOP}V{FLOOR}H{}\" fill=\"none\"/>",
        WIDTH - RIGHT
    );
    if let Some(tolerance) = tolerance {
        let at = y(tolerance);
        let _ = write!(
            out,
            "<path class=\"mark\" d=\"M{LEFT} {at:.1}H{}\"/>",
            WIDTH - RIGHT
        );
    }
    for Series { class, value, .. } in &series {
        let places = levels.iter().enumerate();
        let line: Vec<String> = places
            .clone()
            .map(|(number, level)| format!("{:.1},{:.1}", x(number), y(value(level))))
            .collect();
        let _ = write!(
            out,
            "<polyline class=\"{class}\" points=\"{}\"/>",
            line.join(" ")
        );
        for (number, level) in places {
            let filled = if kept == Some(level.level) {
                " kept"
            } else {
                ""
            };
            let _ = write!(
                out,
                "<circle class=\"{class}{filled}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\"/>",
                x(number),
                y(value(level))
            );
        }
    }
    // Names beside the right ends, pushed apart where they would overlap.
    if let Some(last) = levels.last() {
        let mut names: Vec<(f64, &str, &str)> = series
            .iter()
            .map(|one| (y((one.value)(last)), one.name, one.class))
            .chain(tolerance.map(|tolerance| (y(tolerance), "tolerance", "tolerance")))
            .collect();
        names.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut free = TOP;
        for (at, name, class) in names {
            let at = at.max(free);
            free = at + 13.0;
            let _ = write!(
                out,
                "<text class=\"{class}\" x=\"{}\" y=\"{:.1}\">{name}</text>",
                WIDTH - RIGHT + 4.0,
                at + 4.0
            );
        }
    }
    for (number, level) in levels.iter().enumerate() {
        let _ = write!(
            out,
            "<text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text><text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            FLOOR + 16.0,
            level.level,
            FLOOR + 31.0,
            level.patches,
            at = x(number)
        );
    }
    let _ = write!(
        out,
        "<text x=\"{at}\" y=\"{}\">level</text><text x=\"{at}\" y=\"{}\">patches</text>",
        FLOOR + 16.0,
        FLOOR + 31.0,
        at = WIDTH - RIGHT + 4.0
    );
    out.push_str("</svg></figure>");
    out
}
