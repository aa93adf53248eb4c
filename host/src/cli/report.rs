//! `palpus report`: one self-contained page to look at a surface.

use super::reconstruct::read;
use super::{Common, Exit, Failure, outputs, say};
use anyhow::Context;
use palpus_host::export::SurfaceFile;
use palpus_host::import::read_mesh;
use palpus_host::picture::Page;
use palpus_host::report::Report;
use std::path::PathBuf;

/// Make one self-contained HTML page to look at a surface, without network.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus report surface.json -o surface.html
      the surface alone
  palpus report surface.json -o surface.html --points run.mcap --report report.json
      with the contacts, their tracks by finger, and the figures of all phases
(`palpus reconstruct --page` writes the whole page at once.)")]
pub struct Args {
    /// Surface file that `reconstruct` wrote.
    pub surface: PathBuf,
    /// Where the page goes.
    #[arg(short, long, value_name = "FILE.html")]
    pub output: PathBuf,
    /// Points to show with their distances: runs (.mcap) or point files (.ply, .xyz, .csv, .pcd); several are joined.
    #[arg(long, value_name = "FILE")]
    pub points: Vec<PathBuf>,
    /// Figures of the reconstruction, as `reconstruct --report` wrote them.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Triangles of phase 1 to show, as `reconstruct --stop-after extract --mesh` wrote them.
    #[arg(long, value_name = "MESH")]
    pub extracted: Option<PathBuf>,
    /// Triangles of phase 2 to show, as `reconstruct --stop-after simplify --mesh` wrote them.
    #[arg(long, value_name = "MESH")]
    pub simplified: Option<PathBuf>,
}

/// Reads, lays out, writes.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    let refused = |error: anyhow::Error| Failure::new(Exit::Input, error);
    outputs::check_file(&args.output)?;
    let mesh = |path: &Option<PathBuf>| path.as_ref().map(|p| read_mesh(p)).transpose();
    let extracted = mesh(&args.extracted).map_err(|e| refused(e.into()))?;
    let simplified = mesh(&args.simplified).map_err(|e| refused(e.into()))?;
    let file = SurfaceFile::read(&args.surface).map_err(|e| refused(e.into()))?;
    let cloud = if args.points.is_empty() {
        None
    } else {
        Some(read(&args.points)?)
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
        extracted: extracted.as_ref(),
        simplified: simplified.as_ref(),
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
    say::out(&if common.json {
        let answer = serde_json::json!({
            "file": args.output.display().to_string(),
            "bytes": html.len(),
            "patches": file.surface.faces.len(),
            "points": cloud.map_or(0, |cloud| cloud.points.len()),
        });
        format!("{answer}\n")
    } else {
        format!(
            "{} ({:.1} MB): open it in a browser\n",
            args.output.display(),
            html.len() as f64 / 1e6
        )
    });
    Ok(Exit::Done)
}
