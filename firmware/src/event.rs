//! What happened on the board that someone should know: for the host as log lines, for the debug
//! probe as values.
//!
//! Events are small values. Nothing is formatted while sampling: the text is made when a line is
//! handed to the transmitter, and the probe's log (`defmt`) formats on the host.

use crate::store::StoreError;
use palpus_protocol::{FrameError, GaugeFlags, LogLevel, MessageError, Refusal};

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The board has started, with this calibration (0: none).
    Started {
        /// Id of the calibration in use.
        calibration_id: u32,
    },
    /// The watchdog has restarted the board: sampling had stood still.
    WatchdogRestart,
    /// The board has restarted itself after a panic in this source line; the whole text went to the
    /// probe's log.
    PanicRestart {
        /// The line.
        line: u32,
    },
    /// The board has restarted itself after a processor fault at this address.
    FaultRestart {
        /// The address.
        address: u32,
    },
    /// A gauge went bad.
    GaugeFault {
        /// Number of the gauge.
        gauge: u8,
        /// What is wrong with it.
        flags: GaugeFlags,
    },
    /// All gauges are good again.
    GaugesGood,
    /// A joint angle went missing or failed its check bits.
    JointFault {
        /// Number of the joint, base first.
        joint: u8,
    },
    /// All joint angles are good again.
    JointsGood,
    /// A converter was found reset and was set up again.
    ChipReset {
        /// How many times so far.
        total: u32,
    },
    /// Periods passed without a sample.
    Overrun {
        /// How many.
        periods: u32,
    },
    /// A tare was taken.
    Tared {
        /// Periods averaged.
        samples: u16,
    },
    /// A request was refused.
    Refused {
        /// Id of the request.
        request_id: u32,
        /// Why.
        refusal: Refusal,
    },
    /// A calibration is in use.
    Calibrated {
        /// Its id.
        id: u32,
    },
    /// A calibration could not be kept.
    StoreFailed(StoreError),
    /// A damaged frame was received.
    BadFrame(FrameError),
    /// An undamaged frame could not be acted on.
    BadMessage(MessageError),
}

impl Event {
    /// Weight of the event.
    pub const fn level(&self) -> LogLevel {
        match self {
            Self::Started { .. }
            | Self::GaugesGood
            | Self::JointsGood
            | Self::Tared { .. }
            | Self::Calibrated { .. } => LogLevel::Info,
            Self::ChipReset { .. }
            | Self::Overrun { .. }
            | Self::Refused { .. }
            | Self::BadFrame(_)
            | Self::BadMessage(_)
            | Self::JointFault { .. } => LogLevel::Warning,
            Self::GaugeFault { .. }
            | Self::StoreFailed(_)
            | Self::WatchdogRestart
            | Self::PanicRestart { .. }
            | Self::FaultRestart { .. } => LogLevel::Error,
        }
    }
}

impl core::fmt::Display for Event {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Started { calibration_id: 0 } => f.write_str("started without calibration"),
            Self::Started { calibration_id } => {
                write!(f, "started with calibration {calibration_id}")
            }
            Self::WatchdogRestart => {
                f.write_str("restarted by the watchdog: sampling had stood still")
            }
            Self::PanicRestart { line } => {
                write!(f, "restarted after a panic in source line {line}")
            }
            Self::FaultRestart { address } => {
                write!(f, "restarted after a processor fault at {address:#010x}")
            }
            Self::GaugeFault { gauge, flags } => {
                write!(f, "gauge {gauge}:")?;
                GaugeFlags::NAMES
                    .iter()
                    .filter(|(flag, _)| flags.contains(*flag))
                    .try_for_each(|(_, name)| write!(f, " {name}"))
            }
            Self::GaugesGood => f.write_str("all gauges good again"),
            Self::JointFault { joint } => write!(f, "joint {joint}: no good angle"),
            Self::JointsGood => f.write_str("all joint angles good again"),
            Self::ChipReset { total } => {
                write!(f, "converter reset and set up again ({total} so far)")
            }
            Self::Overrun { periods } => write!(f, "{periods} periods without a sample"),
            Self::Tared { samples } => write!(f, "tared over {samples} periods"),
            Self::Refused {
                request_id,
                refusal,
            } => write!(f, "request {request_id} refused: {refusal}"),
            Self::Calibrated { id } => write!(f, "calibration {id} in use"),
            Self::StoreFailed(error) => write!(f, "{error}"),
            Self::BadFrame(error) => write!(f, "received {error}"),
            Self::BadMessage(error) => write!(f, "{error}"),
        }
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Event {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self {
            Self::Started { calibration_id } => {
                defmt::write!(f, "started, calibration {=u32}", calibration_id)
            }
            Self::WatchdogRestart => defmt::write!(f, "restarted by the watchdog"),
            Self::PanicRestart { line } => {
                defmt::write!(f, "restarted after a panic in line {=u32}", line)
            }
            Self::FaultRestart { address } => {
                defmt::write!(f, "restarted after a fault at {=u32:#010x}", address)
            }
            Self::GaugeFault { gauge, flags } => {
                defmt::write!(f, "gauge {=u8} faulty, flags {=u8:b}", gauge, flags.bits())
            }
            Self::GaugesGood => defmt::write!(f, "gauges good"),
            Self::JointFault { joint } => defmt::write!(f, "joint {=u8} faulty", joint),
            Self::JointsGood => defmt::write!(f, "joints good"),
            Self::ChipReset { total } => defmt::write!(f, "chip reset, {=u32} so far", total),
            Self::Overrun { periods } => defmt::write!(f, "overrun of {=u32} periods", periods),
            Self::Tared { samples } => defmt::write!(f, "tared over {=u16} periods", samples),
            Self::Refused {
                request_id,
                refusal,
            } => defmt::write!(f, "request {=u32} refused: {}", request_id, refusal),
            Self::Calibrated { id } => defmt::write!(f, "calibration {=u32} in use", id),
            Self::StoreFailed(error) => defmt::write!(f, "store: {}", error),
            Self::BadFrame(error) => defmt::write!(f, "frame: {}", error),
            Self::BadMessage(error) => defmt::write!(f, "message: {}", error),
        }
    }
}
