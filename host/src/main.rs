//! The `palpus` command line: parses, calls the library, prints.

mod cli;

use clap::Parser;
use std::process::ExitCode;

/// Touch a thing, get its surface.
#[derive(Parser)]
#[command(name = "palpus", version, about)]
struct Palpus {
    #[command(flatten)]
    common: cli::Common,
    #[command(subcommand)]
    command: Command,
}

/// One variant per subcommand; each lives in `cli/<name>.rs` as `Args` and `run(&Common, Args)`.
#[derive(clap::Subcommand)]
enum Command {
    /// Move a simulated hand over an object.
    Simulate(cli::simulate::Args),
    Evaluate(cli::evaluate::Args),
}

fn main() -> ExitCode {
    let palpus = Palpus::parse();
    let outcome: Result<cli::Exit, cli::Failure> = match palpus.command {
        Command::Simulate(args) => cli::simulate::run(&palpus.common, args),
        Command::Evaluate(args) => cli::evaluate::run(&palpus.common, args),
    };
    match outcome {
        Ok(exit) => exit.into(),
        Err(failure) => {
            eprintln!("palpus: {:#}", failure.error);
            failure.exit.into()
        }
    }
}
