//! A disk-like region as one triangular B-spline: `--surface chart`.
//!
//! | step | file |
//! |---|---|
//! | the extracted mesh is laid into the plane | `flatten` |
//! | a lattice of triangles covers it, with a ring around; knots by [`crate::spline::chart::knot_clouds`] | `lattice` |
//! | least squares with the same data terms as the network's fit, foot points, again | `fit`, `system` |
//! | figures for the report | `phases` |
//! | triangles that hold a point beyond the tolerance are split, knots inserted, fitted again | here |
//!
//! Promised: the spline is C^(n-1) over the whole region; its border follows the border of the extracted mesh as any
//! other datum; the same input gives the same bytes for any number of threads.
//! Not promised: creases (a chart has none), or even patches where the shape has to be stretched to lie flat.

mod fit;
pub mod flatten;
mod lattice;
pub(super) mod phases;
mod system;

use super::fit::foot::Foot;
use super::fit::{Datum, Kind};
use super::refine::face_fits;
use super::surfacing::RefineEnd;
use crate::Vec3;
use crate::mesh::TriangleMesh;
use crate::spline::chart::{Chart, ChartError, CloudBounds};
use crate::spline::simplex::SimplexError;
use fit::{Level, Place};
use flatten::{Flat, flatten};
use lattice::Lattice;
pub use system::ChartSystemError;

