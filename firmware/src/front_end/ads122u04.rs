//! Two strain gauges on a TI ADS122U04: 24-bit bridge converter with a gain of 128 and a UART.
//!
//! [`Ads122u04`] is the driver as a state machine without a UART: it is handed bytes and times, and hands back bytes to
//! send and the time at which it wants to be called again. So it runs on any UART, from an interrupt or a loop, and in
//! tests without either. It never waits and no call takes longer than one reply's check sum.
//!
//! # One period
//!
//! For each of the two channels: select it and start a conversion, wait for it, read counter, data and CRC. After that,
//! when time is left, one configuration register is read back, another in each period. At 115 200 Bd the two channels take
//! 2 x (5 bytes + 0.52 ms + 2 bytes + 6 bytes) = 3.3 ms and the read-back 0.43 ms.
//!
//! A result is taken when the chip's counter says that all conversions started since the last one taken have ended: not that of another
//! channel which was never read, and no answer that came too late. Where that can't be known (after a set-up, or when conversions did not
//! end), the data are read once right after a start, which stops whatever still ran: that gives the counter that the new result follows. It
//! takes no time of its own, since the conversion runs meanwhile. When periods go on ending badly, one begins with the read-back of a register.
//!
//! # What it detects
//!
//! | what happened | seen by | then |
//! |---|---|---|
//! | chip reset in mid-run | an answer ends after the length of a chip without check sums, or a read-back register differs | counted, set up again in the next period |
//! | chip missing or silent | no answer by the period's end | channels missing; a reset is tried every period |
//! | bad bytes | CRC of the answer | read again (the chip keeps the result); counted |
//! | bytes that nobody asked for (noise, an answer from before) | no answer is due | counted and dropped |
//! | conversions slower than expected | the result counter | up to a third longer: nothing, since the question takes its time; beyond: read again |
//! | conversions stand still | the result counter | read again, then late, after [`STALLED_LIMIT`] periods a reset |
//! | gauge saturated | count at the end of the range | flagged, and looked at again at gain 1 |
//! | bridge open | with 10 uA of burn-out current at gain 1, more than [`OPEN_LIMIT_COUNTS`] | flagged open |
//!
//! # What it does not do
//!
//! No current sources, no temperature sensor, no conversion faster than single shots: 2 000 single shots a second is the
//! chip's turbo limit, and 115 200 Bd carry about 390 pairs of channels a second.
//!
//! Register map and commands: ADS122U04 data sheet (SBAS752), sections 8.5 and 8.6.

use heapless::Vec;
use palpus_protocol::GaugeFlags;

/// Bytes for the chip, in the order they go out.
pub type Outgoing = Vec<u8, 32>;

/// Channels of one chip.
pub const CHANNELS: usize = 2;

/// Largest count; the smallest is `-FULL_SCALE_COUNTS - 1`.
pub const FULL_SCALE_COUNTS: i32 = 0x7f_ffff;

/// At gain 1 and 3.3 V reference, 100 mV: ten times what a 1 mV/V bridge on 3.3 V gives at three times its load, and a
/// thirtieth of what 10 uA give on an open wire.
pub const OPEN_LIMIT_COUNTS: i32 = 254_200;

/// Periods without a new conversion after which the chip is reset.
pub const STALLED_LIMIT: u8 = 3;

/// Periods in a row that end badly before one begins with the read-back of a register.
const BAD_BEFORE_PROBING: u8 = 3;

/// Conversions without a result after which the counter is learned anew; it has eight bits.
const UNREAD_LIMIT: u8 = 100;

/// Periods between two looks at a saturated channel.
const LOOK_EVERY: u8 = 20;

/// Silence, in bytes of line time, after which an answer has ended, however short it is.
const ANSWER_PAUSE_BYTES: u64 = 4;

/// Most bytes of an answer: counter, three of data, two of CRC.
const ANSWER_BYTES: usize = 6;

const SYNC: u8 = 0x55;
const RESET: u8 = 0x06;
const START: u8 = 0x08;
const READ_DATA: u8 = 0x10;

const fn read_register(register: u8) -> u8 {
    0x20 | (register << 1)
}

const fn write_register(register: u8) -> u8 {
    0x40 | (register << 1)
}

