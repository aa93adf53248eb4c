//! What a host asks of a board, and what the board answers.
//!
//! Every request carries an id chosen by the host. A board that sees an id again within its last
//! few requests does not act again: it repeats its answer. A host may therefore send a request as
//! often as it likes until the answer comes. Ids must differ between requests; start from a random
//! number, since a board outlives a host's run. Id 0 is never used.

use crate::CRC;
use crate::board::MAX_GAUGES;
use crate::wire::{wire_enum, wire_struct};
use heapless::Vec;

/// Rows of a calibration matrix: three forces, three moments.
pub const WRENCH_AXES: usize = 6;

wire_struct! {
    /// Asks who the board is. **Frozen** like [`Identity`](crate::Identity): answered whatever the
    /// versions of the two sides.
    #[derive(Copy, Eq)]
    pub struct Identify {
        /// Id of the request.
        pub request_id: u32,
    }
}

wire_struct! {
    /// Any other request.
    pub struct Request {
        /// Id of the request, not 0.
        pub request_id: u32,
        /// What is asked.
        pub command: Command,
    }
}

wire_enum! {
    /// What is asked of a board.
    pub enum Command {
        /// Answer [`Outcome::Pong`] with the same number.
        Ping(u32),
        /// Stream from now on as told; replaces what was streamed before.
        Start(Streams),
        /// Stop all streams.
        Stop,
        /// Take the unloaded gauges' mean as zero. Answered when done.
        Tare(TareRequest),
        /// Send the calibration.
        GetCalibration,
        /// Use this calibration and store it.
        SetCalibration(Calibration),
        /// Compare clocks.
        TimeSync(TimeSyncRequest),
        /// Send [`Statistics`](crate::Statistics) and the pages of
        /// [`GaugeStatistics`](crate::GaugeStatistics).
        Statistics,
    }
}

wire_struct! {
    /// Which streams, and how often.
    #[derive(Copy, Eq, Default)]
    pub struct Streams {
        /// Send the contact of every n-th period; 0 for none.
        pub contact_every: u8,
        /// Send the raw gauges of every n-th period; 0 for none.
        pub raw_every: u8,
    }
}

wire_struct! {
    /// How to tare.
    #[derive(Copy, Eq)]
    pub struct TareRequest {
        /// Periods to average over, 1 to 2000 (200 are one second at 5 ms).
        pub samples: u16,
        /// Tare even if the tip seems to be in contact.
        pub force: bool,
    }
}

wire_struct! {
    /// First half of a clock comparison (as in NTP).
    #[derive(Copy, Eq)]
    pub struct TimeSyncRequest {
        /// Host time when the request was sent, us; returned as it is.
        pub host_send_us: u64,
    }
}

wire_struct! {
    /// Gauge counts to wrench: force in N and moment in N mm at the sensor's origin, per tared
    /// count.
    pub struct Calibration {
        /// Id chosen by whoever calibrated, not 0.
        pub id: u32,
        /// Number of gauges, the columns of the matrix.
        pub gauges: u8,
        /// Row-major matrix with 6 rows (Fx, Fy, Fz in N; Mx, My, Mz in N mm) and `gauges` columns.
        pub matrix: Vec<f32, { WRENCH_AXES * MAX_GAUGES }>,
        /// CRC-32C of id, gauges and matrix, all little-endian ([`Calibration::computed_crc`]).
        pub crc: u32,
    }
}

/// Why a calibration can't be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CalibrationError {
    /// The id is 0; choose another.
    ZeroId,
    /// The matrix has not 6 x `gauges` entries, or there are no gauges or more than [`MAX_GAUGES`].
    Shape,
    /// An entry is infinite or not a number.
    NotFinite,
    /// The check sum is not that of the contents; send the calibration again.
    Crc,
}

impl core::fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::ZeroId => "calibration id 0 means none: choose another id",
            Self::Shape => "calibration matrix is not 6 rows by the number of gauges (1 to 8)",
            Self::NotFinite => "calibration matrix holds a value that is not a finite number",
            Self::Crc => "calibration check sum does not match its contents: send it again",
        })
    }
}

impl core::error::Error for CalibrationError {}

impl Calibration {
    /// A calibration with its check sum; `matrix` is row-major, 6 rows of `gauges` entries.
    pub fn sealed(id: u32, gauges: u8, matrix: &[f32]) -> Result<Self, CalibrationError> {
        let matrix = Vec::from_slice(matrix).map_err(|_| CalibrationError::Shape)?;
        let mut calibration = Self {
            id,
            gauges,
            matrix,
            crc: 0,
        };
        calibration.crc = calibration.computed_crc();
        calibration.check()?;
        Ok(calibration)
    }

    /// CRC-32C over id (4 bytes), gauges (1 byte) and the matrix (4 bytes each), little-endian.
    pub fn computed_crc(&self) -> u32 {
        let mut digest = CRC.digest();
        digest.update(&self.id.to_le_bytes());
        digest.update(&[self.gauges]);
        for value in &self.matrix {
            digest.update(&value.to_le_bytes());
        }
        digest.finalize()
    }

