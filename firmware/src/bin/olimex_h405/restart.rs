//! Why the board started: power, reset, watchdog, or its own last words.
//!
//! A panic or a fault writes what it was into RAM that a reset leaves alone, releases the encoders' bus, and resets the
//! board. The next start reports it on the probe's log and on the host's, and samples again within milliseconds.

use core::fmt::Write;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use heapless::String;
use palpus_firmware::Event;
use palpus_protocol::CRC;
use stm32_metapac::RCC;

use crate::pins;

/// Room for what a panic says.
const WORDS: usize = 120;

/// "last" in ASCII.
const MAGIC: u32 = 0x6c61_7374;

/// What survives a reset.
#[repr(C)]
#[derive(Clone, Copy)]
struct LastWords {
    magic: u32,
    /// Whether it was a fault, and where: an address; or else a panic's source line.
    fault: u32,
    place: u32,
    length: u32,
    text: [u8; WORDS],
    crc: u32,
}

// SAFETY: `.uninit` is a section of cortex-m-rt's linker script that the start-up code leaves alone.
#[unsafe(link_section = ".uninit.LAST_WORDS")]
static mut LAST_WORDS: MaybeUninit<LastWords> = MaybeUninit::uninit();

impl LastWords {
    fn sum(&self) -> u32 {
        CRC.checksum(&self.text) ^ self.length ^ self.fault ^ self.place
    }
}

/// Why the board started.
pub enum Cause {
    /// Power, the reset button, or a debugger.
    Ordinary,
    /// The watchdog: sampling had stood still.
    Watchdog,
    /// A panic or a fault: what to report, and what it said.
    Crash {
        /// For the host.
        event: Event,
        /// For the probe.
        text: String<WORDS>,
    },
}

/// Finds out why the board started and forgets it.
pub fn cause() -> Cause {
    // SAFETY: interrupts are off, nobody else looks; any bytes are a valid `LastWords`, and the check sum tells leavings
    // of the power-up from words.
    let words = unsafe {
        let place = (&raw mut LAST_WORDS).cast::<LastWords>();
        let words = place.read_volatile();
        (&raw mut (*place).magic).write_volatile(0);
        words
    };
    let watchdog = RCC.csr().read().wdgrstf();
    RCC.csr().modify(|w| w.set_rmvf(true));
    if words.magic == MAGIC && words.crc == words.sum() {
        let bytes = words.text.get(..words.length as usize).unwrap_or_default();
        let mut text = String::new();
        // As long as the room at most.
        let _ = text.push_str(core::str::from_utf8(bytes).unwrap_or("panic with unreadable words"));
        let event = if words.fault != 0 {
            Event::FaultRestart {
                address: words.place,
            }
        } else {
            Event::PanicRestart { line: words.place }
        };
        Cause::Crash { event, text }
    } else if watchdog {
        Cause::Watchdog
    } else {
        Cause::Ordinary
    }
}

/// Keeps the words and resets the board.
fn die(fault: bool, place: u32, text: &str) -> ! {
    cortex_m::interrupt::disable();
    pins::ENCODER_DIRECTION.set(false);
    pins::LAMP.set(true);
    let mut words = LastWords {
        magic: MAGIC,
        fault: u32::from(fault),
        place,
        length: 0,
        text: [0; WORDS],
        crc: 0,
    };
    let mut length = text.len().min(WORDS);
    while !text.is_char_boundary(length) {
        length -= 1;
    }
    words.text[..length].copy_from_slice(&text.as_bytes()[..length]);
    words.length = length as u32;
    words.crc = words.sum();
    // SAFETY: interrupts are off and this function never returns, so nobody else writes here.
    unsafe {
        (&raw mut LAST_WORDS)
            .cast::<LastWords>()
            .write_volatile(words)
    };
    SCB::sys_reset()
}

/// As much of a panic's text as there is room for.
struct Cut(String<WORDS>);

impl Write for Cut {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        text.chars()
            .try_for_each(|character| self.0.push(character).map_err(|_| core::fmt::Error))
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let mut text = Cut(String::new());
    if let Some(place) = info.location() {
        let file = place.file().rsplit('/').next().unwrap_or_default();
        let _ = write!(text, "{file}:{}: ", place.line());
    }
    let _ = write!(text, "{}", info.message());
    die(
        false,
        info.location().map_or(0, |place| place.line()),
        &text.0,
    )
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    let mut text = Cut(String::new());
    let _ = write!(
        text,
        "fault at {:#010x}, called from {:#010x}",
        frame.pc(),
        frame.lr()
    );
    die(true, frame.pc(), &text.0)
}
