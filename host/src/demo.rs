//! The whole path without hardware: a simulated hand explores an object, is captured through real terminals,
//! and what it felt becomes a surface that is held against the object's true shape.
//!
//! The truth is used for the last figures only; nothing of it reaches the reconstruction.

use crate::cloud::Cloud;
use crate::evaluate::{EvaluateError, Evaluation, Shape, compare};
use crate::hand::Hand;
use crate::reconstruct::{Options, Progress, ReconstructError, Reconstruction, reconstruct};
use crate::run::capture::{CaptureError, CaptureEvent, CaptureSettings, CaptureSummary, capture};
use crate::run::points::{PointsError, RunReport, points};
use crate::simulate::{HandOptions, Object, SimulateError, SimulatedHand};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Why a demo ended early.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// The hand could not be simulated.
    #[error("simulation: {0}")]
    Simulate(#[from] SimulateError),
    /// The capture failed.
    #[error("capture: {0}")]
    Capture(#[from] CaptureError),
    /// The run gave no points.
    #[error("points: {0}")]
    Points(#[from] PointsError),
    /// The reconstruction failed.
    #[error("reconstruction: {0}")]
    Reconstruct(#[from] ReconstructError),
    /// The comparison with the truth failed.
    #[error("evaluation: {0}")]
    Evaluate(#[from] EvaluateError),
}

/// How the contacts of a run lie to the true object.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct ContactTruth {
    /// Valid contacts.
    pub contacts: usize,
    /// Root mean square distance to the object, mm.
    pub position_rms_mm: f64,
    /// Largest distance, mm.
    pub position_max_mm: f64,
    /// Root mean square angle to the object's normal at the nearest point, degrees (off creases).
    pub normal_rms_degrees: f64,
    /// Largest angle, degrees.
    pub normal_max_degrees: f64,
}

/// What happened in a demo.
#[derive(Clone, Debug)]
pub struct Demo {
    /// How the capture ended.
    pub capture: CaptureSummary,
    /// What the run held, finger by finger.
    pub runs: Vec<RunReport>,
    /// The points, mm.
    pub cloud: Cloud,
    /// The points against the true object.
    pub contacts: ContactTruth,
    /// The reconstruction.
    pub reconstruction: Reconstruction,
    /// The surface against the true object.
    pub truth: Evaluation,
}

/// What a demo tells while it runs.
#[derive(Debug)]
pub enum Step<'a> {
    /// The hand explores and is captured.
    Capture(&'a CaptureEvent<'a>),
    /// The reconstruction goes on.
    Reconstruct(Progress),
}

/// Explores `hand.object` once, writing the run to `run`, and reconstructs it.
///
/// # Errors
/// [`DemoError`]; a run that was captured stays on disk whatever fails later.
pub fn demo(
    hand: &HandOptions,
    run: &Path,
    options: &Options,
    stop: &AtomicBool,
    tell: &(dyn Fn(Step<'_>) + Sync),
) -> Result<Demo, DemoError> {
    let simulated = SimulatedHand::start(hand)?;
    let settings = CaptureSettings {
        replace: true,
        ..CaptureSettings::every_contact(
            simulated
                .ports()
                .iter()
                .map(|port| (port.finger.clone(), port.port.display().to_string()))
                .collect(),
            vec![("hand.urdf".into(), Hand::THREE_FINGER_URDF.into())],
            run.to_owned(),
        )
    };
    let done = AtomicBool::new(false);
    let explored = AtomicBool::new(false);
    let summary = std::thread::scope(|scope| {
        // The capture ends when the whole object has been gone over once.
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                if simulated.rounds() >= 1 || simulated.has_failed() || stop.load(Ordering::Relaxed)
                {
                    explored.store(true, Ordering::Relaxed);
                    break;
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let summary = capture(&settings, &explored, &mut |event| {
            tell(Step::Capture(&event))
        });
        done.store(true, Ordering::Relaxed);
        summary
    })?;
    simulated.stop();
    let gathered = points(&[run.to_owned()], None)?;
    let contacts = contact_truth(&hand.object, &gathered.cloud);
    let reconstruction = reconstruct(&gathered.cloud, options, &|p| tell(Step::Reconstruct(p)))?;
    let surface = reconstruction.surface.clone().unwrap_or_default();
    let truth = compare(
        &Shape::surface("surface", surface)?,
        &Shape::mesh("truth", hand.object.truth_mesh()),
        20_000,
    )?;
    Ok(Demo {
        capture: summary,
        runs: gathered.reports,
        cloud: gathered.cloud,
        contacts,
        reconstruction,
        truth,
    })
}

/// Holds contacts against the object they were made on.
pub fn contact_truth(object: &Object, cloud: &Cloud) -> ContactTruth {
    let mut out = ContactTruth {
        contacts: cloud.points.len(),
        ..ContactTruth::default()
    };
    let (mut squares, mut angles) = (0.0, 0.0);
    for point in &cloud.points {
        let foot = object.foot(&point.position);
        let distance = (point.position - foot.position_mm).norm();
        squares += distance * distance;
        out.position_max_mm = out.position_max_mm.max(distance);
        let angle = crate::spline::angle_degrees(foot.normal, point.normal);
        angles += angle * angle;
        out.normal_max_degrees = out.normal_max_degrees.max(angle);
    }
    let count = cloud.points.len().max(1) as f64;
    out.position_rms_mm = (squares / count).sqrt();
    out.normal_rms_degrees = (angles / count).sqrt();
    out
}
