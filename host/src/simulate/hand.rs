//! The simulated hand as a whole: plans the exploration, then runs one board per finger, each in a thread of
//! its own behind a pseudo-terminal, as if it hung on a cable.
//!
//! **Time.** Every board samples on its own clock, which starts at some odd time and runs some 20 ppm too
//! fast or slow, as crystals do. A sample belongs to the instant its period began even if the thread gets to it
//! late, as it would with a timer that triggers converters; after [`PATIENCE`] periods of delay, samples are
//! skipped and the board counts an overrun, as a real one would. With a speed above 1 the fingers and the
//! boards' periods are that much faster; clocks keep real time.
//!
//! **When.** A finger waits at home until the host starts its contact stream, and goes home when it stops.
//! After one round of the itinerary the next begins; readings then differ by their noise.

use super::SimulateError;
use super::bench::{FingerBench, TrueContact};
use super::finger::Reacher;
use super::fingertip::Rubbing;
use super::gauges::GaugeFaults;
use super::itinerary::{divide, itinerary};
use super::motion::{Motion, sliding_mm};
use super::object::Object;
use super::waypoints::Waypoints;
use crate::hand::Hand;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serialport::{SerialPort, TTYPort};
use std::io::{ErrorKind, Read, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Radius of the tip, millimetres.
pub const TIP_RADIUS_MM: f64 = 20.0;
/// Period of a board at speed 1, microseconds.
const PERIOD_US: f64 = 5000.0;
/// Periods a thread may be late before samples are skipped.
const PATIENCE: u64 = 40;
/// Fewest and most places to visit: fewer leave holes in a mug, more make the finger creep without adding
/// anything the contacts' own noise would not hide.
const PLACES: (usize, usize) = (150, 2500);

/// Opening pseudo-terminals is not thread-safe (`ptsname`).
static OPENING: Mutex<()> = Mutex::new(());

/// What is not perfect about the simulated sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// The gauges.
    pub gauges: GaugeFaults,
    /// Resolution of the joint encoders in bits a turn; `None` for no rounding.
    pub encoder_bits: Option<u32>,
    /// Largest error of a board's clock, parts per million.
    pub clock_ppm: f64,
}

impl Noise {
    /// Perfect gauges but for crosstalk and rounding to counts, perfect encoders; clocks are those of
    /// [`Self::standard`].
    pub fn none() -> Self {
        Self {
            gauges: GaugeFaults {
                noise_counts: 0.0,
                crosstalk: 0.08,
                offset_counts: 0.0,
                drift_counts_per_root_minute: 0.0,
            },
            encoder_bits: None,
            clock_ppm: 20.0,
        }
    }

    /// Like a good real sensor: 11.6 mN and 0.23 N mm per reading (public logs of six-axis sensors show 10 to
    /// 17 mN and 0.1 to 0.4 N mm), offsets of some newtons, a drift of 4 mN in a minute, encoders of 14 bits.
    /// Contacts are then within 0.5 mm and 3 degrees (root mean square) at 2 N.
    pub fn standard() -> Self {
        Self::scaled(1.0)
    }

    /// [`Self::standard`] with noise and drift `factor` times as large.
    pub fn scaled(factor: f64) -> Self {
        let none = Self::none();
        Self {
            gauges: GaugeFaults {
                noise_counts: 250.0 * factor,
                offset_counts: 1e5,
                drift_counts_per_root_minute: 86.0 * factor,
                ..none.gauges
            },
            encoder_bits: Some(14),
            ..none
        }
    }
}

