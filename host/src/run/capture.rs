//! Records a run: one thread per finger, one that writes.
//!
//! ```text
//! session (thread per finger) --+
//! session ----------------------+--> queue --> writer --> file
//! session ----------------------+
//! ```
//!
//! Promises: a finger that fails stops no other; a slow disk stops no finger, since sessions only ever offer to a
//! queue ([`QUEUE_EVENTS`], more than five minutes of a finger at 200 Hz) and what it has no room for is counted;
//! memory is bounded by that queue. Whatever ends the capture (time, number of points, `stop`, a full disk), all
//! that had been received is written, as far as the disk takes it, and the file is closed.

use super::RunError;
use super::schema::{Level, LinkState};
use super::writer::{LogFile, RunStart, RunWriter, WorldContact};
use crate::Vec3;
use crate::hand::{Finger, Hand, WorldContact as WorldPlace};
use crate::link::LinkError;
use crate::link::host_clock::HostClock;
use crate::link::port::DEFAULT_BAUD;
use crate::link::session::{LinkEvent, LinkStatus, Session, SessionSettings, Weight};
use palpus_protocol::{Contact, Identity, Streams};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Events the queue to the writer holds for each finger.
pub const QUEUE_EVENTS: usize = 1 << 16;
/// Contacts of so many nanoseconds make one cloud for viewers.
const CLOUD_NS: u64 = 100_000_000;
/// How often the progress is told and the ends are checked.
const PROGRESS_EVERY: Duration = Duration::from_millis(100);
/// Touches that wait for the next progress at most; with more, whoever watches misses some. The run misses none.
const WAITING_TOUCHES: usize = 1 << 14;
/// A wall clock that moved by more than this is worth a note, microseconds.
const WALL_JUMP_US: i64 = 100_000;

/// What to record.
#[derive(Clone, Debug)]
pub struct CaptureSettings {
    /// Each finger's name, as in the hand file, and the device of its board.
    pub fingers: Vec<(String, String)>,
    /// The hand, as [`Hand::sources`] reads it.
    pub hand: Vec<(String, String)>,
    /// The run to write.
    pub output: PathBuf,
    /// Whether an existing file may be replaced.
    pub replace: bool,
    /// Baud rate of all ports.
    pub baud: u32,
    /// What the boards shall stream.
    pub streams: Streams,
    /// Tare each board before it starts, over so many periods; the tips must be free.
    pub tare: Option<u16>,
    /// End after this time.
    pub duration: Option<Duration>,
    /// End after so many valid contacts of all fingers together.
    pub points: Option<u64>,
    /// Anything to keep in the run's metadata.
    pub notes: BTreeMap<String, String>,
    /// The clock of all times of the run.
    pub clock: HostClock,
}

impl CaptureSettings {
    /// Every contact of `fingers` into the new file `output` until stopped: no raw frames, no tare, no limits.
    pub fn every_contact(
        fingers: Vec<(String, String)>,
        hand: Vec<(String, String)>,
        output: PathBuf,
    ) -> Self {
        Self {
            fingers,
            hand,
            output,
            replace: false,
            baud: DEFAULT_BAUD,
            streams: Streams {
                contact_every: 1,
                raw_every: 0,
            },
            tare: None,
            duration: None,
            points: None,
            notes: BTreeMap::new(),
            clock: HostClock::start(),
        }
    }
}

/// What a capture tells while it runs.
#[derive(Debug)]
pub enum CaptureEvent<'a> {
    /// A board was found at the start.
    Found {
        /// Its finger.
        finger: &'a str,
        /// Where.
        port: &'a str,
        /// What it says of itself.
        identity: &'a Identity,
    },
    /// Something happened.
    Note {
        /// The finger, or `host`.
        finger: &'a str,
        /// How grave it is.
        weight: Weight,
        /// What.
        text: &'a str,
    },
    /// What the fingers felt since the last progress, for whoever watches; just before each progress.
    Touches(&'a [Touch]),
    /// Ten times a second.
    Progress(&'a CaptureProgress),
}

/// A contact as it came, valid or not, placed in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Place of the finger among the capture's.
    pub finger: usize,
    /// When it was sampled, microseconds since the Unix epoch by the host's clock.
    pub sampled_us: i64,
    /// As the board sent it.
    pub contact: Contact,
    /// Where that is by the joint angles it came with.
    pub world: WorldPlace,
}

