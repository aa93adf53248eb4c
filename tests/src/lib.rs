//! Shared fixtures of the whole-program tests.

pub mod emulator;
pub mod bench_board;
pub mod fault_line;
