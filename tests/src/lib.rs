//! Shared fixtures of the whole-program tests.

pub mod emulator;
