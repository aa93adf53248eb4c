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
    let mut hopeless = Hopeless::of(data.len());
    let end = loop {
        let badness = badness(&current, &data, options);
        let gained = best.as_ref().is_none_or(|(least, ..)| badness < *least);
        without_gain = if gained { 0 } else { without_gain + 1 };
        let fits = face_fits(current.base.faces.len(), &data, &current.feet);
        let beyond = fits.iter().any(|f| f.max > options.tolerance);
        let lacking: Vec<bool> = fits
            .iter()
            .map(|f| f.max > options.tolerance && f.is_lack_of_fit(options.noise_sigma))
            .collect();
        let split = hopeless.faces_with_hope(&lacking, &data, &current.feet, options.tolerance);
        let next = next_base(&current, &split, project)?;
        let faces = next.faces.len();
        let end = if !beyond {
            Some(RefineEnd::Met)
        } else if !lacking.contains(&true) {
            Some(RefineEnd::Noise)
        } else if without_gain > PATIENCE || !split.contains(&true) {
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

/// Data that finer patches bring no closer: a face is not split again for their sake.
///
/// Two ways were weighed: to end refinement as a whole once a level gains nothing, which goes on splitting around a few
/// contacts that contradict all others for as long as anything improves anywhere; and to remember for each datum whether the
/// last levels helped it. The second is taken, with the first behind it.
struct Hopeless {
    /// By how much each datum lay beyond the tolerance a level ago, if its face lacked fit then.
    excess: Vec<Option<f64>>,
    /// Levels in a row that brought it hardly closer.
    in_vain: Vec<usize>,
}

/// Levels in a row that may bring a datum no closer.
const TRIES: usize = 2;
/// A level that leaves more than this share of what lies beyond the tolerance was in vain.
const HARDLY_CLOSER: f64 = 0.8;

impl Hopeless {
    fn of(data: usize) -> Self {
        Self {
            excess: vec![None; data],
            in_vain: vec![0; data],
        }
    }

    /// The faces among `lacking` that hold a datum beyond the tolerance that a further level may bring closer.
    fn faces_with_hope(
        &mut self,
        lacking: &[bool],
        data: &[Datum],
        feet: &[Option<Foot>],
        tolerance: f64,
    ) -> Vec<bool> {
        let mut split = vec![false; lacking.len()];
        for (number, (datum, foot)) in data.iter().zip(feet).enumerate() {
            let (Kind::Measured, Some(foot)) = (datum.kind, foot) else {
                continue;
            };
            let now = (datum.position - foot.point).norm() - tolerance;
            match self.excess[number] {
                Some(before) if now > HARDLY_CLOSER * before => self.in_vain[number] += 1,
                Some(_) => self.in_vain[number] = 0,
                None => {}
            }
            let face = foot.face as usize;
            let beyond = now > 0.0 && lacking[face];
            self.excess[number] = beyond.then_some(now);
            split[face] |= beyond && self.in_vain[number] < TRIES;
        }
        split
    }
}

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
/// a large price for every folded patch; times the root of the number of patches, so that twice as many have to bring it down
/// by three tenths.
fn badness(fitted: &Fitted, data: &[Datum], options: &SurfacingOptions) -> f64 {
    let beyond: f64 = distances(data, &fitted.feet)
        .map(|d| (d - options.tolerance).max(0.0))
        .sum();
    let folded = 10.0 * options.tolerance * fitted.surface.folded_patches().len() as f64;
    (beyond + folded) * (fitted.base.faces.len() as f64).sqrt()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_is_split_for_a_datum_only_while_that_brings_it_closer() {
        let at = |height: f64| Foot {
            face: 0,
            barycentric: [1.0, 0.0, 0.0],
            point: Vec3::z() * height,
            tangents: [Vec3::x(), Vec3::y()],
            along: None,
        };
        let datum = |kind| Datum {
            position: Vec3::zeros(),
            normal: Vec3::z(),
            weight: 1.0,
            normal_weight: 1.0,
            kind,
        };
        let splits = |kind, heights: &[f64]| -> Vec<bool> {
            let mut hopeless = Hopeless::of(1);
            let level = |height: &f64| {
                let (data, feet) = ([datum(kind)], [Some(at(*height))]);
                hopeless.faces_with_hope(&[true], &data, &feet, 0.1)[0]
            };
            heights.iter().map(level).collect()
        };
        let measured = |heights: &[f64]| splits(Kind::Measured, heights);
        // In vain twice in a row; once, and then closer; within the tolerance.
        assert_eq!(measured(&[0.9, 0.9, 0.85]), [true, true, false]);
        assert_eq!(measured(&[0.9, 0.9, 0.5, 0.5]), [true; 4]);
        assert_eq!(measured(&[0.9, 0.05]), [true, false]);
        assert_eq!(splits(Kind::Field, &[0.9]), [false]);
    }
}
