//! Contact sensing, sampling and commands of the fingertip board.
//!
//! No HAL, no allocation, `f32` only: the same code runs in the board's interrupts and, as the
//! simulated board, in a thread of the host.
//!
//! ```text
//! front_end  counts and angles, without waiting
//!   |
//! tare       offsets: taken on command, followed while nothing is touched
//!   |
//! sensing    wrench -> contact -> validity and sigma
//!   |
//! sampling   one tick: all of the above, counters, a contact or a raw frame
//!   |
//! queue      encoded frames; full means the oldest goes
//!
//! commands   requests from the host, each done once
//! store      the calibration, in two slots
//! restart    last words, and what the watchdog is fed for
//! board      all of it: tick(now), receive(bytes, now), take_frame(now)
//! ```
//! # A board on the host
//!
//! ```
//! use palpus_firmware::front_end::{GaugeFrontEnd, GaugeSample, JointFrontEnd, JointSample};
//! use palpus_firmware::{Board, BoardConfig, store::RamStore};
//! use palpus_protocol::{BoardMessage, Decoder, TipGeometry};
//!
//! struct Gauges;
//! impl GaugeFrontEnd for Gauges {
//!     fn gauges(&self) -> usize {
//!         6
//!     }
//!     fn sample(&mut self, now_us: u64) -> GaugeSample {
//!         GaugeSample::missing(now_us)
//!     }
//! }
//!
//! struct Joints;
//! impl JointFrontEnd for Joints {
//!     fn sample(&mut self, _: u64) -> JointSample {
//!         JointSample::default()
//!     }
//! }
//!
//! let tip = TipGeometry { semi_axes_mm: [20.0; 3], centre_offset_mm: [0.0, 0.0, 35.0] };
//! let config = BoardConfig::new(*b"demo board 1", 0, "thumb", tip);
//! let mut board = Board::new(config, Gauges, Joints, RamStore::new(), 0)?;
//! board.tick(5000);
//!
//! // The first thing a board says is who it is.
//! let mut decoder = Decoder::new();
//! let frame = board.take_frame(5000).unwrap_or_default().to_vec();
//! for byte in frame {
//!     if let Some(frame) = decoder.push(byte) {
//!         assert!(matches!(BoardMessage::try_from(frame?)?, BoardMessage::Identity(_)));
//!     }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![no_std]
#![forbid(unsafe_code)]

pub mod board;
mod commands;
mod cut_off;
pub mod event;
pub mod front_end;
pub mod queue;
pub mod restart;
mod sampling;
pub mod sensing;
pub mod store;
pub mod tare;

pub use board::{Board, BoardConfig, BoardError};
pub use event::Event;