/// Why no chart could be made; every variant says what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ChartFitError {
    /// The region is no disk.
    #[error(
        "the touched region is no disk, so one chart cannot cover it: {components} piece(s), {borders} border(s), {genus} handle(s), where a disk has 1, 1 and 0; leave out --surface chart for a network, or give the points of one side only"
    )]
    NoDisk {
        /// Connected pieces.
        components: usize,
        /// Border loops.
        borders: usize,
        /// Handles.
        genus: i64,
    },
    /// The mesh is no surface.
    #[error(
        "the extracted mesh cannot be laid flat: {0}; touch the thin places again or use a network (without --surface chart)"
    )]
    NoSurface(String),
    /// Equations of the parameterisation could not be solved.
    #[error(
        "the equations that lay the mesh flat could not be factored ({0}); use a network (without --surface chart)"
    )]
    Factor(String),
    /// The least-squares system could not be solved.
    #[error(transparent)]
    System(#[from] ChartSystemError),
    /// Knots or region do not fit together.
    #[error("the chart's triangulation is not usable: {0}; try another --degree or --tolerance")]
    Chart(#[from] ChartError),
    /// Knots or control points do not fit together.
    #[error("the chart's knots are not usable: {0}; try another --degree or --tolerance")]
    Knots(#[from] SimplexError),
}

/// What steers a chart; lengths in the frame of the data.
#[derive(Clone, Debug, PartialEq)]
pub struct ChartOptions {
    /// Degree, 2 to 5.
    pub degree: usize,
    /// Rounds of fit and reparameterisation of the first level.
    pub rounds: usize,
    /// Weight of the energy per datum and triangle.
    pub smoothing: f64,
    /// Largest distance allowed.
    pub tolerance: f64,
    /// Standard deviation of the data along the normal.
    pub noise_sigma: f64,
    /// Scale beyond which a datum counts less.
    pub outlier_scale: f64,
    /// Triangles to start with.
    pub triangles: usize,
    /// Refinement stops before this many triangles.
    pub max_triangles: usize,
    /// Most levels of refinement.
    pub max_levels: usize,
}

/// A fitted chart.
#[derive(Clone, Debug)]
pub struct FittedChart {
    /// The chart.
    pub chart: Chart,
    /// Foot point of each datum (its face a triangle of the chart's net); `None` where none was found.
    pub feet: Vec<Option<Foot>>,
    /// Whether the foot point of each datum lies on the border of the region.
    pub on_border: Vec<bool>,
    /// Functions that reach into the region: three free numbers each.
    pub functions: usize,
    /// What the knot clouds keep to.
    pub bounds: CloudBounds,
    /// Stretch of the map into the plane: largest and smallest.
    pub stretch: [f64; 2],
    /// Root of the mean squared distance of the measured data after each round of the first level.
    pub history: Vec<f64>,
}

/// A triangle with fewer measured data is not split: a chart has four to five functions per triangle.
const LEAST_DATA: usize = 5;
/// Largest share of the triangles that are split one by one; beyond it a finer lattice is laid instead.
const LOCAL_SHARE: f64 = 0.35;
/// A finer lattice has edges of this share.
const FINER: f64 = 0.72;
/// Levels that may pass without coming closer before refinement gives up.
const PATIENCE: usize = 1;
/// From level to level the samples of the extracted surface count less (as in the network's refinement).
const FIELD_FADES: f64 = 0.3;
const LEAST_FIELD_WEIGHT: f64 = 0.01;
/// Rounds of the later levels.
const LEVEL_ROUNDS: usize = 3;

/// Fits a chart over the disk `mesh` to the data, without refinement.
///
/// # Errors
/// See [`ChartFitError`].
pub fn fit_chart(
    mesh: &TriangleMesh,
    data: &[Datum],
    options: &ChartOptions,
) -> Result<(FittedChart, ChartState), ChartFitError> {
    let flat = flatten(mesh)?;
    let lattice = Lattice::over(&flat.outline(options.tolerance), options.triangles);
    let (data, places) = fit::place(mesh, &flat, data);
    let level = Level::new(options.degree, &lattice, &flat.outline(options.tolerance))?;
    let fitted = level.fit(mesh, &flat, &data, places, options, options.rounds)?;
    let out = fitted.finish(&data, flat.stretch);
    Ok((
        out,
        ChartState {
            flat,
            lattice,
            data,
            places: fitted.places,
        },
    ))
}

/// What the next level of refinement starts from.
#[derive(Clone, Debug)]
pub struct ChartState {
    flat: Flat,
    lattice: Lattice,
    data: Vec<Datum>,
    places: Vec<Option<Place>>,
}

/// Refines until the tolerance holds or a stated limit is met. Returns the chart, the levels used and why it ended.
///
/// # Errors
/// As [`fit_chart`].
pub fn refine_chart(
    fitted: FittedChart,
    state: ChartState,
    mesh: &TriangleMesh,
    options: &ChartOptions,
    mut progress: impl FnMut(usize, &FittedChart),
) -> Result<(FittedChart, usize, RefineEnd), ChartFitError> {
    let ChartState {
        flat,
        mut lattice,
        mut data,
        mut places,
    } = state;
    let outline = flat.outline(options.tolerance);
    let mut current = fitted;
    let mut best: Option<(f64, FittedChart, usize)> = None;
    let mut levels = 0;
    let mut without_gain = 0;
    let end = loop {
        let badness = badness(&current, &data, options.tolerance);
        let gained = best.as_ref().is_none_or(|(least, ..)| badness < *least);
        without_gain = if gained { 0 } else { without_gain + 1 };
        let count = current.chart.spline().net().triangles().len();
        let beyond = face_fits(count, &data, &current.feet)
            .iter()
            .any(|f| f.max > options.tolerance);
        // Points whose foot lies on the border lie beyond it: no split brings them closer.
        let within: Vec<Option<Foot>> = current
            .feet
            .iter()
            .zip(&current.on_border)
            .map(|(foot, on_border)| foot.filter(|_| !on_border))
            .collect();
        let fits = face_fits(count, &data, &within);
        let split: Vec<bool> = fits
            .iter()
            .map(|f| {
                f.count >= LEAST_DATA
                    && f.max > options.tolerance
                    && f.is_lack_of_fit(options.noise_sigma)
            })
            .collect();
        let inner = current.chart.inner_triangles().len();
        let marked = split.iter().filter(|s| **s).count();
        if gained {
            best = Some((badness, current, levels));
        }
        let end = if !beyond {
            Some(RefineEnd::Met)
        } else if marked == 0 {
            Some(if fits.iter().any(|f| f.max > options.tolerance) {
                RefineEnd::Noise
            } else {
                RefineEnd::NoGain
            })
        } else if without_gain > PATIENCE {
            Some(RefineEnd::NoGain)
        } else if levels == options.max_levels {
            Some(RefineEnd::LevelLimit)
        } else {
            None
        };
        if let Some(end) = end {
            break end;
        }
        let next = if marked as f64 > LOCAL_SHARE * inner as f64 {
            Lattice::with_edge(&outline, FINER * lattice.edge)
        } else {
            lattice.split(&split)?
        };
        for datum in data.iter_mut().filter(|d| d.kind == Kind::Field) {
            datum.weight = (datum.weight * FIELD_FADES).max(LEAST_FIELD_WEIGHT);
        }
        let level = Level::new(options.degree, &next, &outline)?;
        if level.inner_count() > options.max_triangles {
            break RefineEnd::PatchLimit;
        }
        let rounds = options.rounds.clamp(1, LEVEL_ROUNDS);
        let refined = level.fit(mesh, &flat, &data, places, options, rounds)?;
        current = refined.finish(&data, flat.stretch);
        places = refined.places;
        lattice = next;
        levels += 1;
        progress(levels, &current);
    };
    match best {
        Some((_, fitted, levels)) => Ok((fitted, levels, end)),
        None => Err(ChartSystemError::NotFinite.into()),
    }
}

/// How far a chart is from what is asked, to compare levels.
fn badness(fitted: &FittedChart, data: &[Datum], tolerance: f64) -> f64 {
    super::surfacing::distances(data, &fitted.feet)
        .map(|d| (d - tolerance).max(0.0))
        .sum()
}

impl FittedChart {
    /// Vertices of the net as they lie on the surface, for confidence and reports.
    pub fn vertex_points(&self) -> Vec<Vec3> {
        let net = self.chart.spline().net();
        let corners: Vec<_> = (0..net.vertices()).map(|v| net.cloud(v)[0]).collect();
        self.chart
            .spline()
            .values(&corners)
            .into_iter()
            .map(|p| p.unwrap_or_else(Vec3::zeros))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Options, reconstruct};
    use crate::Vec3;
    use crate::cloud::{Cloud, OrientedPoint};

    /// Points of the upper half of a sphere of diameter 1, spread evenly (Fibonacci), nudged by at most `noise`.
    fn half_sphere(count: usize, noise: f64) -> Cloud {
        let points = (0..count)
            .map(|k| {
                let z = (k as f64 + 0.5) / count as f64;
                let angle = 2.399_963_229_728_653 * k as f64;
                let r = (1.0 - z * z).sqrt();
                let normal = Vec3::new(r * angle.cos(), r * angle.sin(), z);
                let off = noise * (12.9898 * k as f64).sin();
                OrientedPoint {
                    position: normal * (0.5 + off),
                    normal,
                    sigma: None,
                    finger: None,
                    time_us: None,
                }
            })
            .collect();
        Cloud {
            points,
            rejected: Vec::new(),
        }
    }

    #[test]
    fn half_a_sphere_becomes_one_smooth_chart_close_to_it() {
        let cloud = half_sphere(900, 0.0);
        for (degree, threads) in [(2, 1), (3, 2), (4, 1)] {
            let options = Options {
                chart: Some(degree),
                threads: Some(threads),
                ..Options::default()
            };
            let result = reconstruct(&cloud, &options, &|_| ()).unwrap();
            let chart = result.chart.unwrap();
            let surface = result.report.surface.unwrap();
            assert_eq!(surface.degree, degree);
            assert_eq!(
                (surface.euler, surface.borders, surface.folded_patches),
                (1, 1, 0)
            );
            assert!(surface.g1_max_degrees < 1e-9);
            if degree > 2 {
                assert!(surface.curvature_jump_max.unwrap() < 1e-8);
            }
            let sampled = chart.sample_per_patch(6);
            let away = sampled.positions.iter().map(|p| (p.norm() - 0.5).powi(2));
            let rms = (away.sum::<f64>() / sampled.positions.len() as f64).sqrt();
            let tolerance = result.report.error.unwrap().tolerance;
            assert!(rms < tolerance, "degree {degree}: {rms}");
        }
    }

    #[test]
    fn charts_are_the_same_on_any_number_of_threads() {
        let cloud = half_sphere(400, 0.004);
        let of = |threads| {
            let options = Options {
                chart: Some(3),
                threads: Some(threads),
                ..Options::default()
            };
            reconstruct(&cloud, &options, &|_| ())
                .unwrap()
                .chart
                .unwrap()
        };
        assert_eq!(of(1), of(3));
    }

    #[test]
    fn a_whole_sphere_is_refused_with_what_it_is() {
        let mut cloud = half_sphere(500, 0.0);
        let below: Vec<OrientedPoint> = cloud
            .points
            .iter()
            .map(|p| OrientedPoint {
                position: -p.position,
                normal: -p.normal,
                ..*p
            })
            .collect();
        cloud.points.extend(below);
        let options = Options {
            chart: Some(3),
            ..Options::default()
        };
        let error = reconstruct(&cloud, &options, &|_| ())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("no disk") && error.contains("0 border(s)"),
            "{error}"
        );
    }
}
