//! Up to eight strain gauges on a TI ADS131M08: simultaneous 24-bit bridge converter with an SPI.
//!
//! [`Ads131m08`] is a [`GaugeFrontEnd`] over any embedded-hal 1.0 [`SpiDevice`] (mode 1: clock idle low, data on the falling edge). The chip converts on
//! its own; a sample is one frame of ten 24-bit words, 30 us at 8 MHz, and that is the longest the driver ever keeps its caller. All gauges are
//! sampled at the same moment, so this is the front end for boards of 1 kHz and more.
//!
//! # What it detects
//!
//! | what happened | seen by | then |
//! |---|---|---|
//! | chip reset in mid-run | the reset flag of STATUS, or a register read back | counted, set up again over the next samples |
//! | chip missing, wire broken | CRC of the frame | gauges missing; a reset every [`BAD_LIMIT`] samples |
//! | no new conversion | data-ready bits of STATUS; counts that repeat | the last reading with its own time, which the board finds late |
//! | gauge saturated | count at the end of the range | flagged |
//!
//! Every other frame reads a configuration register back instead of STATUS, one after the other, so a changed register is found within ten samples.
//!
//! # What it does not do
//!
//! Open wires: the chip has no burn-out currents; an open input drifts into saturation. No waiting for the data-ready pin: who has it as an
//! interrupt calls `sample` from there.
//!
//! Source: ADS131M08 data sheet (SBAS950), sections 8.5 and 8.6.

use super::{GaugeFrontEnd, GaugeSample};
use embedded_hal::spi::SpiDevice;
use palpus_protocol::{GaugeFlags, MAX_GAUGES};

/// Channels of the chip.
pub const CHANNELS: usize = 8;
/// Bytes of a frame: response or command, eight channels, check sum, three bytes each.
pub const FRAME_BYTES: usize = 3 * (CHANNELS + 2);
/// Bad frames in a row after which the chip is reset.
pub const BAD_LIMIT: u8 = 3;
/// Largest count; the smallest is `-FULL_SCALE_COUNTS - 1`.
pub const FULL_SCALE_COUNTS: i32 = 0x7f_ffff;

const NULL: u16 = 0x0000;
const RESET: u16 = 0x0011;

const fn read_register(register: u8) -> u16 {
    0xa000 | ((register as u16) << 7)
}

const fn write_registers(first: u8, count: u16) -> u16 {
    0x6000 | ((first as u16) << 7) | (count - 1)
}

const MODE: u8 = 2;
/// 24-bit words, time-out on, reset flag cleared.
const MODE_VALUE: u16 = 0x0110;
/// All gains 128.
const GAIN_VALUE: u16 = 0x7777;
/// STATUS: the chip has been reset.
const STATUS_RESET: u16 = 1 << 10;

/// Conversions per second at a clock of 8.192 MHz.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rate {
    /// 1 000, for boards of up to 500 Hz.
    Sps1000 = 5,
    /// 2 000, for 1 kHz.
    #[default]
    Sps2000 = 4,
    /// 4 000.
    Sps4000 = 3,
}

/// What the next frame's first word will be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Response {
    /// The answer to a reset or a write; not looked at.
    Other,
    /// STATUS.
    Status,
    /// A register, by index into the configuration.
    Register(usize),
}

/// What the chip has been brought to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Nothing is known; a reset is due.
    Unknown,
    /// Reset; its registers are due.
    Fresh,
    /// Set up.
    Running,
}

/// What the driver has counted since it was made. Counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Times the chip was found reset or with a changed register.
    pub resets: u32,
    /// Frames with a wrong check sum, or refused by the SPI.
    pub bad_frames: u32,
    /// Frames without a new conversion.
    pub not_ready: u32,
}

/// Driver of one ADS131M08.
#[derive(Debug)]
pub struct Ads131m08<S> {
    spi: S,
    gauges: usize,
    /// MODE, CLOCK, GAIN1, GAIN2, CFG: registers 2 to 6.
    configuration: [u16; 5],
    state: State,
    response: Response,
    next_register: usize,
    bad: u8,
    half_conversion_us: u64,
    last: Option<GaugeSample>,
    counters: Counters,
}

impl<S: SpiDevice> Ads131m08<S> {
    /// A driver of the first `gauges` channels (1 to 8; more are taken as 8); nothing is sent before the first sample.
    pub fn new(spi: S, gauges: usize, rate: Rate) -> Self {
        // All channels on, high resolution.
        let clock = 0xff02 | ((rate as u16) << 2);
        let conversion_us = match rate {
            Rate::Sps1000 => 1_000,
            Rate::Sps2000 => 500,
            Rate::Sps4000 => 250,
        };
        Self {
            spi,
            gauges: gauges.clamp(1, CHANNELS),
            configuration: [MODE_VALUE, clock, GAIN_VALUE, GAIN_VALUE, 0x0600],
            state: State::Unknown,
            response: Response::Other,
            next_register: 0,
            bad: 0,
            half_conversion_us: conversion_us / 2,
            last: None,
            counters: Counters::default(),
        }
    }

    /// What has been counted.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// The SPI, for whoever shares it.
    pub const fn spi(&mut self) -> &mut S {
        &mut self.spi
    }

