//! Runs the checkers in `tests/python`, which need packages that `tests/setup` installs.

use crate::script;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The interpreter that `tests/setup` made; `PALPUS_TEST_PYTHON` names another.
pub fn interpreter() -> PathBuf {
    let made = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/test-python/bin/python");
    std::env::var_os("PALPUS_TEST_PYTHON").map_or(made, PathBuf::from)
}

/// Runs a script of `tests/python` and returns what it printed on stdout.
///
/// # Panics
/// If the interpreter is not there, or the script fails; with what it printed.
pub fn run(script: &str, arguments: &[&Path]) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("python")
        .join(script);
    script::run(
        Command::new(interpreter()).arg(path).args(arguments),
        "Python with the tests' packages",
    )
}
