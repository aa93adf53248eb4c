//! Charts of the report page as plain SVG: histograms of the residuals, errors from phase to phase.

use std::fmt::Write as _;

use super::super::lettering::{round_length, short_number};
use super::super::stages::{Foot, quantile};
use super::super::web::escaped;
use crate::report::Report;

const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 200.0;
const LEFT: f64 = 42.0;
const BASE: f64 = 168.0;
const TOP: f64 = 14.0;

/// All charts there are data for, in one row; empty without data.
pub(super) fn charts(report: Option<&Report>, feet: &[Foot], tolerance: Option<f64>) -> String {
    let mut out = String::new();
    let distances: Vec<f64> = feet
        .iter()
        .map(|foot| foot.distance)
        .filter(|x| x.is_finite())
        .collect();
    if !distances.is_empty() {
        out.push_str(&histogram(
            "Distances of the points",
            "how many points lie how far from the surface",
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
    if let Some(report) = report {
        let errors: Vec<(&str, f64)> = report
            .phases
            .iter()
            .filter_map(|phase| Some((phase.name.as_str(), phase.error_rms?)))
            .collect();
        if errors.len() > 1 {
            out.push_str(&bars(
                "Error from phase to phase",
                "root mean square distance of the points",
                &errors,
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
