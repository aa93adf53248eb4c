//! The whole board on the host: simulated gauges and encoders in, frames out, commands and faults
//! in between.

mod abuse;
mod bench;
mod commands;
mod faults;
mod line;
mod sensing;