/// How far a capture is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CaptureProgress {
    /// Since the first board was started.
    pub elapsed: Duration,
    /// Name and state of each finger's link.
    pub fingers: Vec<(String, LinkStatus)>,
    /// Valid contacts written.
    pub points: u64,
    /// Bytes the file has, safe from the end of the process.
    pub safe_bytes: u64,
}

/// Why a capture ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The time was up.
    Duration,
    /// There were enough points.
    Points,
    /// It was told to stop.
    Stopped,
}

/// What a capture recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureSummary {
    /// Why it ended.
    pub end: End,
    /// The last progress; its `safe_bytes` is the size of the file.
    pub progress: CaptureProgress,
}

/// Why nothing, or not all, could be recorded.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The run can't be written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A board can't be reached at the start.
    #[error("finger `{finger}`: {source}")]
    Link {
        /// The finger.
        finger: String,
        /// Why.
        source: LinkError,
    },
    /// The hand can't be used.
    #[error(transparent)]
    Hand(#[from] crate::hand::HandError),
    /// The hand has no such finger.
    #[error("the hand has no finger `{finger}`; it has: {known}")]
    UnknownFinger {
        /// The name given.
        finger: String,
        /// The names in the hand file.
        known: String,
    },
    /// A finger or a port was given twice.
    #[error("{what} `{name}` is given twice; give each finger one port of its own")]
    Twice {
        /// "finger" or "port".
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// The name can't be that of a channel.
    #[error(
        "finger name `{finger}` is empty or has a slash or a line break in it; rename it in the hand file"
    )]
    FingerName {
        /// The name.
        finger: String,
    },
    /// No finger was given.
    #[error("no finger to record; give at least one --finger NAME=PORT")]
    NoFinger,
    /// The boards are on each other's ports.
    #[error(
        "{port} was given for finger `{finger}`, but its board says it is finger `{says}`; swap the ports"
    )]
    Swapped {
        /// The port.
        port: String,
        /// The finger it was given for.
        finger: String,
        /// What the board says.
        says: String,
    },
}

/// An event of one finger on its way to the writer.
struct Queued {
    finger: usize,
    event: LinkEvent,
}

