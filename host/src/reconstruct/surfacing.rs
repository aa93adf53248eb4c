//! Phases 3 and 4 together: from a base mesh and data to a surface within the tolerance.

use super::fit::foot::Foot;
use super::fit::system::SystemError;
use super::fit::{Datum, Fit, FitOptions, Kind, fit};
use super::refine::face_fits;
use super::refine::templates::{Base, flip_to_even_valence, relax, split_faces};
use crate::Vec3;
use crate::spline::Surface;
use crate::spline::edges::EdgeError;
use crate::spline::network::Network;

/// Why no surface could be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SurfacingError {
    /// The base mesh is no proper triangulation.
    #[error("the base mesh cannot carry a network: {0}")]
    Base(#[from] EdgeError),
    /// A system could not be solved.
    #[error(transparent)]
    System(#[from] SystemError),
    /// No level gave a finite surface.
    #[error("the fit has no finite error; check the input for coinciding or far-off points")]
    NoLevel,
}

/// What steers phases 3 and 4.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfacingOptions {
    /// The fit of every level.
    pub fit: FitOptions,
    /// Largest distance allowed.
    pub tolerance: f64,
    /// Standard deviation of the data along the normal; refinement goes no finer than it supports.
    pub noise_sigma: f64,
    /// Refinement stops before this many patches.
    pub max_patches: usize,
    /// Most levels of refinement.
    pub max_levels: usize,
}

/// A network fitted to data.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The base mesh.
    pub base: Base,
    /// The surface.
    pub surface: Surface,
    /// Foot point of each datum.
    pub feet: Vec<Option<Foot>>,
    /// Root of the mean squared distance after each round.
    pub history: Vec<f64>,
}

/// Fits a network over `base`.
///
/// # Errors
/// A base that is no triangulation, or a system that cannot be solved.
pub fn fit_base(
    base: Base,
    data: &[Datum],
    options: &FitOptions,
) -> Result<Fitted, SurfacingError> {
    let network = Network::new(&base.vertices, &base.faces, &base.creases, &base.corners)?;
    let Fit {
        points,
        feet,
        history,
    } = fit(&network, &base.vertices, data, options)?;
    let surface = Surface {
        vertices: points[..base.vertices.len()].to_vec(),
        faces: base.faces.clone(),
        control_points: network.patches(&points),
        creases: network.creases(),
        sigma: Vec::new(),
    };
    Ok(Fitted {
        base,
        surface,
        feet,
        history,
    })
}

/// Why refinement ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RefineEnd {
    /// Every measured datum lies within the tolerance.
    Met,
    /// What lies beyond is explained by noise.
    Noise,
    /// The next level would have more patches than allowed.
    PatchLimit,
    /// The allowed number of levels was used.
    LevelLimit,
    /// A further level made the surface no better.
    NoGain,
}

/// Refines until the tolerance holds or a stated limit is met. Returns the surface, the levels used and why
/// it ended. `project` takes a point near the surface onto it; `progress` hears of every level that was fitted.
///
/// # Errors
/// As [`fit_base`].
pub fn refine(
    fitted: Fitted,
    data: &[Datum],
    options: &SurfacingOptions,
    project: &dyn Fn(&Vec3) -> Option<Vec3>,
    mut progress: impl FnMut(usize, &Fitted),
) -> Result<(Fitted, usize, RefineEnd), SurfacingError> {
    let mut data = data.to_vec();
    let level_fit = FitOptions {
        rounds: options.fit.rounds.clamp(1, LEVEL_ROUNDS),
        ..options.fit
    };
    let mut current = fitted;
    let mut best: Option<(f64, Fitted, usize)> = None;
    let mut levels = 0;
    let mut without_gain = 0;
    let end = loop {
        let badness = badness(&current, &data, options);
        let gained = best.as_ref().is_none_or(|(least, ..)| badness < *least);
        without_gain = if gained { 0 } else { without_gain + 1 };
        let fits = face_fits(current.base.faces.len(), &data, &current.feet);
        let beyond: Vec<bool> = fits.iter().map(|f| f.max > options.tolerance).collect();
        let split: Vec<bool> = fits
            .iter()
            .zip(&beyond)
            .map(|(fit, beyond)| *beyond && fit.is_lack_of_fit(options.noise_sigma))
            .collect();
        let next = next_base(&current, &split, project)?;
        let faces = next.faces.len();
        let end = if !beyond.contains(&true) {
            Some(RefineEnd::Met)
        } else if !split.contains(&true) {
            Some(RefineEnd::Noise)
        } else if without_gain > PATIENCE {
            Some(RefineEnd::NoGain)
        } else if levels == options.max_levels {
            Some(RefineEnd::LevelLimit)
        } else if faces > options.max_patches {
            Some(RefineEnd::PatchLimit)
        } else {
            None
        };
        if gained {
            best = Some((badness, current, levels));
        }
        if let Some(end) = end {
            break end;
        }
        for datum in data.iter_mut().filter(|d| d.kind == Kind::Field) {
            datum.weight = (datum.weight * FIELD_FADES).max(LEAST_FIELD_WEIGHT);
        }
        current = fit_base(next, &data, &level_fit)?;
        levels += 1;
        progress(levels, &current);
    };
    match best {
        Some((_, fitted, levels)) => Ok((fitted, levels, end)),
        None => Err(SurfacingError::NoLevel),
    }
}

