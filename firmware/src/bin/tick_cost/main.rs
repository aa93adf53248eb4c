//! Counts what a tick costs, part by part, with the very library of the board; runs in the emulator only.
//!
//! Under `-icount shift=0,sleep=off` the emulator's clock goes on by 1 ns per instruction, so SysTick (168 MHz there) counts 0.168 per
//! instruction, the same in every run. Each part is called many times with changing inputs; a line on USART1 gives its name, the mean and the largest
//! count in SysTicks. Chips are stand-ins whose own cost is not counted. See `tests/tests/instruction_counts.rs`.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "the entry point that cortex-m-rt generates")]

use core::cell::RefCell;
use core::convert::Infallible;
use core::fmt::Write;
use core::hint::black_box;
use core::panic::PanicInfo;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use defmt_rtt as _;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use palpus_firmware::front_end::ads131m08::{self, Ads131m08, FRAME_BYTES, Rate};
use palpus_firmware::front_end::serial::{BridgeConverters, EncoderBus, JointMount, SerialLine};
use palpus_firmware::front_end::{
    GaugeFrontEnd, GaugeSample, JointFrontEnd, JointSample, JointState, ads122u04, amt21,
};
use palpus_firmware::sensing::contact::Tip;
use palpus_firmware::sensing::uncertainty::WrenchNoise;
use palpus_firmware::sensing::validity::{ContactGate, ContactLimits};
use palpus_firmware::sensing::wrench::GaugeMatrix;
use palpus_firmware::store::RamStore;
use palpus_firmware::{Board, BoardConfig};
use palpus_protocol::{
    BoardMessage, Calibration, Command, GaugeFlags, HostMessage, MAX_FRAME_BYTES, MAX_GAUGES,
    Request, Streams, TareRequest, TipGeometry,
};
use stm32_metapac::USART1;

const ROUNDS: u32 = 400;
const TIP: TipGeometry = TipGeometry {
    semi_axes_mm: [20.0; 3],
    centre_offset_mm: [0.0, 0.0, 15.0],
};

defmt::timestamp!("{=u32}", 0);

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let _ = writeln!(Wire, "panic {info}");
    loop {
        cortex_m::asm::nop();
    }
}

/// USART1, byte by byte.
struct Wire;

impl Write for Wire {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for byte in text.bytes() {
            while !USART1.sr().read().txe() {}
            USART1.dr().write(|w| w.set_dr(u16::from(byte)));
        }
        Ok(())
    }
}

/// Sum, largest and number of some counts.
#[derive(Default)]
struct Cost {
    sum: u64,
    largest: u32,
    count: u32,
    /// Sum since the last `end_of_tick`.
    tick: u32,
}

impl Cost {
    fn measure<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let before = SYST::get_current();
        let result = black_box(work());
        self.tick += before.wrapping_sub(SYST::get_current()) & 0x00ff_ffff;
        result
    }

    fn end_of_tick(&mut self) {
        self.sum += u64::from(self.tick);
        self.largest = self.largest.max(self.tick);
        self.count += 1;
        self.tick = 0;
    }

    fn print(&self, name: &str) {
        let mean_hundredths = self.sum * 100 / u64::from(self.count.max(1));
        let _ = writeln!(Wire, "{name} {mean_hundredths} {}", self.largest);
    }
}

/// Numbers that change from round to round.
struct Changing(u32);

impl Changing {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 16_777_216.0 - 0.5
    }

    fn counts(&mut self) -> [i32; MAX_GAUGES] {
        // About 3 N towards the finger, a little of everything else.
        let pressed = -60_000.0;
        core::array::from_fn(|gauge| {
            let base = if gauge == 2 { pressed } else { 0.0 };
            (base + self.next() * 8_000.0) as i32
        })
    }
}

/// A line whose other end this program keeps.
struct Kept<'a, T>(&'a RefCell<T>);

/// Answers as an ADS122U04 does, far enough for the driver.
#[derive(Default)]
struct ChipLine {
    registers: [u8; 5],
    counter: u8,
    converting: bool,
    answer: heapless::Vec<u8, 16>,
}

impl SerialLine for Kept<'_, ChipLine> {
    fn send(&mut self, bytes: &[u8]) {
        let mut chip = self.0.borrow_mut();
        // Whatever was started is done before the next question.
        chip.counter = chip.counter.wrapping_add(u8::from(chip.converting));
        chip.converting = false;
        let mut bytes = bytes.iter().copied();
        while let Some(byte) = bytes.next() {
            if byte != 0x55 {
                continue;
            }
            let command = bytes.next().unwrap_or(0);
            let register = usize::from((command >> 1) & 7) % 5;
            let mut body = heapless::Vec::<u8, 8>::new();
            match command & 0xf0 {
                0x00 if command == 0x08 => chip.converting = true,
                0x00 => chip.registers = [0; 5],
                0x10 => {
                    let counter = chip.counter;
                    let _ = body.extend_from_slice(&[counter, counter.wrapping_mul(7), 0x10, 0x01]);
                }
                0x20 => {
                    let value = chip.registers[register];
                    let _ = body.push(value);
                }
                _ => chip.registers[register] = bytes.next().unwrap_or(0),
            }
            if !body.is_empty() {
                let sum = ads122u04::crc(&body).to_le_bytes();
                let _ = chip.answer.extend_from_slice(&body);
                let _ = chip.answer.extend_from_slice(&sum);
            }
        }
    }
}

