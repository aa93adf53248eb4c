//! The fingertip board on an Olimex STM32-H405.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "RTIC's generated dispatch and register access")]

mod clock;

use defmt_rtt as _;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

defmt::timestamp!("{=u32}", 0);

#[rtic::app(device = stm32_metapac, peripherals = false, dispatchers = [EXTI0, EXTI1])]
mod app {
    use crate::clock;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {}

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let clocks = clock::bring_up();
        defmt::info!("clock {} {}", clocks.source, clocks.core_hz);
        let mut st = cx.core.SYST;
        st.set_reload(clocks.core_hz / 1000 - 1);
        st.clear_current();
        st.enable_counter();
        st.enable_interrupt();
        (Shared {}, Local {})
    }

    #[task(binds = SysTick, priority = 4)]
    fn beat(_cx: beat::Context) {
        defmt::info!("beat");
    }
}
