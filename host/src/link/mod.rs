//! The line to a fingertip board: serial port, framing, requests, clock alignment, counters.
//!
//! [`port`] opens devices, [`connection`] turns bytes into messages and asks questions, [`clock`] and
//! [`host_clock`] put the board's times on the host's clock, [`sequence`] counts what is missing, and
//! [`session`] does all of that continuously for one finger, through unplugged cables and restarted boards. [`board`]
//! and [`calibration`] serve a person with one board in hand.
//!
//! # What it promises
//!
//! - A frame is accepted with a right check sum or not at all; the first frame after any garbage is accepted.
//! - Every contact the board made is counted: accepted or lost, from sequence numbers, none twice.
//! - Requests are repeated with the same id until they are answered or time is up; the board acts once.
//! - A board of another version or schema can still be asked who it is, and the error names both sides.
//! - Nothing here waits for a disk: what is received is offered to a queue, and what the queue does not take is
//!   counted.

pub mod board;
pub mod calibration;
pub mod clock;
pub mod connection;
pub mod host_clock;
pub mod port;
pub mod sequence;
pub mod session;

use palpus_protocol::{MessageError, Refusal};
use std::time::Duration;

/// What can go wrong with a board or the line to it.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The device can't be opened.
    #[error(
        "can't open {port}: {reason}; check the cable, the name and your permission to use serial ports"
    )]
    Open {
        /// The device.
        port: String,
        /// What the system says.
        reason: String,
    },
    /// The device has gone, or fails.
    #[error("{port} failed: {source}; check the cable and the board's power")]
    Io {
        /// The device.
        port: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// No answer within the time allowed.
    #[error(
        "no answer on {port} to {asked} within {waited:?} ({bytes} bytes came, {bad} damaged frames); is this the board's port, at the right baud rate?"
    )]
    NoAnswer {
        /// The device.
        port: String,
        /// What was asked.
        asked: &'static str,
        /// How long it was waited for.
        waited: Duration,
        /// Bytes that came meanwhile.
        bytes: u64,
        /// Damaged frames that came meanwhile.
        bad: u64,
    },
    /// The board refused.
    #[error("the board on {port} refused {asked}: {reason}")]
    Refused {
        /// The device.
        port: String,
        /// What was asked.
        asked: &'static str,
        /// Why, and what to do instead.
        reason: Refusal,
    },
    /// The board answered with something else.
    #[error(
        "the board on {port} answered {asked} with something else ({answer}); flash it with this release's firmware"
    )]
    UnexpectedAnswer {
        /// The device.
        port: String,
        /// What was asked.
        asked: &'static str,
        /// What came.
        answer: String,
    },
    /// The board is of another version or schema.
    #[error(
        "the board on {port} does not understand this program: {reason} (`palpus board {port} info` still works)"
    )]
    Mismatch {
        /// The device.
        port: String,
        /// Both sides' versions.
        reason: MessageError,
    },
    /// A message could not be encoded.
    #[error("can't encode the request: {0}; this is a mistake in the program, please report it")]
    Encode(palpus_protocol::EncodeError),
}