/// Records until time, points, `stop` or the disk end it.
///
/// # Errors
/// [`CaptureError`]; when writing fails under way, [`RunError::Write`] after the fingers have been stopped.
pub fn capture(
    settings: &CaptureSettings,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(CaptureEvent<'_>),
) -> Result<CaptureSummary, CaptureError> {
    let hand = Hand::from_sources(&settings.hand)?;
    let fingers = check_fingers(settings, &hand)?;
    if !settings.replace && settings.output.exists() {
        return Err(RunError::Exists {
            path: settings.output.clone(),
        }
        .into());
    }
    let clock = settings.clock;
    let (touched, touches) = sync_channel(WAITING_TOUCHES);
    let sessions = connect(settings)?;
    check_names(settings, &sessions)?;
    for ((finger, port), session) in settings.fingers.iter().zip(&sessions) {
        tell(CaptureEvent::Found {
            finger,
            port,
            identity: session.identity(),
        });
    }
    let start = RunStart {
        started_ns: nanoseconds(clock.now_us()),
        hand: settings.hand.clone(),
        fingers: settings
            .fingers
            .iter()
            .map(|(name, _)| name.clone())
            .collect(),
        notes: notes(settings),
    };
    let writer = RunWriter::create(&settings.output, settings.replace, &start)?;
    record(
        settings,
        stop,
        tell,
        sessions,
        Recorder::new(writer, fingers, settings, touched),
        &touches,
    )
}

fn record(
    settings: &CaptureSettings,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(CaptureEvent<'_>),
    sessions: Vec<Session>,
    recorder: Recorder<'_>,
    touches: &Receiver<Touch>,
) -> Result<CaptureSummary, CaptureError> {
    let (clock, count) = (settings.clock, sessions.len());
    let (queue, queued) = sync_channel::<Queued>(QUEUE_EVENTS * count);
    let (notes, noted) = sync_channel::<(usize, Weight, String)>(1_024);
    let statuses: Vec<Mutex<LinkStatus>> = sessions
        .iter()
        .map(|session| Mutex::new(session.status().clone()))
        .collect();
    let shared = Shared::default();
    let began = Instant::now();
    let mut end = End::Stopped;

    let written = std::thread::scope(|scope| {
        let shared = &shared;
        let writer = scope.spawn(move || recorder.run(&queued, shared));
        let mut threads = Vec::new();
        for (finger, (session, status)) in sessions.into_iter().zip(&statuses).enumerate() {
            let (queue, notes) = (queue.clone(), notes.clone());
            let thread = scope.spawn(move || {
                let mut sink = |event| offer(&queue, &notes, finger, event);
                session.run(&shared.stop, &mut sink, &mut |now| {
                    lock(status).clone_from(now);
                });
            });
            threads.push(thread);
        }
        let queue_for_notes = queue;
        drop(notes);

        let mut wall_jump_us = clock.wall_jump_us();
        let mut felt = Vec::new();
        loop {
            for (finger, weight, text) in noted.try_iter() {
                tell(CaptureEvent::Note {
                    finger: &settings.fingers[finger].0,
                    weight,
                    text: &text,
                });
            }
            let jump_us = clock.wall_jump_us();
            if (jump_us - wall_jump_us).abs() > WALL_JUMP_US {
                let text = format!(
                    "this computer's clock was set by {:.3} s; the run keeps the old one",
                    (jump_us - wall_jump_us) as f64 * 1e-6
                );
                wall_jump_us = jump_us;
                tell(CaptureEvent::Note {
                    finger: "host",
                    weight: Weight::Warning,
                    text: &text,
                });
                let event = LinkEvent::Note {
                    weight: Weight::Warning,
                    text,
                };
                // A full queue has other worries.
                let _ = queue_for_notes.try_send(Queued {
                    finger: count,
                    event,
                });
            }
            felt.clear();
            felt.extend(touches.try_iter());
            if !felt.is_empty() {
                tell(CaptureEvent::Touches(&felt));
            }
            tell(CaptureEvent::Progress(&progress(
                settings, &statuses, shared, began,
            )));
            let ended = if stop.load(Ordering::Relaxed) {
                Some(End::Stopped)
            } else if settings.duration.is_some_and(|d| began.elapsed() >= d) {
                Some(End::Duration)
            } else if settings
                .points
                .is_some_and(|p| shared.points.load(Ordering::Relaxed) >= p)
            {
                Some(End::Points)
            } else {
                None
            };
            if let Some(ended) = ended {
                end = ended;
                break;
            }
            if shared.failed.load(Ordering::Relaxed) {
                break;
            }
            std::thread::sleep(PROGRESS_EVERY);
        }
        shared.stop.store(true, Ordering::Relaxed);
        drop(queue_for_notes);
        for (finger, thread) in threads.into_iter().enumerate() {
            if thread.join().is_err() {
                // A session does not panic; were one to, the others' data are still written.
                lock(&statuses[finger]).connected = false;
            }
        }
        writer.join()
    });
    // The writer does not panic; were it to, its file is as good as a cut-off one.
    let written = written.unwrap_or_else(|_| {
        Err(RunError::Write {
            path: settings.output.clone(),
            source: std::io::Error::other("the writing thread ended early"),
            flushed_bytes: shared.safe_bytes.load(Ordering::Relaxed),
        })
    });
    for (finger, weight, text) in noted.try_iter() {
        tell(CaptureEvent::Note {
            finger: &settings.fingers[finger].0,
            weight,
            text: &text,
        });
    }
    let mut progress = progress(settings, &statuses, &shared, began);
    progress.safe_bytes = written?;
    Ok(CaptureSummary { end, progress })
}

/// What the threads tell each other.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    failed: AtomicBool,
    points: AtomicU64,
    safe_bytes: AtomicU64,
}

fn lock(status: &Mutex<LinkStatus>) -> MutexGuard<'_, LinkStatus> {
    status.lock().unwrap_or_else(PoisonError::into_inner)
}

