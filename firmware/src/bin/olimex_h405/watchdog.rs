//! The independent watchdog: the board restarts when sampling or the link's task stands still.
//!
//! It runs on its own oscillator (32 kHz, 17 to 47 kHz) and can't be stopped once started. It is fed from the lowest
//! priority, and only while ticks and the link's task go on, so a dead interrupt and a task that never ends both end in a restart.

use stm32_metapac::iwdg::vals::{Key, Pr};
use stm32_metapac::{DBGMCU, IWDG};

/// Counts of the watchdog's clock, 0.5 s at 32 kHz / 16; 0.34 s to 0.94 s over the oscillator's range.
const RELOAD: u16 = 1_000;

/// How long the board may be silent.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// 0.5 s.
    Normal,
    /// 8 s, for the erasure of a flash sector (2 s at most), which stops the core.
    Erasing,
}

/// Starts the watchdog.
pub fn start() {
    // A core stopped by a debugger is not a dead one.
    DBGMCU.apb1fzr().modify(|w| w.set_iwdg(true));
    IWDG.kr().write(|w| w.set_key(Key::START));
    set(Patience::Normal);
}

/// Changes how long the board may be silent.
pub fn set(patience: Patience) {
    IWDG.kr().write(|w| w.set_key(Key::ENABLE));
    IWDG.pr().write(|w| {
        w.set_pr(match patience {
            Patience::Normal => Pr::DIVIDE_BY16,
            Patience::Erasing => Pr::DIVIDE_BY256,
        });
    });
    IWDG.rlr().write(|w| w.set_rl(RELOAD));
    // The new values are taken over within five periods of the slow oscillator; 0.3 ms.
    for _ in 0..100_000 {
        let status = IWDG.sr().read();
        if !status.pvu() && !status.rvu() {
            break;
        }
    }
    feed();
}

/// Gives the board its time anew.
pub fn feed() {
    IWDG.kr().write(|w| w.set_key(Key::RESET));
}
