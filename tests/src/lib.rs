//! Shared fixtures of the whole-program tests.

pub mod bench_board;
pub mod browser;
pub mod emulator;
pub mod fault_line;
pub mod fuzz;
pub mod kill;
pub mod outcome;
pub mod patches;
pub mod program;
pub mod python;
pub mod script;
pub mod simulated_line;
