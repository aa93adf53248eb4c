//! `palpus reconstruct`: points with normals in, a smooth surface out.

use super::progress::PhaseLine;
use super::{Common, Exit, Failure, outputs, say};
use anyhow::{Context, anyhow};
use palpus_host::cloud::{self, Cloud};
use palpus_host::export::surface_file::Provenance;
use palpus_host::export::{
    MeshFormat, Origin, SurfaceFile, check_memory, sampled_from_mesh, step, write_bytes, write_mesh,
};
use palpus_host::picture::{FigureOptions, Page, Stages, View};
use palpus_host::reconstruct::creases::CreaseOptions;
use palpus_host::reconstruct::extract;
use palpus_host::reconstruct::fit::NormalTerm;
use palpus_host::reconstruct::{Options, ReconstructError, Reconstruction, Stage, reconstruct};
use palpus_host::report::InputFigures;
use palpus_host::run::points::points;
use palpus_host::spline::{Fineness, SampledSurface, Surface};
use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "\
Examples:
  palpus reconstruct points.ply -o surface.json --page surface.html
      a surface, and a page to look at it
  palpus reconstruct run.mcap -o surface.json --mesh part.stl --step part.step
      from a captured run to a printer and to CAD
  palpus reconstruct points.ply --tolerance 0.05 --strict --json
      figures only; leaves with code 4 if a point lies farther off than 0.05
  palpus reconstruct points.ply --figures figures --turntable --view 30,20
      pictures of all stages, and a turn around the surface";

