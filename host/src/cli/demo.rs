//! `palpus demo`: no hardware; a simulated hand, real terminals, a surface, and what to open.

use super::live::{LiveArgs, Watch};
use super::progress::PhaseLine;
use super::reconstruct::{segments, stages};
use super::simulate::{self, HandArgs};
use super::{Common, Exit, Failure, interruption, outputs, say};
use anyhow::Context;
use palpus_host::cloud::write_ply;
use palpus_host::demo::{Demo, Step, demo};
use palpus_host::export::surface_file::Provenance;
use palpus_host::export::{Origin, SurfaceFile, step, write_bytes, write_mesh};
use palpus_host::hand::Hand;
use palpus_host::picture::{FigureOptions, Page};
use palpus_host::reconstruct::Options;
use palpus_host::run::capture::CaptureEvent;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};

/// Explore an object with a simulated three-finger hand and reconstruct it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus demo
      a torus; everything goes to palpus-demo/
  palpus demo --object mug --live
      a mug, with a page to watch it being touched
  palpus demo --object part.stl --size 120 --noise 2 --out part
      a mesh of your own, 120 mm long, with twice the usual noise")]
pub struct Args {
    /// What to touch: sphere, ellipsoid, torus, two-holed-torus, mug, bowl, bean, trilobe, cube, cylinder, or a
    /// closed mesh file (.ply, .obj, .stl).
    #[arg(long, value_name = "NAME|FILE", default_value = "torus")]
    object: String,
    /// Longest side of an object from a mesh file, in millimetres [default: 150].
    #[arg(long, value_name = "MM")]
    size: Option<f64>,
    /// Folder for everything that is written; made if need be.
    #[arg(long, value_name = "DIR", default_value = "palpus-demo")]
    out: PathBuf,
    #[command(flatten)]
    hand: HandArgs,
    /// Largest distance of a contact from the surface, millimetres. Default: from size and noise.
    #[arg(long, value_name = "MM")]
    tolerance: Option<f64>,
    /// Threads; the surface does not depend on them. Default: all cores.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    #[command(flatten)]
    live: LiveArgs,
}

/// Runs the command.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    let device = |e: anyhow::Error| Failure::new(Exit::Device, e);
    let object = simulate::object(&args.object, args.size)?;
    let hand = args.hand.at(object);
    let options = Options {
        tolerance: args.tolerance,
        threads: args.threads,
        ..Options::default()
    };
    outputs::check_folder(&args.out)?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| {
            format!(
                "{}: cannot be made; choose another folder with --out",
                args.out.display()
            )
        })
        .map_err(|e| Failure::new(Exit::Input, e))?;
    let stop = interruption()?;
    let shipped = [("hand.urdf".to_owned(), Hand::THREE_FINGER_URDF.to_owned())];
    let names: Vec<String> = Hand::from_sources(&shipped)
        .map_err(|e| device(e.into()))?
        .fingers()
        .iter()
        .take(args.hand.fingers)
        .map(|finger| finger.name.clone())
        .collect();
    let line = PhaseLine::new(common);
    line.note(&format!("planning tracks over the {} …", args.object));
    let watch = Watch::start(&args.live, &names, &shipped, &stop)?;
    line.hide(watch.as_ref().is_some_and(Watch::on_screen));
    let watch = Mutex::new(watch);
    let result = demo(
        &hand,
        &args.out.join("run.mcap"),
        &options,
        &stop,
        &|step| {
            let mut watch = watch.lock().unwrap_or_else(PoisonError::into_inner);
            match step {
                Step::Capture(event) => {
                    let on_screen = watch.as_ref().is_some_and(|watch| watch.show(event));
                    if !on_screen {
                        tell(event, args.hand.contacts, &line);
                    }
                }
                Step::Reconstruct(progress) => {
                    if let Some(watch) = watch.take() {
                        watch.end("all gone over");
                        line.hide(false);
                    }
                    line.show(progress);
                }
            }
        },
    );
    drop(watch);
    let result = result.map_err(|e| device(e.into()))?;
    line.say(format!("writing {}", args.out.display()));
    write(&args, &result).map_err(|e| Failure::new(Exit::Input, e))?;
    drop(line);
    if common.json {
        say::out(&format!("{}\n", json(&args, &result)));
    } else {
        say::out(&super::table::demo(&args.object, &args.out, &result));
    }
    Ok(if stop.load(Ordering::Relaxed) {
        Exit::Interrupted
    } else {
        Exit::Done
    })
}

