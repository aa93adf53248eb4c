//! The RAM that survives a reset, and the two ways to crash.
//!
//! A panic or a fault writes its last words into that RAM, releases the encoders' bus, and resets the board. The next start reports them on
//! the probe's log and on the host's, and samples again within milliseconds. What a record holds: [`palpus_firmware::restart`].

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use palpus_firmware::restart::{Cause, LastWords, RECORD_WORDS};
use stm32_metapac::RCC;

use crate::pins;

// SAFETY: `.uninit` is a section of cortex-m-rt's linker script that the start-up code leaves alone.
#[unsafe(link_section = ".uninit.LAST_WORDS")]
static mut LAST_WORDS: MaybeUninit<[u32; RECORD_WORDS]> = MaybeUninit::uninit();

/// Finds out why the board started and forgets it.
pub fn cause() -> Cause {
    // SAFETY: interrupts are off, nobody else looks; any bits are words, and the check sum tells leavings of the power-up from a record.
    let record = unsafe {
        let place = (&raw mut LAST_WORDS).cast::<[u32; RECORD_WORDS]>();
        let record = place.read_volatile();
        place.cast::<u32>().write_volatile(0);
        record
    };
    let watchdog = RCC.csr().read().wdgrstf();
    RCC.csr().modify(|w| w.set_rmvf(true));
    Cause::of(&record, watchdog)
}

/// Keeps the words and resets the board.
fn die(words: &LastWords) -> ! {
    cortex_m::interrupt::disable();
    pins::ENCODER_DIRECTION.set(false);
    pins::LAMP.set(true);
    // SAFETY: interrupts are off and this function never returns, so nobody else writes here.
    unsafe {
        (&raw mut LAST_WORDS)
            .cast::<[u32; RECORD_WORDS]>()
            .write_volatile(words.record())
    };
    SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    let (file, line) = info.location().map_or(("", 0), |place| {
        (
            place.file().rsplit('/').next().unwrap_or_default(),
            place.line(),
        )
    });
    die(&LastWords::panic(
        line,
        format_args!("{file}:{line}: {}", info.message()),
    ))
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    die(&LastWords::fault(
        frame.pc(),
        format_args!(
            "fault at {:#010x}, called from {:#010x}",
            frame.pc(),
            frame.lr()
        ),
    ))
}
