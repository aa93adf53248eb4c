//! The whole board: front ends, sensing, tare, store and link behind four calls.
//!
//! ```text
//! tick(now)            once per period: read, judge, tare, calibrate, solve, encode, queue
//! tick_ended(now)      optional: how long it took
//! receive(bytes, now)  whatever came from the host
//! take_frame(now)      the next frame for the host, or next_byte(now) byte by byte
//! take_event()         what to tell the debug probe, outside of the sampling interrupt
//! ```
//!
//! Every call is bounded, waits for nothing and allocates nothing, with one exception that says so:
//! a `SetCalibration` writes the store, which may take as long as an erase, and is refused while
//! streams are on.
//!
//! # One structure or two: both ways
//!
//! *Two halves* (a sampler and a link) joined by lock-free queues: sampling never waits for the
//! link, not even for a lock. But commands reach across: a tare is asked for in one half, done in
//! the other and answered in the first; statistics gather from both; each crossing is a queue of
//! its own with an order to get wrong, and the simulated board would need both threads. *One
//! structure* that its owner locks: every command is a plain method, the host's simulation is one
//! object in one thread, and the same inputs give the same bytes. The price is that a tick can wait
//! for whoever holds the lock; the longest hold is encoding one frame of 221 bytes, some tens of
//! microseconds at 168 MHz, 1 % of the period. The second was taken.
//!
//! Contacts are encoded when they are made, because 48 bytes are smaller than the contact, and
//! everything else when it is handed out, so that clocks and counters in a reply are those of the
//! moment it leaves.

use crate::commands::{PendingReply, RecentRequests};
use crate::cut_off::CutOff;
use crate::event::Event;
use crate::front_end::{GaugeFrontEnd, JointFrontEnd};
use crate::queue::DropOldest;
use crate::sampling::{Sampling, SamplingCounters};
use crate::sensing::contact::Tip;
use crate::sensing::uncertainty::WrenchNoise;
use crate::sensing::validity::ContactLimits;
use crate::sensing::wrench::GaugeMatrix;
use crate::store::{self, CalibrationStore};
use core::fmt::Write;
use heapless::{String, Vec};
use palpus_protocol::{
    BoardMessage, CONTACT_FRAME_BYTES, Calibration, Contact, Decoder, GAUGES_PER_PAGE,
    GaugeStatistics, Identity, Log, MAX_FRAME_BYTES, MAX_GAUGES, Outcome, RawGauges, Reply,
    SCHEMA_HASH, Statistics, StorePlace, Streams, TimeSyncAnswer, TipGeometry,
};

/// Contacts that can wait for the host: a third of a second at 200 Hz.
pub const CONTACT_QUEUE: usize = 64;
/// Raw frames that can wait.
pub const RAW_QUEUE: usize = 8;
/// Log lines that can wait.
pub const LOG_QUEUE: usize = 8;
/// Replies that can wait.
pub const REPLY_QUEUE: usize = 8;

/// What makes this board this one.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardConfig {
    /// Unique number of the board.
    pub board_id: [u8; 12],
    /// Number of the finger, from 0.
    pub finger_number: u8,
    /// Name of the finger.
    pub finger_name: String<16>,
    /// Sampling period, us.
    pub period_us: u32,
    /// Shape and place of the tip.
    pub tip: TipGeometry,
    /// What counts as a contact.
    pub limits: ContactLimits,
    /// Noise of the wrench that is assumed at least, whatever the gauges show while taring: it
    /// stands for drift since the tare as well.
    pub noise_floor: WrenchNoise,
    /// A gauge whose count stays the same for this many periods is stuck; 0 never. A 24-bit bridge
    /// converter with its noise does not repeat a count twice; a simulated gauge without noise
    /// does, and needs 0.
    pub stuck_after: u16,
}

