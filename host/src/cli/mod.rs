//! One file per subcommand: parse, call the library, print. Nothing else lives here.

pub mod board;
pub mod capture;
pub mod demo;
pub mod evaluate;
pub mod live;
pub mod manual;
mod outputs;
pub mod points;
mod progress;
pub mod reconstruct;
pub mod report;
pub mod say;
mod screen;
pub mod simulate;
mod table;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What every subcommand shares.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Common {
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long, global = true)]
    pub json: bool,
    /// Print progress and logs even when stderr is no terminal; twice for more.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// Exit codes of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done.
    Done = 0,
    /// Wrong usage.
    Usage = 2,
    /// Input refused.
    Input = 3,
    /// With `--strict`: tolerance not met.
    Tolerance = 4,
    /// Device or link trouble.
    Device = 5,
    /// Interrupted; all captured data saved.
    Interrupted = 130,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Failure of a subcommand: what to print and which code to leave with.
#[derive(Debug)]
pub struct Failure {
    /// Code to leave with.
    pub exit: Exit,
    /// What to print: what went wrong and what to do next.
    pub error: anyhow::Error,
}

impl Failure {
    /// A failure with the given exit code.
    pub fn new(exit: Exit, error: impl Into<anyhow::Error>) -> Self {
        Self {
            exit,
            error: error.into(),
        }
    }
}

/// A flag that is set once the program is asked to end (Ctrl-C); to be called once.
fn interruption() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&stop);
    ctrlc::set_handler(move || told.store(true, Ordering::Relaxed))
        .map_err(|e| Failure::new(Exit::Device, e))?;
    Ok(stop)
}
