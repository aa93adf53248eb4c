//! The real program in a folder of its own, looked at from outside: code, prints, files.

use crate::program;
use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Stdio};

/// What a run of the program left behind, besides files.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Code it left with.
    pub code: i32,
    /// What it printed.
    pub stdout: String,
    /// What it complained of.
    pub stderr: String,
}

/// Runs the program in `folder` and waits for its end.
///
/// # Panics
/// When it cannot be started, was killed, panicked, or printed what is no UTF-8.
pub fn palpus<A: AsRef<OsStr>>(folder: &Path, args: &[A]) -> Outcome {
    let output = Command::new(program::palpus())
        .current_dir(folder)
        .args(args)
        .stdin(Stdio::null())
        .output()
        .expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("the program prints UTF-8");
    let outcome = Outcome {
        stdout: text(output.stdout),
        stderr: text(output.stderr),
        code: output
            .status
            .code()
            .unwrap_or_else(|| panic!("the program was killed: {}", output.status)),
    };
    assert!(
        !outcome.stderr.contains("panicked") && outcome.code != 101,
        "{outcome:?}"
    );
    outcome
}

/// Names of what lies in `folder`, sorted.
///
/// # Panics
/// When the folder cannot be read.
pub fn listing(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .expect("the folder can be read")
        .map(|entry| entry.expect("an entry").file_name())
        .map(|name| name.to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}