impl BoardConfig {
    /// A board of the standard kind: 5 ms, standard limits, typical noise, stuck after 20 equal
    /// counts. Names are cut at 16 bytes.
    pub fn new(board_id: [u8; 12], finger_number: u8, finger_name: &str, tip: TipGeometry) -> Self {
        let mut name = String::new();
        for character in finger_name.chars() {
            if name.push(character).is_err() {
                break;
            }
        }
        Self {
            board_id,
            finger_number,
            finger_name: name,
            period_us: 5000,
            tip,
            limits: ContactLimits::STANDARD,
            noise_floor: WrenchNoise::TYPICAL,
            stuck_after: 20,
        }
    }
}

/// Why a board can't be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BoardError {
    /// The tip's semi-axes must be 0.01 to 10 000 mm, its centre within 10 000 mm.
    Tip,
    /// The period must be 100 us to 1 s.
    Period,
    /// The front end must have 1 to 8 gauges.
    Gauges,
}

impl core::fmt::Display for BoardError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Tip => {
                "tip geometry: semi-axes must be 0.01 to 10000 mm and the centre within 10000 mm"
            }
            Self::Period => "sampling period must be 100 us to 1 s",
            Self::Gauges => "the gauge front end must have 1 to 8 gauges",
        })
    }
}

impl core::error::Error for BoardError {}

/// A contact's frame, ready for the line.
pub(crate) type ContactFrame = [u8; CONTACT_FRAME_BYTES];

/// A fingertip board.
pub struct Board<G, J, S> {
    pub(crate) config: BoardConfig,
    pub(crate) tip: Tip,
    pub(crate) gauges: G,
    pub(crate) joints: J,
    pub(crate) store: S,
    pub(crate) calibration: Option<Calibration>,
    pub(crate) calibration_place: StorePlace,
    pub(crate) matrix: Option<GaugeMatrix>,
    pub(crate) sampling: Sampling,
    pub(crate) counters: SamplingCounters,
    pub(crate) streams: Streams,
    pub(crate) decoder: Decoder,
    pub(crate) recent: RecentRequests,
    pub(crate) frames_refused: u32,
    pub(crate) requests_repeated: u32,
    pub(crate) store_failures: u32,
    pub(crate) contacts: DropOldest<ContactFrame, CONTACT_QUEUE>,
    pub(crate) raw: DropOldest<RawGauges, RAW_QUEUE>,
    pub(crate) replies: DropOldest<PendingReply, REPLY_QUEUE>,
    logs: DropOldest<(u64, Event), LOG_QUEUE>,
    events: DropOldest<Event, LOG_QUEUE>,
    transmit: [u8; MAX_FRAME_BYTES],
    transmit_length: usize,
    transmit_next: usize,
    replied_last: bool,
}

impl<G: GaugeFrontEnd, J: JointFrontEnd, S: CalibrationStore> Board<G, J, S> {
    /// Starts a board: loads the calibration from the store and has its identity waiting for the
    /// host.
    pub fn new(
        config: BoardConfig,
        gauges: G,
        joints: J,
        mut store: S,
        now_us: u64,
    ) -> Result<Self, BoardError> {
        let tip = Tip::new(&config.tip).ok_or(BoardError::Tip)?;
        if !(100..=1_000_000).contains(&config.period_us) {
            return Err(BoardError::Period);
        }
        let count = gauges.gauges();
        if count == 0 || count > MAX_GAUGES {
            return Err(BoardError::Gauges);
        }
        let calibration = store::load(&mut store);
        let sampling = Sampling::new(count, config.period_us, config.noise_floor);
        let place = if store.is_permanent() {
            StorePlace::Permanent
        } else {
            StorePlace::RamOnly
        };
        let mut board = Self {
            tip,
            gauges,
            joints,
            store,
            calibration: None,
            calibration_place: place,
            matrix: None,
            sampling,
            counters: SamplingCounters::default(),
            streams: Streams::default(),
            decoder: Decoder::new(),
            recent: RecentRequests::new(),
            frames_refused: 0,
            requests_repeated: 0,
            store_failures: 0,
            contacts: DropOldest::new(),
            raw: DropOldest::new(),
            replies: DropOldest::new(),
            logs: DropOldest::new(),
            events: DropOldest::new(),
            transmit: [0; MAX_FRAME_BYTES],
            transmit_length: 0,
            transmit_next: 0,
            replied_last: false,
            config,
        };
        if let Some(calibration) = calibration {
            // One for another number of gauges stays in the store and out of use.
            if let Ok(matrix) = GaugeMatrix::new(&calibration, count) {
                board.use_calibration(calibration, matrix);
            }
        }
        board.replies.push(PendingReply::Identity { request_id: 0 });
        board.note(
            Event::Started {
                calibration_id: board.calibration_id(),
            },
            now_us,
        );
        Ok(board)
    }

