//! The program `palpus` as a user runs it.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// Path of the program, built first in the profile of the running test.
///
/// # Panics
/// When it can't be built.
pub fn palpus() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        // target/PROFILE/deps/TEST
        let test = std::env::current_exe().expect("the running test");
        let profile = test
            .parent()
            .and_then(Path::parent)
            .expect("the profile's folder");
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut build = Command::new(cargo);
        build.args([
            "build",
            "--quiet",
            "--package",
            "palpus-host",
            "--bin",
            "palpus",
            "--target-dir",
        ]);
        build.arg(profile.parent().expect("the target folder"));
        if profile.ends_with("release") {
            build.arg("--release");
        }
        let built = build
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status()
            .expect("cargo");
        assert!(built.success(), "palpus can't be built");
        profile.join("palpus")
    })
}

/// Runs the program and returns what came of it.
///
/// # Panics
/// When it can't be started.
pub fn run(arguments: &[&str]) -> Output {
    Command::new(palpus())
        .args(arguments)
        .output()
        .expect("palpus starts")
}

/// Runs the program, which must succeed, and returns the JSON it printed.
///
/// # Panics
/// When it fails or prints something else.
pub fn run_json(arguments: &[&str]) -> serde_json::Value {
    let output = run(arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "palpus {arguments:?}: {} {said}",
        output.status
    );
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("palpus {arguments:?}: {error}; {said}"))
}
