//! A capture in a process of its own, to be killed.
//!
//! The test program starts itself again with [`CHILD`] set; the test that stands for the child then captures until
//! it is killed.

use palpus_host::hand::Hand;
use palpus_host::run::capture::{CaptureEvent, CaptureSettings, capture};
use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;

/// Environment variable: `FINGER=PORT;OUTPUT`.
pub const CHILD: &str = "PALPUS_TEST_CAPTURE_CHILD";

/// Captures as the environment says, until killed, printing a line once it runs; returns at once in a process that
/// is no child.
pub fn capture_if_child() {
    let Ok(task) = std::env::var(CHILD) else {
        return;
    };
    let (finger, output) = task.split_once(';').expect("FINGER=PORT;OUTPUT");
    let (name, port) = finger.split_once('=').expect("FINGER=PORT");
    let settings = CaptureSettings {
        replace: true,
        ..CaptureSettings::every_contact(
            vec![(name.into(), port.into())],
            vec![("three_finger.urdf".into(), Hand::THREE_FINGER_URDF.into())],
            output.into(),
        )
    };
    let mut said = false;
    let result = capture(&settings, &AtomicBool::new(false), &mut |event| {
        if let CaptureEvent::Progress(_) = event
            && !said
        {
            said = true;
            println!("\nrunning");
            let _ = std::io::stdout().flush();
        }
    });
    panic!("a capture that should have been killed ended: {result:?}");
}

/// Starts this test program's test `test` as a capturing child.
pub fn start_child(test: &str, finger: &str, port: &str, output: &Path) -> Child {
    Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", test, "--nocapture"])
        .env(CHILD, format!("{finger}={port};{}", output.display()))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("this program starts again")
}
