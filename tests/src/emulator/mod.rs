//! The emulated board: QEMU runs the very ELF that is flashed, and models of its chips answer on its serial ports.
//!
//! ```text
//! World (a hand on an object)  -> volts, angles
//!   Ads122u04 x 3, Encoder x 3 <-> USART2, USART3, USART6, UART4
//! QEMU                             the image, unchanged
//!   USART1                     <-> HostLine: a pseudo-terminal, or bytes in the test's hands
//!   qtest socket               ->  DefmtLog: the log out of the board's RAM, decoded
//! ```
//!
//! Guest time runs at about wall speed, and lags on a busy machine; tests assert on board time and on counts, never on wall
//! time. A UART never waits for its reader, but the emulated one stops the whole machine when its socket is full: so every
//! socket has a thread that always reads, and what a slow host does not take is dropped there, as on a real line. The
//! emulator is ended with SIGKILL, because a guest that is blocked on a socket does not hear anything else.

pub mod ads122u04;
pub mod amt21;
mod board;
mod chips;
pub mod client;
mod host_line;
pub mod log;
pub mod sliding;

pub use board::{Board, BoardError, command};
pub use chips::{Bench, World};
pub use client::Client;
pub use host_line::HostLine;
pub use log::{DefmtLog, LogLine, Memory};
pub use sliding::{GaugeFault, Motion, SlidingFinger};

/// The hand that comes with the host.
pub fn hand_file() -> std::path::PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../host/src/hand/three_finger.urdf")
}
