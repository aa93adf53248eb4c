//! Tables of the report page: what the figures are and what they mean in plain words.

use std::fmt::Write as _;

use super::super::lettering::short_number;
use super::super::stages::Foot;
use super::super::web::escaped;
use super::Page;
use crate::report::ErrorFigures;
use crate::spline::{Measures, SampledSurface};

/// What the tables are drawn from.
pub(super) struct Facts<'a> {
    pub page: &'a Page<'a>,
    pub measures: &'a Measures,
    pub sampled: &'a SampledSurface,
    pub feet: &'a [Foot],
}

impl Facts<'_> {
    fn error(&self) -> Option<&ErrorFigures> {
        let report = self.page.report.and_then(|report| report.error.as_ref());
        report.or(self.page.file.error.as_ref())
    }

    fn length(&self, value: f64) -> String {
        format!("{} {}", short_number(value), self.page.unit())
            .trim_end()
            .to_owned()
    }

    /// Pieces, handles and openings in words.
    fn shape(&self) -> String {
        let topology = &self.measures.topology;
        let number = |count: i64, one: &str, many: &str| match count {
            0 => format!("no {one}"),
            1 => format!("1 {one}"),
            _ => format!("{count} {many}"),
        };
        let pieces = number(topology.components as i64, "piece", "pieces");
        let handles = number(topology.genus, "handle", "handles");
        if topology.borders == 0 {
            format!("closed, {pieces}, {handles}")
        } else {
            let borders = number(topology.borders as i64, "opening", "openings");
            format!("{pieces}, {handles}, {borders}")
        }
    }

    /// The page's first sentence.
    pub(super) fn verdict(&self) -> String {
        let mut out = format!(
            "{} curved patches, {}, smooth across every smooth edge to {}°.",
            self.measures.topology.faces,
            escaped(&self.shape()),
            short_number(self.measures.g1_max_degrees)
        );
        if let Some(error) = self.error() {
            let tolerance = escaped(&self.length(error.tolerance));
            if error.met {
                let which = if error.outliers > 0 {
                    "Every point not taken for a false contact"
                } else {
                    "Every point"
                };
                let _ = write!(
                    out,
                    " <strong class=\"good\">{which} lies within the tolerance of {tolerance}.</strong>"
                );
            } else {
                let says = match error.beyond {
                    0 => format!("Not every point lies within the tolerance of {tolerance}."),
                    1 => format!("1 point lies farther off than the tolerance of {tolerance}."),
                    count => {
                        format!("{count} points lie farther off than the tolerance of {tolerance}.")
                    }
                };
                let _ = write!(out, " <strong class=\"bad\">{says}</strong>");
            }
            if let Some(reason) = &error.reason {
                let _ = write!(out, " ({})", escaped(bare(reason)));
            }
        }
        if self.measures.folded_patches > 0 {
            let _ = write!(
                out,
                " <strong class=\"bad\">{} patches fold over.</strong>",
                self.measures.folded_patches
            );
        }
        out
    }

    /// Figure, value, meaning.
    pub(super) fn figures(&self) -> String {
        let mut rows: Vec<(&str, String, String)> = Vec::new();
        let mut row =
            |name, value: String, meaning: &str| rows.push((name, value, meaning.to_owned()));
        row(
            "Shape",
            self.shape(),
            "Counted on the patches themselves. A mug has one handle, a ball none.",
        );
        let surface = &self.page.file.surface;
        row(
            "Patches",
            format!("{} of degree 5", surface.faces.len()),
            "Curved triangles the surface is made of. Each is a polynomial with 21 control points.",
        );
        let (low, high) = bounds(self.sampled);
        let size = [0, 1, 2].map(|i| short_number(high[i] - low[i]));
        row(
            "Size",
            format!(
                "{} × {} × {} {}",
                size[0],
                size[1],
                size[2],
                self.page.unit()
            )
            .trim_end()
            .to_owned(),
            "Along x, y and z.",
        );
        let (area, volume) = area_and_volume(self.sampled);
        row(
            "Area",
            short_number(area),
            "In the square of the unit of length, from the triangles drawn above.",
        );
        if self.measures.topology.borders == 0 {
            row(
                "Volume",
                short_number(volume),
                "In the cube of the unit of length, from the triangles drawn above.",
            );
        }
        row(
            "Smoothness",
            format!("{}°", short_number(self.measures.g1_max_degrees)),
            "Largest angle between the two sides' normals at any smooth edge or vertex, measured on this surface. A visible kink begins at about 1°.",
        );
        if !surface.creases.is_empty() {
            row(
                "Creases",
                format!("{} edges", surface.creases.len()),
                "Edges that are meant to be sharp.",
            );
        }
        if let Some(jump) = self
            .page
            .report
            .and_then(|report| report.surface.as_ref()?.curvature_jump_rms)
        {
            row(
                "Jump of curvature",
                short_number(jump),
                "Root mean square jump of the mean curvature across smooth edges, in 1 over the unit of length. Tangent planes agree exactly, curvature only nearly: the curvature picture may show the patches' edges. --fair-curvature makes it small.",
            );
        }
        row(
            "Evenness",
            short_number(self.measures.min_jacobian),
            "Smallest stretch of any patch, as a share of that patch's mean. 0 would be a pinch; above 0.1 is sound.",
        );
        row(
            "Folded patches",
            self.measures.folded_patches.to_string(),
            "Patches whose normal turns over. Must be 0.",
        );
        if let Some(error) = self.error() {
            row(
                "Tolerance",
                format!("{}, {}", self.length(error.tolerance), error.outcome()),
                &match error.reason.as_deref() {
                    Some(reason) => {
                        format!("Largest distance any point was allowed; {}.", bare(reason))
                    }
                    None => "Largest distance any point was allowed.".to_owned(),
                },
            );
            row(
                "Typical distance",
                self.length(error.rms),
                "Root mean square of the points' distances from the surface.",
            );
            row(
                "Largest distance",
                self.length(error.max),
                "Of any point that was not taken for a false contact.",
            );
            row(
                "Error sum",
                short_number(error.sum),
                "Sum of squared distances, the measure the fit makes small.",
            );
            row(
                "Outliers",
                error.outliers.to_string(),
                "Points taken for false contacts and left out of these figures.",
            );
        } else if !self.feet.is_empty() {
            let squares: f64 = self.feet.iter().map(|foot| foot.distance.powi(2)).sum();
            let rms = (squares / self.feet.len() as f64).sqrt();
            let most = self
                .feet
                .iter()
                .map(|foot| foot.distance)
                .fold(0.0, f64::max);
            row(
                "Typical distance",
                self.length(rms),
                "Root mean square of the given points' distances from the surface.",
            );
            row("Largest distance", self.length(most), "Of any given point.");
        }
        if let Some(report) = self.page.report {
            let input = &report.input;
            row(
                "Points",
                format!("{} of {} used", input.used, input.points),
                "The others could not be used: not finite, or without a normal.",
            );
            row(
                "Noise found",
                format!(
                    "{}, {}°",
                    self.length(input.noise_sigma),
                    short_number(input.noise_normal_degrees)
                ),
                "Standard deviation of the points along the normal, and of the normals, as found in the data.",
            );
            if let Some(normals) = &report.normals {
                row(
                    "Normals",
                    format!(
                        "{}° mean, {}° largest",
                        short_number(normals.mean_degrees),
                        short_number(normals.max_degrees)
                    ),
                    "Angle between each measured normal and the surface's where it was touched.",
                );
            }
            row(
                "Time",
                format!(
                    "{} s on {} threads",
                    short_number(report.seconds),
                    report.threads
                ),
                "From the first point read to the last figure.",
            );
        }
        let mut out = String::from(
            "<section><h2>The figures, in plain words</h2><table class=\"figures\"><thead><tr><th>Figure</th><th>Value</th><th>Meaning</th></tr></thead><tbody>",
        );
        for (name, value, meaning) in rows {
            let _ = write!(
                out,
                "<tr><th scope=\"row\">{}</th><td class=\"value\">{}</td><td class=\"meaning\">{}</td></tr>",
                escaped(name),
                escaped(&value),
                escaped(&meaning)
            );
        }
        out.push_str("</tbody></table></section>");
        out
    }

    /// What each phase did; empty without a report.
    pub(super) fn phases(&self) -> String {
        let Some(report) = self.page.report else {
            return String::new();
        };
        let mut out = String::from(
            "<section><h2>Phase by phase</h2><div class=\"scroll\"><table class=\"numbers\"><thead><tr><th>Phase</th><th>Triangles</th><th>Patches</th><th>Sum of squares</th><th>rms</th><th>Largest</th><th>Seconds</th></tr></thead><tbody>",
        );
        for phase in &report.phases {
            let whole =
                |value: Option<usize>| value.map_or(String::new(), |value| value.to_string());
            let real = |value: Option<f64>| value.map_or(String::new(), short_number);
            let _ = write!(
                out,
                "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                escaped(&phase.name),
                whole(phase.triangles),
                whole(phase.patches),
                real(phase.error_sum),
                real(phase.error_rms),
                real(phase.error_max),
                short_number(phase.seconds)
            );
        }
        out.push_str("</tbody></table></div>");
        if !report.notes.is_empty() {
            out.push_str("<h2>Worth knowing</h2><ul>");
            for note in &report.notes {
                let _ = write!(out, "<li>{}</li>", escaped(note));
            }
            out.push_str("</ul>");
        }
        out.push_str("</section>");
        out
    }

    /// Where the surface came from, and how to make it again.
    pub(super) fn origin(&self) -> String {
        let provenance = &self.page.file.provenance;
        if provenance.inputs.is_empty() && provenance.options.is_empty() {
            return String::new();
        }
        let mut command = String::from("palpus reconstruct");
        for input in &provenance.inputs {
            let _ = write!(command, " {}", quoted(&input.name));
        }
        command.push_str(" -o SURFACE.json");
        for (name, value) in &provenance.options {
            let flag = name.replace('_', "-");
            match value {
                serde_json::Value::Bool(true) => {
                    let _ = write!(command, " --{flag}");
                }
                serde_json::Value::Number(number) => {
                    let _ = write!(command, " --{flag} {number}");
                }
                serde_json::Value::String(text) => {
                    let _ = write!(command, " --{flag} {}", quoted(text));
                }
                _ => {}
            }
        }
        let mut out = String::from("<section><h2>Where it came from</h2>");
        if !provenance.inputs.is_empty() {
            out.push_str("<table><thead><tr><th>Input</th><th>Bytes</th><th>SHA-256</th></tr></thead><tbody>");
            for input in &provenance.inputs {
                let _ = write!(
                    out,
                    "<tr><td>{}</td><td>{}</td><td><code class=\"hash\">{}</code></td></tr>",
                    escaped(&input.name),
                    input.bytes,
                    escaped(&input.sha256)
                );
            }
            out.push_str("</tbody></table>");
        }
        let _ = write!(
            out,
            "<p>To make it again:</p><pre>{}</pre></section>",
            escaped(&command)
        );
        out
    }
}

/// A reason of the report without the label before it and the full stop after it.
fn bare(reason: &str) -> &str {
    reason
        .trim_start_matches("tolerance: ")
        .trim_end_matches('.')
}

/// A word for a shell, quoted if it needs to be.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:+=".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

fn bounds(sampled: &SampledSurface) -> ([f64; 3], [f64; 3]) {
    let Some(first) = sampled.positions.first() else {
        return ([0.0; 3], [0.0; 3]);
    };
    let (low, high) = sampled
        .positions
        .iter()
        .fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
    (low.into(), high.into())
}

/// Area and enclosed volume of the triangles.
fn area_and_volume(sampled: &SampledSurface) -> (f64, f64) {
    let origin = sampled.positions.first().copied().unwrap_or_default();
    sampled
        .triangles
        .iter()
        .fold((0.0, 0.0), |(area, volume), triangle| {
            let [a, b, c] = triangle.map(|v| sampled.positions[v as usize] - origin);
            (
                area + 0.5 * (b - a).cross(&(c - a)).norm(),
                volume + a.dot(&b.cross(&c)) / 6.0,
            )
        })
}