fn progress(
    settings: &CaptureSettings,
    statuses: &[Mutex<LinkStatus>],
    shared: &Shared,
    began: Instant,
) -> CaptureProgress {
    CaptureProgress {
        elapsed: began.elapsed(),
        fingers: settings
            .fingers
            .iter()
            .zip(statuses)
            .map(|((name, _), status)| (name.clone(), lock(status).clone()))
            .collect(),
        points: shared.points.load(Ordering::Relaxed),
        safe_bytes: shared.safe_bytes.load(Ordering::Relaxed),
    }
}

fn offer(
    queue: &SyncSender<Queued>,
    notes: &SyncSender<(usize, Weight, String)>,
    finger: usize,
    event: LinkEvent,
) -> bool {
    if let LinkEvent::Note { weight, text } = &event {
        // The person at the terminal may miss one of a thousand notes; the run keeps all.
        let _ = notes.try_send((finger, *weight, text.clone()));
    }
    queue.try_send(Queued { finger, event }).is_ok()
}

fn check_fingers(settings: &CaptureSettings, hand: &Hand) -> Result<Vec<Finger>, CaptureError> {
    if settings.fingers.is_empty() {
        return Err(CaptureError::NoFinger);
    }
    let mut fingers = Vec::new();
    for (k, (name, port)) in settings.fingers.iter().enumerate() {
        if name.is_empty() || name.contains(['/', '\n']) {
            return Err(CaptureError::FingerName {
                finger: name.clone(),
            });
        }
        for (other_name, other_port) in &settings.fingers[..k] {
            for (what, a, b) in [("finger", name, other_name), ("port", port, other_port)] {
                if a == b {
                    return Err(CaptureError::Twice {
                        what,
                        name: a.clone(),
                    });
                }
            }
        }
        let (_, finger) = hand.finger(name).ok_or_else(|| {
            let known: Vec<&str> = hand.fingers().iter().map(|f| f.name.as_str()).collect();
            CaptureError::UnknownFinger {
                finger: name.clone(),
                known: known.join(", "),
            }
        })?;
        fingers.push(finger.clone());
    }
    Ok(fingers)
}

fn connect(settings: &CaptureSettings) -> Result<Vec<Session>, CaptureError> {
    let mut sessions = Vec::new();
    for (finger, port) in &settings.fingers {
        let session = Session::connect(
            SessionSettings {
                finger: finger.clone(),
                port: port.clone(),
                baud: settings.baud,
                streams: settings.streams,
            },
            settings.clock,
        );
        let tared = session.and_then(|mut session| {
            if let Some(samples) = settings.tare {
                session.tare(samples)?;
            }
            Ok(session)
        });
        sessions.push(tared.map_err(|source| CaptureError::Link {
            finger: finger.clone(),
            source,
        })?);
    }
    Ok(sessions)
}

/// Refuses ports whose boards name each other's fingers; a board with a name of its own is the user's business.
fn check_names(settings: &CaptureSettings, sessions: &[Session]) -> Result<(), CaptureError> {
    for ((finger, port), session) in settings.fingers.iter().zip(sessions) {
        let says = session.identity().finger_name.as_str();
        let is_another = settings
            .fingers
            .iter()
            .any(|(name, _)| name == says && name != finger);
        if is_another {
            return Err(CaptureError::Swapped {
                port: port.clone(),
                finger: finger.clone(),
                says: says.into(),
            });
        }
    }
    Ok(())
}