/// What to simulate.
#[derive(Clone, Debug)]
pub struct HandOptions {
    /// What is touched.
    pub object: Arc<Object>,
    /// Fingers to use, 1 to 3.
    pub fingers: usize,
    /// What is not perfect.
    pub noise: Noise,
    /// Contacts, of all fingers together, in which the whole object is gone over once. The fingers slide
    /// accordingly fast, and their tracks lie accordingly dense.
    pub contacts: usize,
    /// Normal force, N.
    pub normal_force_n: f64,
    /// Tangential over normal force while sliding.
    pub friction: f64,
    /// Largest moment about the contact's normal, N mm.
    pub spin_n_mm: f64,
    /// How much faster than 200 Hz.
    pub speed: f64,
    /// Whether to keep what was true, for checks; takes 64 bytes per contact.
    pub keep_truth: bool,
    /// Everything random follows from it.
    pub seed: u64,
}

impl HandOptions {
    /// Three fingers at 2 N with standard noise, 6000 contacts a round at 200 Hz.
    pub fn new(object: Object) -> Self {
        Self {
            object: Arc::new(object),
            fingers: 3,
            noise: Noise::standard(),
            contacts: 6000,
            normal_force_n: 2.0,
            friction: 0.3,
            spin_n_mm: 1.0,
            speed: 1.0,
            keep_truth: false,
            seed: 1,
        }
    }
}

/// An exploration, planned but not yet running.
pub(crate) struct Plan {
    pub motions: Vec<Motion>,
    pub touchable: f64,
    pub unreachable: usize,
    pub places: usize,
    pub pace_mm: f64,
}

/// Plans who touches what on which way.
pub(crate) fn plan(options: &HandOptions) -> Result<Plan, SimulateError> {
    let hand = shipped_hand()?;
    let known = hand.fingers().len();
    if options.fingers == 0 || options.fingers > known {
        return Err(SimulateError::Fingers {
            asked: options.fingers,
            known,
        });
    }
    for (name, value, low, high) in [
        ("normal force", options.normal_force_n, 0.01, 40.0),
        ("friction", options.friction, 0.0, 10.0),
        ("spin moment", options.spin_n_mm, 0.0, 1000.0),
        ("speed", options.speed, 0.01, 50.0),
    ] {
        if !(low..=high).contains(&value) {
            return Err(SimulateError::Option {
                name,
                value,
                low,
                high,
            });
        }
    }
    let reachers: Vec<Reacher> = hand
        .fingers()
        .iter()
        .take(options.fingers)
        .filter_map(Reacher::new)
        .collect();
    let object = &options.object;
    let places = (options.contacts / 3).clamp(PLACES.0, PLACES.1);
    let waypoints = Waypoints::spread(object, TIP_RADIUS_MM, places, options.seed);
    let division = divide(&waypoints, &reachers);
    let itineraries: Vec<_> = reachers
        .par_iter()
        .zip(&division.parts)
        .map(|(reacher, parts)| itinerary(object, &waypoints, TIP_RADIUS_MM, reacher, parts))
        .collect();
    let total: f64 = itineraries.iter().map(|legs| sliding_mm(legs)).sum();
    if total <= 0.0 {
        return Err(SimulateError::OutOfReach {
            object: object.name().to_owned(),
        });
    }
    let pace_mm = total / options.contacts.max(1) as f64;
    let motions = reachers
        .into_iter()
        .zip(itineraries)
        .map(|(reacher, legs)| {
            Motion::new(
                Arc::clone(object),
                reacher,
                legs,
                TIP_RADIUS_MM,
                options.normal_force_n,
                pace_mm,
            )
        })
        .collect();
    Ok(Plan {
        motions,
        touchable: waypoints.touchable,
        unreachable: division.unreachable,
        places: waypoints.placements.len(),
        pace_mm,
    })
}

fn shipped_hand() -> Result<Hand, SimulateError> {
    Ok(Hand::from_urdf(
        Hand::THREE_FINGER_URDF,
        "three_finger.urdf",
    )?)
}

/// A finger's board as the outside sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FingerPort {
    /// Name of the finger, as in the hand's description.
    pub finger: String,
    /// The pseudo-terminal its board is connected to.
    pub port: PathBuf,
}