/// What the capture tells, in lines; how far it is, in the line that lives.
fn tell(event: &CaptureEvent<'_>, contacts: usize, line: &PhaseLine) {
    match event {
        CaptureEvent::Found {
            finger,
            port,
            identity,
        } => line.note(&format!(
            "{finger}: board `{}` on {port}, {} Hz",
            identity.finger_name,
            1_000_000 / identity.period_us.max(1)
        )),
        CaptureEvent::Progress(progress) => {
            let seconds = progress.elapsed.as_secs_f64();
            let rate = progress.points as f64 / seconds.max(0.1);
            // The fingers touch the asked number of times on their way, and some more where they turn.
            let left = (contacts as f64 - progress.points as f64).max(0.0) / rate.max(1.0);
            line.live(format!(
                "touching: {} valid contacts, {rate:.0} a second, about {left:.0} s left",
                progress.points
            ));
        }
        CaptureEvent::Note { finger, text, .. } => line.note(&format!("{finger}: {text}")),
        CaptureEvent::Touches(_) => {}
    }
}

/// Writes everything into the folder.
fn write(args: &Args, result: &Demo) -> anyhow::Result<()> {
    let at = |name: &str| args.out.join(name);
    write_bytes(&at("hand.urdf"), Hand::THREE_FINGER_URDF.as_bytes())?;
    let mut bytes = Vec::new();
    write_ply(&result.cloud, &mut bytes)?;
    write_bytes(&at("points.ply"), &bytes)?;
    let report = &result.reconstruction.report;
    write_bytes(&at("report.json"), report.to_json().as_bytes())?;
    let Some(surface) = &result.reconstruction.surface else {
        return Ok(());
    };
    let file = SurfaceFile {
        surface: surface.clone(),
        chart: None,
        units: Some("mm".into()),
        provenance: Provenance {
            inputs: vec![Origin::of_file(&at("run.mcap"))?],
            options: std::collections::BTreeMap::new(),
        },
        error: report.error.clone(),
    };
    file.write(&at("surface.json"))?;
    let sampled = surface.sample_per_patch(segments(surface.faces.len()))?;
    for name in ["surface.ply", "surface.stl", "surface.glb"] {
        write_mesh(&at(name), &sampled)?;
    }
    step::write(&at("surface.step"), surface, Some("mm"))?;
    let page = Page {
        title: &args.object,
        file: &file,
        report: Some(report),
        cloud: Some(&result.cloud),
        extracted: Some(&result.reconstruction.extracted),
        simplified: result.reconstruction.simplified.as_ref(),
    };
    write_bytes(&at("report.html"), page.html()?.as_bytes())?;
    let figures = FigureOptions {
        unit: "mm".into(),
        ..FigureOptions::default()
    };
    stages(&result.cloud, &result.reconstruction).draw(&at("figures"), &figures)?;
    Ok(())
}

fn json(args: &Args, result: &Demo) -> serde_json::Value {
    let fingers: Vec<serde_json::Value> = result
        .runs
        .iter()
        .flat_map(|run| &run.fingers)
        .map(|f| {
            serde_json::json!({
                "finger": f.finger, "contacts": f.contacts, "valid": f.valid, "lost": f.lost,
                "out_of_order": f.out_of_order, "duplicates": f.duplicates,
            })
        })
        .collect();
    serde_json::json!({
        "object": args.object,
        "out": args.out,
        "fingers": fingers,
        "contacts": result.contacts,
        "report": result.reconstruction.report,
        "truth": result.truth,
    })
}

/// The files a person opens first.
pub fn what_to_open(out: &Path) -> String {
    format!(
        "open {}/report.html in a browser, {}/figures/contact-sheet.png, {}/surface.glb in a viewer, {}/surface.step in CAD\n",
        out.display(),
        out.display(),
        out.display(),
        out.display()
    )
}
