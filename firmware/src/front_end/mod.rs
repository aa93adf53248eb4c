//! What stands between the board and its converters: gauges and joint encoders behind two traits.
//!
//! A front end never waits. Conversions run on their own (interrupts, DMA, a simulated hand); once per period the board asks for what
//! there is and starts the next round. So a tick's length does not depend on a chip's mood, and a chip that is silent, reset or broken
//! shows as flags in a sample instead of as a hung board.

pub mod ads122u04;
pub mod ads131m08;
pub mod amt21;
pub mod serial;

use palpus_protocol::{GaugeFlags, MAX_GAUGES};

/// Joints of a finger.
pub const JOINTS: usize = 3;

/// One reading of all gauges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugeSample {
    /// When the gauges were read, board time in us: the middle of the round of conversions, or what is known of it.
    pub time_us: u64,
    /// Counts, in the order of the calibration's columns; entries beyond the front end's number of gauges are ignored.
    pub counts: [i32; MAX_GAUGES],
    /// What is wrong with each. The count of a gauge that is `MISSING` has no meaning. Age and lack of change are judged by the board as well,
    /// so a front end sets `LATE` and `STUCK` only for what it alone can see.
    pub flags: [GaugeFlags; MAX_GAUGES],
}

impl GaugeSample {
    /// A sample in which every gauge is missing, to be filled in.
    pub const fn missing(time_us: u64) -> Self {
        Self {
            time_us,
            counts: [0; MAX_GAUGES],
            flags: [GaugeFlags::MISSING; MAX_GAUGES],
        }
    }
}

/// The bridge converters of one finger tip.
pub trait GaugeFrontEnd {
    /// Number of gauges, 1 to [`MAX_GAUGES`]; never changes.
    fn gauges(&self) -> usize;

    /// The newest complete reading, taken without waiting; also starts the next round where conversions don't run freely.
    ///
    /// Called once per period with the board time. Where there is nothing new, the last reading with its own time is right: the board marks it as late.
    fn sample(&mut self, now_us: u64) -> GaugeSample;

    /// How many times a chip was found reset and has been set up again.
    fn chip_resets(&self) -> u32 {
        0
    }
}

/// State of one joint angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum JointState {
    /// Read and checked.
    Good,
    /// No answer yet, or none in time; the angle has no meaning.
    #[default]
    Missing,
    /// The answer failed its check bits; the angle is the last good one, if any.
    BadCheck,
}

/// One reading of the joint angles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointSample {
    /// When the angles were read, board time in us (the oldest of them).
    pub time_us: u64,
    /// Angles, base joint first, rad.
    pub angles_rad: [f32; JOINTS],
    /// Whether each can be trusted.
    pub states: [JointState; JOINTS],
}

/// The joint encoders of one finger.
pub trait JointFrontEnd {
    /// The newest angles, taken without waiting; also starts the next round. Called once per period with the board time.
    fn sample(&mut self, now_us: u64) -> JointSample;
}

// A front end that the caller keeps, as tests and simulations do.
impl<G: GaugeFrontEnd + ?Sized> GaugeFrontEnd for &mut G {
    fn gauges(&self) -> usize {
        (**self).gauges()
    }

    fn sample(&mut self, now_us: u64) -> GaugeSample {
        (**self).sample(now_us)
    }

    fn chip_resets(&self) -> u32 {
        (**self).chip_resets()
    }
}

impl<J: JointFrontEnd + ?Sized> JointFrontEnd for &mut J {
    fn sample(&mut self, now_us: u64) -> JointSample {
        (**self).sample(now_us)
    }
}
