//! What a board says of itself: identity, raw gauges, statistics, log lines.

use crate::wire::{Wire, wire_enum, wire_struct};
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Most gauges one board can have.
pub const MAX_GAUGES: usize = 8;
/// Gauges in one [`GaugeStatistics`] page.
pub const GAUGES_PER_PAGE: usize = 4;

wire_struct! {
    /// Shape and place of the finger tip, in sensor coordinates: an ellipsoid (a sphere when the
    /// semi-axes agree).
    #[derive(Copy)]
    pub struct TipGeometry {
        /// Semi-axes along x, y, z, mm.
        pub semi_axes_mm: [f32; 3],
        /// Tip centre from the sensor's origin, mm.
        pub centre_offset_mm: [f32; 3],
    }
}

wire_struct! {
    /// Who the board is. **Frozen**: every protocol version keeps these fields in this order and
    /// may only append, so that two sides of different versions still know whom they talk to.
    pub struct Identity {
        /// The [`Identify`](crate::Identify) this answers; 0 when the board speaks unasked, as it
        /// does when it starts.
        pub request_id: u32,
        /// Unique number of the board (on the STM32 its 96-bit device id).
        pub board_id: [u8; 12],
        /// Number of the finger, from 0.
        pub finger_number: u8,
        /// Name of the finger.
        pub finger_name: String<16>,
        /// Firmware version, such as `0.1.0`.
        pub firmware_version: String<16>,
        /// Fingerprint of all messages ([`SCHEMA_HASH`](crate::SCHEMA_HASH) of the board's build).
        pub schema_hash: u32,
        /// Sampling period, us.
        pub period_us: u32,
        /// Number of gauges, at most [`MAX_GAUGES`].
        pub gauges: u8,
        /// Shape of the tip.
        pub tip: TipGeometry,
        /// Id of the loaded calibration; 0 is none.
        pub calibration_id: u32,
        /// Board time now, us since start; a smaller value than before means a restart.
        pub board_time_us: u64,
    }
}

/// State of one gauge in one reading, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GaugeFlags(u8);

impl GaugeFlags {
    /// The count is at the end of the converter's range.
    pub const SATURATED: Self = Self(1 << 0);
    /// The bridge is open (burn-out current or an impossible value).
    pub const OPEN: Self = Self(1 << 1);
    /// The count has stopped changing.
    pub const STUCK: Self = Self(1 << 2);
    /// There is no count for this period.
    pub const MISSING: Self = Self(1 << 3);
    /// The count is older than one period.
    pub const LATE: Self = Self(1 << 4);

    /// Every flag with its name, in bit order.
    pub const NAMES: [(Self, &'static str); 5] = [
        (Self::SATURATED, "saturated"),
        (Self::OPEN, "open"),
        (Self::STUCK, "stuck"),
        (Self::MISSING, "missing"),
        (Self::LATE, "late"),
    ];

    /// A good reading.
    pub const fn none() -> Self {
        Self(0)
    }

    /// The flags of a byte.
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits)
    }

    /// The flags as a byte.
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Whether the reading is good.
    pub const fn is_good(self) -> bool {
        self.0 == 0
    }

    /// Whether every flag of `other` is set here.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Sets every flag of `other`.
    pub const fn insert(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// Both sets together.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl Wire for GaugeFlags {
    const MAX_BYTES: usize = 1;
    const SCHEMA: u64 = crate::wire::fnv1a(crate::wire::FNV_BASIS, b"GaugeFlags u8");
}

wire_struct! {
    /// One gauge in one period.
    #[derive(Copy, Eq)]
    pub struct GaugeValue {
        /// The converter's count.
        pub counts: i32,
        /// The count less the tare offset (rounded); the count itself before the first tare.
        pub tared_counts: i32,
        /// What is wrong with it.
        pub flags: GaugeFlags,
    }
}

wire_struct! {
    /// All gauges in one period, before calibration.
    pub struct RawGauges {
        /// Counts the raw frames the board has made since it started, sent or dropped. A contact of
        /// the same sample has the same time.
        pub sequence: u32,
        /// Time of the sample, us since the board started.
        pub board_time_us: u64,
        /// The gauges in the front end's order.
        pub gauges: Vec<GaugeValue, MAX_GAUGES>,
    }
}

