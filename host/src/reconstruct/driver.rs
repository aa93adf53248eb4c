//! The driver: runs the four phases one after the other and says what each did.

use super::averaging::{self, Averaged};
use super::chart::phases::{Prepared, chart_phases};
use super::chart::{ChartFitError, ChartOptions};
use super::creases::{CreaseOptions, Creased, Sheets};
use super::extract::{self, ExtractError, Extracted, FieldFit};
use super::fit::foot::Foot;
use super::fit::{Datum, FitOptions, Kind, NormalTerm};
use super::frame::Frame;
use super::refine::templates::Base;
use super::repeats;
use super::simplify::{self, Simplified, SimplifyError};
use super::surfacing::{
    Fitted, RefineEnd, SurfacingError, SurfacingOptions, distances, fit_base, normal_angles, refine,
};
use crate::Vec3;
use crate::cloud::{Cloud, Neighbourhoods};
use crate::mesh::TriangleMesh;
use crate::report::{
    ErrorFigures, InputFigures, LevelFigures, NormalFigures, PhaseFigures, Report, SurfaceFigures,
};
use crate::spline::chart::Chart;
use crate::spline::edges::EdgeTable;
use crate::spline::{Surface, SurfaceError};
use std::time::Instant;

/// A phase after which the reconstruction can be stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Phase 1: the dense mesh.
    Extract,
    /// Phase 2: the base mesh.
    Simplify,
    /// Phase 3: the fitted network.
    Fit,
    /// Phase 4: the refined network.
    Refine,
}

/// What steers a reconstruction; lengths in the unit of the input.
#[derive(Clone, Debug)]
pub struct Options {
    /// Largest distance of a point from the surface. Without it 1e-3 of the bounding box's diagonal or three
    /// times the noise found, whichever is larger.
    pub tolerance: Option<f64>,
    /// Weight of the normal term relative to the squared distance, for tangents of unit parameter length
    /// (paper, eq. 9). Without it from the noise of positions and normals.
    pub lambda: Option<f64>,
    /// How the measured normal enters.
    pub normal_term: NormalTerm,
    /// Weight of the jump of curvature across smooth edges of a network ([`super::fit::FitOptions`]); 0: none. Without
    /// it from the noise.
    pub fair_curvature: Option<f64>,
    /// Most patches.
    pub max_patches: usize,
    /// Rounds of fit and reparameterisation.
    pub rounds: usize,
    /// Stop after this phase.
    pub stop_after: Stage,
    /// Phase 1.
    pub extract: extract::Options,
    /// Creases; `None` makes everything smooth.
    pub creases: Option<CreaseOptions>,
    /// Phase 2. Its accuracy, where it is not set, follows from tolerance and noise.
    pub simplify: simplify::Options,
    /// Degree (2 to 5) of the one chart that is made instead of a network; `None` makes a network.
    pub chart: Option<usize>,
    /// Threads; without it all cores. The result does not depend on it.
    pub threads: Option<usize>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            tolerance: None,
            lambda: None,
            normal_term: NormalTerm::default(),
            fair_curvature: None,
            max_patches: 20_000,
            rounds: 4,
            stop_after: Stage::Refine,
            extract: extract::Options::default(),
            creases: Some(CreaseOptions::default()),
            simplify: simplify::Options::default(),
            chart: None,
            threads: None,
        }
    }
}