/// Inputs of a channel, bits 7 to 4 of register 0: AIN0 against AIN1, AIN2 against AIN3.
const MULTIPLEXER: [u8; CHANNELS] = [0x00, 0x60];
/// Gain of 128, bits 3 to 1 of register 0.
const GAIN_128: u8 = 0x0e;
/// 2 000 conversions a second (code 6 in turbo mode), single shots, reference at REFP and REFN.
const REGISTER_1: u8 = 0xc0 | 0x10 | 0x02;
/// Result counter, and CRC after every answer.
const REGISTER_2: u8 = 0x40 | 0x20;
/// Burn-out currents, register 2.
const BURN_OUT: u8 = 0x08;
/// "Conversion ready" of register 2, no part of the configuration.
const READY: u8 = 0x80;
/// No current sources, answers only when asked.
const REGISTER_3: u8 = 0x00;
/// Registers that are read back, in turn.
const READ_BACK: [u8; 4] = [2, 1, 3, 0];

/// What the driver has to know of its line, in us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// One byte on the line, rounded up: 87 at 115 200 Bd.
    pub byte_us: u32,
    /// One conversion. The data sheet gives 1 065 clocks of 2.048 MHz for a single shot in turbo mode, which is 0.52 ms; its
    /// clock is good to 2 %. Not confirmed: the table does not agree with itself on these modes, so a chip that is not ready is asked
    /// again.
    pub conversion_us: u32,
    /// From the start of a period to the moment at which an answer is no longer waited for.
    pub give_up_us: u32,
}

impl Timing {
    /// 115 200 Bd, 200 Hz.
    pub const AT_115200: Self = Self {
        byte_us: 87,
        conversion_us: 545,
        give_up_us: 4_400,
    };
}

/// Wait after a reset command; the data sheet asks for 80 us.
const RESET_WAIT_US: u64 = 150;
/// Wait before a result that was not ready is read again.
const AGAIN_US: u64 = 120;
/// Most tries at one result.
const TRIES: u8 = 4;

/// One channel's result of one period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChannelReading {
    /// Count at gain 128; the last one there was, when there is none for this period.
    pub counts: i32,
    /// What is wrong with it.
    pub flags: GaugeFlags,
    /// When its conversion was started.
    pub started_us: u64,
}

/// What the driver has counted since it was made. Counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Times the chip was found reset, with a changed register, or standing still, and was set up again.
    pub resets: u32,
    /// Answers with a wrong check sum.
    pub check_errors: u32,
    /// Periods that ended while an answer was missing.
    pub timeouts: u32,
    /// Results that were not new when they were read.
    pub not_ready: u32,
    /// Bytes that nobody had asked for.
    pub strays: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Nothing to do until the next period.
    Idle,
    /// A reset was sent; the chip is ready at this time.
    Resetting { until_us: u64 },
    /// Registers were written; one of them is being read back, by index into [`READ_BACK`].
    SettingUp { index: usize },
    /// A conversion has been started, and the result before it was asked for.
    Learning { channel: usize, until_us: u64 },
    /// A conversion is running.
    Converting { channel: usize, until_us: u64 },
    /// A result was asked for.
    Reading { channel: usize },
    /// The result was not new or its check sum wrong; it is asked for again at this time.
    Waiting { channel: usize, until_us: u64 },
    /// A register is being read back after the results, by index into [`READ_BACK`].
    Checking { index: usize },
    /// A register is being read back before the conversions, because the last periods ended badly.
    Probing { index: usize },
}

/// Driver of one ADS122U04 with two gauges.
#[derive(Debug)]
pub struct Ads122u04 {
    timing: Timing,
    state: State,
    configured: bool,
    /// Periods in a row that ended badly.
    ended_badly: u8,
    crc_reversed: bool,
    period_us: u64,
    answer: Vec<u8, ANSWER_BYTES>,
    last_byte_us: u64,
    tries: u8,
    /// Counter of the last result that was taken; `None` where it says nothing.
    last_counter: Option<u8>,
    /// Conversions started since.
    unread: u8,
    /// Whether the counter was learned in this period.
    learned: bool,
    stalled: u8,
    next_check: usize,
    readings: [ChannelReading; CHANNELS],
    fresh: [bool; CHANNELS],
    ever: [bool; CHANNELS],
    look: [Look; CHANNELS],
    looking: Option<usize>,
    counters: Counters,
}

