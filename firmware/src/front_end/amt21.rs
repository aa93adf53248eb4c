//! Joint angles from CUI AMT21 absolute encoders on one RS-485 bus.
//!
//! [`Amt21Bus`] asks the encoders of a finger one after the other, as a state machine without a UART: bytes and times in,
//! bytes and a deadline out. The two-wire bus is half duplex; who owns the UART drives the transceiver's direction pin
//! while bytes go out and drops it within 11 us of the last stop bit (3 us at 2 MBd), before the answer begins.
//!
//! A question is the encoder's address; the answer is two bytes, low byte first: 14 bits of position and two check bits,
//! each the inverse of the exclusive or of one half of the position's bits. An answer with wrong check bits is asked for
//! once more, after the bus has been silent for a while: what still comes belongs to what was wrong.
//!
//! Two check bits let one in four pass of what is no answer at all. But then the true answer comes too, and is one too many: a byte that
//! comes when none is due makes what was read before in the same round doubtful.
//!
//! An answer does not say whose it is. So after an encoder stayed silent, or a byte came that nobody had asked for, the bus is left alone for
//! [`QUIET_PERIODS`] periods, long enough for whatever is under way to end; an answer that comes too late can't be taken for another encoder's.
//! The next round then begins behind the silent encoder, so that one that is dead does not hide the others.
//!
//! Source: AMT21 data sheet, sections "serial interface" and "checksum".

use super::JOINTS;
use heapless::Vec;

/// Bytes for the bus.
pub type Outgoing = Vec<u8, 32>;

/// Steps in one turn, as they are sent; a 12-bit encoder sends its position times 4.
pub const STEPS_PER_TURN: u16 = 1 << 14;

/// Tries at one encoder in one period.
const TRIES: u8 = 2;

/// Periods without a question after something went wrong: 20 ms at 200 Hz.
pub const QUIET_PERIODS: u8 = 4;

/// Why there is no angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderFault {
    /// No answer, or half of one.
    Silent,
    /// Both tries had wrong check bits.
    CheckBits,
    /// It was not asked in this period.
    NotAsked,
}

/// Times on the bus, in us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// From the start of a period to the moment at which no answer is waited for any more.
    pub give_up_us: u32,
    /// Silence after wrong check bits; longer than a question and its answer.
    pub silence_us: u32,
}

impl Timing {
    /// 115 200 Bd, 200 Hz: a question and its answer take 0.28 ms.
    pub const AT_115200: Self = Self {
        give_up_us: 4_200,
        silence_us: 350,
    };
}

/// What the driver has counted since it was made. Counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Answers with wrong check bits.
    pub check_errors: u32,
    /// Questions without a whole answer.
    pub timeouts: u32,
    /// Bytes that nobody had asked for.
    pub strays: u32,
}

/// The encoders of one finger.
#[derive(Debug)]
pub struct Amt21Bus {
    addresses: [u8; JOINTS],
    timing: Timing,
    period_us: u64,
    /// The encoder that a round begins with: the base joint's, after a whole round.
    first: usize,
    /// Encoders of this round that are done; `JOINTS` when all are.
    done: usize,
    tries: u8,
    quiet: u8,
    low: Option<u8>,
    /// After wrong check bits: when the bus will have been silent for long enough.
    silent_us: Option<u64>,
    results: [Result<u16, EncoderFault>; JOINTS],
    counters: Counters,
}

impl Amt21Bus {
    /// A bus with encoders at these addresses (multiples of 4), in the order of the joints.
    pub const fn new(addresses: [u8; JOINTS], timing: Timing) -> Self {
        Self {
            addresses,
            timing,
            period_us: 0,
            first: 0,
            done: JOINTS,
            tries: 0,
            quiet: 0,
            low: None,
            silent_us: None,
            results: [Err(EncoderFault::NotAsked); JOINTS],
            counters: Counters {
                check_errors: 0,
                timeouts: 0,
                strays: 0,
            },
        }
    }

    /// What has been counted.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Whether every encoder has answered or been given up.
    pub const fn is_finished(&self) -> bool {
        self.done >= JOINTS
    }

    /// The encoder whose turn it is.
    const fn asked(&self) -> usize {
        (self.first + self.done) % JOINTS
    }