    /// Makes a calibration the one in use.
    pub(crate) fn use_calibration(&mut self, calibration: Calibration, matrix: GaugeMatrix) {
        self.sampling.calibrated(&matrix);
        self.matrix = Some(matrix);
        self.calibration = Some(calibration);
    }

    /// The configuration the board was made with.
    pub const fn config(&self) -> &BoardConfig {
        &self.config
    }

    /// The gauge front end, for whoever feeds it.
    pub const fn gauges_mut(&mut self) -> &mut G {
        &mut self.gauges
    }

    /// The joint front end, for whoever feeds it.
    pub const fn joints_mut(&mut self) -> &mut J {
        &mut self.joints
    }

    /// The calibration store.
    pub const fn store_mut(&mut self) -> &mut S {
        &mut self.store
    }

    /// Id of the calibration in use; 0 is none.
    pub fn calibration_id(&self) -> u32 {
        self.calibration
            .as_ref()
            .map_or(0, |calibration| calibration.id)
    }

    /// What is being streamed.
    pub const fn streams(&self) -> Streams {
        self.streams
    }

    /// The contact of the last tick, sent or not; `None` before the first.
    pub const fn last_contact(&self) -> Option<&Contact> {
        self.sampling.last_contact()
    }

    /// Notes an event for the host's log and the probe's.
    pub fn note(&mut self, event: Event, now_us: u64) {
        self.logs.push((now_us, event));
        self.events.push(event);
    }

    /// The next event for the debug probe. Call it outside of the sampling interrupt.
    pub fn take_event(&mut self) -> Option<Event> {
        self.events.pop()
    }

    /// Who the board is.
    pub fn identity(&self, request_id: u32, now_us: u64) -> Identity {
        let mut firmware_version = String::new();
        // Versions are shorter than 16 bytes; a longer one would be left out rather than cut.
        let _ = firmware_version.push_str(env!("CARGO_PKG_VERSION"));
        Identity {
            request_id,
            board_id: self.config.board_id,
            finger_number: self.config.finger_number,
            finger_name: self.config.finger_name.clone(),
            firmware_version,
            schema_hash: SCHEMA_HASH,
            period_us: self.config.period_us,
            gauges: self.gauges.gauges() as u8,
            tip: self.config.tip,
            calibration_id: self.calibration_id(),
            board_time_us: now_us,
        }
    }

    /// What the board has counted.
    pub fn statistics(&self, request_id: u32, now_us: u64) -> Statistics {
        let link = self.decoder.counters();
        let sampled = &self.counters;
        Statistics {
            request_id,
            board_time_us: now_us,
            gauges: self.gauges.gauges() as u8,
            ticks: sampled.ticks,
            rate_millihertz: sampled.rate_millihertz,
            jitter_rms_us: sampled.jitter_rms_us,
            jitter_max_us: sampled.jitter_max_us,
            tick_max_us: sampled.tick_max_us,
            overruns: sampled.overruns,
            late_ticks: sampled.late_ticks,
            contacts: sampled.contacts,
            contacts_valid: sampled.contacts_valid,
            contacts_dropped: self.contacts.dropped(),
            raw_dropped: self.raw.dropped(),
            logs_dropped: self.logs.dropped(),
            replies_dropped: self.replies.dropped(),
            contact_queue_high_water: self.contacts.high_water(),
            raw_queue_high_water: self.raw.high_water(),
            log_queue_high_water: self.logs.high_water(),
            reply_queue_high_water: self.replies.high_water(),
            bytes_received: link.bytes,
            frames_received: link.frames,
            frames_bad: link.bad(),
            frames_refused: self.frames_refused,
            requests_repeated: self.requests_repeated,
            chip_resets: self.gauges.chip_resets(),
            joint_errors: sampled.joint_errors,
            store_failures: self.store_failures,
        }
    }

