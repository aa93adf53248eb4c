//! The SPI front end against a register-level model of its chip, alone and under a board at 1 kHz.

use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use palpus_firmware::front_end::ads131m08::{Ads131m08, FRAME_BYTES, Rate};
use palpus_firmware::front_end::{GaugeFrontEnd, JointFrontEnd, JointSample, JointState};
use palpus_firmware::store::RamStore;
use palpus_firmware::{Board, BoardConfig};
use palpus_protocol::{
    BoardMessage, Command, ContactFlags, Decoder, GaugeFlags, HostMessage, MAX_FRAME_BYTES,
    Request, Streams, TipGeometry,
};
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

/// The chip: written from its data sheet, apart from the driver. Frames of ten 24-bit words, answers one frame late.
struct Chip {
    /// ID, STATUS, MODE, CLOCK, GAIN1, GAIN2, CFG.
    registers: [u16; 7],
    response: u16,
    /// Volts at the inputs.
    volts: [f64; 8],
    /// The last conversion.
    held: [i32; 8],
    converted_us: u64,
    now_us: u64,
    noise: u32,
    ready: bool,
    /// No answer: the line stays high.
    absent: bool,
    /// One bit of every n-th frame is wrong.
    damage_every: Option<u32>,
    frames: u32,
}

impl Chip {
    fn new() -> Self {
        let mut chip = Self {
            registers: [0; 7],
            response: 0,
            volts: [0.0; 8],
            held: [0; 8],
            converted_us: 0,
            now_us: 0,
            noise: 7,
            ready: false,
            absent: false,
            damage_every: None,
            frames: 0,
        };
        chip.power_on();
        chip
    }

    fn power_on(&mut self) {
        self.registers = [0x2800, 0x0500, 0x0510, 0xff0e, 0, 0, 0x0600];
        self.response = 0xff28;
        self.ready = false;
    }

    /// Conversions between the last frame and now: at 8.192 MHz / 2 / ratio.
    fn run_to(&mut self, now_us: u64) {
        let ratio = 128_u64 << ((self.registers[3] >> 2) & 7);
        let period_us = ratio * 1_000_000 / 4_096_000;
        self.now_us = now_us;
        if now_us >= self.converted_us + period_us {
            self.converted_us = now_us - now_us % period_us;
            self.ready = true;
            self.held = core::array::from_fn(|channel| self.counts(channel));
        }
    }

    fn counts(&mut self, channel: usize) -> i32 {
        let gain = f64::from(1 << ((self.registers[4 + channel / 4] >> (4 * (channel % 4))) & 7));
        self.noise = self
            .noise
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        let flicker = f64::from(self.noise >> 8) / f64::from(1 << 24) * 40.0 - 20.0;
        // Full scale is 1.2 V over the gain.
        let counts = (self.volts[channel] * gain / 1.2 * f64::from(1 << 23) + flicker).round();
        counts.clamp(-f64::from(1 << 23), f64::from((1 << 23) - 1)) as i32
    }

    fn frame(&mut self, input: &[u8]) -> Vec<u8> {
        assert_eq!(
            input.len(),
            FRAME_BYTES,
            "frames of another length are out of step"
        );
        self.frames += 1;
        let mut output = Vec::with_capacity(FRAME_BYTES);
        output.extend(self.response.to_be_bytes());
        output.push(0);
        for channel in 0..8 {
            let counts = self.held[channel];
            output.extend(&counts.to_be_bytes()[1..]);
        }
        let sum = check_sum(&output);
        output.extend(sum.to_be_bytes());
        output.push(0);
        if self
            .damage_every
            .is_some_and(|every| self.frames.is_multiple_of(every))
        {
            output[5] ^= 0x10;
        }

        let word = |index: usize| u16::from_be_bytes([input[3 * index], input[3 * index + 1]]);
        let status = self.registers[1] & !0xff | if self.ready { 0xff } else { 0 };
        self.ready = false;
        let command = word(0);
        let (first, count) = (
            usize::from((command >> 7) & 63),
            usize::from(command & 127) + 1,
        );
        self.response = match command >> 13 {
            0 if command == 0x0011 => {
                self.power_on();
                0xff28
            }
            3 => {
                for offset in 0..count {
                    if let Some(register) = self.registers.get_mut(first + offset) {
                        *register = word(1 + offset);
                    }
                }
                // Clearing the flag in MODE clears it in STATUS.
                self.registers[1] = self.registers[1] & !0x0400 | self.registers[2] & 0x0400;
                0x4000 | (command & 0x1fff)
            }
            5 if count == 1 => self.registers.get(first).copied().unwrap_or(0),
            _ => status,
        };
        if self.absent {
            vec![0xff; FRAME_BYTES]
        } else {
            output
        }
    }
}

