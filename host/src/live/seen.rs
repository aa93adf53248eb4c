//! All that has been seen of a capture so far.
//!
//! Points are kept up to [`MOST_POINTS`]; then every second one is let go and from there on only every second, fourth, …
//! is kept, so memory is bounded and the picture stays even. Each such thinning begins a new epoch, by which
//! viewers know to begin anew.

use super::refit::LiveSurface;
use crate::Vec3;
use crate::cloud::{Cloud, OrientedPoint};
use crate::hand::Finger;
use crate::link::session::{LinkStatus, Weight};
use crate::run::capture::{CaptureEvent, CaptureProgress, Touch};
use palpus_protocol::ContactFlags;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicUsize};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Points that are kept for viewers.
pub const MOST_POINTS: usize = 1 << 17;
/// Notes that are kept.
const MOST_NOTES: usize = 40;
/// Rates are taken over so long.
const RATE_OVER: Duration = Duration::from_secs(1);

/// What the threads share.
#[derive(Debug)]
pub struct Shared {
    seen: Mutex<Seen>,
    pub stop: AtomicBool,
    /// Viewers being served.
    pub viewers: AtomicUsize,
}

impl Shared {
    pub fn new(fingers: Vec<(String, Option<Finger>)>) -> Self {
        Self {
            seen: Mutex::new(Seen::new(fingers)),
            stop: AtomicBool::new(false),
            viewers: AtomicUsize::new(0),
        }
    }