    /// A page of the gauges' counters, from gauge `first` on.
    pub fn gauge_statistics(&self, request_id: u32, first: u8) -> GaugeStatistics {
        let gauges: Vec<_, GAUGES_PER_PAGE> = (usize::from(first)
            ..self.gauges.gauges().min(MAX_GAUGES))
            .take(GAUGES_PER_PAGE)
            .map(|gauge| self.sampling.gauge_counts(gauge, &self.counters))
            .collect();
        GaugeStatistics {
            request_id,
            first,
            gauges,
        }
    }

    /// The next frame for the host, whole; valid until the next call.
    ///
    /// Replies go first, but never two in a row while contacts wait; then contacts, raw frames, log
    /// lines. Don't mix with [`next_byte`](Self::next_byte) in mid-frame.
    pub fn take_frame(&mut self, now_us: u64) -> Option<&[u8]> {
        self.transmit_length = self.fill_transmit(now_us)?;
        self.transmit_next = self.transmit_length;
        self.transmit.get(..self.transmit_length)
    }

    /// The next byte for the host.
    pub fn next_byte(&mut self, now_us: u64) -> Option<u8> {
        if self.transmit_next >= self.transmit_length {
            self.transmit_length = self.fill_transmit(now_us)?;
            self.transmit_next = 0;
        }
        let byte = self.transmit.get(self.transmit_next).copied();
        self.transmit_next += 1;
        byte
    }

    /// Writes the next frame into the transmit buffer and returns its length.
    fn fill_transmit(&mut self, now_us: u64) -> Option<usize> {
        let reply_may_go = !self.replied_last || self.contacts.is_empty();
        let message = if let Some(reply) = if reply_may_go {
            self.replies.pop()
        } else {
            None
        } {
            self.replied_last = true;
            self.message_of(reply, now_us)
        } else if let Some(frame) = self.contacts.pop() {
            self.replied_last = false;
            self.transmit[..CONTACT_FRAME_BYTES].copy_from_slice(&frame);
            return Some(CONTACT_FRAME_BYTES);
        } else if let Some(raw) = self.raw.pop() {
            BoardMessage::RawGauges(raw)
        } else {
            let (board_time_us, event) = self.logs.pop()?;
            let mut text = String::new();
            // A line that is too long ends where the room does.
            let _ = write!(CutOff(&mut text), "{event}");
            BoardMessage::Log(Log {
                board_time_us,
                level: event.level(),
                text,
            })
        };
        // The buffer holds the largest frame there is.
        message.encode(&mut self.transmit).ok()
    }

    fn message_of(&self, reply: PendingReply, now_us: u64) -> BoardMessage {
        let (request_id, outcome) = match reply {
            PendingReply::Identity { request_id } => {
                return self.identity(request_id, now_us).into();
            }
            PendingReply::Statistics { request_id } => {
                return self.statistics(request_id, now_us).into();
            }
            PendingReply::GaugeStatistics { request_id, first } => {
                return self.gauge_statistics(request_id, first).into();
            }
            PendingReply::Time {
                request_id,
                host_send_us,
                board_receive_us,
            } => {
                let answer = TimeSyncAnswer {
                    host_send_us,
                    board_receive_us,
                    board_send_us: now_us,
                };
                (request_id, Outcome::Time(answer))
            }
            PendingReply::Calibration { request_id } => match &self.calibration {
                Some(calibration) => (request_id, Outcome::Calibration(calibration.clone())),
                None => (
                    request_id,
                    Outcome::Refused(palpus_protocol::Refusal::NoCalibration),
                ),
            },
            PendingReply::Outcome {
                request_id,
                outcome,
            } => (request_id, outcome),
        };
        Reply {
            request_id,
            outcome,
        }
        .into()
    }

    /// Whether anything waits to be sent.
    pub fn has_output(&self) -> bool {
        self.transmit_next < self.transmit_length
            || !(self.replies.is_empty()
                && self.contacts.is_empty()
                && self.raw.is_empty()
                && self.logs.is_empty())
    }
}
