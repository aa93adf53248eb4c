//! Register-level model of the TI ADS122U04: bytes and times in, answers out.
//!
//! Written from the data sheet and apart from the driver: commands, registers, multiplexer, gain, conversion time, single
//! shots, result counter, the three kinds of check, burn-out currents, bus time-out, reset. The differential voltages come
//! from the caller. What the chip does in hidden ways (a start in mid-conversion, the counter after a reset) follows the
//! plainest reading.

/// What stands at the inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input {
    /// An intact bridge: differential volts.
    Volts(f64),
    /// An open wire: floating, so that the amplifier's bias runs it into a rail within milliseconds.
    Open,
}

/// One thing that is wrong with the chip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChipFault {
    /// Nothing.
    #[default]
    None,
    /// It does not answer (no power, a broken wire).
    Silent,
    /// Every n-th answer has one wrong bit, each time another one.
    BadBits(u32),
    /// Conversions take so many per cent longer.
    Slow(u32),
    /// Conversions never end.
    Stalled,
}

const SUPPLY_V: f64 = 3.3;
/// 10 uA into an open wire end at the supply; into a 350 ohm bridge they make 3.5 mV.
const BURN_OUT_V: f64 = 3.5e-3;

/// The chip.
#[derive(Debug)]
pub struct Ads122u04 {
    registers: [u8; 5],
    ready: bool,
    counter: u8,
    result: i32,
    conversion: Option<(u64, i32)>,
    parser: Parser,
    last_byte_us: u64,
    answers: u32,
    /// What is wrong.
    pub fault: ChipFault,
    /// Counts that a channel is stuck at.
    pub stuck_at: [Option<i32>; 2],
    /// Resets commanded over the line.
    pub resets_seen: u32,
    /// Conversions finished.
    pub conversions: u32,
    /// Answers with a wrong bit.
    pub damaged: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Parser {
    Sync,
    Command,
    Value(u8),
}

impl Default for Ads122u04 {
    fn default() -> Self {
        Self {
            registers: [0; 5],
            ready: false,
            counter: 0,
            result: 0,
            conversion: None,
            parser: Parser::Sync,
            last_byte_us: 0,
            answers: 0,
            fault: ChipFault::None,
            stuck_at: [None; 2],
            resets_seen: 0,
            conversions: 0,
            damaged: 0,
        }
    }
}

impl Ads122u04 {
    /// Registers and results as after power-on; also what a brown-out does in mid-run.
    pub fn power_on(&mut self) {
        self.registers = [0; 5];
        self.ready = false;
        self.counter = 0;
        self.result = 0;
        self.conversion = None;
        self.parser = Parser::Sync;
    }

    /// Changes bits of a register, as a burst of noise on the supply may do.
    pub fn upset(&mut self, register: usize, bits: u8) {
        if let Some(value) = self.registers.get_mut(register) {
            *value ^= bits;
        }
    }

    /// The channel that the multiplexer selects: 0 for AIN0-AIN1, 1 for AIN2-AIN3.
    pub fn channel(&self) -> Option<usize> {
        match self.registers[0] >> 4 {
            0 => Some(0),
            6 => Some(1),
            _ => None,
        }
    }

    /// Takes one byte and returns what the chip sends. `input` gives the voltage of a channel when a conversion starts.
    pub fn receive(
        &mut self,
        byte: u8,
        now_us: u64,
        mut input: impl FnMut(usize) -> Input,
    ) -> Vec<u8> {
        self.settle(now_us);
        if now_us.saturating_sub(self.last_byte_us) > 128_000 {
            self.parser = Parser::Sync;
        }
        self.last_byte_us = now_us;
        if self.fault == ChipFault::Silent {
            return Vec::new();
        }
        match self.parser {
            Parser::Sync => {
                if byte == 0x55 {
                    self.parser = Parser::Command;
                }
                Vec::new()
            }
            Parser::Command => {
                self.parser = Parser::Sync;
                let register = usize::from((byte >> 1) & 7);
                match byte & 0xf0 {
                    0x00 if byte & 0x0e == 0x06 => {
                        self.power_on();
                        self.resets_seen += 1;
                        Vec::new()
                    }
                    0x00 if byte & 0x0e == 0x08 => {
                        self.start(now_us, &mut input);
                        Vec::new()
                    }
                    0x10 => self.data(),
                    0x20 if register < 5 => {
                        let mut value = self.registers[register];
                        if register == 2 && self.ready {
                            value |= 0x80;
                        }
                        self.checked(vec![value])
                    }
                    0x40 if register < 5 => {
                        self.parser = Parser::Value(register as u8);
                        Vec::new()
                    }
                    _ => Vec::new(),
                }
            }
            Parser::Value(register) => {
                self.parser = Parser::Sync;
                let value = if register == 2 { byte & 0x7f } else { byte };
                self.registers[usize::from(register)] = value;
                if register != 4 && self.conversion.is_some() {
                    self.start(now_us, &mut input);
                }
                Vec::new()
            }
        }
    }