/// Reconstruct a surface from points with normals.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Runs (.mcap) or point files with normals (.ply, .xyz, .csv, .pcd); several are joined.
    #[arg(required = true)]
    input: Vec<PathBuf>,
    /// Surface file to write (.json).
    #[arg(short, long, help_heading = "Outputs")]
    output: Option<PathBuf>,
    /// Largest distance of a point from the surface, in the unit of the input.
    /// Default: 1e-3 of the bounding box's diagonal, or three times the noise found, whichever is larger.
    #[arg(long, help_heading = "How close", value_name = "E")]
    tolerance: Option<f64>,
    /// Weight of the normals relative to the positions. Default: from the noise of both.
    #[arg(long, help_heading = "How close", value_name = "L")]
    lambda: Option<f64>,
    /// How the measured normal enters the fit.
    #[arg(long, help_heading = "How close", value_enum, default_value_t = Term::ParameterFree)]
    normal_term: Term,
    /// Bring curvature across the patches' edges together (a network has it continuous only nearly). Optional weight:
    /// more is fairer and farther from the points; 0 leaves it out. Default: a little, by the noise.
    #[arg(long, help_heading = "What surface", value_name = "W", num_args = 0..=1, default_missing_value = "1")]
    fair_curvature: Option<f64>,
    /// Most patches.
    #[arg(
        long,
        help_heading = "How close",
        value_name = "N",
        default_value_t = 20_000
    )]
    max_patches: usize,
    /// Rounds of fit and reparameterisation per level, at most 100.
    #[arg(
        long,
        help_heading = "How close",
        value_name = "N",
        default_value_t = 4
    )]
    rounds: usize,
    /// Mesh to write, by extension .ply, .obj, .stl or .glb; may be given several times.
    #[arg(long, help_heading = "Meshes", value_name = "FILE")]
    mesh: Vec<PathBuf>,
    /// Edge length of the meshes' triangles, in the unit of the input.
    #[arg(
        long,
        help_heading = "Meshes",
        value_name = "H",
        conflicts_with = "mesh_per_patch"
    )]
    mesh_step: Option<f64>,
    /// Cut each patch edge in so many segments. Default: as many as give about 100 000 triangles, 6 to 40.
    #[arg(long, help_heading = "Meshes", value_name = "K")]
    mesh_per_patch: Option<usize>,
    /// Cut the triangles as coarsely as a chord error of this much allows, in the unit of the input.
    #[arg(long, help_heading = "Meshes", value_name = "E", conflicts_with_all = ["mesh_step", "mesh_per_patch"])]
    mesh_chord: Option<f64>,
    /// Write mean and Gaussian curvature to .ply and .glb, and colour them by the mean curvature.
    #[arg(long, help_heading = "Meshes")]
    mesh_curvature: bool,
    /// Largest gap between contacts that is closed, in the unit of the input; wider ones stay open with a clean
    /// border. Default: from the data, with the reason in the report.
    #[arg(long, help_heading = "What surface", value_name = "GAP")]
    max_gap: Option<f64>,
    /// What kind of surface: a network of patches over any shape, or one chart over a disk-like region, smooth
    /// in curvature everywhere from degree 3.
    #[arg(long, help_heading = "What surface", value_enum, default_value_t = Kind::Network)]
    surface: Kind,
    /// Degree of the chart, 2 to 5; it is continuously differentiable one time less.
    #[arg(long, help_heading = "What surface", value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(2..=5))]
    degree: u8,
    /// Make everything smooth: look for no creases.
    #[arg(long, help_heading = "What surface")]
    no_creases: bool,
    /// Most memory that extraction, simplification, fit and meshes may each take, in MB: estimated before it is taken.
    /// Refinement ends before it would take more.
    #[arg(
        long,
        help_heading = "Running",
        value_name = "MB",
        default_value_t = 2048
    )]
    max_memory: usize,
    /// CAD file to write (.step): the patches themselves, without approximation.
    #[arg(long, help_heading = "Outputs", value_name = "FILE")]
    step: Option<PathBuf>,
    /// Report to write (.json).
    #[arg(long, help_heading = "Outputs", value_name = "FILE")]
    report: Option<PathBuf>,
    /// Folder for pictures of every stage (.png); made if need be.
    #[arg(long, help_heading = "Outputs", value_name = "DIR")]
    figures: Option<PathBuf>,
    /// Where the pictures are taken from: azimuth,elevation in degrees.
    #[arg(
        long,
        help_heading = "Outputs",
        value_name = "A,E",
        allow_hyphen_values = true,
        requires = "figures"
    )]
    view: Option<View>,
    /// Also draw a turn around the surface, of so many pictures, as an animated PNG (turntable.png).
    #[arg(long, help_heading = "Outputs", value_name = "N", num_args = 0..=1, default_missing_value = "36", requires = "figures",
          value_parser = clap::value_parser!(u16).range(2..=360))]
    turntable: Option<u16>,
    /// Page to write (.html): the surface in the browser with the meshes, points and figures of all stages.
    #[arg(long, help_heading = "Outputs", value_name = "FILE")]
    page: Option<PathBuf>,
    /// How the field of phase 1 is made.
    #[arg(long, help_heading = "What surface", value_enum, default_value_t = FieldMethod::Hermite)]
    field: FieldMethod,
    /// Unit of the input's lengths (mm, cm, m, in); kept in the files that can say it.
    #[arg(long, help_heading = "Outputs", value_name = "UNIT")]
    units: Option<String>,
    /// Threads; the result does not depend on them. Default: all cores.
    #[arg(long, help_heading = "Running", value_name = "N")]
    threads: Option<usize>,
    /// Seed; kept in the surface file. Nothing in the reconstruction is random.
    #[arg(long, help_heading = "Running", value_name = "S", default_value_t = 0)]
    seed: u64,
    /// Stop after this phase and write what there is.
    #[arg(long, help_heading = "Running", value_enum)]
    stop_after: Option<StopAfter>,
    /// Leave with code 4 if the tolerance is not met.
    #[arg(long, help_heading = "Running")]
    strict: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// Patches of degree 5 whose tangent planes agree.
    Network,
    /// One triangular B-spline.
    Chart,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Term {
    /// The component of the measured normal in the tangent plane.
    ParameterFree,
    /// Tangents in the frame of the base triangle (the paper's eqs. 7 and 8).
    FaceFrame,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum FieldMethod {
    /// Local Gaussian-process fits to positions and normals, blended.
    Hermite,
    /// The paper's distance to averaged tangent planes.
    TangentPlanes,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum StopAfter {
    /// The dense mesh of phase 1.
    Extract,
    /// The base mesh of phase 2.
    Simplify,
    /// The fitted network of phase 3.
    Fit,
}

/// Runs the command.
pub fn run(common: &Common, args: &Args) -> Result<Exit, Failure> {
    check_outputs(args)?;
    let cloud = read(&args.input)?;
    let options = Options {
        tolerance: args.tolerance,
        lambda: args.lambda,
        normal_term: match args.normal_term {
            Term::ParameterFree => NormalTerm::ParameterFree,
            Term::FaceFrame => NormalTerm::FaceFrame,
        },
        fair_curvature: args.fair_curvature,
        max_patches: args.max_patches,
        rounds: args.rounds,
        threads: args.threads,
        stop_after: match args.stop_after {
            Some(StopAfter::Extract) => Stage::Extract,
            Some(StopAfter::Simplify) => Stage::Simplify,
            Some(StopAfter::Fit) => Stage::Fit,
            None => Stage::Refine,
        },
        extract: extract::Options {
            method: match args.field {
                FieldMethod::Hermite => extract::Options::default().method,
                FieldMethod::TangentPlanes => extract::Method::TangentPlanes,
            },
            max_gap: args.max_gap,
            max_memory: args.max_memory.saturating_mul(1 << 20),
            // With -v only: the line that lives has the terminal.
            announce: if common.verbose > 0 { announce } else { |_| {} },
            ..extract::Options::default()
        },
        chart: (args.surface == Kind::Chart).then_some(usize::from(args.degree)),
        creases: (!args.no_creases).then(CreaseOptions::default),
        ..Options::default()
    };
    let line = PhaseLine::new(common);
    let result = reconstruct(&cloud, &options, &|progress| line.show(progress)).map_err(|e| {
        // There is no report to name them in, and they may be why.
        for row in InputFigures::of(&cloud).rejected_rows {
            say::err(&format!("  left out: {row}"));
        }
        Failure::new(exit_of(&e), e)
    })?;
    line.say("writing".to_owned());
    write(args, &cloud, &result)?;
    drop(line);
    let text = if common.json {
        result.report.to_json()
    } else {
        super::table::report(&result.report)
    };
    say::out(&text);
    let met = result.report.error.as_ref().is_none_or(|e| e.met);
    Ok(if args.strict && !met {
        Exit::Tolerance
    } else {
        Exit::Done
    })
}

fn announce(lattice: extract::Estimate) {
    say::err(&format!(
        "  lattice of about {} cubes, {:.1} MB of at most {}",
        lattice.cubes,
        lattice.bytes as f64 / f64::from(1 << 20),
        lattice.limit >> 20
    ));
}

/// Which code a failed reconstruction leaves with.
fn exit_of(error: &ReconstructError) -> Exit {
    match error {
        ReconstructError::BadOption { .. } | ReconstructError::Threads(_) => Exit::Usage,
        _ => Exit::Input,
    }
}

/// Refuses, before any work is done, what could not be written after it.
fn check_outputs(args: &Args) -> Result<(), Failure> {
    let usage = |e: anyhow::Error| Err(Failure::new(Exit::Usage, e));
    if matches!(
        args.stop_after,
        Some(StopAfter::Extract | StopAfter::Simplify)
    ) && (args.output.is_some() || args.step.is_some())
    {
        return usage(anyhow!(
            "--stop-after extract and simplify end before there is a surface, so -o and --step have nothing to write; leave them out and use --mesh for the triangles of that stage"
        ));
    }
    for (name, value) in [
        ("mesh-step", args.mesh_step),
        ("mesh-chord", args.mesh_chord),
    ] {
        if let Some(value) = value.filter(|s| !(s.is_finite() && *s > 0.0)) {
            return usage(anyhow!("--{name} {value}: a number above 0 is needed"));
        }
    }
    for path in &args.mesh {
        if let Err(error) = MeshFormat::of(path) {
            return usage(error.into());
        }
    }
    if args.page.is_some() && args.surface == Kind::Chart {
        return usage(anyhow!(
            "--page shows networks; leave out --surface chart, or look at it by --mesh or --figures"
        ));
    }
    let files = [&args.output, &args.step, &args.report, &args.page];
    for path in files.into_iter().flatten().chain(&args.mesh) {
        outputs::check_file(path)?;
    }
    args.figures
        .as_deref()
        .map_or(Ok(()), outputs::check_folder)
}

/// First bytes of a run.
const RUN_MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Reads and joins the inputs, runs and point files alike.
pub fn read(inputs: &[PathBuf]) -> Result<Cloud, Failure> {
    let mut all = Cloud::default();
    for path in inputs {
        let is_run = File::open(path).is_ok_and(|mut file| {
            let mut head = [0; RUN_MAGIC.len()];
            file.read_exact(&mut head).is_ok() && head == RUN_MAGIC
        });
        let cloud = if is_run {
            points(std::slice::from_ref(path), None)
                .map_err(|e| Failure::new(Exit::Input, e))?
                .cloud
        } else {
            cloud::read(path).map_err(|e| Failure::new(Exit::Input, e))?
        };
        all.append(cloud);
    }
    Ok(all)
}

/// Writes what was asked for.
fn write(args: &Args, cloud: &Cloud, result: &Reconstruction) -> Result<(), Failure> {
    let input = |e: anyhow::Error| Failure::new(Exit::Input, e);
    let surface = final_surface(args, result)?;
    if (args.output.is_some() || args.page.is_some())
        && (surface.is_some() || result.chart.is_some())
    {
        let file = SurfaceFile {
            surface: result.surface.clone().unwrap_or_default(),
            chart: result.chart.clone(),
            units: args.units.clone(),
            provenance: provenance(args).map_err(input)?,
            error: result.report.error.clone(),
        };
        if let Some(path) = &args.output {
            file.write(path).map_err(|e| input(e.into()))?;
        }
        if let Some(path) = &args.page {
            let title = args.output.as_ref().or(args.input.first());
            let title = title.and_then(|path| path.file_stem());
            let page = Page {
                title: &title.unwrap_or_default().to_string_lossy(),
                file: &file,
                report: Some(&result.report),
                cloud: Some(cloud),
                extracted: Some(&result.extracted),
                simplified: result.simplified.as_ref(),
            };
            let html = page.html().map_err(|e| input(e.into()))?;
            write_bytes(path, html.as_bytes()).map_err(|e| input(e.into()))?;
        }
    }
    if let (Some(path), Some(surface)) = (&args.step, &surface) {
        step::write(path, surface, args.units.as_deref()).map_err(|e| input(e.into()))?;
    }
    if let Some(folder) = &args.figures {
        let figures = FigureOptions {
            view: args.view.unwrap_or_default(),
            unit: args.units.clone().unwrap_or_default(),
            turntable_frames: args.turntable.map_or(0, usize::from),
            ..FigureOptions::default()
        };
        Stages {
            refined: surface.as_deref(),
            ..stages(cloud, result)
        }
        .draw(folder, &figures)
        .map_err(|e| input(e.into()))?;
    }
    if let Some(path) = &args.report {
        write_bytes(path, result.report.to_json().as_bytes()).map_err(|e| input(e.into()))?;
    }
    // Last: what is too fine for the memory allowed keeps nothing else from being written.
    for path in &args.mesh {
        let sampled = sample(args, result, path).map_err(input)?;
        write_mesh(path, &sampled).map_err(|e| input(e.into()))?;
    }
    Ok(())
}

/// The surface that STEP and the pictures show: the network, or a chart's pieces where they are needed.
fn final_surface<'a>(
    args: &Args,
    result: &'a Reconstruction,
) -> Result<Option<Cow<'a, Surface>>, Failure> {
    Ok(match (&result.surface, &result.chart) {
        (Some(surface), _) => Some(Cow::Borrowed(surface)),
        (None, Some(chart)) if args.step.is_some() || args.figures.is_some() => {
            let pieces = chart.pieces().map_err(|e| Failure::new(Exit::Input, e))?;
            Some(Cow::Owned(pieces.surface))
        }
        _ => None,
    })
}