    /// Exchanges a frame: some words out, ten words in. `None` when the SPI failed or the check sum is wrong.
    fn exchange(&mut self, words: &[u16]) -> Option<[u8; FRAME_BYTES]> {
        let mut frame = [0; FRAME_BYTES];
        for (place, word) in frame.chunks_exact_mut(3).zip(words) {
            place[..2].copy_from_slice(&word.to_be_bytes());
        }
        let sent = self.spi.transfer_in_place(&mut frame).is_ok();
        let (body, check) = frame.split_at(FRAME_BYTES - 3);
        (sent && crc(body) == u16::from_be_bytes([check[0], check[1]])).then_some(frame)
    }

    /// One sample's exchange; a reading when there is a new one.
    fn step(&mut self, now_us: u64) -> Option<GaugeSample> {
        match self.state {
            State::Unknown => {
                // The frame's answer is that of the frame before, whatever it was. The chip needs 5 us; a period is longer.
                let _ = self.exchange(&[RESET]);
                self.state = State::Fresh;
                self.response = Response::Other;
                None
            }
            State::Fresh => {
                let [mode, clock, gain_1, gain_2, other] = self.configuration;
                let words = [write_registers(MODE, 5), mode, clock, gain_1, gain_2, other];
                let _ = self.exchange(&words);
                self.state = State::Running;
                self.response = Response::Other;
                self.bad = 0;
                None
            }
            State::Running => self.run(now_us),
        }
    }

    fn run(&mut self, now_us: u64) -> Option<GaugeSample> {
        let expected = self.response;
        // STATUS and the registers take turns.
        let (command, next) = if expected == Response::Status {
            let index = self.next_register;
            self.next_register = (index + 1) % self.configuration.len();
            (read_register(MODE + index as u8), Response::Register(index))
        } else {
            (NULL, Response::Status)
        };
        let Some(frame) = self.exchange(&[command]) else {
            self.counters.bad_frames = self.counters.bad_frames.wrapping_add(1);
            self.bad += 1;
            // What the chip made of the command is not known.
            self.response = Response::Other;
            if self.bad >= BAD_LIMIT {
                self.state = State::Unknown;
                self.bad = 0;
            }
            self.last = None;
            return None;
        };
        self.bad = 0;
        self.response = next;
        let word = u16::from_be_bytes([frame[0], frame[1]]);
        let lost = match expected {
            Response::Status => word & STATUS_RESET != 0,
            Response::Register(index) => word != self.configuration[index],
            Response::Other => false,
        };
        if lost {
            self.counters.resets = self.counters.resets.wrapping_add(1);
            self.state = State::Unknown;
            self.last = None;
            return None;
        }
        if expected == Response::Status && word & 0x00ff != 0x00ff {
            self.counters.not_ready = self.counters.not_ready.wrapping_add(1);
            return None;
        }
        if expected == Response::Other {
            // The first conversion after a reset or a set-up is not settled.
            return None;
        }
        let mut sample = GaugeSample::missing(now_us.saturating_sub(self.half_conversion_us));
        for gauge in 0..self.gauges {
            let at = 3 * (gauge + 1);
            let counts = i32::from_be_bytes([frame[at], frame[at + 1], frame[at + 2], 0]) >> 8;
            sample.counts[gauge] = counts;
            sample.flags[gauge] = if (-FULL_SCALE_COUNTS..FULL_SCALE_COUNTS).contains(&counts) {
                GaugeFlags::none()
            } else {
                GaugeFlags::SATURATED
            };
        }
        // A frame with a register says nothing of new data; 24 bits with their noise do not repeat.
        if self
            .last
            .is_some_and(|last| last.counts[..self.gauges] == sample.counts[..self.gauges])
        {
            self.counters.not_ready = self.counters.not_ready.wrapping_add(1);
            return None;
        }
        Some(sample)
    }
}

impl<S: SpiDevice> GaugeFrontEnd for Ads131m08<S> {
    fn gauges(&self) -> usize {
        self.gauges.min(MAX_GAUGES)
    }

    fn sample(&mut self, now_us: u64) -> GaugeSample {
        if let Some(sample) = self.step(now_us) {
            self.last = Some(sample);
        }
        self.last.unwrap_or(GaugeSample::missing(now_us))
    }

    fn chip_resets(&self) -> u32 {
        self.counters.resets
    }
}

/// The chip's check sum: CCITT, polynomial 0x1021, all ones at the start. Half a byte at a time, a table of 32 bytes.
pub fn crc(bytes: &[u8]) -> u16 {
    const TABLE: [u16; 16] = {
        let mut table = [0; 16];
        let mut index = 0;
        while index < 16 {
            let mut remainder = (index as u16) << 12;
            let mut bit = 0;
            while bit < 4 {
                remainder = if remainder & 0x8000 != 0 {
                    (remainder << 1) ^ 0x1021
                } else {
                    remainder << 1
                };
                bit += 1;
            }
            table[index] = remainder;
            index += 1;
        }
        table
    };
    let step = |remainder: u16, half: u8| {
        (remainder << 4) ^ TABLE[usize::from((remainder >> 12) as u8 ^ half)]
    };
    bytes.iter().fold(0xffff, |remainder, byte| {
        step(step(remainder, byte >> 4), byte & 15)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_sum_is_ccitt() {
        // CRC-16/IBM-3740's check value.
        assert_eq!(crc(b"123456789"), 0x29b1);
    }
}