fn check_sum(bytes: &[u8]) -> u16 {
    let mut remainder = 0xffff_u16;
    for byte in bytes {
        remainder ^= u16::from(*byte) << 8;
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

#[derive(Clone)]
struct Spi(Rc<RefCell<Chip>>);

impl ErrorType for Spi {
    type Error = Infallible;
}

impl SpiDevice for Spi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        for operation in operations {
            match operation {
                Operation::TransferInPlace(words) => {
                    let answer = self.0.borrow_mut().frame(words);
                    words.copy_from_slice(&answer);
                }
                other => panic!("{other:?}"),
            }
        }
        Ok(())
    }
}

fn rig() -> (Rc<RefCell<Chip>>, Ads131m08<Spi>) {
    let chip = Rc::new(RefCell::new(Chip::new()));
    let driver = Ads131m08::new(Spi(Rc::clone(&chip)), 6, Rate::Sps2000);
    (chip, driver)
}

const PERIOD_US: u64 = 1_000;

/// Samples some periods and gives the last sample.
fn sample(
    chip: &RefCell<Chip>,
    driver: &mut Ads131m08<Spi>,
    periods: u64,
) -> palpus_firmware::front_end::GaugeSample {
    let mut last = None;
    for _ in 0..periods {
        let now_us = chip.borrow().now_us + PERIOD_US;
        chip.borrow_mut().run_to(now_us);
        last = Some(driver.sample(now_us));
    }
    last.expect("at least one period")
}

#[test]
fn the_chip_is_set_up_and_read() {
    let (chip, mut driver) = rig();
    chip.borrow_mut().volts = [1e-3, -2e-3, 3e-3, 0.0, 5e-3, -6e-3, 0.0, 0.0];
    let reading = sample(&chip, &mut driver, 6);
    assert_eq!(
        chip.borrow().registers[2..6],
        [0x0110, 0xff12, 0x7777, 0x7777]
    );
    for (gauge, volts) in [1e-3, -2e-3, 3e-3, 0.0, 5e-3, -6e-3]
        .into_iter()
        .enumerate()
    {
        assert!(reading.flags[gauge].is_good());
        let expected = volts * 128.0 / 1.2 * 8_388_608.0;
        assert!((f64::from(reading.counts[gauge]) - expected).abs() <= 21.0);
    }
    assert_eq!(reading.time_us, 6_000 - 250);
    assert_eq!((driver.gauges(), driver.chip_resets()), (6, 0));
}

#[test]
fn a_saturated_gauge_says_so() {
    let (chip, mut driver) = rig();
    chip.borrow_mut().volts[4] = -20e-3;
    let reading = sample(&chip, &mut driver, 6);
    assert_eq!(reading.flags[4], GaugeFlags::SATURATED);
    assert!(reading.flags[3].is_good());
}

#[test]
fn a_reset_and_a_changed_register_are_found_and_mended() {
    let (chip, mut driver) = rig();
    sample(&chip, &mut driver, 10);
    chip.borrow_mut().power_on();
    // The reset flag is seen within two samples; reset, set-up and two settling frames follow.
    let reading = sample(&chip, &mut driver, 8);
    assert!(reading.flags[0].is_good());
    assert_eq!(driver.chip_resets(), 1);
    chip.borrow_mut().registers[4] = 0x0000;
    let reading = sample(&chip, &mut driver, 18);
    assert!(reading.flags[0].is_good());
    assert_eq!(
        (driver.chip_resets(), chip.borrow().registers[4]),
        (2, 0x7777)
    );
}

#[test]
fn a_missing_chip_is_missing_until_it_comes_back() {
    let (chip, mut driver) = rig();
    sample(&chip, &mut driver, 10);
    chip.borrow_mut().absent = true;
    let reading = sample(&chip, &mut driver, 10);
    assert!(
        reading.flags[..6]
            .iter()
            .all(|flags| *flags == GaugeFlags::MISSING)
    );
    chip.borrow_mut().absent = false;
    assert!(sample(&chip, &mut driver, 10).flags[0].is_good());
}