/// Everything that can be drawn.
pub fn stages<'a>(cloud: &'a Cloud, result: &'a Reconstruction) -> Stages<'a> {
    Stages {
        cloud: Some(cloud),
        extracted: Some(&result.extracted),
        simplified: result.simplified.as_ref(),
        fitted: result.fitted.as_ref(),
        refined: result.surface.as_ref(),
    }
}

/// The triangles of the last stage that ran, for a mesh to be written to `path`.
fn sample(args: &Args, result: &Reconstruction, path: &Path) -> anyhow::Result<SampledSurface> {
    let fineness = |patches: usize| match (args.mesh_step, args.mesh_chord) {
        (Some(step), _) => Fineness::Step(step),
        (None, Some(chord)) => Fineness::Chord(chord),
        (None, None) => {
            Fineness::Segments(args.mesh_per_patch.unwrap_or_else(|| segments(patches)))
        }
    };
    let limit = args.max_memory.saturating_mul(1 << 20);
    if let Some(chart) = &result.chart {
        let fineness = fineness(chart.inner_triangles().len());
        check_memory(path, chart.triangles_at(fineness), true, limit)?;
        let mut sampled = chart.sample_to(fineness);
        if args.mesh_curvature {
            chart.add_curvature(&mut sampled);
        }
        return Ok(sampled);
    }
    let Some(surface) = &result.surface else {
        return Ok(sampled_from_mesh(
            result.simplified.as_ref().unwrap_or(&result.extracted),
        ));
    };
    let fineness = fineness(surface.faces.len());
    check_memory(path, surface.triangles_at(fineness)?, false, limit)?;
    let mut sampled = surface.sample_to(fineness)?;
    if args.mesh_curvature {
        surface.add_curvature(&mut sampled);
    }
    Ok(sampled)
}

