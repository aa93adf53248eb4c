//! The capture log: one MCAP file per run, written as it goes, readable after anything that can happen to it.
//!
//! # What is in it
//!
//! | record | content |
//! |---|---|
//! | attachment `hand/…` | the hand file the run was captured with, bytes as they are |
//! | metadata `palpus.run` | format version, protocol, start, units, fingers |
//! | metadata `palpus.identity/1`, `/2`, … | what a board said of itself, once per connection |
//! | `/FINGER/wire` | `palpus.WireFrame`: every accepted frame, untouched |
//! | `/FINGER/points` | `foxglove.PointCloud`: valid contacts in the world (m), ten clouds a second, for viewers |
//! | `/FINGER/clock` | `palpus.RoundTrip`: what the clock alignment was computed from |
//! | `/FINGER/link` | `palpus.LinkState`: counters and alignment, once a second |
//! | `/events` | `foxglove.Log`: unplugged, found again, restarted, texts of the boards |
//!
//! On `/FINGER/wire` the log time is when the host had the frame, the publish time when the board took the
//! sample, on the host's clock as aligned at that moment; sequence is the low 32 bits of the frame's place in
//! the run. Frames that carry no sample have both times equal.
//!
//! # What it promises
//!
//! - Chunks are closed, written in one go and handed to the system at most every [`FLUSH_EVERY`], so that a
//!   killed process costs at most that much, and a lost power supply that much plus the time the disk takes.
//! - The file grows only at its end. Cut off anywhere, all complete chunks and the whole messages of the last,
//!   broken one are read back .
//! - A damaged chunk costs what is damaged: frames carry a check sum of their own and are taken one by one.
//!
//! Compression is left out on purpose: wire frames hardly compress, and a broken compressed chunk is lost as a
//! whole.

pub mod capture;
pub mod points;
pub mod reader;
pub mod records;
pub mod schema;
pub mod writer;

use std::path::PathBuf;
use std::time::Duration;

/// What the names of the metadata records of boards begin with.
const IDENTITY: &str = "palpus.identity";

/// Longest time between two flushes of a run that is being written.
pub const FLUSH_EVERY: Duration = Duration::from_millis(250);
/// Version of the layout described above; a reader refuses a newer one.
pub const FORMAT_VERSION: u32 = 1;

/// What can be wrong with a run file as a whole. What is wrong with parts of it is [`records::Damage`].
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The output is there already.
    #[error("{path} exists; choose another name or give --force to replace it")]
    Exists {
        /// The output.
        path: PathBuf,
    },
    /// The output can't be made.
    #[error("can't create {path}: {source}; choose a folder that exists and may be written to")]
    Create {
        /// The output.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Writing failed under way.
    #[error(
        "writing {path} failed: {source}; all that was flushed before is in the file ({flushed_bytes} bytes), free some room and capture again"
    )]
    Write {
        /// The output.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
        /// Bytes that are safe.
        flushed_bytes: u64,
    },
    /// The file can't be read.
    #[error("can't read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is no run.
    #[error("{path} is no Palpus run: {reason}; give a file written by `palpus capture`")]
    NotARun {
        /// The file.
        path: PathBuf,
        /// What was found instead.
        reason: String,
    },
    /// The file was written by a later version.
    #[error(
        "{path} has run format {found}, this program reads up to {FORMAT_VERSION}; use a newer palpus"
    )]
    TooNew {
        /// The file.
        path: PathBuf,
        /// Its format version.
        found: u32,
    },
}
