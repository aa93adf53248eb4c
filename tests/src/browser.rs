//! Runs the scripts in `tests/node` that drive a headless browser, which `tests/setup` installs.

use crate::script;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

/// Runs a script of `tests/node` and returns the JSON it printed last.
///
/// # Panics
/// If there is no node, or the script fails; with what it said.
pub fn run<A: AsRef<OsStr>>(script: &str, arguments: &[A]) -> serde_json::Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("node")
        .join(script);
    let printed = script::run(Command::new("node").arg(path).args(arguments), "node");
    script::last_json(&printed)
}