    pub fn lock(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One finger as it is now.
#[derive(Clone, Debug, Default)]
pub struct FingerView {
    /// Its name.
    pub name: String,
    /// State and counters of its link.
    pub status: LinkStatus,
    /// Contacts a second, over the last second.
    pub contacts_per_s: f64,
    /// Share of valid ones among them; NaN without contacts.
    pub valid_share: f64,
    /// The last contact, valid or not.
    pub last: Option<Touch>,
    /// Joints, sensor and centre of the tip, root first, mm; empty before the first contact.
    pub chain_mm: Vec<Vec3>,
}

impl FingerView {
    /// Why the last contact is not valid; empty if it is, or there is none.
    pub fn reasons(&self) -> Vec<&'static str> {
        let flags = self.last.map_or(0, |touch| touch.contact.flags.bits());
        let invalid = flags & ContactFlags::INVALIDATING.bits();
        ContactFlags::from_bits(invalid).names().collect()
    }
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Note {
    /// Counts all notes from 1.
    pub number: u64,
    /// Since the capture began.
    pub at: Duration,
    /// The finger, or `host`.
    pub finger: String,
    /// How grave it is.
    pub weight: Weight,
    /// What.
    pub text: String,
}

/// What is to be seen now, but for points and surface.
#[derive(Clone, Debug, Default)]
pub struct View {
    /// Time, counters, bytes.
    pub progress: CaptureProgress,
    /// The fingers.
    pub fingers: Vec<FingerView>,
    /// The last notes, oldest first.
    pub notes: Vec<Note>,
    /// How the last fit went, in words, if it gave no surface.
    pub no_surface: Option<String>,
    /// Why the capture has ended, if it has.
    pub ended: Option<String>,
}

/// A valid contact for viewers.
#[derive(Clone, Copy, Debug)]
pub struct SeenPoint {
    pub position_mm: [f32; 3],
    pub normal: [f32; 3],
    pub sigma_mm: f32,
    pub finger: u8,
}

/// State behind the lock.
#[derive(Debug)]
pub struct Seen {
    geometry: Vec<Option<Finger>>,
    view: View,
    rates_from: CaptureProgress,
    notes: VecDeque<Note>,
    noted: u64,
    points: Vec<SeenPoint>,
    epoch: u32,
    stride: usize,
    skipped: usize,
    surface: Option<Arc<LiveSurface>>,
}

impl Seen {
    fn new(fingers: Vec<(String, Option<Finger>)>) -> Self {
        let (names, geometry): (Vec<_>, Vec<_>) = fingers.into_iter().unzip();
        let view = View {
            fingers: names
                .into_iter()
                .map(|name| FingerView {
                    name,
                    valid_share: f64::NAN,
                    ..FingerView::default()
                })
                .collect(),
            ..View::default()
        };
        Self {
            geometry,
            view,
            rates_from: CaptureProgress::default(),
            notes: VecDeque::new(),
            noted: 0,
            points: Vec::new(),
            epoch: 0,
            stride: 1,
            skipped: 0,
            surface: None,
        }
    }

    /// Takes in what the capture tells.
    pub fn take_in(&mut self, event: &CaptureEvent<'_>) {
        match event {
            CaptureEvent::Found {
                finger,
                port,
                identity,
            } => {
                let text = format!("board `{}` on {port}", identity.finger_name);
                self.note(finger, Weight::Info, text);
            }
            CaptureEvent::Note {
                finger,
                weight,
                text,
            } => self.note(finger, *weight, (*text).to_owned()),
            CaptureEvent::Touches(touches) => touches.iter().for_each(|touch| self.touch(touch)),
            CaptureEvent::Progress(progress) => self.progress(progress),
        }
    }

    fn note(&mut self, finger: &str, weight: Weight, text: String) {
        self.noted += 1;
        if self.notes.len() == MOST_NOTES {
            self.notes.pop_front();
        }
        self.notes.push_back(Note {
            number: self.noted,
            at: self.view.progress.elapsed,
            finger: finger.to_owned(),
            weight,
            text,
        });
    }

    fn touch(&mut self, touch: &Touch) {
        let Some(finger) = self.view.fingers.get_mut(touch.finger) else {
            return;
        };
        finger.last = Some(*touch);
        if let Some(Some(geometry)) = self.geometry.get(touch.finger) {
            finger.chain_mm = geometry.chain_mm(&touch.contact.joint_angles_rad.map(f64::from));
        }
        let position_mm: [f32; 3] = touch.world.position_mm.map(|x| x as f32).into();
        if !touch.contact.is_valid() || !position_mm.iter().all(|x| x.is_finite()) {
            return;
        }
        self.skipped += 1;
        if self.skipped < self.stride {
            return;
        }
        self.skipped = 0;
        if self.points.len() == MOST_POINTS {
            let mut number = 0;
            self.points.retain(|_| {
                number += 1;
                number % 2 == 0
            });
            // The last one kept is a stride back: this one falls between it and the next.
            self.skipped = self.stride;
            self.stride *= 2;
            self.epoch += 1;
            return;
        }
        self.points.push(SeenPoint {
            position_mm,
            normal: touch.world.normal.map(|x| x as f32).into(),
            sigma_mm: touch.contact.sigma_mm,
            finger: touch.finger.min(255) as u8,
        });
    }

    fn progress(&mut self, progress: &CaptureProgress) {
        self.view.progress.clone_from(progress);
        let past = progress
            .elapsed
            .saturating_sub(self.rates_from.elapsed)
            .as_secs_f64();
        let due = past >= RATE_OVER.as_secs_f64();
        for (k, (finger, (_, status))) in self
            .view
            .fingers
            .iter_mut()
            .zip(&progress.fingers)
            .enumerate()
        {
            finger.status.clone_from(status);
            if due {
                let before = self.rates_from.fingers.get(k).map(|(_, status)| status);
                let since =
                    |now: u64, before: Option<u64>| now.saturating_sub(before.unwrap_or(0)) as f64;
                let contacts = since(status.contacts, before.map(|b| b.contacts));
                let valid = since(status.valid, before.map(|b| b.valid));
                finger.contacts_per_s = contacts / past;
                finger.valid_share = valid / contacts;
            }
        }
        if due {
            self.rates_from.clone_from(progress);
        }
    }

    pub fn view(&self) -> View {
        View {
            notes: self.notes.iter().cloned().collect(),
            ..self.view.clone()
        }
    }

    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    pub fn points(&self) -> &[SeenPoint] {
        &self.points
    }

    pub fn surface(&self) -> Option<Arc<LiveSurface>> {
        self.surface.clone()
    }

    pub fn set_surface(&mut self, made: Result<LiveSurface, String>) {
        match made {
            Ok(surface) => {
                self.surface = Some(Arc::new(surface));
                self.view.no_surface = None;
            }
            Err(why) => self.view.no_surface = Some(why),
        }
    }

    pub fn end(&mut self, why: &str) {
        self.view.ended = Some(why.to_owned());
    }

    /// Every so-manieth point, so that there are at most `most`.
    fn thinned(&self, most: usize) -> impl Iterator<Item = &SeenPoint> {
        let step = self.points.len().div_ceil(most.max(1)).max(1);
        self.points.iter().step_by(step)
    }

    pub fn some_points(&self, most: usize) -> Vec<([f32; 3], u8)> {
        self.thinned(most)
            .map(|p| (p.position_mm, p.finger))
            .collect()
    }

    /// At most `most` points as input of a fit, mm.
    pub fn cloud(&self, most: usize) -> Cloud {
        let wide = |v: [f32; 3]| Vec3::from(v.map(f64::from));
        let points = self.thinned(most).filter_map(|p| {
            Some(OrientedPoint {
                position: wide(p.position_mm),
                normal: wide(p.normal).try_normalize(0.5)?,
                sigma: Some(f64::from(p.sigma_mm)).filter(|s| s.is_finite() && *s > 0.0),
                finger: Some(u16::from(p.finger)),
                time_us: None,
            })
        });
        Cloud {
            points: points.collect(),
            rejected: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::sequence::tests::contact;

    /// A valid touch of finger 0 at `x` on the x axis.
    fn touch(x: f64) -> Touch {
        Touch {
            finger: 0,
            sampled_us: 0,
            contact: contact(0),
            world: crate::hand::WorldContact {
                position_mm: Vec3::new(x, 0.0, 0.0),
                normal: Vec3::x(),
            },
        }
    }

    #[test]
    fn memory_is_bounded_and_thinning_stays_even() {
        let mut seen = Seen::new(vec![("index".into(), None)]);
        let total = 3 * MOST_POINTS;
        for k in 0..total {
            seen.take_in(&CaptureEvent::Touches(&[touch(k as f64)]));
        }
        assert!(seen.points().len() <= MOST_POINTS && seen.points().len() > MOST_POINTS / 2);
        assert_eq!(seen.epoch(), 2);
        let steps: Vec<f32> = seen
            .points()
            .windows(2)
            .map(|w| w[1].position_mm[0] - w[0].position_mm[0])
            .collect();
        assert!(steps.iter().all(|step| *step == 4.0));
        assert!(seen.cloud(500).points.len() <= 500);
    }

    #[test]
    fn invalid_and_unreal_touches_move_the_hand_but_are_no_points() {
        let mut seen = Seen::new(vec![("index".into(), None)]);
        let mut bad = touch(1.0);
        bad.contact.flags = ContactFlags::SPIN_LIMIT.union(ContactFlags::LOADED);
        let mut unreal = touch(f64::NAN);
        unreal.finger = 0;
        let mut foreign = touch(1.0);
        foreign.finger = 7;
        seen.take_in(&CaptureEvent::Touches(&[unreal, foreign, bad]));
        assert!(seen.points().is_empty());
        let finger = &seen.view().fingers[0];
        assert_eq!(finger.last, Some(bad));
        assert_eq!(finger.reasons(), ["spin moment above limit"]);
    }

    #[test]
    fn rates_are_over_the_last_second_and_notes_are_bounded() {
        let mut seen = Seen::new(vec![("index".into(), None)]);
        let mut progress = CaptureProgress {
            fingers: vec![("index".into(), LinkStatus::default())],
            ..CaptureProgress::default()
        };
        for tick in 0..=25_u64 {
            progress.elapsed = Duration::from_millis(100 * tick);
            progress.fingers[0].1.contacts = if tick <= 10 { 20 * tick } else { 200 };
            progress.fingers[0].1.valid = progress.fingers[0].1.contacts / 2;
            seen.take_in(&CaptureEvent::Progress(&progress));
            if tick == 10 {
                let finger = &seen.view().fingers[0];
                assert!((finger.contacts_per_s - 200.0).abs() < 1e-9);
                assert!((finger.valid_share - 0.5).abs() < 1e-9);
            }
        }
        assert_eq!(seen.view().fingers[0].contacts_per_s, 0.0);
        for k in 0..100 {
            seen.note("host", Weight::Info, format!("{k}"));
        }
        let notes = seen.view().notes;
        assert_eq!((notes.len(), notes[0].number), (MOST_NOTES, 61));
    }
}
