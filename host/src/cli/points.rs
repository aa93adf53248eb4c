//! `palpus points`: from runs to a point file.

use super::{Common, Exit, Failure, outputs};
use anyhow::Context;
use palpus_host::cloud::{Cloud, write_ply};
use palpus_host::hand::Hand;
use palpus_host::run::points::{RunReport, points};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Turn the valid contacts of runs into points in the world: mm, normals, sigma, finger, time.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus points run.mcap -o points.ply
  palpus points monday.mcap tuesday.mcap --hand hand-as-mended.urdf -o points.ply
      two runs joined, placed by a hand measured anew")]
pub struct Args {
    /// Runs written by `palpus capture`, whole or cut off.
    #[arg(value_name = "RUN.mcap", required = true)]
    runs: Vec<PathBuf>,
    /// The point file to write.
    #[arg(short, long, value_name = "POINTS.ply")]
    output: PathBuf,
    /// Use this hand instead of the one in the runs.
    #[arg(long, value_name = "FILE")]
    hand: Option<PathBuf>,
}

/// Runs the command.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    let refused = |e: anyhow::Error| Failure::new(Exit::Input, e);
    outputs::check_file(&args.output)?;
    let hand = match &args.hand {
        Some(path) => Some(Hand::read(path).map_err(|e| refused(e.into()))?),
        None => None,
    };
    let result = points(&args.runs, hand.as_ref()).map_err(|e| refused(e.into()))?;
    write(&args.output, &result.cloud)
        .with_context(|| format!("can't write {}", args.output.display()))
        .map_err(refused)?;
    // A reader that has gone away is no fault of the points.
    let _ = print(common, &args, &result.reports, result.cloud.points.len());
    Ok(Exit::Done)
}

fn write(path: &Path, cloud: &Cloud) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    write_ply(cloud, &mut file)?;
    file.flush()
}

fn print(common: &Common, args: &Args, reports: &[RunReport], count: usize) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if common.json {
        let runs: Vec<serde_json::Value> = reports.iter().map(report_json).collect();
        return writeln!(
            out,
            "{}",
            serde_json::json!({"output": args.output, "points": count, "runs": runs})
        );
    }
    writeln!(out, "{}: {count} points", args.output.display())?;
    for report in reports {
        let state = if report.complete {
            ""
        } else {
            ", not closed properly"
        };
        writeln!(
            out,
            "{}: {:.1} s{state}",
            report.path.display(),
            report.seconds
        )?;
        for damage in &report.damage {
            writeln!(out, "  {damage}")?;
        }
        for finger in &report.fingers {
            writeln!(
                out,
                "  {}: {} points of {} contacts; {} lost, {} restarts",
                finger.finger, finger.valid, finger.contacts, finger.lost, finger.restarts
            )?;
            for (reason, count) in &finger.invalid {
                writeln!(out, "    {count} invalid: {reason}")?;
            }
            if let Some(reason) = &finger.unreadable_reason {
                writeln!(out, "    {} unreadable frames: {reason}", finger.unreadable)?;
            }
            if let Some(link) = &finger.link
                && link.bad + link.dropped_by_host > 0
            {
                writeln!(
                    out,
                    "    {} frames damaged on the line, {} dropped by the computer",
                    link.bad, link.dropped_by_host
                )?;
            }
        }
    }
    Ok(())
}

fn report_json(report: &RunReport) -> serde_json::Value {
    let fingers: Vec<serde_json::Value> = report
        .fingers
        .iter()
        .map(|f| {
            serde_json::json!({
                "finger": f.finger, "contacts": f.contacts, "points": f.valid, "invalid": f.invalid,
                "lost": f.lost, "duplicates": f.duplicates, "out_of_order": f.out_of_order,
                "restarts": f.restarts, "unreadable": f.unreadable,
                "bad": f.link.as_ref().map(|l| l.bad),
                "dropped_by_host": f.link.as_ref().map(|l| l.dropped_by_host),
            })
        })
        .collect();
    serde_json::json!({
        "run": report.path, "complete": report.complete, "damage": report.damage,
        "seconds": report.seconds, "fingers": fingers,
    })
}