/// Segments per patch edge for about 100 000 triangles.
pub fn segments(patches: usize) -> usize {
    ((1e5 / patches.max(1) as f64).sqrt() as usize).clamp(6, 40)
}

fn provenance(args: &Args) -> anyhow::Result<Provenance> {
    let inputs = args
        .input
        .iter()
        .map(|path| {
            Origin::of_file(path).with_context(|| format!("{}: cannot be read", path.display()))
        })
        .collect::<anyhow::Result<_>>()?;
    let mut options = std::collections::BTreeMap::new();
    let mut put = |name: &str, value: serde_json::Value| {
        if !value.is_null() {
            options.insert(name.to_owned(), value);
        }
    };
    put("tolerance", args.tolerance.into());
    put("lambda", args.lambda.into());
    put("fair-curvature", args.fair_curvature.into());
    put("max-patches", args.max_patches.into());
    put("rounds", args.rounds.into());
    put("max-gap", args.max_gap.into());
    put("units", args.units.clone().into());
    if args.normal_term == Term::FaceFrame {
        put("normal-term", "face-frame".into());
    }
    if args.field == FieldMethod::TangentPlanes {
        put("field", "tangent-planes".into());
    }
    if args.no_creases {
        put("no-creases", true.into());
    }
    match args.stop_after {
        Some(StopAfter::Fit) => put("stop-after", "fit".into()),
        Some(StopAfter::Extract | StopAfter::Simplify) | None => {}
    }
    if args.surface == Kind::Chart {
        put("surface", "chart".into());
        put("degree", args.degree.into());
    }
    put("seed", args.seed.into());
    Ok(Provenance { inputs, options })
}
