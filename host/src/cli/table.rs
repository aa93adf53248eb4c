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
            error.outcome(),
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

/// The figures of a demo, beside those of the paper.
pub fn demo(object: &str, out: &std::path::Path, demo: &palpus_host::demo::Demo) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_demo(&mut text, object, demo);
    text.push_str(&super::demo::what_to_open(out));
    text
}

/// The paper's two experiments: points; triangles extracted and simplified; patches and error sum after fit
/// and refinement; tolerance; minutes per phase.
const PAPER: [[&str; 12]; 2] = [
    [
        "paper, object 1",
        "1229",
        "1314",
        "174",
        "174",
        "2.3e-3",
        "195",
        "1.4e-3",
        "1.8 s",
        "12 s",
        "28 min",
        "35 min",
    ],
    [
        "paper, object 2",
        "1122",
        "860",
        "93",
        "93",
        "2.48e-2",
        "169",
        "9e-3",
        "1.2 s",
        "12 s",
        "38 min",
        "47 min",
    ],
];

fn write_demo(out: &mut String, object: &str, demo: &palpus_host::demo::Demo) -> std::fmt::Result {
    for run in &demo.runs {
        for finger in &run.fingers {
            writeln!(
                out,
                "{}: {} contacts, {} valid, {} lost, {} out of order",
                finger.finger, finger.contacts, finger.valid, finger.lost, finger.out_of_order
            )?;
        }
    }
    let contacts = &demo.contacts;
    writeln!(
        out,
        "contacts against the true {object}: {:.3} mm and {:.2} degrees rms, {:.3} mm and {:.2} degrees at most",
        contacts.position_rms_mm,
        contacts.normal_rms_degrees,
        contacts.position_max_mm,
        contacts.normal_max_degrees
    )?;
    let report = &demo.reconstruction.report;
    write_report(out, report)?;
    writeln!(
        out,
        "surface against the true {object}: {:.4} mm rms, {:.3} mm at most; {:.4} mm and {:.3} mm the other way",
        demo.truth.accuracy.rms,
        demo.truth.accuracy.max,
        demo.truth.completeness.rms,
        demo.truth.completeness.max
    )?;
    let phase = |name: &str| report.phases.iter().find(|p| p.name == name);
    let whole = |n: Option<usize>| n.map_or_else(|| "-".into(), |n| n.to_string());
    let real = |x: Option<f64>| x.map_or_else(|| "-".into(), |x| format!("{x:.2e}"));
    let time =
        |name: &str| phase(name).map_or_else(|| "-".into(), |p| format!("{:.3} s", p.seconds));
    let own: [String; 12] = [
        format!("this {object}"),
        report.input.used.to_string(),
        whole(phase("extract").and_then(|p| p.triangles)),
        whole(phase("simplify").and_then(|p| p.triangles)),
        whole(phase("fit").and_then(|p| p.patches)),
        real(phase("fit").and_then(|p| p.error_sum)),
        whole(phase("refine").and_then(|p| p.patches)),
        real(phase("refine").and_then(|p| p.error_sum)),
        time("extract"),
        time("simplify"),
        time("fit"),
        time("refine"),
    ];
    let heads = [
        "",
        "points",
        "extracted",
        "simplified",
        "fitted",
        "error",
        "refined",
        "error",
        "extract",
        "simplify",
        "fit",
        "refine",
    ];
    let row = |out: &mut String, cells: &[&str]| {
        let (first, rest) = cells.split_first().unwrap_or((&"", &[]));
        let _ = write!(out, "{first:<18}");
        for cell in rest {
            let _ = write!(out, "{cell:>11}");
        }
        out.push('\n');
    };
    row(out, &heads);
    row(out, &own.each_ref().map(String::as_str));
    for paper in &PAPER {
        row(out, paper);
    }
    writeln!(
        out,
        "(error: sum of squared distances, here in mm^2; the paper's unit is its object's size, its machine a 600 MHz Pentium III)"
    )
}
