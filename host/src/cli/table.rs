//! Reports as people read them: short tables.

use palpus_host::report::Report;
use std::fmt::Write;

/// The figures of a reconstruction.
pub fn report(report: &Report) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_report(&mut out, report);
    out
}

fn write_report(out: &mut String, report: &Report) -> std::fmt::Result {
    let input = &report.input;
    writeln!(
        out,
        "{} points, {} used, {} rejected; diagonal {:.4}, noise {:.2e} and {:.2} degrees",
        input.points,
        input.used,
        input.rejected,
        input.bbox_diagonal,
        input.noise_sigma,
        input.noise_normal_degrees
    )?;
    for row in &input.rejected_rows {
        writeln!(out, "  left out: {row}")?;
    }
    writeln!(
        out,
        "{:<10}{:>10}{:>9}{:>12}{:>12}{:>12}{:>12}{:>9}",
        "phase", "triangles", "patches", "error sum", "abs sum", "rms", "max", "s"
    )?;
    for phase in &report.phases {
        let whole = |n: Option<usize>| n.map_or(String::new(), |n| n.to_string());
        let real = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.3e}"));
        writeln!(
            out,
            "{:<10}{:>10}{:>9}{:>12}{:>12}{:>12}{:>12}{:>9.3}",
            phase.name,
            whole(phase.triangles),
            whole(phase.patches),
            real(phase.error_sum),
            real(phase.error_abs_sum),
            real(phase.error_rms),
            real(phase.error_max),
            phase.seconds
        )?;
    }
    if let Some(surface) = &report.surface {
        writeln!(
            out,
            "surface: {} patches of degree {}, {} component(s), genus {}, {} border loop(s), {} crease edges; tangent planes agree to {:.1e} degrees, least Jacobian {:.2}",
            surface.patches,
            surface.degree,
            surface.components,
            surface.genus,
            surface.borders,
            surface.crease_edges,
            surface.g1_max_degrees,
            surface.min_jacobian
        )?;
    }
    if let Some(error) = &report.error {
        writeln!(
            out,
            "tolerance {:.3e}: {}{}",
            error.tolerance,
            if error.met { "met" } else { "not met" },
            error
                .reason
                .as_ref()
                .map_or(String::new(), |r| format!(" ({r})"))
        )?;
        if error.outliers > 0 {
            writeln!(out, "{} points taken for false contacts", error.outliers)?;
        }
    }
    if let Some(normals) = &report.normals {
        writeln!(
            out,
            "normals: {:.2} degrees in the mean, {:.2} at most",
            normals.mean_degrees, normals.max_degrees
        )?;
    }
    for note in &report.notes {
        writeln!(out, "note: {note}")?;
    }
    writeln!(
        out,
        "{:.3} s on {} thread(s)",
        report.seconds, report.threads
    )
}