/// A cloud being gathered for viewers.
#[derive(Default)]
struct Gathered {
    since_ns: u64,
    contacts: Vec<WorldContact>,
}

/// The writing thread's side.
struct Recorder<'a> {
    writer: RunWriter<LogFile>,
    fingers: Vec<Finger>,
    clouds: Vec<Gathered>,
    settings: &'a CaptureSettings,
    touched: SyncSender<Touch>,
}

impl<'a> Recorder<'a> {
    fn new(
        writer: RunWriter<LogFile>,
        fingers: Vec<Finger>,
        settings: &'a CaptureSettings,
        touched: SyncSender<Touch>,
    ) -> Self {
        Self {
            touched,
            writer,
            clouds: fingers.iter().map(|_| Gathered::default()).collect(),
            fingers,
            settings,
        }
    }

    /// Writes what is queued until all fingers have ended; returns the size of the file.
    fn run(mut self, queued: &Receiver<Queued>, shared: &Shared) -> Result<u64, RunError> {
        let result = loop {
            let done = match queued.recv_timeout(Duration::from_millis(50)) {
                Ok(Queued { finger, event }) => self.write(finger, event, shared),
                Err(RecvTimeoutError::Timeout) => Ok(()),
                Err(RecvTimeoutError::Disconnected) => break Ok(()),
            };
            if let Err(error) = done.and_then(|()| self.writer.flush_if_due()) {
                break Err(error);
            }
            shared
                .safe_bytes
                .store(self.writer.safe_bytes(), Ordering::Relaxed);
        };
        if let Err(error) = result {
            shared.failed.store(true, Ordering::Relaxed);
            // The fingers are told by the main thread; until they have ended what they offer is let go.
            while queued.recv().is_ok() {}
            return Err(error);
        }
        for finger in 0..self.clouds.len() {
            self.write_cloud(finger)?;
        }
        self.writer.finish()
    }

    fn write(&mut self, finger: usize, event: LinkEvent, shared: &Shared) -> Result<(), RunError> {
        match event {
            LinkEvent::Frame {
                received_us,
                sampled_us,
                wire,
                contact,
            } => {
                let sampled_ns = nanoseconds(sampled_us);
                self.writer
                    .frame(finger, nanoseconds(received_us), sampled_ns, &wire)?;
                let (Some(contact), Some(geometry)) = (contact, self.fingers.get(finger)) else {
                    return Ok(());
                };
                let world = world_contact(geometry, &contact);
                // Whoever watches may miss some; the run has them all.
                let _ = self.touched.try_send(Touch {
                    finger,
                    sampled_us,
                    contact,
                    world,
                });
                if !contact.is_valid() {
                    return Ok(());
                }
                shared.points.fetch_add(1, Ordering::Relaxed);
                self.gather(finger, sampled_ns, &contact, &world)
            }
            LinkEvent::RoundTrip(trip) => self.writer.round_trip(finger, trip),
            LinkEvent::Status(status) => {
                let now_ns = nanoseconds(self.settings.clock.now_us());
                self.writer.link_state(finger, now_ns, &link_state(&status))
            }
            LinkEvent::Connected { port, identity } => {
                let name = self.name(finger).to_owned();
                self.writer.identity(describe(&name, &port, &identity))
            }
            LinkEvent::Note { weight, text } => {
                let level = match weight {
                    Weight::Info => Level::Info,
                    Weight::Warning => Level::Warning,
                    Weight::Error => Level::Error,
                };
                let name = self.name(finger).to_owned();
                self.writer.event(
                    nanoseconds(self.settings.clock.now_us()),
                    level,
                    &name,
                    &text,
                )
            }
        }
    }

    fn name(&self, finger: usize) -> &str {
        self.settings
            .fingers
            .get(finger)
            .map_or("host", |(name, _)| name)
    }