#[test]
fn damaged_frames_are_never_taken() {
    let (chip, mut driver) = rig();
    chip.borrow_mut().volts[0] = 1e-3;
    sample(&chip, &mut driver, 10);
    chip.borrow_mut().damage_every = Some(3);
    let expected = 1e-3 * 128.0 / 1.2 * 8_388_608.0;
    let mut good = 0;
    for _ in 0..300 {
        let reading = sample(&chip, &mut driver, 1);
        if reading.flags[0].is_good() {
            good += 1;
            assert!((f64::from(reading.counts[0]) - expected).abs() <= 21.0);
        }
    }
    assert!(good >= 100, "{good}");
    assert!(driver.counters().bad_frames >= 99);
}

#[test]
fn a_chip_that_stands_still_grows_old() {
    let (chip, mut driver) = rig();
    let time_us = sample(&chip, &mut driver, 10).time_us;
    // No conversions: the chip's clock is gone, its registers still answer.
    for tick in 1..=20 {
        let reading = driver.sample(10_000 + tick * PERIOD_US);
        assert!(
            reading.time_us <= time_us + 2 * PERIOD_US,
            "{}",
            reading.time_us
        );
    }
    assert!(driver.counters().not_ready > 5);
}

struct Joints;

impl JointFrontEnd for Joints {
    fn sample(&mut self, now_us: u64) -> JointSample {
        JointSample {
            time_us: now_us,
            angles_rad: [0.1, 0.2, 0.3],
            states: [JointState::Good; 3],
        }
    }
}

#[test]
fn a_board_holds_one_kilohertz_for_a_minute() {
    let (chip, driver) = rig();
    let tip = TipGeometry {
        semi_axes_mm: [20.0; 3],
        centre_offset_mm: [0.0, 0.0, 15.0],
    };
    let config = BoardConfig {
        period_us: 1_000,
        ..BoardConfig::new([1; 12], 0, "index", tip)
    };
    let mut board = Board::new(config, driver, Joints, RamStore::new(), 0).expect("a board");
    let mut bytes = [0; MAX_FRAME_BYTES];
    let start = Request {
        request_id: 1,
        command: Command::Start(Streams {
            contact_every: 1,
            raw_every: 0,
        }),
    };
    let length = HostMessage::from(start)
        .encode(&mut bytes)
        .expect("a request");
    board.receive(&bytes[..length], 0);
    let (mut decoder, mut sequence, mut contacts, mut late) = (Decoder::new(), None, 0, 0);
    let (mut sent, mut allowance) = (0_u64, 0.0_f64);
    for tick in 1..=60_000_u64 {
        chip.borrow_mut().run_to(tick * PERIOD_US);
        board.tick(tick * PERIOD_US);
        // The line: 921 600 Bd are 92 bytes a millisecond.
        allowance += 92.16;
        while allowance >= 1.0 {
            let Some(byte) = board.next_byte(tick * PERIOD_US) else {
                break;
            };
            allowance -= 1.0;
            sent += 1;
            if let Some(frame) = decoder.push(byte)
                && let Ok(BoardMessage::Contact(contact)) =
                    BoardMessage::try_from(frame.expect("an undamaged frame"))
            {
                assert!(sequence.is_none_or(|sequence| contact.lost_since(sequence) == 0));
                sequence = Some(contact.sequence);
                contacts += 1;
                late += u32::from(
                    tick > 20
                        && contact.flags.intersects(
                            ContactFlags::GAUGE_LATE.union(ContactFlags::GAUGE_MISSING),
                        ),
                );
            }
        }
        allowance = allowance.min(92.16);
    }
    let statistics = board.statistics(1, 60_000_000);
    println!(
        "{contacts} contacts in 60 s, {sent} bytes, {} mHz, {} overruns",
        statistics.rate_millihertz, statistics.overruns
    );
    assert_eq!(
        (statistics.overruns, statistics.contacts_dropped, late),
        (0, 0, 0)
    );
    assert_eq!(statistics.rate_millihertz, 1_000_000);
    assert!(contacts >= 59_990, "{contacts}");
}
