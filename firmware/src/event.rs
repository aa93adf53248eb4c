//! What happened on the board that someone should know: for the host as log lines, for the debug
//! probe as values.
//!
//! Events are small values. Nothing is formatted while sampling: the text is made when a line is
//! handed to the transmitter, and the probe's log (`defmt`) formats on the host.
//!
//! Gauges and joints that go bad together and in the same way are one event: a dead converter or a
//! torn cable must not push out of the queue what came before it.

use crate::front_end::JointState;
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
    /// The watchdog has restarted the board: sampling or the link had stood still.
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
    /// Gauges went bad in the same way.
    GaugeFault {
        /// Which: bit n is gauge n.
        gauges: u8,
        /// What is wrong with them: one flag.
        flag: GaugeFlags,
    },
    /// All gauges are good again.
    GaugesGood,
    /// Joint angles went missing or failed their check bits.
    JointFault {
        /// Which: bit n is joint n, base first.
        joints: u8,
        /// What is wrong with them.
        state: JointState,
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

/// "gauge 4:", "gauges 0 1 2:".
fn write_numbers(f: &mut core::fmt::Formatter<'_>, what: &str, bits: u8) -> core::fmt::Result {
    f.write_str(what)?;
    if bits.count_ones() > 1 {
        f.write_str("s")?;
    }
    (0..8)
        .filter(|number| bits & (1 << number) != 0)
        .try_for_each(|number| write!(f, " {number}"))?;
    f.write_str(":")
}

impl core::fmt::Display for Event {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Started { calibration_id: 0 } => f.write_str("started without calibration"),
            Self::Started { calibration_id } => {
                write!(f, "started with calibration {calibration_id}")
            }
            Self::WatchdogRestart => {
                f.write_str("restarted by the watchdog: sampling or the link had stood still")
            }
            Self::PanicRestart { line } => {
                write!(f, "restarted after a panic in source line {line}")
            }
            Self::FaultRestart { address } => {
                write!(f, "restarted after a processor fault at {address:#010x}")
            }
            Self::GaugeFault { gauges, flag } => {
                write_numbers(f, "gauge", *gauges)?;
                GaugeFlags::NAMES
                    .iter()
                    .filter(|(one, _)| flag.contains(*one))
                    .try_for_each(|(_, name)| write!(f, " {name}"))
            }
            Self::GaugesGood => f.write_str("all gauges good again"),
            Self::JointFault { joints, state } => {
                write_numbers(f, "joint", *joints)?;
                f.write_str(match state {
                    JointState::Good => " good",
                    JointState::Missing => " no answer",
                    JointState::BadCheck => " wrong check bits",
                })
            }
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
            Self::GaugeFault { gauges, flag } => {
                defmt::write!(
                    f,
                    "gauges {=u8:08b} faulty, flag {=u8:05b}",
                    gauges,
                    flag.bits()
                )
            }
            Self::GaugesGood => defmt::write!(f, "gauges good"),
            Self::JointFault { joints, state } => {
                defmt::write!(f, "joints {=u8:03b} faulty: {}", joints, state)
            }
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
