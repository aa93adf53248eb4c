//! Hands what libFuzzer makes up to the target that `PALPUS_FUZZ_TARGET` names.
//!
//! One program for all targets: it is built in minutes, and only once.
#![no_main]

use libfuzzer_sys::fuzz_target;
use palpus_tests::fuzz::{Target, find};
use std::sync::LazyLock;

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("PALPUS_FUZZ_TARGET").expect("PALPUS_FUZZ_TARGET names a target");
    find(&name).expect("PALPUS_FUZZ_TARGET is one of palpus_tests::fuzz::TARGETS")
});

fuzz_target!(|bytes: &[u8]| (TARGET.run)(bytes));
