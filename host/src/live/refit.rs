//! A surface of what has been touched so far, fitted again and again beside the capture.
//!
//! At most [`MOST_POINTS`] contacts, evenly picked from all, go through the same phases as `reconstruct` up to the
//! first fit, with half of the cores, so that a fit stays within a second and leaves the capture room. Refinement is
//! left out: on a torus half touched it took 2 to 4 s of the 3 to 5, since the rim of what has been touched contradicts
//! itself from fit to fit, and brought rms from 0.15 mm to 0.10 mm at best. Where the contacts leave a gap the
//! surface stays open, and the border is drawn: there is still to be touched. What fails is said and tried again.

use super::seen::Shared;
use crate::Vec3;
use crate::cloud::Cloud;
use crate::picture::open_borders;
use crate::reconstruct::{Options, Stage, extract, reconstruct};
use crate::spline::SampledSurface;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Contacts that go into one fit: enough for the shape, few enough for a fit in a second.
const MOST_POINTS: usize = 800;
/// Contacts before the first fit.
const FEWEST_POINTS: usize = 60;
/// Triangles a viewer is sent, about.
const TRIANGLES: usize = 12_000;
/// How often it is looked whether a fit is due.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A fitted surface for viewers; mm.
#[derive(Clone, Debug, Default)]
pub struct LiveSurface {
    /// Counts the surfaces from 1.
    pub number: u64,
    /// Points it rests on.
    pub points: usize,
    /// What it took, seconds.
    pub seconds: f64,
    /// Patches.
    pub patches: usize,
    /// Connected pieces.
    pub pieces: usize,
    /// Handles.
    pub handles: i64,
    /// Border loops: the openings still to be touched, or the object's own.
    pub openings: usize,
    /// Root mean square distance of the contacts from it, mm.
    pub rms_mm: f64,
    /// Triangles with normals and confidence (standard deviation).
    pub sampled: SampledSurface,
    /// Lines along the openings.
    pub borders: Vec<[Vec3; 2]>,
}

/// Starts the thread; it ends when the capture has ended or `shared.stop` is set.
pub fn start(shared: Arc<Shared>, every: Duration) {
    std::thread::spawn(move || {
        let mut number = 0;
        let mut done = 0;
        let mut began: Option<Instant> = None;
        while !shared.stop.load(Ordering::Relaxed) {
            let (count, ended) = {
                let seen = shared.lock();
                (seen.points().len(), seen.view().ended.is_some())
            };
            if ended {
                break;
            }
            let rested = began.is_none_or(|at| at.elapsed() >= every);
            if !rested || count == done || count < FEWEST_POINTS {
                std::thread::sleep(LOOK_EVERY);
                continue;
            }
            began = Some(Instant::now());
            done = count;
            let cloud = shared.lock().cloud(MOST_POINTS);
            let made = fit(&cloud, number + 1);
            if made.is_ok() {
                number += 1;
            }
            shared.lock().set_surface(made);
        }
    });
}

/// One fit; says in words why there is none.
fn fit(cloud: &Cloud, number: u64) -> Result<LiveSurface, String> {
    let began = Instant::now();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let options = Options {
        rounds: 2,
        stop_after: Stage::Fit,
        threads: Some((cores / 2).max(1)),
        extract: extract::Options {
            max_memory: 512 << 20,
            ..extract::Options::default()
        },
        ..Options::default()
    };
    let made = reconstruct(cloud, &options, &|_| {}).map_err(|e| e.to_string())?;
    let surface = made.surface.unwrap_or_default();
    let segments = (TRIANGLES / surface.faces.len().max(1))
        .isqrt()
        .clamp(2, 12);
    let sampled = surface
        .sample_per_patch(segments)
        .map_err(|e| e.to_string())?;
    let figures = made.report.surface.unwrap_or_default();
    Ok(LiveSurface {
        number,
        points: cloud.points.len(),
        seconds: began.elapsed().as_secs_f64(),
        patches: figures.patches,
        pieces: figures.components,
        handles: figures.genus,
        openings: figures.borders,
        rms_mm: made.report.error.map_or(f64::NAN, |e| e.rms),
        sampled,
        borders: open_borders(&surface),
    })
}