    fn conversion_us(&self) -> u64 {
        let turbo = self.registers[1] & 0x10 != 0;
        let rate = [20, 45, 90, 175, 330, 600, 1_000, 1_000][usize::from(self.registers[1] >> 5)];
        // 1065 modulator clocks at the highest turbo rate, in proportion elsewhere.
        let turbo_us = 520 * 1_000 / rate;
        let conversion_us = if turbo { turbo_us } else { 2 * turbo_us };
        match self.fault {
            ChipFault::Slow(per_cent) => conversion_us * u64::from(100 + per_cent) / 100,
            _ => conversion_us,
        }
    }

    fn start(&mut self, now_us: u64, input: &mut impl FnMut(usize) -> Input) {
        let burn_out = self.registers[2] & 0x08 != 0;
        let gain = f64::from(1_u32 << ((self.registers[0] >> 1) & 7));
        // Only ratiometric operation is modelled: reference and bridge supply are the same.
        let counts = match self.channel().map(|channel| (channel, input(channel))) {
            Some((channel, _)) if self.stuck_at[channel].is_some() => {
                self.stuck_at[channel].unwrap_or(0)
            }
            Some((_, Input::Volts(volts))) => {
                let volts = if burn_out { volts + BURN_OUT_V } else { volts };
                quantised(volts * gain)
            }
            Some((_, Input::Open)) => {
                quantised(if burn_out { SUPPLY_V } else { 0.9 * SUPPLY_V } * gain)
            }
            None => 0,
        };
        self.ready = false;
        self.conversion = Some((now_us + self.conversion_us(), counts));
    }

    fn settle(&mut self, now_us: u64) {
        if let Some((done_us, counts)) = self.conversion
            && now_us >= done_us
            && self.fault != ChipFault::Stalled
        {
            self.result = counts;
            self.counter = self.counter.wrapping_add(1);
            self.ready = true;
            self.conversion = None;
            self.conversions += 1;
        }
    }

    fn data(&mut self) -> Vec<u8> {
        self.ready = false;
        let [low, middle, high, _] = self.result.to_le_bytes();
        let mut answer = Vec::new();
        if self.registers[2] & 0x40 != 0 {
            answer.push(self.counter);
        }
        answer.extend([low, middle, high]);
        self.checked(answer)
    }

    fn checked(&mut self, mut answer: Vec<u8>) -> Vec<u8> {
        match (self.registers[2] >> 4) & 3 {
            1 => {
                let inverted: Vec<u8> = answer.iter().map(|byte| !byte).collect();
                answer.extend(inverted);
            }
            2 => {
                let sum = check_sum(&answer);
                answer.extend(sum.to_le_bytes());
            }
            _ => {}
        }
        self.answers += 1;
        if let ChipFault::BadBits(every) = self.fault
            && self.answers.is_multiple_of(every.max(1))
        {
            let place = self.damaged as usize;
            let bytes = answer.len();
            answer[place % bytes] ^= 1 << (place % 8);
            self.damaged += 1;
        }
        answer
    }
}

fn quantised(amplified_volts: f64) -> i32 {
    let counts = (amplified_volts / SUPPLY_V * f64::from(1 << 23)).round();
    counts.clamp(-f64::from(1 << 23), f64::from((1 << 23) - 1)) as i32
}

/// Division of the message, each byte's least significant bit first and behind sixteen ones, by x^16 + x^12 + x^5 + 1, bit by bit.
fn check_sum(bytes: &[u8]) -> u16 {
    let mut register = 0xffff_u32;
    for byte in bytes {
        for bit in 0..8 {
            let top = (register >> 15) & 1;
            let bit = u32::from(byte >> bit) & 1;
            register = (register << 1) & 0xffff;
            if top != bit {
                register ^= 0x1021;
            }
        }
    }
    register as u16
}
