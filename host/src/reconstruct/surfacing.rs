//! Phases 3 and 4 together: from a base mesh and data to a surface within the tolerance.

use super::fit::foot::Foot;
use super::fit::system::SystemError;
use super::fit::{Datum, Fit, FitOptions, Kind, fit};
use super::refine::face_fits;
use super::refine::templates::{Base, flip_to_even_valence, split_faces};
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
    } = fit(&network, &base.vertices, data, None, options)?;
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
/// it ended.
///
/// # Errors
/// As [`fit_base`].
pub fn refine(
    fitted: Fitted,
    data: &[Datum],
    options: &SurfacingOptions,
    mut progress: impl FnMut(usize, usize),
) -> Result<(Fitted, usize, RefineEnd), SurfacingError> {
    let mut best = fitted;
    let mut levels = 0;
    loop {
        let fits = face_fits(best.base.faces.len(), data, &best.feet);
        let beyond: Vec<bool> = fits.iter().map(|f| f.max > options.tolerance).collect();
        if !beyond.contains(&true) {
            return Ok((best, levels, RefineEnd::Met));
        }
        let split: Vec<bool> = fits
            .iter()
            .zip(&beyond)
            .map(|(fit, beyond)| *beyond && fit.is_lack_of_fit(options.noise_sigma))
            .collect();
        if !split.contains(&true) {
            return Ok((best, levels, RefineEnd::Noise));
        }
        if levels == options.max_levels {
            return Ok((best, levels, RefineEnd::LevelLimit));
        }
        let surface = &best.surface;
        let mut next = split_faces(&best.base, &split, |face, local| {
            let mut at = [0.5; 3];
            at[(local + 2) % 3] = 0.0;
            surface.point(face, at)
        })?;
        if next.faces.len() > options.max_patches {
            return Ok((best, levels, RefineEnd::PatchLimit));
        }
        // Vertices move onto the fitted surface before angles are taken from them.
        for (vertex, point) in next.vertices.iter_mut().zip(&surface.vertices) {
            *vertex = *point;
        }
        flip_to_even_valence(&mut next)?;
        let candidate = fit_base(next, data, &options.fit)?;
        levels += 1;
        progress(levels, candidate.base.faces.len());
        let (before, after) = (
            badness(&best, data, options),
            badness(&candidate, data, options),
        );
        if after >= before {
            return Ok((best, levels - 1, RefineEnd::NoGain));
        }
        best = candidate;
    }
}

/// How far a surface is from what is asked, to compare levels: the squares of what lies beyond the tolerance.
fn badness(fitted: &Fitted, data: &[Datum], options: &SurfacingOptions) -> f64 {
    distances(data, &fitted.feet)
        .map(|d| (d - options.tolerance).max(0.0).powi(2))
        .sum()
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