/// What is known of a channel that saturates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Look {
    wanted: bool,
    open: bool,
    wait: u8,
}

impl Ads122u04 {
    /// A driver that has not spoken to its chip yet.
    pub const fn new(timing: Timing) -> Self {
        const NONE: ChannelReading = ChannelReading {
            counts: 0,
            flags: GaugeFlags::MISSING,
            started_us: 0,
        };
        Self {
            timing,
            state: State::Idle,
            configured: false,
            ended_badly: 0,
            crc_reversed: false,
            period_us: 0,
            answer: Vec::new(),
            last_byte_us: 0,
            tries: 0,
            last_counter: None,
            unread: 0,
            learned: false,
            stalled: 0,
            next_check: 0,
            readings: [NONE; CHANNELS],
            fresh: [false; CHANNELS],
            ever: [false; CHANNELS],
            look: [Look {
                wanted: false,
                open: false,
                wait: 0,
            }; CHANNELS],
            looking: None,
            counters: Counters {
                resets: 0,
                check_errors: 0,
                timeouts: 0,
                not_ready: 0,
                strays: 0,
            },
        }
    }

    /// What has been counted.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Whether the chip answers and holds its configuration, as far as is known.
    pub const fn is_configured(&self) -> bool {
        self.configured
    }

    /// Whether everything of this period is done.
    pub fn is_finished(&self) -> bool {
        matches!(self.state, State::Idle)
    }

    /// Whether both channels have their result of this period (or it is known that they will not have one); what follows is
    /// only the read-back of a register.
    pub fn has_results(&self) -> bool {
        matches!(self.state, State::Idle | State::Checking { .. })
    }

    /// The time at which [`Ads122u04::elapse`] wants to be called; `None` while nothing runs.
    pub const fn deadline_us(&self) -> Option<u64> {
        match self.state {
            State::Idle => None,
            State::Resetting { until_us }
            | State::Converting { until_us, .. }
            | State::Waiting { until_us, .. } => Some(until_us),
            State::SettingUp { .. }
            | State::Learning { .. }
            | State::Reading { .. }
            | State::Checking { .. }
            | State::Probing { .. } => Some(self.give_up_us()),
        }
    }

    const fn give_up_us(&self) -> u64 {
        self.period_us + self.timing.give_up_us as u64
    }

    const fn line_us(&self, bytes: u64) -> u64 {
        bytes * self.timing.byte_us as u64
    }

    /// Starts a period: what is left of the last one is given up.
    pub fn begin(&mut self, now_us: u64, out: &mut Outgoing) {
        if !self.is_finished() {
            self.give_up(now_us);
        }
        self.period_us = now_us;
        self.fresh = [false; CHANNELS];
        self.tries = 0;
        self.looking = None;
        self.learned = false;
        if !self.configured {
            self.reset(now_us, out);
        } else if self.ended_badly >= BAD_BEFORE_PROBING {
            self.ended_badly = 0;
            // In turn too; but the last, register 0, may be anything where a period ended badly.
            let index = self.next_check % (READ_BACK.len() - 1);
            self.next_check = index + 1;
            let question = [SYNC, read_register(READ_BACK[index])];
            self.ask(State::Probing { index }, &question, out);
        } else {
            self.convert(0, now_us, out);
        }
    }

    /// Ends a period and gives its results; a channel without one keeps its last count and is flagged.
    pub fn take(&mut self) -> [ChannelReading; CHANNELS] {
        let mut readings = self.readings;
        for channel in 0..CHANNELS {
            if !self.fresh[channel] {
                let flag = if self.ever[channel] && self.configured {
                    GaugeFlags::LATE
                } else {
                    GaugeFlags::MISSING
                };
                readings[channel].flags.insert(flag);
            }
        }
        readings
    }