    fn gather(
        &mut self,
        finger: usize,
        sampled_ns: u64,
        contact: &Contact,
        world: &WorldPlace,
    ) -> Result<(), RunError> {
        let Some(cloud) = self.clouds.get_mut(finger) else {
            return Ok(());
        };
        if cloud.contacts.is_empty() {
            cloud.since_ns = sampled_ns;
        }
        cloud.contacts.push(WorldContact {
            position_m: [0, 1, 2].map(|k| (world.position_mm[k] * 1e-3) as f32),
            normal: [0, 1, 2].map(|k| world.normal[k] as f32),
            sigma_m: contact.sigma_mm * 1e-3,
            force_n: contact.normal_force_n,
        });
        if sampled_ns.saturating_sub(cloud.since_ns) >= CLOUD_NS {
            return self.write_cloud(finger);
        }
        Ok(())
    }

    fn write_cloud(&mut self, finger: usize) -> Result<(), RunError> {
        let cloud = std::mem::take(&mut self.clouds[finger]);
        if cloud.contacts.is_empty() {
            return Ok(());
        }
        self.writer.points(finger, cloud.since_ns, &cloud.contacts)
    }
}

/// A contact in the world by the joint angles in its own frame.
pub(super) fn world_contact(finger: &Finger, contact: &Contact) -> WorldPlace {
    let wide = |v: [f32; 3]| v.map(f64::from);
    finger.world_contact(
        &wide(contact.joint_angles_rad),
        &Vec3::from(wide(contact.point_mm)),
        &Vec3::from(wide(contact.normal)),
    )
}

fn nanoseconds(us: i64) -> u64 {
    u64::try_from(us).unwrap_or(0).saturating_mul(1_000)
}

fn link_state(status: &LinkStatus) -> LinkState {
    LinkState {
        port: status.port.clone(),
        connected: status.connected,
        contacts: status.contacts,
        lost: status.lost,
        bad: status.bad + status.unreadable,
        duplicates: status.duplicates,
        out_of_order: status.out_of_order,
        valid: status.valid,
        reconnects: status.reconnects,
        reboots: status.reboots,
        dropped_by_host: status.dropped_by_host,
        offset_us: status.offset_us,
        drift_ppm: status.drift * 1e6,
        clock_bound_us: status.clock_bound_us,
    }
}

/// An identity as text, for a run's metadata.
fn describe(finger: &str, port: &str, identity: &Identity) -> BTreeMap<String, String> {
    let list = |values: &[f32]| {
        let texts: Vec<String> = values.iter().map(f32::to_string).collect();
        texts.join(" ")
    };
    let id: String = identity
        .board_id
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect();
    [
        ("finger", finger.to_owned()),
        ("port", port.to_owned()),
        ("board_id", id),
        ("board_finger_number", identity.finger_number.to_string()),
        ("board_finger_name", identity.finger_name.to_string()),
        ("firmware_version", identity.firmware_version.to_string()),
        ("schema_hash", format!("{:08x}", identity.schema_hash)),
        ("period_us", identity.period_us.to_string()),
        ("gauges", identity.gauges.to_string()),
        ("tip_semi_axes_mm", list(&identity.tip.semi_axes_mm)),
        ("tip_centre_offset_mm", list(&identity.tip.centre_offset_mm)),
        ("calibration_id", identity.calibration_id.to_string()),
        ("board_time_us", identity.board_time_us.to_string()),
    ]
    .into_iter()
    .map(|(key, value)| (key.to_owned(), value))
    .collect()
}

/// What else a reader needs to know.
fn notes(settings: &CaptureSettings) -> BTreeMap<String, String> {
    let mut notes = settings.notes.clone();
    let streams = settings.streams;
    notes.insert("contact_every".into(), streams.contact_every.to_string());
    notes.insert("raw_every".into(), streams.raw_every.to_string());
    notes.insert(
        "protocol_version".into(),
        palpus_protocol::PROTOCOL_VERSION.to_string(),
    );
    notes.insert(
        "schema_hash".into(),
        format!("{:08x}", palpus_protocol::SCHEMA_HASH),
    );
    notes
}
