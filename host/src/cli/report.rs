//! `palpus report`: one self-contained page to look at a surface.

use super::{Common, Exit, Failure};
use anyhow::Context;
use palpus_host::cloud;
use palpus_host::export::SurfaceFile;
use palpus_host::picture::Page;
use palpus_host::report::Report;
use std::io::Write;
use std::path::PathBuf;

/// Make one self-contained HTML page to look at a surface, without network.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Surface file that `reconstruct` wrote.
    pub surface: PathBuf,
    /// Where the page goes.
    #[arg(short, long, value_name = "FILE.html")]
    pub output: PathBuf,
    /// Points to show with their distances (.ply, .xyz, .csv, .pcd); several are joined.
    #[arg(long, value_name = "FILE")]
    pub points: Vec<PathBuf>,
    /// Figures of the reconstruction, as `reconstruct --report` wrote them.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
}

/// Reads, lays out, writes.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    let refused = |error: anyhow::Error| Failure::new(Exit::Input, error);
    let file = SurfaceFile::read(&args.surface).map_err(|e| refused(e.into()))?;
    let cloud = if args.points.is_empty() {
        None
    } else {
        Some(cloud::read_all(&args.points).map_err(|e| refused(e.into()))?)
    };
    let report = args.report.as_ref().map(|path| -> anyhow::Result<Report> {
        let name = path.display();
        let text = std::fs::read(path).with_context(|| {
            format!("{name}: cannot be read; check the path and the permissions")
        })?;
        serde_json::from_slice(&text).with_context(|| {
            format!("{name}: is no report; give a file that `palpus reconstruct --report` wrote")
        })
    });
    let report = report.transpose().map_err(refused)?;
    let title = args.surface.file_stem().unwrap_or(args.surface.as_os_str());
    let title = title.to_string_lossy();
    let page = Page {
        title: &title,
        file: &file,
        report: report.as_ref(),
        cloud: cloud.as_ref(),
    };
    let html = page.html().map_err(|e| refused(e.into()))?;
    std::fs::write(&args.output, &html)
        .with_context(|| {
            format!(
                "{}: cannot be written; choose another folder or make room",
                args.output.display()
            )
        })
        .map_err(refused)?;
    // A reader that has gone away (a closed pipe) is no fault of the page.
    let mut out = std::io::stdout().lock();
    if common.json {
        let answer = serde_json::json!({
            "file": args.output.display().to_string(),
            "bytes": html.len(),
            "patches": file.surface.faces.len(),
            "points": cloud.map_or(0, |cloud| cloud.points.len()),
        });
        let _ = writeln!(out, "{answer}");
    } else {
        let _ = writeln!(
            out,
            "{} ({:.1} MB): open it in a browser",
            args.output.display(),
            html.len() as f64 / 1e6
        );
    }
    Ok(Exit::Done)
}
