//! The line to a fingertip board: serial port, framing, commands, clock alignment, counters.

pub mod clock;