    /// Takes one byte from the line.
    pub fn receive(&mut self, byte: u8, now_us: u64, out: &mut Outgoing) {
        let expected = match self.state {
            State::Learning { .. } | State::Reading { .. } => ANSWER_BYTES,
            State::SettingUp { .. } | State::Checking { .. } | State::Probing { .. } => 3,
            State::Resetting { .. } => return,
            // Nothing was asked: the rest of an answer that came too late, or noise.
            State::Idle | State::Converting { .. } | State::Waiting { .. } => {
                self.counters.strays = self.counters.strays.wrapping_add(1);
                if self.learned {
                    // It may be the answer that the counter should have been learned from.
                    self.last_counter = None;
                    self.abandon();
                }
                return;
            }
        };
        self.last_byte_us = now_us;
        if self.answer.push(byte).is_err() || self.answer.len() < expected {
            return;
        }
        let (body, check) = self.answer.split_at(expected - 2);
        let (sum, check) = (crc(body), u16::from_le_bytes([check[0], check[1]]));
        if self.state == (State::SettingUp { index: 0 }) {
            self.crc_reversed = check != sum;
        }
        let good = check
            == if self.crc_reversed {
                sum.reverse_bits()
            } else {
                sum
            };
        match self.state {
            State::Reading { channel } if good => {
                let counter = self.answer[0];
                let counts = counts(self.answer[1], self.answer[2], self.answer[3]);
                self.result(channel, counter, counts, now_us, out);
            }
            State::Reading { channel } => {
                self.counters.check_errors = self.counters.check_errors.wrapping_add(1);
                self.again(channel, now_us, out);
            }
            State::Learning { channel, until_us } if good => {
                self.last_counter = Some(self.answer[0]);
                self.unread = 1;
                self.learned = true;
                self.state = State::Converting { channel, until_us };
            }
            State::Learning { .. } => {
                self.counters.check_errors = self.counters.check_errors.wrapping_add(1);
                self.abandon();
            }
            State::SettingUp { index } => self.set_up_answer(index, good, now_us, out),
            State::Checking { index } => {
                if !good {
                    self.counters.check_errors = self.counters.check_errors.wrapping_add(1);
                } else if !self.holds(READ_BACK[index], self.answer[0]) {
                    self.lost();
                }
                self.state = State::Idle;
            }
            State::Probing { index } => {
                if good && self.holds(READ_BACK[index], self.answer[0]) {
                    self.convert(0, now_us, out);
                } else if good {
                    self.lost();
                    self.reset(now_us, out);
                } else {
                    self.counters.check_errors = self.counters.check_errors.wrapping_add(1);
                    self.abandon();
                }
            }
            State::Idle
            | State::Resetting { .. }
            | State::Converting { .. }
            | State::Waiting { .. } => {}
        }
    }

    /// Does what is due at `now_us`; to be called at [`Ads122u04::deadline_us`] or later.
    pub fn elapse(&mut self, now_us: u64, out: &mut Outgoing) {
        if self.deadline_us().is_none_or(|deadline| now_us < deadline) {
            return;
        }
        match self.state {
            State::Idle => {}
            State::Resetting { .. } => self.configure(out),
            State::Converting { channel, .. } | State::Waiting { channel, .. } => {
                self.ask(State::Reading { channel }, &[SYNC, READ_DATA], out);
            }
            State::SettingUp { .. }
            | State::Learning { .. }
            | State::Reading { .. }
            | State::Checking { .. }
            | State::Probing { .. } => {
                self.give_up(now_us);
            }
        }
    }

    fn ask(&mut self, state: State, bytes: &[u8], out: &mut Outgoing) {
        self.answer.clear();
        self.state = state;
        send(bytes, out);
    }

    fn reset(&mut self, now_us: u64, out: &mut Outgoing) {
        self.last_counter = None;
        self.stalled = 0;
        send(&[SYNC, RESET], out);
        self.state = State::Resetting {
            until_us: now_us + self.line_us(2) + RESET_WAIT_US,
        };
    }

    fn configure(&mut self, out: &mut Outgoing) {
        for (register, value) in [
            (0, self.wanted(0)),
            (1, REGISTER_1),
            (2, REGISTER_2),
            (3, REGISTER_3),
        ] {
            send(&[SYNC, write_register(register), value], out);
        }
        self.ask(
            State::SettingUp { index: 0 },
            &[SYNC, read_register(READ_BACK[0])],
            out,
        );
    }

