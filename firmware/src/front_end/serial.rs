//! Front ends at the end of serial lines: three bridge converters, and a bus of encoders.
//!
//! The drivers ([`Ads122u04`], [`Amt21Bus`]) know bytes and times. Here they meet a [`SerialLine`], which is all that is asked
//! of a UART: to take bytes without waiting. Whoever owns the interrupts calls `receive` for each byte that came and
//! `elapse` now and then (every 0.1 ms is plenty); the board calls `sample` once per period.
//!
//! A sample holds the conversions of the period before, so a contact is about one period old when it is sent, and says so
//! in its time.

use super::ads122u04::{self, Ads122u04};
use super::amt21::{self, Amt21Bus, EncoderFault};
use super::{GaugeFrontEnd, GaugeSample, JOINTS, JointFrontEnd, JointSample, JointState};
use core::f32::consts::TAU;
use palpus_protocol::{GaugeFlags, MAX_GAUGES};

/// Where a front end's bytes go.
pub trait SerialLine {
    /// Takes bytes to send. Must not wait; at most 32 bytes are ever under way.
    fn send(&mut self, bytes: &[u8]);
}

/// Up to four bridge converters of two gauges each, one line for each.
#[derive(Debug)]
pub struct BridgeConverters<L, const CHIPS: usize> {
    chips: [Ads122u04; CHIPS],
    lines: [L; CHIPS],
    conversion_us: u32,
    last_good_us: u64,
}

impl<L: SerialLine, const CHIPS: usize> BridgeConverters<L, CHIPS> {
    const FITS: () = assert!(CHIPS > 0 && CHIPS * ads122u04::CHANNELS <= MAX_GAUGES);

    /// Converters on these lines; nothing is sent before the first sample.
    pub fn new(timing: ads122u04::Timing, lines: [L; CHIPS]) -> Self {
        const { Self::FITS }
        Self {
            chips: core::array::from_fn(|_| Ads122u04::new(timing)),
            lines,
            conversion_us: timing.conversion_us,
            last_good_us: 0,
        }
    }

    /// The line of a chip, for the interrupt that sends from it.
    pub fn line(&mut self, chip: usize) -> Option<&mut L> {
        self.lines.get_mut(chip)
    }

    /// Takes a byte that came on a chip's line.
    pub fn receive(&mut self, chip: usize, byte: u8, now_us: u64) {
        if let (Some(driver), Some(line)) = (self.chips.get_mut(chip), self.lines.get_mut(chip)) {
            let mut out = ads122u04::Outgoing::new();
            driver.receive(byte, now_us, &mut out);
            transmit(line, &out);
        }
    }

    /// Does what is due.
    pub fn elapse(&mut self, now_us: u64) {
        for (driver, line) in self.chips.iter_mut().zip(&mut self.lines) {
            let mut out = ads122u04::Outgoing::new();
            driver.elapse(now_us, &mut out);
            transmit(line, &out);
        }
    }

    /// What each chip's driver has counted.
    pub fn counters(&self) -> [ads122u04::Counters; CHIPS] {
        core::array::from_fn(|chip| self.chips[chip].counters())
    }
}

impl<L: SerialLine, const CHIPS: usize> GaugeFrontEnd for BridgeConverters<L, CHIPS> {
    fn gauges(&self) -> usize {
        CHIPS * ads122u04::CHANNELS
    }

    fn sample(&mut self, now_us: u64) -> GaugeSample {
        let mut sample = GaugeSample::missing(now_us);
        let (mut sum_us, mut good) = (0_u64, 0_u64);
        for (chip, driver) in self.chips.iter_mut().enumerate() {
            for (channel, reading) in driver.take().into_iter().enumerate() {
                let gauge = chip * ads122u04::CHANNELS + channel;
                sample.counts[gauge] = reading.counts;
                sample.flags[gauge] = reading.flags;
                let absent = GaugeFlags::MISSING.union(GaugeFlags::LATE);
                if reading.flags.bits() & absent.bits() == 0 {
                    sum_us += reading.started_us;
                    good += 1;
                }
            }
        }
        if let Some(mean_us) = sum_us.checked_div(good) {
            self.last_good_us = mean_us + u64::from(self.conversion_us) / 2;
        }
        sample.time_us = self.last_good_us;
        for (driver, line) in self.chips.iter_mut().zip(&mut self.lines) {
            let mut out = ads122u04::Outgoing::new();
            driver.begin(now_us, &mut out);
            transmit(line, &out);
        }
        sample
    }

