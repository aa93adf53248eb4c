//! The clock tree of the STM32-H405: 168 MHz from the 8 MHz crystal, every wait bounded.
//!
//! Whatever the oscillators do, [`bring_up`] returns, and says what the core runs at:
//! crystal and PLL in the normal case; the internal oscillator and PLL when the crystal does not
//! start; the internal oscillator alone (16 MHz) when the PLL does not lock. Baud rates and the time
//! base are computed from the answer.
//!
//! Silicon always starts on its internal oscillator, so `HSIRDY` reads 1 after reset. Where it reads
//! 0 there is no clock tree to set up: the core is an emulated one, which runs at a fixed 168 MHz.

use stm32_metapac::flash::vals::Latency;
use stm32_metapac::pwr::vals::Vos;
use stm32_metapac::rcc::vals::{Hpre, Pllm, Plln, Pllp, Pllq, Pllsrc, Ppre, Sw};
use stm32_metapac::{FLASH, PWR, RCC};

/// Polls before an oscillator or the PLL counts as dead. At 16 MHz one poll takes about 0.4 us, so
/// this is some 40 ms; a crystal starts within 2 ms, the PLL locks within 0.3 ms (data sheet).
const READY_POLLS: u32 = 100_000;

/// Where the core's clock comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum Source {
    /// 8 MHz crystal through the PLL.
    Crystal,
    /// Internal oscillator through the PLL: right in rate to 1 %, so the time stamps drift more.
    Internal,
    /// Internal oscillator alone; the PLL did not lock.
    InternalSlow,
    /// An emulated core without a clock tree.
    Fixed,
}

/// The clocks the board runs on.
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// Where they come from.
    pub source: Source,
    /// Core and SysTick, in Hz.
    pub core_hz: u32,
    /// USART2 to 5, in Hz.
    pub apb1_hz: u32,
    /// USART1 and 6, in Hz.
    pub apb2_hz: u32,
}

impl Clocks {
    const fn full_speed(source: Source) -> Self {
        Self {
            source,
            core_hz: 168_000_000,
            apb1_hz: 42_000_000,
            apb2_hz: 84_000_000,
        }
    }
}

fn within(polls: u32, mut ready: impl FnMut() -> bool) -> bool {
    (0..polls).any(|_| ready())
}

/// Sets the clocks up; takes at most about 0.2 s, whatever is broken.
pub fn bring_up() -> Clocks {
    if !RCC.cr().read().hsirdy() {
        return Clocks::full_speed(Source::Fixed);
    }

    RCC.apb1enr().modify(|w| w.set_pwren(true));
    PWR.cr1().modify(|w| w.set_vos(Vos::SCALE1));

    RCC.cr().modify(|w| w.set_hseon(true));
    let crystal = within(READY_POLLS, || RCC.cr().read().hserdy());
    let (source, pll_source, divider) = if crystal {
        (Source::Crystal, Pllsrc::HSE, Pllm::DIV8)
    } else {
        RCC.cr().modify(|w| w.set_hseon(false));
        (Source::Internal, Pllsrc::HSI, Pllm::DIV16)
    };

    // 1 MHz into the PLL, 336 MHz out of its oscillator, 168 MHz to the core.
    RCC.pllcfgr().write(|w| {
        w.set_pllsrc(pll_source);
        w.set_pllm(divider);
        w.set_plln(Plln::MUL336);
        w.set_pllp(Pllp::DIV2);
        w.set_pllq(Pllq::DIV7);
    });
    RCC.cr().modify(|w| w.set_pllon(true));
    if !within(READY_POLLS, || RCC.cr().read().pllrdy()) {
        RCC.cr().modify(|w| w.set_pllon(false));
        return slow();
    }

    // Five wait states at 168 MHz and 3.3 V; the accelerator hides most of them.
    FLASH.acr().write(|w| {
        w.set_latency(Latency::WS5);
        w.set_icen(true);
        w.set_dcen(true);
        w.set_prften(true);
    });
    RCC.cfgr().modify(|w| {
        w.set_hpre(Hpre::DIV1);
        w.set_ppre1(Ppre::DIV4);
        w.set_ppre2(Ppre::DIV2);
    });
    RCC.cfgr().modify(|w| w.set_sw(Sw::PLL1_P));
    if within(READY_POLLS, || RCC.cfgr().read().sws() == Sw::PLL1_P) {
        Clocks::full_speed(source)
    } else {
        RCC.cfgr().modify(|w| {
            w.set_sw(Sw::HSI);
            w.set_ppre1(Ppre::DIV1);
            w.set_ppre2(Ppre::DIV1);
        });
        slow()
    }
}

const fn slow() -> Clocks {
    Clocks {
        source: Source::InternalSlow,
        core_hz: 16_000_000,
        apb1_hz: 16_000_000,
        apb2_hz: 16_000_000,
    }
}