    fn set_up_answer(&mut self, index: usize, good: bool, now_us: u64, out: &mut Outgoing) {
        let register = READ_BACK[index];
        if !good || !self.holds(register, self.answer[0]) {
            // Tried again from the reset on in the next period.
            self.counters.check_errors = self.counters.check_errors.wrapping_add(1);
            self.state = State::Idle;
        } else if index + 1 < READ_BACK.len() {
            let next = [SYNC, read_register(READ_BACK[index + 1])];
            self.ask(State::SettingUp { index: index + 1 }, &next, out);
        } else {
            self.configured = true;
            // One pair of channels takes 26 bytes and two conversions.
            let pair_us = self.line_us(26) + 2 * u64::from(self.timing.conversion_us);
            if now_us + pair_us < self.give_up_us() {
                self.convert(0, now_us, out);
            } else {
                self.state = State::Idle;
            }
        }
    }

    /// Value a register should have; register 0 as after the second channel's conversion.
    const fn wanted(&self, register: u8) -> u8 {
        match register {
            0 => MULTIPLEXER[CHANNELS - 1] | GAIN_128,
            1 => REGISTER_1,
            2 => REGISTER_2,
            _ => REGISTER_3,
        }
    }

    /// Whether a register read back is as it should be.
    const fn holds(&self, register: u8, value: u8) -> bool {
        let state = if register == 2 { READY } else { 0 };
        value & !state == self.wanted(register)
    }

    fn convert(&mut self, channel: usize, now_us: u64, out: &mut Outgoing) {
        let look = &mut self.look[channel];
        let mut register_0 = MULTIPLEXER[channel] | GAIN_128;
        if look.wanted && look.wait == 0 && self.looking.is_none() {
            look.wanted = false;
            look.wait = LOOK_EVERY;
            self.looking = Some(channel);
            register_0 = MULTIPLEXER[channel];
            send(&[SYNC, write_register(2), REGISTER_2 | BURN_OUT], out);
        } else {
            look.wait = look.wait.saturating_sub(1);
        }
        // Writing the register alone would not start a single shot.
        send(&[SYNC, write_register(0), register_0, SYNC, START], out);
        let started_us = now_us + self.line_us(out.len() as u64);
        let until_us = started_us + u64::from(self.timing.conversion_us);
        self.readings[channel].started_us = started_us;
        self.tries = 0;
        self.unread = self.unread.saturating_add(1);
        if self.last_counter.is_some() && self.unread < UNREAD_LIMIT {
            self.state = State::Converting { channel, until_us };
        } else {
            let learning = State::Learning { channel, until_us };
            self.ask(learning, &[SYNC, READ_DATA], out);
        }
    }

    fn result(
        &mut self,
        channel: usize,
        counter: u8,
        counts: i32,
        now_us: u64,
        out: &mut Outgoing,
    ) {
        let ended = counter.wrapping_sub(self.last_counter.unwrap_or(counter));
        if ended < self.unread {
            self.counters.not_ready = self.counters.not_ready.wrapping_add(1);
            self.again(channel, now_us, out);
            return;
        }
        if ended > self.unread {
            // The chip has converted what nobody asked for.
            self.last_counter = None;
            self.abandon();
            return;
        }
        self.last_counter = Some(counter);
        self.unread = 0;
        self.learned = false;
        self.stalled = 0;
        if self.looking == Some(channel) {
            self.look[channel].open = counts.abs() > OPEN_LIMIT_COUNTS;
            send(&[SYNC, write_register(2), REGISTER_2], out);
            self.readings[channel].flags = if self.look[channel].open {
                GaugeFlags::OPEN.union(GaugeFlags::SATURATED)
            } else {
                GaugeFlags::SATURATED
            };
            self.fresh[channel] = true;
        } else {
            let look = &mut self.look[channel];
            let saturated = !(-FULL_SCALE_COUNTS..FULL_SCALE_COUNTS).contains(&counts);
            if saturated {
                look.wanted = true;
            } else {
                *look = Look::default();
            }
            self.readings[channel].counts = counts;
            self.readings[channel].flags = match (saturated, look.open) {
                (false, _) => GaugeFlags::none(),
                (true, false) => GaugeFlags::SATURATED,
                (true, true) => GaugeFlags::OPEN.union(GaugeFlags::SATURATED),
            };
            self.fresh[channel] = true;
            self.ever[channel] = true;
        }
        self.advance(channel, now_us, out);
    }