/// Answers as encoders do.
#[derive(Default)]
struct BusLine(heapless::Vec<u8, 8>);

impl SerialLine for Kept<'_, BusLine> {
    fn send(&mut self, _bytes: &[u8]) {
        let _ = self
            .0
            .borrow_mut()
            .0
            .extend_from_slice(&0x61ab_u16.to_le_bytes());
    }
}

fn serial_front_ends() {
    let chips: [RefCell<ChipLine>; 3] = core::array::from_fn(|_| RefCell::default());
    let bus = RefCell::new(BusLine::default());
    let mut converters = BridgeConverters::new(
        ads122u04::Timing::AT_115200,
        [Kept(&chips[0]), Kept(&chips[1]), Kept(&chips[2])],
    );
    let mut encoders = EncoderBus::new(
        amt21::Amt21Bus::new([0x54, 0x58, 0x5c], amt21::Timing::AT_115200),
        [JointMount::default(); 3],
        Kept(&bus),
    );
    let mut cost = Cost::default();
    for round in 0..ROUNDS {
        let now_us = u64::from(round) * 5_000;
        let sample = cost.measure(|| converters.sample(now_us));
        cost.measure(|| encoders.sample(now_us));
        // As on the board: a look at the deadlines every 0.1 ms, and each byte as it comes.
        for beat in 1..50 {
            let now_us = now_us + beat * 100;
            cost.measure(|| converters.elapse(now_us));
            cost.measure(|| encoders.elapse(now_us));
            for chip in 0..3 {
                let answer = core::mem::take(&mut chips[chip].borrow_mut().answer);
                for byte in answer {
                    cost.measure(|| converters.receive(chip, byte, now_us));
                }
            }
            let answer = core::mem::take(&mut bus.borrow_mut().0);
            for byte in answer {
                cost.measure(|| encoders.receive(byte, now_us));
            }
        }
        if round >= 10 {
            assert!(sample.flags[..6].iter().all(|flags| flags.is_good()));
            cost.end_of_tick();
        }
        cost.tick = 0;
    }
    cost.print("read_serial");
}

/// An SPI at whose end new readings always wait.
struct SpiChip {
    status: [u16; 16],
    frame: [u8; FRAME_BYTES],
    spent: u32,
}

impl ErrorType for SpiChip {
    type Error = Infallible;
}

impl SpiDevice for SpiChip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let before = SYST::get_current();
        for operation in operations {
            if let Operation::TransferInPlace(words) = operation {
                let command = u16::from_be_bytes([words[0], words[1]]);
                let mut answer = self.frame;
                // The chip's work and the transfer itself are not the driver's.
                let sum = ads131m08::crc(&answer[..FRAME_BYTES - 3]);
                answer[FRAME_BYTES - 3..FRAME_BYTES - 1].copy_from_slice(&sum.to_be_bytes());
                if command & 0xe000 == 0x6000 {
                    for register in 0..5 {
                        let at = 3 * (register + 1);
                        self.status[2 + register] = u16::from_be_bytes([words[at], words[at + 1]]);
                    }
                }
                let response = match command & 0xe000 {
                    0xa000 => self.status[usize::from((command >> 7) & 15)],
                    _ => 0x05ff & !(1 << 10),
                };
                self.frame[..2].copy_from_slice(&response.to_be_bytes());
                words.copy_from_slice(&answer);
            }
        }
        self.spent += before.wrapping_sub(SYST::get_current()) & 0x00ff_ffff;
        Ok(())
    }
}

fn spi_front_end() {
    let chip = SpiChip {
        status: [0; 16],
        frame: [0x11; FRAME_BYTES],
        spent: 0,
    };
    let mut converter = Ads131m08::new(chip, 6, Rate::Sps2000);
    let mut cost = Cost::default();
    for round in 0..ROUNDS {
        converter.spi().spent = 0;
        let sample = cost.measure(|| converter.sample(u64::from(round) * 1_000));
        cost.tick -= converter.spi().spent;
        if round >= 10 {
            assert!(sample.flags[..6].iter().all(|flags| flags.is_good()));
            cost.end_of_tick();
        }
        cost.tick = 0;
    }
    cost.print("read_spi");
}

fn calibration() -> Calibration {
    let mut matrix = [0.0; 36];
    for (at, entry) in matrix.iter_mut().enumerate() {
        let main = if at / 6 < 3 { 5e-5 } else { 9e-4 };
        *entry = if at % 7 == 0 { main } else { main * 0.1 };
    }
    match Calibration::sealed(1, 6, &matrix) {
        Ok(calibration) => calibration,
        Err(_) => panic!("a calibration that can't be used"),
    }
}