/// Rounds of a level: it starts from well-placed vertices, so the fourth round changes little.
const LEVEL_ROUNDS: usize = 3;
/// From level to level the samples of the extracted surface count less, down to a hundredth: they hold what has
/// no data, while the measured points decide where refinement goes on.
const FIELD_FADES: f64 = 0.3;
const LEAST_FIELD_WEIGHT: f64 = 0.01;

/// Levels that may pass without coming closer before refinement gives up: one bad triangle can spoil a level
/// and be mended in the next.
const PATIENCE: usize = 1;

/// The base mesh of the next level.
fn next_base(
    current: &Fitted,
    split: &[bool],
    project: &dyn Fn(&Vec3) -> Option<Vec3>,
) -> Result<Base, EdgeError> {
    let surface = &current.surface;
    let first_new = current.base.vertices.len() as u32;
    let mut next = split_faces(&current.base, split, |face, local| {
        let mut at = [0.5; 3];
        at[(local + 2) % 3] = 0.0;
        surface.point(face, at)
    })?;
    // Vertices move onto the fitted surface before angles are taken from them.
    for (vertex, point) in next.vertices.iter_mut().zip(&surface.vertices) {
        *vertex = *point;
    }
    flip_to_even_valence(&mut next)?;
    let near: Vec<bool> = next
        .faces
        .iter()
        .map(|face| face.iter().any(|v| *v >= first_new))
        .collect();
    relax(&mut next, &near, 5, project)?;
    Ok(next)
}

/// How far a surface is from what is asked, to compare levels: the sum of what lies beyond the tolerance, and
/// a large price for every folded patch.
fn badness(fitted: &Fitted, data: &[Datum], options: &SurfacingOptions) -> f64 {
    let beyond: f64 = distances(data, &fitted.feet)
        .map(|d| (d - options.tolerance).max(0.0))
        .sum();
    beyond + 10.0 * options.tolerance * fitted.surface.folded_patches().len() as f64
}

/// Distance of each measured datum to its foot point.
pub fn distances<'a>(
    data: &'a [Datum],
    feet: &'a [Option<Foot>],
) -> impl Iterator<Item = f64> + 'a {
    data.iter()
        .zip(feet)
        .filter(|(datum, _)| datum.kind == Kind::Measured)
        .filter_map(|(datum, foot)| Some((datum.position - foot.as_ref()?.point).norm()))
}

/// Angle between each measured normal and the surface's at its foot point, degrees.
pub fn normal_angles<'a>(
    data: &'a [Datum],
    feet: &'a [Option<Foot>],
) -> impl Iterator<Item = f64> + 'a {
    data.iter()
        .zip(feet)
        .filter(|(datum, _)| datum.kind == Kind::Measured)
        .filter_map(|(datum, foot)| {
            let normal: Vec3 = foot.as_ref()?.normal()?;
            Some(crate::spline::angle_degrees(normal, datum.normal))
        })
}