    /// The time at which [`Amt21Bus::elapse`] wants to be called; `None` while nothing runs.
    pub const fn deadline_us(&self) -> Option<u64> {
        if self.is_finished() {
            return None;
        }
        match self.silent_us {
            Some(silent_us) if silent_us < self.give_up_us() => Some(silent_us),
            _ => Some(self.give_up_us()),
        }
    }

    const fn give_up_us(&self) -> u64 {
        self.period_us + self.timing.give_up_us as u64
    }

    /// Starts a period: all encoders are asked again, unless the bus is left alone.
    pub fn begin(&mut self, now_us: u64, out: &mut Outgoing) {
        if !self.is_finished() {
            self.give_up();
        }
        self.results = [Err(EncoderFault::NotAsked); JOINTS];
        if self.quiet > 0 {
            self.quiet -= 1;
            return;
        }
        self.period_us = now_us;
        self.done = 0;
        self.tries = 0;
        self.ask(out);
    }

    /// Ends a period and gives the steps of each joint, 0 to [`STEPS_PER_TURN`] - 1.
    pub fn take(&mut self) -> [Result<u16, EncoderFault>; JOINTS] {
        if !self.is_finished() {
            self.give_up();
        }
        self.results
    }

    /// Takes one byte from the bus.
    pub fn receive(&mut self, byte: u8, now_us: u64, out: &mut Outgoing) {
        if self.is_finished() {
            self.quiet = QUIET_PERIODS;
            self.doubt();
            return;
        }
        if self.silent_us.is_some() {
            self.await_silence(now_us);
            self.doubt();
            return;
        }
        let Some(low) = self.low.take() else {
            self.low = Some(byte);
            return;
        };
        match position(u16::from_le_bytes([low, byte])) {
            Some(steps) => {
                self.results[self.asked()] = Ok(steps);
                self.next(out);
            }
            None => {
                self.counters.check_errors = self.counters.check_errors.wrapping_add(1);
                self.results[self.asked()] = Err(EncoderFault::CheckBits);
                self.tries += 1;
                self.await_silence(now_us);
            }
        }
    }

    /// Notes a byte that nobody had asked for: what was read in this round may be out of step.
    fn doubt(&mut self) {
        self.counters.strays = self.counters.strays.wrapping_add(1);
        for result in &mut self.results {
            *result = result.and(Err(EncoderFault::CheckBits));
        }
    }

    fn await_silence(&mut self, now_us: u64) {
        self.silent_us = Some(now_us + u64::from(self.timing.silence_us));
    }

    /// Does what is due at `now_us`; to be called at [`Amt21Bus::deadline_us`] or later.
    pub fn elapse(&mut self, now_us: u64, out: &mut Outgoing) {
        if self.deadline_us().is_none_or(|deadline| now_us < deadline) {
            return;
        }
        if now_us >= self.give_up_us() {
            self.give_up();
        } else if self.tries < TRIES {
            self.ask(out);
        } else {
            self.next(out);
        }
    }

    fn give_up(&mut self) {
        self.counters.timeouts = self.counters.timeouts.wrapping_add(1);
        let silent = self.asked();
        if self.results[silent] == Err(EncoderFault::NotAsked) {
            self.results[silent] = Err(EncoderFault::Silent);
        }
        self.first = (silent + 1) % JOINTS;
        self.done = JOINTS;
        self.quiet = QUIET_PERIODS;
    }

    fn next(&mut self, out: &mut Outgoing) {
        self.done += 1;
        self.tries = 0;
        if self.is_finished() {
            self.first = 0;
        }
        self.ask(out);
    }

    fn ask(&mut self, out: &mut Outgoing) {
        self.low = None;
        self.silent_us = None;
        if !self.is_finished() {
            // One byte into an empty buffer.
            let _ = out.push(self.addresses[self.asked()]);
        }
    }
}

/// The position in an answer; `None` when its check bits are wrong.
pub const fn position(answer: u16) -> Option<u16> {
    let odd = (answer & 0xaaaa).count_ones() % 2;
    let even = (answer & 0x5555).count_ones() % 2;
    // With its inverted check bit, each half has an odd number of ones.
    if odd == 1 && even == 1 {
        Some(answer & 0x3fff)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_damaged_bit_is_noticed() {
        // The data sheet's example, and the all-zero answer of a bus that is held low.
        assert_eq!(position(0x61ab), Some(8_619));
        assert_eq!(position(0x0000), None);
        for bit in 0..16 {
            assert_eq!(position(0x61ab ^ (1 << bit)), None);
        }
    }
}