fn sensing() {
    let (Ok(matrix), Some(tip)) = (GaugeMatrix::new(&calibration(), 6), Tip::new(&TIP)) else {
        panic!("no matrix or no tip")
    };
    let mut changing = Changing(1);
    let mut gate = ContactGate::new();
    let [mut calibrate, mut solve, mut validate] = [const {
        Cost {
            sum: 0,
            largest: 0,
            count: 0,
            tick: 0,
        }
    }; 3];
    for _ in 0..ROUNDS {
        let counts = changing.counts().map(|count| count as f32);
        let wrench = calibrate.measure(|| matrix.wrench(black_box(&counts)));
        calibrate.end_of_tick();
        let solved = solve.measure(|| tip.solve(&black_box(&wrench).about(tip.centre_mm())));
        solve.end_of_tick();
        validate.measure(|| {
            gate.judge_load(&wrench, &WrenchNoise::TYPICAL);
            solved.map(|solved| {
                let sigma_mm = WrenchNoise::TYPICAL.point_sigma_mm(&tip, &solved);
                gate.judge(
                    &solved,
                    sigma_mm,
                    &WrenchNoise::TYPICAL,
                    &ContactLimits::STANDARD,
                )
            })
        });
        validate.end_of_tick();
    }
    calibrate.print("calibrate");
    solve.print("solve");
    validate.print("validate");
}

struct Gauges(GaugeSample);

impl GaugeFrontEnd for Gauges {
    fn gauges(&self) -> usize {
        6
    }

    fn sample(&mut self, now_us: u64) -> GaugeSample {
        GaugeSample {
            time_us: now_us,
            ..self.0
        }
    }
}

struct Joints;

impl JointFrontEnd for Joints {
    fn sample(&mut self, now_us: u64) -> JointSample {
        JointSample {
            time_us: now_us,
            angles_rad: [0.3, -0.7, 1.1],
            states: [JointState::Good; 3],
        }
    }
}

fn whole_board() {
    let config = BoardConfig::new(*b"EMULATED-BRD", 0, "index", TIP);
    let gauges = Gauges(GaugeSample {
        time_us: 0,
        counts: [0; MAX_GAUGES],
        flags: [GaugeFlags::none(); MAX_GAUGES],
    });
    let Ok(mut board) = Board::new(config, gauges, Joints, RamStore::new(), 0) else {
        panic!("no board")
    };
    let mut bytes = [0; MAX_FRAME_BYTES];
    for (request_id, command) in (1..).zip([
        Command::SetCalibration(calibration()),
        Command::Tare(TareRequest {
            samples: 10,
            force: true,
        }),
        Command::Start(Streams {
            contact_every: 1,
            raw_every: 0,
        }),
    ]) {
        let Ok(length) = HostMessage::from(Request {
            request_id,
            command,
        })
        .encode(&mut bytes) else {
            panic!("no request")
        };
        board.receive(&bytes[..length], 0);
    }
    let mut changing = Changing(2);
    let [mut tick, mut take, mut encode] = [const {
        Cost {
            sum: 0,
            largest: 0,
            count: 0,
            tick: 0,
        }
    }; 3];
    let mut valid = 0;
    for round in 1..=ROUNDS {
        let now_us = u64::from(round) * 5_000;
        board.gauges_mut().0.counts = if round <= 20 {
            [round as i32; MAX_GAUGES]
        } else {
            changing.counts()
        };
        tick.measure(|| board.tick(now_us));
        if round > 30 {
            tick.end_of_tick();
            let Some(contact) = board.last_contact().copied() else {
                panic!("no contact")
            };
            valid += u32::from(contact.is_valid());
            encode.measure(|| BoardMessage::from(contact).encode(&mut bytes).is_ok());
            encode.end_of_tick();
            take.measure(|| board.take_frame(now_us).map(<[u8]>::len));
            take.end_of_tick();
        }
        tick.tick = 0;
        while board.take_frame(now_us).is_some() {}
        while board.take_event().is_some() {}
    }
    encode.print("encode");
    tick.print("board_tick");
    take.print("take_frame");
    let _ = writeln!(Wire, "valid {valid} {ROUNDS}");
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut core) = cortex_m::Peripherals::take() else {
        panic!("taken twice")
    };
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(0x00ff_ffff);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    USART1.cr1().write(|w| {
        w.set_ue(true);
        w.set_te(true);
    });
    let mut nothing = Cost::default();
    for _ in 0..ROUNDS {
        nothing.measure(|| black_box(0));
        nothing.end_of_tick();
    }
    nothing.print("nothing");
    serial_front_ends();
    spi_front_end();
    sensing();
    whole_board();
    let _ = writeln!(Wire, "end 0 0");
    loop {
        cortex_m::asm::wfi();
    }
}
