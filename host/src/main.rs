//! The `palpus` command line: parses, calls the library, prints.

mod cli;

use clap::{CommandFactory, Parser};
use std::process::ExitCode;

/// Small systems are factored by the thousand: with the C library's allocator a fifth of the time of `reconstruct` goes
/// into giving their pages back and taking them again.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;
const EXAMPLES: &str = "\
Examples:
  palpus demo                                       the whole path without hardware
  palpus reconstruct points.ply -o surface.json --page surface.html
  palpus capture --finger index=/dev/ttyACM0 --hand hand.urdf -o run.mcap --live
  palpus help reconstruct                           options and examples of one command

Exit codes: 0 done; 2 wrong usage; 3 input refused; 4 with --strict, tolerance not met; 5 device or link trouble;
130 interrupted, with all captured data saved.";

/// Touch a thing, get its surface.
#[derive(Parser)]
#[command(name = "palpus", version, about, after_help = EXAMPLES)]
struct Palpus {
    #[command(flatten)]
    common: cli::Common,
    #[command(subcommand)]
    command: Command,
}

/// One variant per subcommand; each lives in `cli/<name>.rs` as `Args` and `run(&Common, Args)`.
#[derive(clap::Subcommand)]
enum Command {
    Demo(cli::demo::Args),
    /// Move a simulated hand over an object.
    Simulate(cli::simulate::Args),
    Evaluate(cli::evaluate::Args),
    Board(cli::board::Args),
    Capture(cli::capture::Args),
    Points(cli::points::Args),
    Report(cli::report::Args),
    Reconstruct(cli::reconstruct::Args),
    Completions(cli::manual::CompletionsArgs),
    Manual(cli::manual::ManualArgs),
}

fn main() -> ExitCode {
    let palpus = Palpus::parse();
    let outcome: Result<cli::Exit, cli::Failure> = match palpus.command {
        Command::Demo(args) => cli::demo::run(&palpus.common, args),
        Command::Simulate(args) => cli::simulate::run(&palpus.common, args),
        Command::Evaluate(args) => cli::evaluate::run(&palpus.common, args),
        Command::Board(args) => cli::board::run(&palpus.common, args),
        Command::Capture(args) => cli::capture::run(&palpus.common, args),
        Command::Points(args) => cli::points::run(&palpus.common, args),
        Command::Report(args) => cli::report::run(&palpus.common, args),
        Command::Reconstruct(args) => cli::reconstruct::run(&palpus.common, &args),
        Command::Completions(args) => cli::manual::completions(&args, Palpus::command()),
        Command::Manual(args) => cli::manual::manual(&palpus.common, &args, Palpus::command()),
    };
    match outcome {
        Ok(exit) => exit.into(),
        Err(failure) => {
            cli::say::err(&format!("palpus: {}", said_once(&failure.error)));
            failure.exit.into()
        }
    }
}

/// The error and its causes, without those that the message before them already quotes.
fn said_once(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}
