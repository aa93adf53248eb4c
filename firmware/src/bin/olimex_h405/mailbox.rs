//! The front ends' last results, handed over to the board by value.
//!
//! The drivers live with their interrupts, above the board's priority. A tick takes their results, puts them here, and lets the board
//! find them through the traits; so the board never holds the drivers' lock.

use palpus_firmware::front_end::{GaugeFrontEnd, GaugeSample, JointFrontEnd, JointSample};

/// Gauges of this board.
pub const GAUGES: usize = 6;

/// A gauge sample on its way.
pub struct Gauges {
    /// The sample.
    pub sample: GaugeSample,
    /// Chip resets so far.
    pub resets: u32,
}

impl GaugeFrontEnd for Gauges {
    fn gauges(&self) -> usize {
        GAUGES
    }

    fn sample(&mut self, _now_us: u64) -> GaugeSample {
        self.sample
    }

    fn chip_resets(&self) -> u32 {
        self.resets
    }
}

/// A joint sample on its way.
#[derive(Default)]
pub struct Joints(pub JointSample);

impl JointFrontEnd for Joints {
    fn sample(&mut self, _now_us: u64) -> JointSample {
        self.0
    }
}