    fn chip_resets(&self) -> u32 {
        self.chips
            .iter()
            .fold(0, |sum, chip| sum.wrapping_add(chip.counters().resets))
    }
}

/// How an encoder sits on its joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JointMount {
    /// Steps at the joint's zero.
    pub zero_steps: u16,
    /// Whether the encoder counts down when the joint's angle grows.
    pub reversed: bool,
}

impl JointMount {
    /// The joint's angle, -pi (included) to pi, rad.
    pub fn angle_rad(self, steps: u16) -> f32 {
        const HALF: i32 = amt21::STEPS_PER_TURN as i32 / 2;
        let mut turned = i32::from(steps) - i32::from(self.zero_steps);
        if self.reversed {
            turned = -turned;
        }
        let wrapped = (turned + HALF).rem_euclid(2 * HALF) - HALF;
        wrapped as f32 * (TAU / f32::from(amt21::STEPS_PER_TURN))
    }
}

/// The encoders of a finger on one RS-485 line.
#[derive(Debug)]
pub struct EncoderBus<L> {
    bus: Amt21Bus,
    line: L,
    mounts: [JointMount; JOINTS],
    angles_rad: [f32; JOINTS],
    read_us: [Option<u64>; JOINTS],
    states: [JointState; JOINTS],
    asked_us: u64,
}

impl<L: SerialLine> EncoderBus<L> {
    /// Encoders on this line, base joint first; nothing is sent before the first sample.
    pub const fn new(bus: Amt21Bus, mounts: [JointMount; JOINTS], line: L) -> Self {
        Self {
            bus,
            line,
            mounts,
            angles_rad: [0.0; JOINTS],
            read_us: [None; JOINTS],
            states: [JointState::Missing; JOINTS],
            asked_us: 0,
        }
    }

    /// The line, for the interrupt that sends from it.
    pub const fn line(&mut self) -> &mut L {
        &mut self.line
    }

    /// Takes a byte that came on the line.
    pub fn receive(&mut self, byte: u8, now_us: u64) {
        let mut out = amt21::Outgoing::new();
        self.bus.receive(byte, now_us, &mut out);
        transmit(&mut self.line, &out);
    }

    /// Does what is due.
    pub fn elapse(&mut self, now_us: u64) {
        let mut out = amt21::Outgoing::new();
        self.bus.elapse(now_us, &mut out);
        transmit(&mut self.line, &out);
    }

    /// What the driver has counted.
    pub const fn counters(&self) -> amt21::Counters {
        self.bus.counters()
    }
}

impl<L: SerialLine> JointFrontEnd for EncoderBus<L> {
    fn sample(&mut self, now_us: u64) -> JointSample {
        for (joint, result) in self.bus.take().into_iter().enumerate() {
            self.states[joint] = match result {
                Ok(steps) => {
                    self.angles_rad[joint] = self.mounts[joint].angle_rad(steps);
                    self.read_us[joint] = Some(self.asked_us);
                    JointState::Good
                }
                Err(EncoderFault::CheckBits) if self.read_us[joint].is_some() => {
                    JointState::BadCheck
                }
                Err(EncoderFault::CheckBits | EncoderFault::Silent) => JointState::Missing,
                // What was known stays known, and grows old.
                Err(EncoderFault::NotAsked) => self.states[joint],
            };
        }
        let oldest_us = self
            .read_us
            .iter()
            .map(|read| read.unwrap_or(0))
            .min()
            .unwrap_or(0);
        let sample = JointSample {
            time_us: oldest_us,
            angles_rad: self.angles_rad,
            states: self.states,
        };
        self.asked_us = now_us;
        let mut out = amt21::Outgoing::new();
        self.bus.begin(now_us, &mut out);
        transmit(&mut self.line, &out);
        sample
    }
}

fn transmit(line: &mut impl SerialLine, bytes: &[u8]) {
    if !bytes.is_empty() {
        line.send(bytes);
    }
}
