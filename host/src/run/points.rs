//! From runs to points in the world.
//!
//! Every frame carries the joint angles of its own sample, so a contact is placed by its own frame alone: clocks
//! that differ between boards, or a finger that moves, smear nothing. What is not turned into a point is
//! reported with its reason.

use super::RunError;
use super::capture::world_contact;
use super::reader::{Run, RunItem};
use super::schema::LinkState;
use crate::cloud::{Cloud, OrientedPoint};
use crate::hand::{Hand, HandError};
use crate::link::connection::decode_wire;
use crate::link::sequence::{SequenceCounts, SequenceTracker};
use palpus_protocol::{BoardMessage, Contact, ContactFlags};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why a run gives no points.
#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    /// The run can't be read.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The hand in the run can't be used.
    #[error("{path}: {source}")]
    Hand {
        /// The run.
        path: PathBuf,
        /// Why.
        source: HandError,
    },
    /// There is no hand.
    #[error("{path} holds no hand file; give the hand it was captured with by --hand FILE")]
    NoHand {
        /// The run.
        path: PathBuf,
    },
    /// The hand has no such finger.
    #[error(
        "{path}: the hand has no finger `{finger}`; give the hand it was captured with by --hand FILE"
    )]
    UnknownFinger {
        /// The run.
        path: PathBuf,
        /// The finger.
        finger: String,
    },
}

/// What a run gave of one finger, and what is missing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FingerReport {
    /// Name of the finger.
    pub finger: String,
    /// Contacts in the run, each once.
    pub contacts: u64,
    /// Of these, those turned into points.
    pub valid: u64,
    /// Contacts that are invalid, by reason; one may have several.
    pub invalid: BTreeMap<&'static str, u64>,
    /// Contacts the board made that are not in the run, between its first and its last.
    pub lost: u64,
    /// Contacts that are in the run twice; used once.
    pub duplicates: u64,
    /// Contacts that are in the run after a later one; used.
    pub out_of_order: u64,
    /// Times the board started anew.
    pub restarts: u64,
    /// Frames in the run that can't be read, with the first reason.
    pub unreadable: u64,
    /// Why the first unreadable frame is so.
    pub unreadable_reason: Option<String>,
    /// The capture's own last counters.
    pub link: Option<LinkState>,
}

/// What a run gave, and what is missing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunReport {
    /// The run.
    pub path: PathBuf,
    /// Whether the file is complete to its last byte.
    pub complete: bool,
    /// What is damaged, in words.
    pub damage: Vec<String>,
    /// Length of the run, seconds.
    pub seconds: f64,
    /// The fingers.
    pub fingers: Vec<FingerReport>,
}

/// Points of some runs with their reports.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunPoints {
    /// The points, mm, in the order they were written, run by run.
    pub cloud: Cloud,
    /// One report per run.
    pub reports: Vec<RunReport>,
}

/// Valid contacts of runs in the world: mm, normals out of the object, sigma, finger (its place in the hand), time.
///
/// `hand` replaces the hand the runs were captured with.
///
/// # Errors
/// [`PointsError`]; what is damaged or missing within a run is in its report.
pub fn points(paths: &[PathBuf], hand: Option<&Hand>) -> Result<RunPoints, PointsError> {
    let mut all = RunPoints::default();
    for path in paths {
        let report = add_points(path, hand, &mut all.cloud)?;
        all.reports.push(report);
    }
    Ok(all)
}

fn add_points(
    path: &Path,
    hand: Option<&Hand>,
    cloud: &mut Cloud,
) -> Result<RunReport, PointsError> {
    let run = Run::open(path)?;
    let own_hand = match hand {
        Some(_) => None,
        None => run.read_hand().map_err(|source| PointsError::Hand {
            path: path.into(),
            source,
        })?,
    };
    let Some(hand) = hand.or(own_hand.as_ref()) else {
        return Err(PointsError::NoHand { path: path.into() });
    };
    let mut fingers = Vec::new();
    for name in &run.fingers {
        let (index, finger) = hand
            .finger(name)
            .ok_or_else(|| PointsError::UnknownFinger {
                path: path.into(),
                finger: name.clone(),
            })?;
        let report = FingerReport {
            finger: name.clone(),
            ..FingerReport::default()
        };
        let every = stream_every(&run);
        fingers.push((index, finger, report, SequenceTracker::new(every)));
    }
    run.each(|item| match item {
        RunItem::Frame {
            finger,
            sampled_ns,
            wire,
            ..
        } => {
            let Some((index, geometry, report, tracker)) = fingers.get_mut(finger) else {
                return;
            };
            match decode_wire(&wire) {
                Ok(BoardMessage::Contact(contact)) => {
                    if tracker.take(&contact) == crate::link::sequence::Arrival::Duplicate {
                        return;
                    }
                    if !contact.is_valid() {
                        count_reasons(&contact, &mut report.invalid);
                        return;
                    }
                    let world = world_contact(geometry, &contact);
                    cloud.points.push(OrientedPoint {
                        position: world.position_mm,
                        normal: world.normal,
                        sigma: Some(f64::from(contact.sigma_mm)),
                        finger: u16::try_from(*index).ok(),
                        time_us: i64::try_from(sampled_ns / 1_000).ok(),
                    });
                    report.valid += 1;
                }
                Ok(_) => {}
                Err(reason) => {
                    report.unreadable += 1;
                    report.unreadable_reason.get_or_insert(reason);
                }
            }
        }
        RunItem::Link { finger, state } => {
            if let Some((_, _, report, _)) = fingers.get_mut(finger) {
                report.link = Some(state);
            }
        }
        RunItem::Event(_) => {}
    })?;
    let fingers = fingers.into_iter().map(|(_, _, report, tracker)| {
        let SequenceCounts {
            accepted,
            lost,
            duplicates,
            out_of_order,
            restarts,
        } = tracker.counts();
        FingerReport {
            contacts: accepted,
            lost,
            duplicates,
            out_of_order,
            restarts,
            ..report
        }
    });
    Ok(RunReport {
        path: path.into(),
        complete: run.complete,
        damage: run.damage.iter().map(ToString::to_string).collect(),
        seconds: run.span_ns.map_or(0.0, |(first, last)| {
            last.saturating_sub(first) as f64 * 1e-9
        }),
        fingers: fingers.collect(),
    })
}

/// Every how many contacts the boards were told to send one.
fn stream_every(run: &Run) -> u32 {
    let every = run.about.get("contact_every").and_then(|v| v.parse().ok());
    every.unwrap_or(1)
}

fn count_reasons(contact: &Contact, reasons: &mut BTreeMap<&'static str, u64>) {
    for (flag, name) in ContactFlags::NAMES {
        if contact.flags.contains(flag) && flag.intersects(ContactFlags::INVALIDATING) {
            *reasons.entry(name).or_insert(0) += 1;
        }
    }
}
