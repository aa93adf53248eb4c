//! A bench board and its line in simulated time: a port whose reader moves the time on.
//!
//! The board is the real firmware library, the bytes are those of the real protocol, and the line has the faults of
//! [`super::fault_line`]. Only time is made up: it stands still while anyone computes and moves on when the host waits
//! for bytes. The same seed therefore gives the same on every machine, however busy, in less than the time simulated.
//!
//! Every thread has a time of its own, and with it every session that runs in a thread of its own.

use crate::bench_board::{BenchSettings, FirmwareBoard, firmware};
use crate::fault_line::{FaultInjector, LineFaults, OnTheWay};
use palpus_host::link::host_clock::HostClock;
use palpus_host::link::port::Port;
use std::cell::Cell;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

/// Where simulated time begins.
static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);
/// The date of that, microseconds since the Unix epoch.
const BEGIN_US: i64 = 1_700_000_000_000_000;

thread_local! {
    static PASSED: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

fn now() -> Instant {
    *BEGIN + PASSED.get()
}

fn wall_us() -> i64 {
    BEGIN_US + PASSED.get().as_micros() as i64
}

/// A clock by this thread's simulated time, which it sets back to the beginning.
pub fn simulated_clock() -> HostClock {
    PASSED.set(Duration::ZERO);
    HostClock::told(now, wall_us)
}

/// When the clock of a board that began with simulated time showed `board_us`, microseconds since the Unix epoch.
pub fn host_us(settings: &BenchSettings, board_us: u64) -> f64 {
    let since = board_us as f64 - settings.start_us as f64;
    BEGIN_US as f64 + since / (1.0 + settings.drift)
}

/// The host's end of a line to a pressed bench board.
pub struct SimulatedLine {
    settings: BenchSettings,
    board: FirmwareBoard,
    next_tick_us: u64,
    baud: Option<u32>,
    /// Until when the board's line is busy with a frame.
    busy_until: Instant,
    faults: LineFaults,
    injectors: [FaultInjector; 2],
    to_host: OnTheWay,
    to_board: OnTheWay,
    patience: Duration,
}

impl SimulatedLine {
    /// A line on which bytes take the time of `baud` (none: they take none), with faults by `seed`.
    pub fn new(settings: BenchSettings, baud: Option<u32>, faults: LineFaults, seed: u64) -> Self {
        let loaded = Arc::new(AtomicBool::new(true));
        Self {
            board: firmware(&settings, settings.start_us, &loaded),
            next_tick_us: settings.start_us + u64::from(settings.period_us),
            settings,
            baud,
            busy_until: now(),
            faults,
            injectors: [FaultInjector::new(seed), FaultInjector::new(!seed)],
            to_host: OnTheWay::default(),
            to_board: OnTheWay::default(),
            patience: Duration::ZERO,
        }
    }

    /// What the board's clock shows.
    fn board_us(&self) -> u64 {
        let passed_us = PASSED.get().as_secs_f64() * 1e6;
        self.settings.start_us + (passed_us * (1.0 + self.settings.drift)) as u64
    }

    /// When the board's clock will show `board_us`.
    fn when(&self, board_us: u64) -> Instant {
        let passed_us = (board_us - self.settings.start_us) as f64 / (1.0 + self.settings.drift);
        // Rounded up, so that the clock has reached it by then.
        *BEGIN + Duration::from_nanos((passed_us * 1e3).ceil() as u64 + 1)
    }

    fn on_wire(&self, bytes: usize) -> Duration {
        self.baud.map_or(Duration::ZERO, |baud| {
            Duration::from_secs_f64(10.0 * bytes as f64 / f64::from(baud))
        })
    }

    /// Everything the board does at this time.
    fn run_board(&mut self) {
        let board_us = self.board_us();
        let board = &mut self.board;
        self.to_board.arrive(now(), |bytes| {
            board.receive(bytes, board_us);
            bytes.len()
        });
        while self.next_tick_us <= board_us {
            board.tick(self.next_tick_us);
            self.next_tick_us += u64::from(self.settings.period_us);
        }
        while self.busy_until <= now() {
            let Some(frame) = self.board.take_frame(board_us) else {
                return;
            };
            let frame = frame.to_vec();
            let time = self.on_wire(frame.len());
            self.busy_until = now() + time;
            let faults = &self.faults.to_host;
            let injector = &mut self.injectors[0];
            let (bytes, stall) = injector.apply(&frame, faults);
            let late = stall + injector.lateness(faults);
            self.to_host.send(now() + time + late, bytes);
            if time.is_zero() {
                continue;
            }
            return;
        }
    }

    /// When anything happens next.
    fn next(&self) -> Instant {
        let mut next = self.when(self.next_tick_us);
        if self.busy_until > now() {
            next = next.min(self.busy_until);
        }
        let arrivals = [self.to_host.next_due(), self.to_board.next_due()];
        arrivals.into_iter().flatten().fold(next, Instant::min)
    }
}

impl Read for SimulatedLine {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let end = now() + self.patience;
        loop {
            self.run_board();
            let mut count = 0;
            self.to_host.arrive(now(), |bytes| {
                let taken = bytes.len().min(buffer.len() - count);
                buffer[count..count + taken].copy_from_slice(&bytes[..taken]);
                count += taken;
                taken
            });
            if count > 0 {
                return Ok(count);
            }
            let next = self.next().max(now());
            PASSED.set(next.min(end) - *BEGIN);
            if next > end {
                return Err(ErrorKind::TimedOut.into());
            }
        }
    }
}

impl Write for SimulatedLine {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let faults = &self.faults.to_board;
        let injector = &mut self.injectors[1];
        let (sent, stall) = injector.apply(bytes, faults);
        let late = stall + injector.lateness(faults);
        let due = now() + self.on_wire(bytes.len()) + late;
        self.to_board.send(due, sent);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Port for SimulatedLine {
    fn set_patience(&mut self, patience: Duration) -> io::Result<()> {
        self.patience = patience;
        Ok(())
    }
}