    /// Goes on after a channel, with or without its result.
    fn advance(&mut self, channel: usize, now_us: u64, out: &mut Outgoing) {
        if channel + 1 < CHANNELS {
            self.convert(channel + 1, now_us, out);
            return;
        }
        self.ended_badly = 0;
        // Question and answer are five bytes; a byte or two more may be waiting on the line.
        if now_us + self.line_us(8) < self.give_up_us() && self.looking.is_none() {
            let index = self.next_check;
            self.next_check = (index + 1) % READ_BACK.len();
            self.ask(
                State::Checking { index },
                &[SYNC, read_register(READ_BACK[index])],
                out,
            );
        } else {
            self.state = State::Idle;
        }
    }

    fn again(&mut self, channel: usize, now_us: u64, out: &mut Outgoing) {
        self.tries += 1;
        if self.tries < TRIES {
            self.state = State::Waiting {
                channel,
                until_us: now_us + AGAIN_US,
            };
            return;
        }
        self.stall();
        if self.configured {
            self.advance(channel, now_us, out);
        } else {
            self.state = State::Idle;
        }
    }

    /// Notes that the chip answers and has nothing to say.
    fn stall(&mut self) {
        self.last_counter = None;
        self.stalled = self.stalled.saturating_add(1);
        if self.stalled >= STALLED_LIMIT {
            self.lost();
        }
    }

    /// The chip does not hold its configuration any more.
    fn lost(&mut self) {
        self.configured = false;
        self.counters.resets = self.counters.resets.wrapping_add(1);
    }

    /// Ends a period in which an answer stayed out.
    fn give_up(&mut self, now_us: u64) {
        self.counters.timeouts = self.counters.timeouts.wrapping_add(1);
        // The bytes of an answer follow each other; one that pauses has ended.
        let ended = now_us >= self.last_byte_us + self.line_us(ANSWER_PAUSE_BYTES);
        match self.state {
            // A chip with its registers at 0 answers with the register alone, without a check sum.
            State::Probing { .. } | State::Checking { .. } if ended && self.answer.len() == 1 => {
                self.lost();
            }
            // Likewise its three bytes of data.
            State::Reading { .. } | State::Learning { .. } if ended && self.answer.len() == 3 => {
                self.lost();
            }
            State::Reading { .. } | State::Waiting { .. } if self.tries > 0 => self.stall(),
            // Not even the first answer of the period came.
            State::Learning { .. } if self.answer.is_empty() => self.configured = false,
            State::Probing { .. } | State::SettingUp { .. } => self.configured = false,
            _ => {}
        }
        self.abandon();
    }

    /// Ends the period where it stands. What the chip still has to say is not known.
    fn abandon(&mut self) {
        self.ended_badly = self.ended_badly.saturating_add(1);
        if self.looking.is_some() {
            // The burn-out currents may still be on.
            self.configured = false;
        }
        self.state = State::Idle;
    }
}

fn send(bytes: &[u8], out: &mut Outgoing) {
    // At most 14 bytes are ever sent in one call; the buffer is emptied by the caller each time.
    let _ = out.extend_from_slice(bytes);
}

const fn counts(low: u8, middle: u8, high: u8) -> i32 {
    i32::from_le_bytes([0, low, middle, high]) >> 8
}

/// The chip's check sum: polynomial 0x1021, all ones at the start, every byte taken least significant bit first (the order
/// on the line), sent low byte first.
///
/// Not confirmed: whether the remainder is sent as it stands or with its bits reversed. The first register read back at set-up,
/// whose value is known, tells the driver which of the two its chip uses.
pub fn crc(bytes: &[u8]) -> u16 {
    let mut remainder = 0xffff_u16;
    for byte in bytes {
        remainder ^= u16::from(byte.reverse_bits()) << 8;
        for _ in 0..8 {
            remainder = if remainder & 0x8000 != 0 {
                (remainder << 1) ^ 0x1021
            } else {
                remainder << 1
            };
        }
    }
    remainder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_sum_is_the_reflected_one_bit_reversed() {
        // CRC-16/MCRF4XX, the same polynomial reflected on both sides, has the check value 0x6f91.
        assert_eq!(crc(b"123456789"), 0x6f91_u16.reverse_bits());
    }

    #[test]
    fn counts_are_signed() {
        assert_eq!(counts(0xff, 0xff, 0x7f), FULL_SCALE_COUNTS);
        assert_eq!(counts(0x00, 0x00, 0x80), -FULL_SCALE_COUNTS - 1);
        assert_eq!(counts(0xfe, 0xff, 0xff), -2);
    }
}