    /// Whether the calibration can be used: id, shape, finite entries, check sum.
    pub fn check(&self) -> Result<(), CalibrationError> {
        let gauges = usize::from(self.gauges);
        if self.crc != self.computed_crc() {
            Err(CalibrationError::Crc)
        } else if self.id == 0 {
            Err(CalibrationError::ZeroId)
        } else if gauges == 0 || gauges > MAX_GAUGES || self.matrix.len() != WRENCH_AXES * gauges {
            Err(CalibrationError::Shape)
        } else if !self.matrix.iter().all(|value| value.is_finite()) {
            Err(CalibrationError::NotFinite)
        } else {
            Ok(())
        }
    }
}

wire_struct! {
    /// Answer to a [`Request`].
    pub struct Reply {
        /// Id of the request.
        pub request_id: u32,
        /// What came of it.
        pub outcome: Outcome,
    }
}

wire_enum! {
    /// What came of a request.
    pub enum Outcome {
        /// Done; nothing to tell.
        Done,
        /// Answer to a ping.
        Pong(u32),
        /// A tare has been taken.
        Tared(Tared),
        /// The calibration in use.
        Calibration(Calibration),
        /// A calibration is in use, and where it is kept.
        CalibrationStored(CalibrationStored),
        /// Second half of a clock comparison.
        Time(TimeSyncAnswer),
        /// Not done, and why.
        Refused(Refusal),
    }
}

wire_struct! {
    /// Result of a tare.
    pub struct Tared {
        /// Periods averaged.
        pub samples: u16,
        /// Offset of each gauge, counts.
        pub offset_counts: Vec<i32, MAX_GAUGES>,
        /// Standard deviation of each gauge's readings meanwhile, counts.
        pub noise_counts: Vec<f32, MAX_GAUGES>,
    }
}

wire_struct! {
    /// Where a calibration went.
    #[derive(Copy, Eq)]
    pub struct CalibrationStored {
        /// Its id.
        pub id: u32,
        /// Where it is kept.
        pub place: StorePlace,
    }
}

wire_enum! {
    /// Where a calibration is kept.
    #[derive(Copy, Eq)]
    pub enum StorePlace {
        /// In memory that outlives the power.
        Permanent,
        /// In RAM, since the permanent store could not be written: it goes with the power.
        RamOnly,
    }
}

wire_struct! {
    /// Second half of a clock comparison: with the host's receive time t4, offset = ((t2 - t1) +
    /// (t3 - t4)) / 2 and round trip = (t4 - t1) - (t3 - t2).
    #[derive(Copy, Eq)]
    pub struct TimeSyncAnswer {
        /// t1: host time of the request, as it was sent.
        pub host_send_us: u64,
        /// t2: board time when the request was whole.
        pub board_receive_us: u64,
        /// t3: board time when the answer was handed to the transmitter.
        pub board_send_us: u64,
    }
}

wire_enum! {
    /// Why a request was not done, and what to do instead.
    #[derive(Copy, Eq)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    pub enum Refusal {
        /// The tip seems to be in contact: lift it, or force.
        InContact,
        /// A tare with another id is being taken: wait for it.
        Busy,
        /// The number of samples is 0 or above 2000: choose another.
        SampleCount,
        /// This gauge gave no good reading while taring: see the statistics.
        GaugeFaulty(u8),
        /// The readings did not settle (the load changed meanwhile): keep the tip free and still,
        /// then try again.
        Unsettled,
        /// There is no calibration to send.
        NoCalibration,
        /// The calibration's check sum is wrong: send it again.
        CalibrationCrc,
        /// The calibration is for another number of gauges, or its matrix is not 6 rows: this is
        /// the board's number of gauges.
        CalibrationShape(u8),
        /// The calibration holds a value that is not finite, or the id 0.
        CalibrationValue,
        /// Streams are on, and storing would stall them: stop them first.
        Streaming,
    }
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::InContact => {
                f.write_str("the tip seems to be in contact: lift it, or force the tare")
            }
            Self::Busy => f.write_str("another tare is being taken: wait for it"),
            Self::SampleCount => f.write_str("the number of samples must be 1 to 2000"),
            Self::GaugeFaulty(gauge) => write!(
                f,
                "gauge {gauge} gave no good reading: see the board's statistics"
            ),
            Self::Unsettled => f.write_str(
                "the readings did not settle: keep the tip free and still, then try again",
            ),
            Self::NoCalibration => f.write_str("the board holds no calibration: upload one"),
            Self::CalibrationCrc => {
                f.write_str("the calibration's check sum is wrong: send it again")
            }
            Self::CalibrationShape(gauges) => write!(
                f,
                "the calibration must be 6 rows by this board's {gauges} gauges"
            ),
            Self::CalibrationValue => {
                f.write_str("the calibration holds a value that is not finite, or the id 0")
            }
            Self::Streaming => {
                f.write_str("streams are on and storing would stall them: stop them first")
            }
        }
    }
}

impl core::error::Error for Refusal {}
