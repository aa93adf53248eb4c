//! Board time in us from SysTick, the one timer that both silicon and the emulated core have.
//!
//! SysTick interrupts every [`BEAT_US`]; its handler counts with [`Clock::beat`]. Between two beats the counter register
//! gives the rest. The time never runs backwards, whoever asks from whatever priority.

use core::cell::Cell;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{DCB, DWT, SCB, SYST};
use critical_section::Mutex;

/// Time between two SysTick interrupts, us. Short enough for the front ends' deadlines, and at about 60 instructions a
/// beat less than 1 % of the core.
pub const BEAT_US: u32 = 100;

/// `ICSR.PENDSTSET`: the counter has run out and its interrupt has not been served yet.
const PENDING: u32 = 1 << 26;

static BEATS: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));
static TICKS_PER_BEAT: Mutex<Cell<u32>> = Mutex::new(Cell::new(u32::MAX));

/// The core's peripherals that keep time.
pub struct Core<'a> {
    /// The timer.
    pub syst: &'a mut SYST,
    /// Priorities.
    pub scb: &'a mut SCB,
    /// Switch of the trace unit.
    pub dcb: &'a mut DCB,
    /// The cycle counter.
    pub dwt: &'a mut DWT,
}

/// Starts the time base; `core_hz` is what the core runs at.
pub fn start(core: &mut Core<'_>, core_hz: u32, priority: u8) {
    let Core {
        syst,
        scb,
        dcb,
        dwt,
    } = core;
    dcb.enable_trace();
    dwt.enable_cycle_counter();
    let ticks = core_hz / 1_000_000 * BEAT_US;
    critical_section::with(|cs| TICKS_PER_BEAT.borrow(cs).set(ticks));
    // SAFETY: done once, before interrupts are enabled.
    unsafe { scb.set_priority(SystemHandler::SysTick, priority) };
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(ticks - 1);
    syst.clear_current();
    syst.enable_counter();
    syst.enable_interrupt();
}

/// Counts a beat; called by SysTick's handler only.
pub fn beat() {
    critical_section::with(|cs| {
        let beats = BEATS.borrow(cs);
        beats.set(beats.get() + 1);
    });
}

/// Board time, us since the time base started.
pub fn now_us() -> u64 {
    critical_section::with(|cs| {
        let ticks = TICKS_PER_BEAT.borrow(cs).get();
        let before = SYST::get_current();
        // SAFETY: reading a status register has no side effect.
        let pending = unsafe { (*SCB::PTR).icsr.read() } & PENDING != 0;
        let current = SYST::get_current();
        // With an interrupt pending, or a counter that wrapped between the two reads, one beat has not been counted yet.
        let uncounted = u64::from(pending || current > before);
        let beats = BEATS.borrow(cs).get() + uncounted;
        beats * u64::from(BEAT_US)
            + u64::from((ticks - 1 - current.min(ticks - 1)) / (ticks / BEAT_US))
    })
}

/// Measures how long the core stood still, which SysTick's interrupt can't tell.
pub struct Stopwatch {
    cycles: u32,
    board_us: u64,
}

impl Stopwatch {
    /// Starts measuring.
    pub fn start() -> Self {
        Self {
            cycles: DWT::cycle_count(),
            board_us: now_us(),
        }
    }

    /// Adds the beats that were missed since the start to board time; at most 25 s at 168 MHz, where the cycle counter wraps.
    pub fn catch_up(self, core_hz: u32) {
        let passed_us = u64::from(DWT::cycle_count().wrapping_sub(self.cycles)) * 1_000_000
            / u64::from(core_hz);
        let counted_us = now_us() - self.board_us;
        let missed = passed_us.saturating_sub(counted_us) / u64::from(BEAT_US);
        critical_section::with(|cs| {
            let beats = BEATS.borrow(cs);
            beats.set(beats.get() + missed);
        });
    }
}