/// A running simulated hand. Dropping it stops it.
#[derive(Debug)]
pub struct SimulatedHand {
    ports: Vec<FingerPort>,
    touchable: f64,
    unreachable: f64,
    slide_mm_per_s: f64,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    stop: AtomicBool,
    rounds: Vec<AtomicU64>,
    truth: Vec<Mutex<Vec<TrueContact>>>,
    keep_truth: bool,
}

impl SimulatedHand {
    /// Plans the exploration (a second or a few) and starts the boards.
    ///
    /// # Errors
    /// [`SimulateError`].
    pub fn start(options: &HandOptions) -> Result<Self, SimulateError> {
        let plan = plan(options)?;
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            rounds: plan.motions.iter().map(|_| AtomicU64::new(0)).collect(),
            truth: plan.motions.iter().map(|_| Mutex::default()).collect(),
            keep_truth: options.keep_truth,
        });
        let mut hand = Self {
            ports: Vec::new(),
            touchable: plan.touchable,
            unreachable: plan.unreachable as f64 / plan.places.max(1) as f64,
            slide_mm_per_s: plan.pace_mm * 1e6 * options.speed / PERIOD_US,
            shared: Arc::clone(&shared),
            threads: Vec::new(),
        };
        let rubbing = Rubbing {
            friction: options.friction,
            spin_n_mm: options.spin_n_mm,
        };
        let period_us = (PERIOD_US / options.speed).round() as u32;
        for (number, motion) in plan.motions.into_iter().enumerate() {
            let clock = BoardClock {
                began: Instant::now(),
                // Between ten seconds and a quarter of an hour since the board was switched on.
                offset_us: random.random_range(1e7..1e9),
                rate: 1.0 + 1e-6 * options.noise.clock_ppm * random.random_range(-1.0..1.0),
            };
            let bench = FingerBench::new(
                number as u8,
                motion,
                &options.noise,
                rubbing,
                TIP_RADIUS_MM,
                period_us,
                random.random(),
                clock.now_us(),
            )?;
            let (master, slave) = {
                let _one_at_a_time = OPENING.lock().unwrap_or_else(PoisonError::into_inner);
                TTYPort::pair().map_err(|e| SimulateError::Terminal {
                    reason: e.to_string(),
                })?
            };
            let finger = bench.reacher().finger().name.clone();
            let port = slave
                .name()
                .map(PathBuf::from)
                .ok_or_else(|| SimulateError::Terminal {
                    reason: "it has no name".into(),
                })?;
            hand.ports.push(FingerPort { finger, port });
            let cable = Cable {
                bench,
                clock,
                period_us: u64::from(period_us),
                master,
                _slave: slave,
                unsent: Vec::new(),
                number,
                shared: Arc::clone(&shared),
            };
            let thread = std::thread::Builder::new()
                .name(format!("simulated board {number}"))
                .spawn(move || cable.run())
                .map_err(|e| SimulateError::Terminal {
                    reason: format!("no thread for its board: {e}"),
                })?;
            hand.threads.push(thread);
        }
        Ok(hand)
    }

    /// Where each finger's board is connected.
    pub fn ports(&self) -> &[FingerPort] {
        &self.ports
    }

    /// Share of the object's area that the tip can touch, 0 to 1.
    pub fn touchable(&self) -> f64 {
        self.touchable
    }

    /// Share of that which no finger can reach with its hemisphere, 0 to 1.
    pub fn unreachable(&self) -> f64 {
        self.unreachable
    }

    /// How fast the contact slides over the object, millimetres per second.
    pub fn slide_mm_per_s(&self) -> f64 {
        self.slide_mm_per_s
    }

    /// How often all fingers have gone over the whole object.
    pub fn rounds(&self) -> u64 {
        let rounds = self.shared.rounds.iter();
        rounds.map(|r| r.load(Ordering::Relaxed)).min().unwrap_or(0)
    }

    /// What was true about the contacts of one finger (in the order of [`Self::ports`]) so far; empty unless
    /// [`HandOptions::keep_truth`].
    pub fn truth(&self, finger: usize) -> Vec<TrueContact> {
        self.shared
            .truth
            .get(finger)
            .map_or_else(Vec::new, |truth| {
                truth.lock().unwrap_or_else(PoisonError::into_inner).clone()
            })
    }

    /// Whether a board's thread has ended by itself, which it only does when its terminal fails.
    pub fn has_failed(&self) -> bool {
        self.threads.iter().any(JoinHandle::is_finished)
    }

    /// Stops the boards and takes their terminals away.
    pub fn stop(self) {
        drop(self);
    }
}

