//! The front ends with their chips, in virtual time of 1 us.
//!
//! What the chips measure changes from period to period, so that a count or an angle tells when it was measured; each gauge and joint has
//! values of its own, so that it tells where. [`Rig::bad`] then holds every sample against the truth.

use crate::ads122u04::{Ads122u04, Input};
use crate::amt21::Encoder;
use crate::line::Line;
use palpus_firmware::front_end::serial::{BridgeConverters, EncoderBus, JointMount};
use palpus_firmware::front_end::{
    GaugeFrontEnd, GaugeSample, JointFrontEnd, JointSample, JointState, ads122u04, amt21,
};
use palpus_protocol::GaugeFlags;

pub const PERIOD_US: u64 = 5_000;
const BEAT_US: u64 = 100;
const VOLTS_PER_COUNT: f64 = 3.3 / 128.0 / 8_388_608.0;

pub struct Rig {
    pub converters: [Ads122u04; 3],
    pub encoders: [Encoder; 3],
    /// What stands at a gauge instead of its own voltage.
    pub instead: [Option<Input>; 6],
    pub bridges: BridgeConverters<crate::line::Wire, 3>,
    pub bus: EncoderBus<crate::line::Wire>,
    pub lines: [Line; 4],
    pub now_us: u64,
    pub samples: Vec<GaugeSample>,
    pub angles: Vec<JointSample>,
}

/// Count of a gauge in a period.
pub fn true_counts(gauge: usize, period: u64) -> i32 {
    (gauge as i32 - 2) * 1_000_000 + 37 * period as i32
}

/// Angle of a joint in a period, in the encoder's steps.
pub fn true_steps(joint: usize, period: u64) -> u64 {
    (4_000 * joint as u64 + 3 * period) % 16_384
}

impl Rig {
    pub fn new() -> Self {
        let lines: [Line; 4] = Default::default();
        let wires = [0, 1, 2].map(|line: usize| lines[line].wire.clone());
        let addresses = [0x54, 0x58, 0x5c];
        Self {
            converters: Default::default(),
            encoders: addresses.map(|address| Encoder {
                address,
                ..Encoder::default()
            }),
            instead: [None; 6],
            bridges: BridgeConverters::new(ads122u04::Timing::AT_115200, wires),
            bus: EncoderBus::new(
                amt21::Amt21Bus::new(addresses, amt21::Timing::AT_115200),
                [JointMount::default(); 3],
                lines[3].wire.clone(),
            ),
            lines,
            now_us: 0,
            samples: Vec::new(),
            angles: Vec::new(),
        }
    }

    /// A rig that has run for ten periods.
    pub fn running() -> Self {
        let mut rig = Self::new();
        rig.run(10);
        assert_eq!(rig.bad(5), [0; 6]);
        rig
    }

    /// Period that runs, from 0.
    pub fn period(&self) -> u64 {
        self.now_us / PERIOD_US
    }

    /// Runs to the beginning of a later period.
    pub fn run(&mut self, periods: u64) {
        self.run_to((self.period() + periods) * PERIOD_US);
    }

    pub fn run_to(&mut self, until_us: u64) {
        while self.now_us < until_us {
            self.step();
            self.now_us += 1;
        }
    }

    fn step(&mut self) {
        let now_us = self.now_us;
        let period = self.period();
        for chip in 0..3 {
            if let Some(byte) = self.lines[chip].at_chip(now_us) {
                let instead = &self.instead;
                let answer = self.converters[chip].receive(byte, now_us, |channel| {
                    let gauge = 2 * chip + channel;
                    let volts = f64::from(true_counts(gauge, period)) * VOLTS_PER_COUNT;
                    instead[gauge].unwrap_or(Input::Volts(volts))
                });
                self.lines[chip].answer(&answer, now_us);
            }
            if let Some(byte) = self.lines[chip].at_board(now_us) {
                self.bridges.receive(chip, byte, now_us);
            }
        }
        if let Some(byte) = self.lines[3].at_chip(now_us) {
            for (joint, encoder) in self.encoders.iter().enumerate() {
                let angle_rad =
                    true_steps(joint, period) as f64 / 16_384.0 * core::f64::consts::TAU;
                if let Some(answer) = encoder.answer(byte, angle_rad) {
                    self.lines[3].answer(&answer, now_us);
                }
            }
        }
        if let Some(byte) = self.lines[3].at_board(now_us) {
            self.bus.receive(byte, now_us);
        }
        if now_us.is_multiple_of(BEAT_US) {
            self.bridges.elapse(now_us);
            self.bus.elapse(now_us);
        }
        if now_us.is_multiple_of(PERIOD_US) {
            self.samples.push(self.bridges.sample(now_us));
            self.angles.push(self.bus.sample(now_us));
        }
    }

    /// How often each gauge was flagged in the samples from this one on. A gauge that is not flagged must be what it was in the period
    /// that the sample was made in.
    pub fn bad(&self, from: usize) -> [usize; 6] {
        let mut bad = [0; 6];
        for (number, sample) in self.samples.iter().enumerate().skip(from) {
            for gauge in 0..6 {
                if sample.flags[gauge] == GaugeFlags::none() {
                    let truth = true_counts(gauge, number as u64 - 1);
                    assert_eq!(
                        sample.counts[gauge], truth,
                        "gauge {gauge} in sample {number}"
                    );
                } else {
                    bad[gauge] += 1;
                }
            }
        }
        bad
    }

    /// How often each joint was bad or old. One that is neither must be what it was.
    pub fn bad_joints(&self, from: usize) -> [usize; 3] {
        let mut bad = [0; 3];
        for (number, sample) in self.angles.iter().enumerate().skip(from) {
            let fresh = sample.time_us == (number as u64 - 1) * PERIOD_US;
            for joint in 0..3 {
                if sample.states[joint] != JointState::Good {
                    bad[joint] += 1;
                } else if fresh {
                    let steps = true_steps(joint, number as u64 - 1) as f32 / 16_384.0;
                    let turned = sample.angles_rad[joint] / core::f32::consts::TAU;
                    let miss = (steps - turned).rem_euclid(1.0);
                    assert!(
                        miss.min(1.0 - miss) < 1e-6,
                        "joint {joint} in sample {number}"
                    );
                }
            }
        }
        bad
    }
}
