//! `palpus completions` and `palpus manual`: made from the same description of the commands that parses them.

use super::{Common, Exit, Failure, outputs, say};
use anyhow::Context;
use clap_complete::Shell;
use std::path::PathBuf;

/// Print completions for a shell.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus completions bash > ~/.local/share/bash-completion/completions/palpus
  palpus completions zsh > ~/.zfunc/_palpus
  palpus completions fish > ~/.config/fish/completions/palpus.fish")]
pub struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

/// Write manual pages, one per command.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus manual -o ~/.local/share/man/man1 && man palpus-reconstruct")]
pub struct ManualArgs {
    /// Folder for palpus.1, palpus-reconstruct.1 and so on; made if need be.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Runs `palpus completions`.
pub fn completions(args: &CompletionsArgs, mut command: clap::Command) -> Result<Exit, Failure> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "palpus", &mut text);
    say::out(&String::from_utf8_lossy(&text));
    Ok(Exit::Done)
}

/// Runs `palpus manual`.
pub fn manual(common: &Common, args: &ManualArgs, command: clap::Command) -> Result<Exit, Failure> {
    outputs::check_folder(&args.output)?;
    let next = || {
        format!(
            "{}: cannot be written; choose another folder",
            args.output.display()
        )
    };
    std::fs::create_dir_all(&args.output)
        .and_then(|()| clap_mangen::generate_to(command, &args.output))
        .with_context(next)
        .map_err(|e| Failure::new(Exit::Usage, e))?;
    say::out(&if common.json {
        format!("{}\n", serde_json::json!({"folder": args.output}))
    } else {
        format!("{}: manual pages\n", args.output.display())
    });
    Ok(Exit::Done)
}