impl Drop for SimulatedHand {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A board that panicked has said so already; stopping goes on.
            let _ = thread.join();
        }
    }
}

/// The clock of a board.
#[derive(Clone, Copy, Debug)]
struct BoardClock {
    began: Instant,
    offset_us: f64,
    rate: f64,
}

impl BoardClock {
    fn now_us(&self) -> u64 {
        (self.offset_us + self.began.elapsed().as_secs_f64() * 1e6 * self.rate) as u64
    }
}

/// One board and its end of the cable.
struct Cable {
    bench: FingerBench,
    clock: BoardClock,
    period_us: u64,
    master: TTYPort,
    /// Held open so that the terminal outlives hosts that come and go; never read.
    _slave: TTYPort,
    /// Bytes of a frame that the terminal had no room for.
    unsent: Vec<u8>,
    number: usize,
    shared: Arc<Shared>,
}

impl Cable {
    fn run(mut self) {
        let mut due_us = self.clock.now_us() + self.period_us;
        let mut buffer = [0; 512];
        while !self.shared.stop.load(Ordering::Relaxed) {
            let now_us = self.clock.now_us();
            if now_us > due_us + PATIENCE * self.period_us {
                // Skipped samples: the board sees the gap and counts it.
                due_us += (now_us - due_us) / self.period_us * self.period_us;
            }
            while due_us <= self.clock.now_us() {
                let truth = self.bench.period(due_us);
                due_us += self.period_us;
                if let (Some(truth), true) = (truth, self.shared.keep_truth) {
                    let log = &self.shared.truth[self.number];
                    log.lock()
                        .unwrap_or_else(PoisonError::into_inner)
                        .push(truth);
                }
                self.shared.rounds[self.number].store(self.bench.rounds(), Ordering::Relaxed);
                if !self.send() {
                    return;
                }
            }
            // Until the next period there is time to listen.
            let spare = due_us.saturating_sub(self.clock.now_us());
            let patience = Duration::from_micros(spare.clamp(200, 20_000));
            if self.master.set_timeout(patience).is_err() {
                return;
            }
            match self.master.read(&mut buffer) {
                Ok(count) => {
                    self.bench.receive(&buffer[..count], self.clock.now_us());
                    if !self.send() {
                        return;
                    }
                }
                Err(e)
                    if matches!(
                        e.kind(),
                        ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock
                    ) => {}
                Err(_) => return,
            }
        }
    }

    /// Sends what the terminal takes; the rest waits, and the board's own queues count what they lose
    /// meanwhile. False when the terminal is gone.
    fn send(&mut self) -> bool {
        if self.master.set_timeout(Duration::from_micros(200)).is_err() {
            return false;
        }
        loop {
            if self.unsent.is_empty() {
                match self.bench.take_frame(self.clock.now_us()) {
                    Some(frame) => self.unsent.extend_from_slice(frame),
                    None => return true,
                }
            }
            match self.master.write(&self.unsent) {
                Ok(count) => {
                    self.unsent.drain(..count);
                }
                Err(e)
                    if matches!(
                        e.kind(),
                        ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock
                    ) =>
                {
                    return true;
                }
                Err(_) => return false,
            }
        }
    }
}