wire_struct! {
    /// What the board has counted since it started. Counters wrap at 2^32; high-water marks and
    /// extremes are since start.
    #[derive(Copy, Default)]
    pub struct Statistics {
        /// The request this answers.
        pub request_id: u32,
        /// Board time now, us since start.
        pub board_time_us: u64,
        /// Number of gauges; their own figures follow in [`GaugeStatistics`] pages.
        pub gauges: u8,
        /// Sampling periods run.
        pub ticks: u32,
        /// Measured sampling rate over about the last second, mHz.
        pub rate_millihertz: u32,
        /// Root mean square of the deviation of a period from its nominal length over about the
        /// last second, us.
        pub jitter_rms_us: u32,
        /// Largest such deviation since start, us.
        pub jitter_max_us: u32,
        /// Longest time from the start of a tick to its end, us; 0 when the board does not measure
        /// it.
        pub tick_max_us: u32,
        /// Periods that passed without a sample.
        pub overruns: u32,
        /// Samples taken more than half a period late.
        pub late_ticks: u32,
        /// Contacts made.
        pub contacts: u32,
        /// Contacts made that were valid.
        pub contacts_valid: u32,
        /// Contacts dropped because the host read too slowly (the oldest goes first).
        pub contacts_dropped: u32,
        /// Raw frames dropped likewise.
        pub raw_dropped: u32,
        /// Log lines dropped likewise.
        pub logs_dropped: u32,
        /// Replies dropped because the host asked faster than it read.
        pub replies_dropped: u32,
        /// Most contacts ever waiting.
        pub contact_queue_high_water: u16,
        /// Most raw frames ever waiting.
        pub raw_queue_high_water: u16,
        /// Most log lines ever waiting.
        pub log_queue_high_water: u16,
        /// Most replies ever waiting.
        pub reply_queue_high_water: u16,
        /// Bytes received.
        pub bytes_received: u32,
        /// Frames received whole and checked.
        pub frames_received: u32,
        /// Frames received with a bad check sum, bad stuffing or a bad length.
        pub frames_bad: u32,
        /// Whole frames that could not be acted on: unknown kind, other version or schema,
        /// unreadable body.
        pub frames_refused: u32,
        /// Requests that repeated an id already answered.
        pub requests_repeated: u32,
        /// Converter chips found reset and set up again.
        pub chip_resets: u32,
        /// Periods in which a joint angle was missing or failed its check bits.
        pub joint_errors: u32,
        /// Writes to the calibration store that failed.
        pub store_failures: u32,
    }
}

wire_struct! {
    /// What the board has counted for one gauge since it started.
    #[derive(Copy, Default)]
    pub struct GaugeCounts {
        /// Good readings.
        pub good: u32,
        /// Saturated readings.
        pub saturated: u32,
        /// Open readings.
        pub open: u32,
        /// Stuck readings.
        pub stuck: u32,
        /// Missing readings.
        pub missing: u32,
        /// Late readings.
        pub late: u32,
        /// Tare offset now, counts.
        pub tare_counts: i32,
        /// How far the offset has drifted since the last commanded tare, counts.
        pub drift_counts: i32,
    }
}

wire_struct! {
    /// Statistics of up to four gauges; as many pages follow a [`Statistics`] as its gauge count
    /// needs.
    pub struct GaugeStatistics {
        /// The request this answers.
        pub request_id: u32,
        /// Number of the first gauge of this page.
        pub first: u8,
        /// The gauges.
        pub gauges: Vec<GaugeCounts, GAUGES_PER_PAGE>,
    }
}

wire_enum! {
    /// Weight of a log line.
    #[derive(Copy, Eq)]
    pub enum LogLevel {
        /// Worth knowing.
        Info,
        /// Something is wrong and the board goes on.
        Warning,
        /// Something is broken.
        Error,
    }
}

wire_struct! {
    /// A line of text for the person at the host.
    pub struct Log {
        /// Time of the line, us since the board started.
        pub board_time_us: u64,
        /// Weight.
        pub level: LogLevel,
        /// The text.
        pub text: String<80>,
    }
}
