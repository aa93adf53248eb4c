//! Contact sensing, sampling and commands of the fingertip board.
//!
//! No HAL, no allocation, `f32` only: the same code runs in the board's interrupts and, as the simulated board, in a thread of the host.
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
//! board      all of it: tick(now), receive(bytes, now), take_frame(now)
//! ```
#![no_std]
#![forbid(unsafe_code)]

pub mod board;
mod commands;
pub mod event;
pub mod front_end;
pub mod queue;
mod sampling;
pub mod sensing;
pub mod store;
pub mod tare;

pub use board::{Board, BoardConfig, BoardError};
pub use event::Event;
