//! Runs a checker written in another language, and says what it said if it fails.

use std::process::Command;

/// Runs the checker and returns what it printed on stdout; `what` is what it needs.
///
/// # Panics
/// If its interpreter is not there, or it fails.
pub fn run(command: &mut Command, what: &str) -> String {
    let out = command.output();
    let out = out.unwrap_or_else(|e| panic!("no {what} ({e}): run tests/setup"));
    let stdout = String::from_utf8_lossy(&out.stdout);
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(
        out.status.success(),
        "{command:?}: {} (is all there? run tests/setup)\n{stdout}{stderr}",
        out.status
    );
    stdout.into_owned()
}

/// The JSON on the last line that a checker printed.
///
/// # Panics
/// If there is none.
pub fn last_json(printed: &str) -> serde_json::Value {
    serde_json::from_str(printed.lines().last().unwrap_or_default())
        .unwrap_or_else(|e| panic!("no JSON ({e}): {printed}"))
}