/// Why a reconstruction ended without a surface.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ReconstructError {
    /// The points have no extent.
    #[error(
        "the {0} points have no extent: they coincide or are not finite; check the input and its unit"
    )]
    NoExtent(usize),
    /// An option has no meaning.
    #[error("option {name} is {value}; it has to be {range}")]
    BadOption {
        /// The option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        range: &'static str,
    },
    /// The fit would take too much memory.
    #[error(
        "a fit of {patches} patches would take about {needed} bytes, more than the {limit} allowed: allow more memory or a wider tolerance"
    )]
    TooMuchMemory {
        /// Patches it would start with.
        patches: usize,
        /// Bytes it would take.
        needed: usize,
        /// Bytes allowed.
        limit: usize,
    },
    /// The extracted mesh takes more memory to simplify than allowed.
    #[error(
        "simplifying {triangles} triangles would take about {needed} bytes, more than the {limit} allowed: allow more memory or hand in fewer contacts"
    )]
    TooManyTriangles {
        /// Triangles of the extracted mesh.
        triangles: usize,
        /// Bytes it would take.
        needed: usize,
        /// Bytes allowed.
        limit: usize,
    },
    /// Phase 1 failed.
    #[error("extraction: {0}")]
    Extract(#[from] ExtractError),
    /// Phase 2 failed.
    #[error("simplification: {0}")]
    Simplify(#[from] SimplifyError),
    /// Phase 3 or 4 failed.
    #[error("fit: {0}")]
    Surfacing(#[from] SurfacingError),
    /// No chart could be made.
    #[error("chart: {0}")]
    Chart(#[from] ChartFitError),
    /// The result is no valid surface.
    #[error("result: {0}")]
    Surface(#[from] SurfaceError),
    /// Threads could not be started.
    #[error("threads could not be started ({0}); ask for fewer with --threads")]
    Threads(String),
}

/// What a reconstruction made, stage by stage, in the input's coordinates.
#[derive(Clone, Debug, Default)]
pub struct Reconstruction {
    /// Mesh after phase 1.
    pub extracted: TriangleMesh,
    /// Mesh after phase 2.
    pub simplified: Option<TriangleMesh>,
    /// Surface after phase 3.
    pub fitted: Option<Surface>,
    /// The last surface made: after phase 4, or phase 3 if stopped there.
    pub surface: Option<Surface>,
    /// The chart, where one was asked for; `fitted` and `surface` are then absent.
    pub chart: Option<Chart>,
    /// Distance of each usable row of the input to the surface; NaN where there is none (outliers).
    pub distances: Vec<f64>,
    /// Everything in figures.
    pub report: Report,
}

/// What is going on, for a caller that shows progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// A phase began.
    Phase(&'static str),
    /// A level of refinement ended with so many patches.
    Level(usize, usize),
}

/// Runs the phases on `cloud`.
///
/// # Errors
/// See [`ReconstructError`]. A tolerance that cannot be met is no error: the report says why.
pub fn reconstruct(
    cloud: &Cloud,
    options: &Options,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Reconstruction, ReconstructError> {
    let threads = options.threads.unwrap_or(0);
    if threads > MOST_THREADS {
        return Err(ReconstructError::BadOption {
            name: "threads",
            value: threads as f64,
            range: "at most 512",
        });
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| ReconstructError::Threads(e.to_string()))?;
    let Some(distinct) = repeats::without(cloud) else {
        return pool.install(|| run(cloud, options, progress));
    };
    let made = pool.install(|| run(&distinct.cloud, options, progress));
    let mut out = made.map_err(|error| match error {
        ReconstructError::NoExtent(_) => ReconstructError::NoExtent(cloud.points.len()),
        ReconstructError::Extract(ExtractError::NotFinite { index }) => {
            let place = |k: &u32| *k as usize == index;
            let index = distinct.first.iter().position(place).unwrap_or(index);
            ExtractError::NotFinite { index }.into()
        }
        other => other,
    })?;
    let repeated = cloud.points.len() - distinct.cloud.points.len();
    let first = |k: &u32| out.distances.get(*k as usize).copied();
    out.distances = distinct
        .first
        .iter()
        .map(|k| first(k).unwrap_or(f64::NAN))
        .collect();
    out.report.input.points += repeated;
    out.report.input.used += repeated;
    out.report.notes.push(format!(
        "{repeated} contacts repeat another exactly and were counted once"
    ));
    Ok(out)
}

/// Most threads; a machine that has more gains nothing from them here.
const MOST_THREADS: usize = 512;

/// Largest weight of the normals. There a normal that is 1.8 degrees off costs as much as a distance of a patch's edge;
/// with 1e6 even exact data ask for ever more patches (a ball of 400 contacts: minutes, where 1000 takes 0.3 s).
const MOST_LAMBDA: f64 = 1e3;
/// Most rounds. Four are usual; each of a thousand would take as long as any other.
const MOST_ROUNDS: usize = 100;
/// Bytes that a fit takes for each patch: the equations' pattern, values and factor. Measured on a ball and a clean scan
/// of 190 to 4150 patches: 260 000 to 360 000.
const FIT_BYTES_PER_PATCH: usize = 400_000;
/// Bytes that simplification takes per triangle of the extracted mesh; measured at 570 above what extraction took.
const SIMPLIFY_BYTES_PER_TRIANGLE: usize = 800;

/// Accuracy of the base mesh against the tolerance, and against the noise. Patches that miss the field's surface by 0.3
/// of the noise add nothing to the error that the data leave (15 noisy sets of smooth shapes: median 0.69e-3 of the
/// diagonal at 0.3, 0.70 at 0.25 and 0.15). A tolerance that was asked for is met with few patches (torus within 5e-4: 190);
/// the default one is a bound, and exact data deserve better (14 sets: 0.074e-3 rms at 0.3, 0.067 at 0.22 with a seventh
/// more patches and a tenth more time, 0.081 at 0.5).
const ACCURACY_OF_TOLERANCE: f64 = 0.58;
const ACCURACY_OF_DEFAULT_TOLERANCE: f64 = 0.3;
const ACCURACY_OF_NOISE: f64 = 0.3;
/// Where the tolerance is this many times the noise, and no more, the noise alone counts.
const TOLERANCE_OF_NOISE: f64 = 3.0;
/// Accuracy, relative to the size, beyond which the base mesh is made no finer.
const LEAST_ACCURACY: f64 = 1e-4;
/// Weight of the points of borders and creases relative to a measured point: where sheets meet is known from all of their
/// contacts. With 1 the corners of noisy cubes and cylinders' rims are drawn up to twice as far off (4.8e-3 of the diagonal).
const LINE_WEIGHT: f64 = 10.0;
/// A sample of the extracted surface counts (this * sigma of a contact / the field's own sigma)^2 of a measured
/// point, at most 1. With 1 everywhere the mug's gaps follow the field's swings (rms 2.5e-3 of the diagonal); at 0.3
/// the third derivatives of the patches bridge them better (1.4e-3). Below 0.3 the smooth shapes with 374 points lose.
const FIELD_TRUST: f64 = 0.35;
/// Standard deviation of contacts, relative to the size, below which the field's samples lose no more: between exact
/// contacts the field is still the best there is (clean torus: 0.04e-3 with this, 0.10e-3 without).
const LEAST_TRUSTED_SIGMA: f64 = 3e-4;
/// A base mesh with more patches than these, and than so many per contact, follows no surface: 1000 random places and
/// normals ask for 5400, shapes of one contact in ten to one in two patches. Its fit would take minutes.
const MOST_BASE_PATCHES: usize = 1000;
const MOST_BASE_PATCHES_PER_CONTACT: usize = 2;
/// A surface with edges of at least a patch to so many contacts is compared with a smooth one, and is torn if it has so many times
/// its patches: those that false edges tore had 2.6 to 9 times as many, those with true edges a twelfth to a third.
const TORN_CONTACTS_PER_PATCH: usize = 3;
const TORN_PATCHES: usize = 2;
/// Samples of the extracted surface: at most so many, and at least so many per patch where the mesh has them.
const FIELD_SAMPLES: usize = 6000;
const FIELD_SAMPLES_PER_PATCH: usize = 40;

fn run(
    cloud: &Cloud,
    options: &Options,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Reconstruction, ReconstructError> {
    let begin = Instant::now();
    check(options)?;
    let frame = Frame::of(cloud).ok_or(ReconstructError::NoExtent(cloud.points.len()))?;
    let inner = frame.cloud(cloud);
    let mut out = Reconstruction {
        distances: vec![f64::NAN; cloud.points.len()],
        ..Reconstruction::default()
    };
    out.report.input = InputFigures::of(cloud);
    out.report.threads = rayon::current_num_threads();
    out.report.version = env!("CARGO_PKG_VERSION").to_owned();

    progress(Progress::Phase("extract"));
    let started = Instant::now();
    let mut extract_options = options.extract.clone();
    extract_options.spacing = extract_options.spacing.map(|s| frame.length(s));
    extract_options.max_gap = extract_options.max_gap.map(|g| frame.length(g));
    // Dense tracks are averaged for the phases that look at neighbourhoods; the fit hears every contact.
    let averaged = averaging::average(&inner);
    let spread = averaged.as_ref().map_or(&inner, |a| &a.cloud);
    let (mut extracted, creased, note) = find_creases(spread, options, &extract_options)?;
    out.report.notes.extend(note);
    if let Some(averaged) = &averaged {
        of_single_contacts(&mut extracted, averaged);
        out.report.notes.push(format!(
            "{} contacts lie so densely on their tracks that they were averaged in {} narrow regions before phase 1",
            inner.points.len(),
            averaged.members.len()
        ));
    }
    out.extracted = frame.mesh(&extracted.mesh);
    let noise = extracted.noise;
    out.report.input.used = cloud.points.len() - extracted.outliers.len();
    out.report.input.noise_sigma = noise.position_sigma * frame.scale;
    out.report.input.noise_normal_degrees = noise.normal_sigma.to_degrees();
    out.report.phases.push(PhaseFigures {
        name: "extract".into(),
        seconds: started.elapsed().as_secs_f64(),
        triangles: Some(extracted.mesh.faces.len()),
        ..PhaseFigures::default()
    });
    out.report.notes.extend(notes(&extracted, &frame));
    if options.stop_after == Stage::Extract {
        out.report.seconds = begin.elapsed().as_secs_f64();
        return Ok(out);
    }

    progress(Progress::Phase("simplify"));
    check_triangles(extracted.mesh.faces.len(), options)?;
    let started = Instant::now();
    let (tolerance, tolerance_from) =
        tolerance(options, &frame, cloud.diagonal(), noise.position_sigma);
    let simplified = simplify_mesh(spread, &extracted, &creased, options, tolerance)?;
    out.simplified = Some(frame.mesh(&simplified.mesh));
    if options.stop_after > Stage::Simplify {
        let patches = simplified.mesh.faces.len();
        let edges = !creased.lines.edges.is_empty();
        let too_many = follows_no_surface(patches, cloud.points.len());
        if too_many && !edges {
            return Err(ExtractError::NoSurface.into());
        }
        if edges && (too_many || is_torn(patches, cloud, options, progress)?) {
            let why = "no surface with few patches";
            return without_creases(cloud, options, progress, why);
        }
    }
    out.report.phases.push(PhaseFigures {
        name: "simplify".into(),
        seconds: started.elapsed().as_secs_f64(),
        triangles: Some(simplified.mesh.faces.len()),
        ..PhaseFigures::default()
    });
    if options.stop_after == Stage::Simplify {
        out.report.seconds = begin.elapsed().as_secs_f64();
        return Ok(out);
    }

    progress(Progress::Phase("fit"));
    let started = Instant::now();
    check_memory(simplified.mesh.faces.len(), options)?;
    let (data, numbers) = data(&inner, &extracted, &creased, &simplified, options);
    let smoothing = smoothing(noise.position_sigma);
    let surfacing = SurfacingOptions {
        fit: FitOptions {
            rounds: options.rounds,
            normal_term: options.normal_term,
            fair_curvature: options.fair_curvature.unwrap_or(FAIRNESS * smoothing),
            smoothing,
            outlier_scale: 6.0 * noise.position_sigma.max(1e-4),
        },
        tolerance,
        noise_sigma: noise.position_sigma,
        max_patches: most_patches(options),
        max_levels: 8,
    };
    if let Some(degree) = options.chart {
        let prepared = Prepared {
            frame: &frame,
            extracted: &extracted,
            mesh: &creased.mesh,
            data: &data,
            numbers: &numbers,
            tolerance,
            tolerance_from,
            stop_after: options.stop_after,
        };
        let chart_options = ChartOptions {
            degree,
            rounds: options.rounds,
            smoothing: surfacing.fit.smoothing,
            tolerance,
            noise_sigma: noise.position_sigma,
            outlier_scale: surfacing.fit.outlier_scale,
            triangles: simplified.mesh.faces.len(),
            max_triangles: surfacing.max_patches,
            max_levels: surfacing.max_levels,
        };
        chart_phases(&mut out, &prepared, &chart_options, progress)?;
        out.report.seconds = begin.elapsed().as_secs_f64();
        return Ok(out);
    }
    let base = Base {
        vertices: simplified.mesh.positions.clone(),
        faces: simplified.mesh.faces.clone(),
        creases: simplified.creases.clone(),
        corners: simplified.corners.clone(),
    };
    let fitted = match fit_base(base, &data, &surfacing.fit) {
        Err(SurfacingError::System(_)) if !creased.lines.edges.is_empty() => {
            let why = "no patches that could be fitted";
            return without_creases(cloud, options, progress, why);
        }
        fitted => fitted?,
    };
    out.fitted = Some(frame.surface(&fitted.surface));
    out.report.phases.push(phase_with_errors(
        "fit",
        started,
        &fitted,
        &data,
        frame.scale,
        Some(options.rounds),
        None,
    ));

    let mut last = fitted;
    let mut end = None;
    if options.stop_after == Stage::Refine {
        progress(Progress::Phase("refine"));
        let started = Instant::now();
        let project = |x: &Vec3| extracted.field.project(x);
        let level_of = |level, fitted: &Fitted| {
            let distances = distances(&data, &fitted.feet).map(|d| d * frame.scale);
            level_figures(level, fitted.base.faces.len(), distances)
        };
        let mut by_level = vec![level_of(0, &last)];
        let (refined, levels, why) = refine(last, &data, &surfacing, &project, |level, fitted| {
            let figures = level_of(level, fitted);
            progress(Progress::Level(level, figures.patches));
            by_level.push(figures);
        })?;
        let figures = phase_with_errors(
            "refine",
            started,
            &refined,
            &data,
            frame.scale,
            None,
            Some(levels),
        );
        out.report.phases.push(PhaseFigures {
            by_level,
            ..figures
        });
        end = Some(why);
        last = refined;
    }
    let asked = tolerance * frame.scale;
    let beyond = count_beyond(distances(&data, &last.feet).map(|d| d * frame.scale), asked);
    finish(&mut out, &frame, &extracted, last, &data, &numbers)?;
    judge(
        &mut out.report,
        asked,
        tolerance_from,
        end,
        beyond,
        &extracted.outliers,
    );
    out.report.seconds = begin.elapsed().as_secs_f64();
    Ok(out)
}

/// Whether a base mesh of so many patches follows no surface.
fn follows_no_surface(patches: usize, contacts: usize) -> bool {
    patches > MOST_BASE_PATCHES.max(MOST_BASE_PATCHES_PER_CONTACT * contacts)
}

/// Whether sheets that were taken wrongly tear the surface: then it has far more patches than a smooth one, which is rounded off
/// at edges and whole. `patches`: of the surface with edges.
fn is_torn(
    patches: usize,
    cloud: &Cloud,
    options: &Options,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<bool, ReconstructError> {
    if TORN_CONTACTS_PER_PATCH * patches <= cloud.points.len() {
        return Ok(false);
    }
    let smooth = Options {
        creases: None,
        stop_after: Stage::Simplify,
        ..options.clone()
    };
    let smooth = run(cloud, &smooth, progress)?;
    let fewer = |mesh: &TriangleMesh| TORN_PATCHES * mesh.faces.len() < patches;
    Ok(smooth.simplified.as_ref().is_some_and(fewer))
}

/// The reconstruction without edges, with the reason why.
fn without_creases(
    cloud: &Cloud,
    options: &Options,
    progress: &(dyn Fn(Progress) + Sync),
    why: &str,
) -> Result<Reconstruction, ReconstructError> {
    let smooth = Options {
        creases: None,
        ..options.clone()
    };
    let mut out = run(cloud, &smooth, progress)?;
    out.report.notes.push(format!(
        "sheets that break with one another were found, but {why}: edges follow one smooth field"
    ));
    Ok(out)
}

/// Outliers and noise of the averages as those of the contacts that went into them.
fn of_single_contacts(extracted: &mut Extracted, averaged: &Averaged) {
    let regions = extracted.outliers.iter();
    let mut outliers: Vec<usize> = regions
        .flat_map(|region| &averaged.members[*region])
        .map(|contact| *contact as usize)
        .collect();
    outliers.sort_unstable();
    extracted.outliers = outliers;
    let noise = &mut extracted.noise;
    noise.position_sigma = noise.position_sigma.max(averaged.position_scatter);
    noise.normal_sigma = noise.normal_sigma.max(averaged.normal_scatter);
}

/// What phase 1 decided.
fn notes(extracted: &Extracted, frame: &Frame) -> Vec<String> {
    let mut notes: Vec<String> = extracted
        .holes
        .iter()
        .map(|hole| {
            let place = frame.leave(hole.place);
            let depth = if hole.depth.is_finite() {
                format!("up to {:.3} from any contact", hole.depth * frame.scale)
            } else {
                "faced by no contact".to_owned()
            };
            format!(
                "gap near ({:.4}, {:.4}, {:.4}), {depth}, {:.1} % of the touched area: {}",
                place.x,
                place.y,
                place.z,
                100.0 * hole.area_share,
                if hole.closed {
                    "closed by the field"
                } else {
                    "left open, for it is too wide to be known; touch there or give --max-gap"
                }
            )
        })
        .collect();
    if extracted.dropped_components > 0 {
        notes.push(format!(
            "{} separate pieces of the field's surface were left out: hardly any contact lies on them",
            extracted.dropped_components
        ));
    }
    notes
}

/// Most patches, by their number and by the memory that fitting them takes.
fn most_patches(options: &Options) -> usize {
    let by_memory = options.extract.max_memory / FIT_BYTES_PER_PATCH;
    options.max_patches.min(by_memory)
}

/// Bytes that `count` things take, if that is more memory than allowed.
fn too_much(count: usize, bytes_each: usize, options: &Options) -> Option<usize> {
    let needed = count.saturating_mul(bytes_each);
    (needed > options.extract.max_memory).then_some(needed)
}

/// Refuses a fit that would take more memory than allowed, before it takes any.
fn check_memory(patches: usize, options: &Options) -> Result<(), ReconstructError> {
    match too_much(patches, FIT_BYTES_PER_PATCH, options) {
        None => Ok(()),
        Some(needed) => Err(ReconstructError::TooMuchMemory {
            patches,
            needed,
            limit: options.extract.max_memory,
        }),
    }
}

/// Refuses a simplification that would take more memory than allowed, before it takes any.
fn check_triangles(triangles: usize, options: &Options) -> Result<(), ReconstructError> {
    match too_much(triangles, SIMPLIFY_BYTES_PER_TRIANGLE, options) {
        None => Ok(()),
        Some(needed) => Err(ReconstructError::TooManyTriangles {
            triangles,
            needed,
            limit: options.extract.max_memory,
        }),
    }
}

fn check(options: &Options) -> Result<(), ReconstructError> {
    let positive = |name, value: Option<f64>| match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => Err(ReconstructError::BadOption {
            name,
            value,
            range: "a number above 0",
        }),
        _ => Ok(()),
    };
    positive("tolerance", options.tolerance)?;
    for (name, value) in [
        ("lambda", options.lambda),
        ("fair-curvature", options.fair_curvature),
    ] {
        if let Some(value) = value.filter(|value| !(*value >= 0.0 && value.is_finite())) {
            return Err(ReconstructError::BadOption {
                name,
                value,
                range: "0 or above",
            });
        }
    }
    if let Some(value) = options.lambda.filter(|value| *value > MOST_LAMBDA) {
        return Err(ReconstructError::BadOption {
            name: "lambda",
            value,
            range: "0 to 1000",
        });
    }
    if let Some(degree) = options.chart.filter(|n| !(2..=5).contains(n)) {
        return Err(ReconstructError::BadOption {
            name: "degree",
            value: degree as f64,
            range: "2 to 5",
        });
    }
    if !(1..=MOST_ROUNDS).contains(&options.rounds) {
        return Err(ReconstructError::BadOption {
            name: "rounds",
            value: options.rounds as f64,
            range: "1 to 100",
        });
    }
    if options.max_patches == 0 {
        return Err(ReconstructError::BadOption {
            name: "max-patches",
            value: 0.0,
            range: "at least 1",
        });
    }
    Ok(())
}

/// The tolerance in the frame, and where it comes from.
fn tolerance(options: &Options, frame: &Frame, diagonal: f64, sigma: f64) -> (f64, &'static str) {
    let least = frame.length(1e-3 * diagonal);
    match options.tolerance {
        Some(tolerance) => (frame.length(tolerance), "asked for"),
        None if TOLERANCE_OF_NOISE * sigma > least => (
            TOLERANCE_OF_NOISE * sigma,
            "three times the noise found in the data",
        ),
        None => (least, "1e-3 of the bounding box's diagonal"),
    }
}

/// Weight of the jumps of curvature against that of the third derivatives: on 14 noisy sets of smooth shapes 30 to 300
/// differ by less than 0.01e-3 of the diagonal; without any the mug is off by 1.5e-3, with 1.4e-3.
const FAIRNESS: f64 = 100.0;

/// Weight of the energy per datum: the noise variance over the energy that shapes of interest have.
fn smoothing(sigma: f64) -> f64 {
    // Trials with noise of 3e-3 of the diagonal did best near 1e-4 (torus, bean, trilobe, two-holed torus, mug: 3e-5 to
    // 3e-4 differ by less than a tenth, 1e-3 doubles the error of bean and trilobe), clean ones need 1e-6 or less.
    (1e-4 * (sigma / 3e-3).powi(2)).clamp(1e-7, 1e-2)
}

/// The contacts that phase 1 did not set aside.
fn inliers(inner: &Cloud, outliers: &[usize]) -> Cloud {
    let kept = kept(inner, outliers);
    Cloud {
        points: kept.iter().map(|i| inner.points[*i]).collect(),
        rejected: Vec::new(),
    }
}

/// The numbers of the contacts that are not among the `outliers` (rising).
fn kept(inner: &Cloud, outliers: &[usize]) -> Vec<usize> {
    let mut outliers = outliers.iter().peekable();
    (0..inner.points.len())
        .filter(|number| outliers.next_if_eq(&number).is_none())
        .collect()
}

/// Follows the field's surface. Smooth sheets that break with one another are looked for first; where there are some, each
/// gets a field of its own and the surface is cut along the lines where they meet. If they give no surface, a note says so.
///
/// Sheets are found best without outliers, which a field tells; and a field that is followed needs more care than one that
/// only tells outliers. So sheets are looked for in all contacts first, to know which field will do, and then in the rest.
fn find_creases(
    inner: &Cloud,
    options: &Options,
    extract_options: &extract::Options,
) -> Result<(Extracted, Creased, Option<String>), ReconstructError> {
    let smooth = |field: Option<FieldFit>, note: Option<String>| {
        let field = match field {
            Some(field) => field,
            None => extract::fit_field(inner, extract_options)?,
        };
        let extracted = field.trace(extract_options)?;
        let mesh = extracted.mesh.clone();
        let creased = Creased {
            mesh,
            ..Creased::default()
        };
        Ok((extracted, creased, note))
    };
    // A chart is smooth everywhere.
    let wanted = options.creases.as_ref().filter(|_| options.chart.is_none());
    let Some(creases) = wanted else {
        return smooth(None, None);
    };
    let of_all = Sheets::of(inner, creases);
    let (field, mut outliers, noise) = if of_all.sharp().is_empty() {
        let field = extract::fit_field(inner, extract_options)?;
        let (outliers, noise) = (field.outliers().to_vec(), field.noise());
        (Some(field), outliers, noise)
    } else {
        let (outliers, noise) = extract::find_outliers(inner, extract_options)?;
        (None, outliers, noise)
    };
    let inliers = inliers(inner, &outliers);
    let sheets = if outliers.is_empty() {
        of_all
    } else {
        Sheets::of(&inliers, creases)
    };
    if sheets.sharp().is_empty() {
        return smooth(field, None);
    }
    let again = extract::extract_sheets(
        &inliers,
        extract_options,
        sheets.labels(),
        sheets.sharp(),
        &noise,
    );
    let again = match again {
        Ok(again) => again,
        Err(error) => {
            let note = format!(
                "sheets that break with one another were found but give no surface ({error}); edges follow one smooth field"
            );
            return smooth(field, Some(note));
        }
    };
    // Those that lie off the sheets are numbered among the inliers.
    let kept = kept(inner, &outliers);
    outliers.extend(again.outliers.iter().map(|i| kept[*i]));
    outliers.sort_unstable();
    let extracted = Extracted { outliers, ..again };
    let creased = sheets
        .cut(&extracted.mesh, Some(&extracted.field))
        .map_err(SimplifyError::from)?;
    Ok((extracted, creased, None))
}

fn simplify_mesh(
    inner: &Cloud,
    extracted: &Extracted,
    creased: &Creased,
    options: &Options,
    tolerance: f64,
) -> Result<Simplified, SimplifyError> {
    let mut simplify_options = options.simplify.clone();
    // Finer than this is left to the refinement, which looks where it is needed.
    let sigma = extracted.noise.position_sigma;
    let spared = tolerance - TOLERANCE_OF_NOISE * sigma;
    let share = match options.tolerance {
        Some(_) => ACCURACY_OF_TOLERANCE,
        None => ACCURACY_OF_DEFAULT_TOLERANCE,
    };
    let accuracy = ACCURACY_OF_NOISE * sigma + share * spared.max(0.0);
    simplify_options
        .accuracy
        .get_or_insert(accuracy.max(LEAST_ACCURACY));
    let field = &extracted.field;
    let project = |x: &Vec3| {
        let (foot, gradient) = field.foot(x)?;
        Some((foot, gradient.try_normalize(1e-12)?))
    };
    let simplify = |options: &simplify::Options| {
        simplify::simplify(
            &creased.mesh,
            inner,
            &creased.lines,
            options,
            Some(&project),
        )
    };
    let simplified = simplify(&simplify_options)?;
    let most = most_patches(options);
    if simplified.mesh.faces.len() <= most {
        return Ok(simplified);
    }
    simplify_options.target_faces = Some(most);
    simplify(&simplify_options)
}

/// Measured inliers, samples of the extracted surface and of its border, with the number of the input point
/// behind each measured one.
fn data(
    inner: &Cloud,
    extracted: &Extracted,
    creased: &Creased,
    simplified: &Simplified,
    options: &Options,
) -> (Vec<Datum>, Vec<usize>) {
    let noise = extracted.noise;
    // Floors: interpolation is never asked beyond 1e-5 of the size and 0.05 degrees.
    let sigma = noise.position_sigma.max(1e-5);
    let normal_weight = match options.lambda {
        Some(lambda) => {
            let faces = simplified.mesh.faces.len().max(1) as f64;
            lambda * simplified.mesh.area() / faces
        }
        None => (sigma / noise.normal_sigma.max(1e-3)).powi(2),
    };
    let mut stated: Vec<f64> = inner.points.iter().filter_map(|p| p.sigma).collect();
    stated.sort_by(f64::total_cmp);
    let typical = stated.get(stated.len() / 2).copied().filter(|s| *s > 0.0);
    let mut data = Vec::new();
    let mut numbers = Vec::new();
    let mut outliers = extracted.outliers.iter().peekable();
    for (number, point) in inner.points.iter().enumerate() {
        if outliers.next_if_eq(&&number).is_some() {
            continue;
        }
        let weight = match (point.sigma, typical) {
            (Some(s), Some(t)) => (t / s.max(0.05 * t)).powi(2),
            _ => 1.0,
        };
        numbers.push(number);
        data.push(Datum {
            position: point.position,
            normal: point.normal.try_normalize(0.0).unwrap_or_else(Vec3::z),
            weight,
            normal_weight,
            kind: Kind::Measured,
        });
    }
    let trusted = FIELD_TRUST * sigma.max(LEAST_TRUSTED_SIGMA);
    let mesh = &creased.mesh;
    let near_crease = near_creases(creased, 3.0 * extracted.spacing);
    let normals = mesh.vertex_normals();
    let wanted = FIELD_SAMPLES.max(FIELD_SAMPLES_PER_PATCH * simplified.mesh.faces.len());
    let stride = mesh.positions.len().div_ceil(wanted).max(1);
    for (number, position) in mesh.positions.iter().enumerate().step_by(stride) {
        // The field rounds creases off: near them the mesh, put back onto the sheets, knows better.
        let normal = match near_crease.get(number) {
            Some(Near::On) => continue,
            Some(Near::Beside) => normals[number],
            _ => extracted.field.gradient(position),
        };
        let Some(normal) = normal.try_normalize(1e-12) else {
            continue;
        };
        data.push(Datum {
            position: *position,
            normal,
            weight: (trusted / extracted.field.sample_sigma(position))
                .powi(2)
                .min(1.0),
            normal_weight,
            kind: Kind::Field,
        });
    }
    let lines = border(mesh).into_iter().chain(
        creased
            .lines
            .edges
            .iter()
            .flatten()
            .filter_map(|v| mesh.positions.get(*v as usize).copied()),
    );
    data.extend(lines.map(|position| Datum {
        position,
        normal: Vec3::z(),
        weight: LINE_WEIGHT,
        normal_weight: 0.0,
        kind: Kind::Line,
    }));
    (data, numbers)
}

/// Where a vertex of the cut mesh lies.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Near {
    /// On a crease.
    On,
    /// Within the strip that the field rounds off.
    Beside,
    /// Elsewhere.
    Away,
}

/// Where each vertex lies with respect to the creases; empty if there are none.
fn near_creases(creased: &Creased, reach: f64) -> Vec<Near> {
    if creased.lines.edges.is_empty() {
        return Vec::new();
    }
    let positions = &creased.mesh.positions;
    let mut near = vec![Near::Away; positions.len()];
    let mut on: Vec<u32> = creased.lines.edges.iter().flatten().copied().collect();
    on.sort_unstable();
    on.dedup();
    on.retain(|v| (*v as usize) < positions.len());
    let line = Neighbourhoods::new(on.iter().map(|v| positions[*v as usize]).collect());
    for (state, position) in near.iter_mut().zip(positions) {
        if line
            .nearest_one(position)
            .is_some_and(|(_, d2)| d2 < reach * reach)
        {
            *state = Near::Beside;
        }
    }
    for v in on {
        near[v as usize] = Near::On;
    }
    near
}

/// Vertices and middles of the border edges of the extracted mesh.
fn border(mesh: &TriangleMesh) -> Vec<Vec3> {
    let Ok(table) = EdgeTable::new(mesh.positions.len(), &mesh.faces) else {
        return Vec::new();
    };
    table
        .edges
        .iter()
        .filter(|edge| edge.is_border())
        .flat_map(|edge| {
            let [a, b] = edge.vertices.map(|v| mesh.positions[v as usize]);
            [a, (a + b) / 2.0]
        })
        .collect()
}

fn phase_with_errors(
    name: &str,
    started: Instant,
    fitted: &Fitted,
    data: &[Datum],
    scale: f64,
    rounds: Option<usize>,
    levels: Option<usize>,
) -> PhaseFigures {
    let figures = figures(distances(data, &fitted.feet).map(|d| d * scale));
    PhaseFigures {
        name: name.into(),
        seconds: started.elapsed().as_secs_f64(),
        triangles: None,
        patches: Some(fitted.base.faces.len()),
        rounds,
        levels,
        error_sum: Some(figures.sum),
        error_abs_sum: Some(figures.abs_sum),
        error_rms: Some(figures.rms),
        error_max: Some(figures.max),
        by_level: Vec::new(),
    }
}

/// A level of refinement, from the distances it leaves.
pub(super) fn level_figures(
    level: usize,
    patches: usize,
    distances: impl Iterator<Item = f64>,
) -> LevelFigures {
    let figures = figures(distances);
    LevelFigures {
        level,
        patches,
        error_sum: figures.sum,
        error_rms: figures.rms,
        error_max: figures.max,
    }
}

/// Sums over distances.
pub(super) fn figures(distances: impl Iterator<Item = f64>) -> ErrorFigures {
    let mut out = ErrorFigures::default();
    let mut count = 0usize;
    for distance in distances {
        out.sum += distance * distance;
        out.abs_sum += distance;
        out.max = out.max.max(distance);
        count += 1;
    }
    out.rms = (out.sum / count.max(1) as f64).sqrt();
    out
}

/// How many distances are larger than the tolerance.
pub(super) fn count_beyond(distances: impl Iterator<Item = f64>, tolerance: f64) -> usize {
    distances.filter(|distance| *distance > tolerance).count()
}

/// Angle between a contact's normal and the surface's from which the report speaks of it.
const TURNED_DEGREES: f64 = 60.0;

/// Measures the surface and fills the report.
fn finish(
    out: &mut Reconstruction,
    frame: &Frame,
    extracted: &Extracted,
    last: Fitted,
    data: &[Datum],
    numbers: &[usize],
) -> Result<(), ReconstructError> {
    let mut last = last;
    last.surface.sigma = last
        .surface
        .vertices
        .iter()
        .map(|v| extracted.field.confidence(v))
        .collect();
    let measures = last.surface.measure()?;
    let mut surface_figures = SurfaceFigures::of(&last.surface, &measures);
    for jump in [
        &mut surface_figures.curvature_jump_max,
        &mut surface_figures.curvature_jump_rms,
    ] {
        *jump = jump.map(|jump| jump / frame.scale);
    }
    out.report.surface = Some(surface_figures);
    out.report.error = Some(figures(
        distances(data, &last.feet).map(|d| d * frame.scale),
    ));
    let (mut sum, mut max, mut count, mut turned) = (0.0, 0.0f64, 0usize, 0usize);
    for angle in normal_angles(data, &last.feet) {
        sum += angle;
        max = max.max(angle);
        count += 1;
        turned += usize::from(angle > TURNED_DEGREES);
    }
    if turned > 0 {
        out.report.notes.push(format!(
            "{turned} contact(s) with normals more than {TURNED_DEGREES} degrees off the surface where they lie: touched at an edge, with the normal of its other side, or false"
        ));
    }
    out.report.normals = Some(NormalFigures {
        mean_degrees: sum / count.max(1) as f64,
        max_degrees: max,
    });
    let feet = data
        .iter()
        .zip(&last.feet)
        .filter(|(d, _)| d.kind == Kind::Measured);
    for (number, (datum, foot)) in numbers.iter().zip(feet) {
        let foot: &Option<Foot> = foot;
        if let Some(foot) = foot {
            out.distances[*number] = (datum.position - foot.point).norm() * frame.scale;
        }
    }
    out.surface = Some(frame.surface(&last.surface));
    Ok(())
}

/// Says whether the tolerance is met, and if not, why.
pub(super) fn judge(
    report: &mut Report,
    tolerance: f64,
    from: &str,
    end: Option<RefineEnd>,
    beyond: usize,
    outliers: &[usize],
) {
    let sigma = report.input.noise_sigma;
    let Some(error) = &mut report.error else {
        return;
    };
    error.tolerance = tolerance;
    error.beyond = beyond;
    error.outliers = outliers.len();
    error.outlier_points = outliers.to_vec();
    error.met = error.max <= tolerance;
    error.reason = if error.met {
        Some(format!("tolerance: {from}"))
    } else {
        Some(match end {
            Some(RefineEnd::Noise) => format!(
                "what lies beyond the tolerance ({from}) is noise, standard deviation {sigma:.3e}: finer patches would follow the noise, not the surface"
            ),
            Some(RefineEnd::PatchLimit) => {
                "the next level would have more patches than --max-patches allows, or than fit into --max-memory"
                    .to_owned()
            }
            Some(RefineEnd::LevelLimit) => {
                "the limit on levels of refinement was reached".to_owned()
            }
            Some(RefineEnd::NoGain) => {
                "a further level brought no point closer: the data there contradict each other or are too sparse".to_owned()
            }
            Some(RefineEnd::Met) | None => "stopped before refinement".to_owned(),
        })
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::unit_ball;

    #[test]
    fn a_surface_with_edges_is_torn_if_a_smooth_one_has_far_fewer_patches() {
        let cloud = unit_ball(300);
        let torn = |patches| is_torn(patches, &cloud, &Options::default(), &|_| ()).unwrap();
        assert!(torn(400));
        assert!(!torn(90), "few enough not to be asked");
        let smooth = Options {
            creases: None,
            stop_after: Stage::Simplify,
            ..Options::default()
        };
        let smooth = run(&cloud, &smooth, &|_| ()).unwrap().simplified.unwrap();
        let patches = smooth.faces.len();
        let crowded = unit_ball(3 * patches);
        assert!(!is_torn(patches + 1, &crowded, &Options::default(), &|_| ()).unwrap());
    }

    /// Exact contacts of a cube, and some beyond an edge that still tell the normal of the side they come from.
    fn cube_with_lagging_normals() -> Cloud {
        let mesh = crate::mesh::shapes::cube(10);
        let mut cloud = unit_ball(mesh.faces.len());
        for (point, face) in cloud.points.iter_mut().zip(&mesh.faces) {
            let [a, b, c] = face.map(|v| mesh.positions[v as usize]);
            point.position = (a + b + c) / 3.0;
            point.normal = (b - a).cross(&(c - a)).normalize();
        }
        for k in 0..24 {
            let along = -0.92 + 0.08 * f64::from(k);
            let mut point = cloud.points[0];
            point.position = Vec3::new(1.0, 1.0 - 0.002 * f64::from(k % 5), along);
            point.normal = Vec3::y();
            cloud.points.push(point);
        }
        cloud
    }

    #[test]
    fn normals_that_lag_at_an_edge_cost_no_patches() {
        let cloud = cube_with_lagging_normals();
        let report = run(&cloud, &Options::default(), &|_| ()).unwrap().report;
        let (surface, error) = (report.surface.unwrap(), report.error.unwrap());
        println!("{surface:?} {error:?}");
        assert!(surface.crease_edges >= 12);
        assert!(surface.patches < 60, "{}", surface.patches);
        assert!(error.met && error.outliers < 6, "{error:?}");
    }
}
