//! The fingertip board on an Olimex STM32-H405: six gauges, three joint encoders, one line to the host.
//!
//! ```text
//! priority 4   SysTick        every 0.1 ms: drivers' deadlines; every 5 ms: starts a tick
//!              USART2, 3, 6   bytes of the bridge converters
//!              UART4          bytes of the encoders, and the bus' direction
//!              USART1         bytes of the host's line, in and out of queues
//! priority 2   tick           takes the drivers' results, starts their next round, runs the board
//! priority 1   serve          decodes what the host sent, encodes what it gets
//! idle         log, lamp, watchdog
//! ```
//!
//! # How long things take
//!
//! A tick waits for one `serve` step at most (a frame encoded or 32 bytes decoded; a calibration that is written to flash takes up to 2 s,
//! and is refused while contacts are streamed). The interrupts of priority 4 wait for each other and for
//! a tick's exchange with the drivers. Figures are in the firmware's README, "Instruction counts".
//!
//! The log never waits: lines are dropped when the probe does not read. Nothing is logged in an interrupt; the board notes events, and
//! the idle loop logs them.
#![no_std]
#![no_main]
#![allow(
    unsafe_code,
    reason = "RTIC's generated dispatch, registers, flash and the RAM that survives a reset"
)]
#![allow(missing_docs, reason = "what RTIC generates has no documentation")]

mod clock;
mod host_port;
mod mailbox;
mod pins;
mod restart;
mod settings;
mod store;
mod time;
mod uart;
mod watchdog;

use defmt_rtt as _;

defmt::timestamp!("{=u64:us}", time::now_us());

#[rtic::app(device = stm32_metapac, peripherals = false, dispatchers = [EXTI0, EXTI1])]
mod app {
    use crate::host_port::{HostPort, HostQueues, RECEIVED, TO_SEND};
    use crate::mailbox::{Gauges, Joints};
    use crate::restart;
    use crate::store::FlashStore;
    use crate::uart::{ChipLine, Port};
    use crate::{clock, pins, settings, time, uart, watchdog};
    use heapless::spsc::Queue;
    use palpus_firmware::Board;
    use palpus_firmware::front_end::serial::{BridgeConverters, EncoderBus};
    use palpus_firmware::front_end::{GaugeFrontEnd, GaugeSample, JointFrontEnd, ads122u04, amt21};
    use palpus_firmware::restart::{Cause, Vigil};
    use palpus_protocol::LogLevel;

    /// Beats of SysTick in one period.
    const BEATS: u32 = settings::PERIOD_US / time::BEAT_US;

    /// Ticks that the converters get to come up before the board takes what they say: 0.1 s. The encoders take 0.2 s after power-on, and
    /// are missing until then.
    const START_TICKS: u8 = 20;

    /// Beats without a tick or without service of the link after which the watchdog is not fed any more: 0.1 s.
    const PATIENCE_BEATS: u32 = 1_000;

    type FingerBoard = Board<Gauges, Joints, FlashStore>;

    #[shared]
    struct Shared {
        converters: BridgeConverters<ChipLine, 3>,
        encoders: EncoderBus<ChipLine>,
        board: FingerBoard,
        vigil: Vigil,
    }

    #[local]
    struct Local {
        beats: u32,
        start_ticks: u8,
        port: HostPort,
        queues: HostQueues,
    }

    #[init(local = [
        received: Queue<u8, RECEIVED> = Queue::new(),
        to_send: Queue<u8, TO_SEND> = Queue::new(),
    ])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let cause = restart::cause();
        let clocks = clock::bring_up();
        pins::bring_up();
        uart::bring_up();
        defmt::info!(
            "clock from {}, core at {=u32} Hz",
            clocks.source,
            clocks.core_hz
        );

        let converters = BridgeConverters::new(
            ads122u04::Timing::AT_115200,
            Port::converters(&clocks).map(ChipLine::new),
        );
        let encoders = EncoderBus::new(
            amt21::Amt21Bus::new(settings::ENCODER_ADDRESSES, amt21::Timing::AT_115200),
            settings::JOINT_MOUNTS,
            ChipLine::half_duplex(Port::encoders(&clocks)),
        );
        let gauges = Gauges {
            sample: GaugeSample::missing(0),
            resets: 0,
        };
        let config = settings::board(clocks.source);
        let store = FlashStore::new(clocks.core_hz);
        let Ok(mut board) = Board::new(config, gauges, Joints::default(), store, 0) else {
            // The settings are constants of this image.
            panic!("settings that no board can have");
        };
        if let Cause::Crash(words) = &cause {
            defmt::error!("last words: {=str}", words.text.as_str());
        }
        if let Some(event) = cause.event() {
            board.note(event, 0);
        }

        let (received_in, received_out) = cx.local.received.split();
        let (send_in, send_out) = cx.local.to_send.split();
        let port = Port::host(&clocks);
        let mut core = time::Core {
            syst: &mut cx.core.SYST,
            scb: &mut cx.core.SCB,
            dcb: &mut cx.core.DCB,
            dwt: &mut cx.core.DWT,
        };
        time::start(
            &mut core,
            clocks.core_hz,
            rtic::export::cortex_logical2hw(4, 4),
        );
        watchdog::start();
        (
            Shared {
                converters,
                encoders,
                board,
                vigil: Vigil::new(PATIENCE_BEATS),
            },
            Local {
                beats: 0,
                start_ticks: START_TICKS,
                port: HostPort::new(port, received_in, send_out),
                queues: HostQueues::new(port, received_out, send_in),
            },
        )
    }

    /// Tells the probe what happened, and keeps the watchdog quiet while the board is well.
    #[idle(shared = [board, vigil])]
    fn idle(mut cx: idle::Context) -> ! {
        loop {
            if let Some(event) = cx.shared.board.lock(FingerBoard::take_event) {
                match event.level() {
                    LogLevel::Info => defmt::info!("{}", event),
                    LogLevel::Warning => defmt::warn!("{}", event),
                    LogLevel::Error => defmt::error!("{}", event),
                }
            }
            if cx.shared.vigil.lock(|vigil| vigil.is_well()) {
                watchdog::feed();
            }
            cortex_m::asm::wfi();
        }
    }

    #[task(binds = SysTick, priority = 4, local = [beats], shared = [converters, encoders, vigil])]
    fn beat(mut cx: beat::Context) {
        time::beat();
        let now_us = time::now_us();
        cx.shared
            .converters
            .lock(|converters| converters.elapse(now_us));
        cx.shared.encoders.lock(|encoders| encoders.elapse(now_us));
        cx.shared.vigil.lock(Vigil::beat);
        *cx.local.beats += 1;
        if *cx.local.beats >= BEATS {
            *cx.local.beats = 0;
            // A tick that still runs misses this one; the board counts it by the time that passed.
            let _ = tick::spawn();
        }
    }

    #[task(priority = 2, local = [start_ticks], shared = [converters, encoders, board, vigil])]
    async fn tick(mut cx: tick::Context) {
        let now_us = time::now_us();
        let (sample, resets) = cx
            .shared
            .converters
            .lock(|converters| (converters.sample(now_us), converters.chip_resets()));
        let joints = cx.shared.encoders.lock(|encoders| encoders.sample(now_us));
        if *cx.local.start_ticks > 0 {
            *cx.local.start_ticks -= 1;
            cx.shared.vigil.lock(Vigil::ticked);
            let _ = serve::spawn();
            return;
        }
        let valid = cx.shared.board.lock(|board| {
            *board.gauges_mut() = Gauges { sample, resets };
            *board.joints_mut() = Joints(joints);
            board.tick(now_us);
            board.tick_ended(time::now_us());
            board
                .last_contact()
                .is_some_and(|contact| contact.flags.is_valid())
        });
        // Lit while something is touched and everything is right.
        pins::LAMP.set(!valid);
        cx.shared.vigil.lock(Vigil::ticked);
        let _ = serve::spawn();
    }

    #[task(priority = 1, local = [queues], shared = [board, vigil])]
    async fn serve(mut cx: serve::Context) {
        let queues = cx.local.queues;
        loop {
            let bytes = queues.received();
            if bytes.is_empty() {
                break;
            }
            cx.shared
                .board
                .lock(|board| board.receive(&bytes, time::now_us()));
        }
        while queues.has_room() {
            let sent = cx
                .shared
                .board
                .lock(|board| match board.take_frame(time::now_us()) {
                    Some(frame) => {
                        queues.send(frame);
                        true
                    }
                    None => false,
                });
            if !sent {
                break;
            }
        }
        cx.shared.vigil.lock(Vigil::served);
    }

    #[task(binds = USART1, priority = 4, local = [port])]
    fn host(cx: host::Context) {
        let served = cx.local.port.interrupt();
        if served.received || served.room {
            let _ = serve::spawn();
        }
    }

    #[task(binds = USART2, priority = 4, shared = [converters])]
    fn converter_0(mut cx: converter_0::Context) {
        cx.shared
            .converters
            .lock(|converters| exchange(converters, 0));
    }

    #[task(binds = USART3, priority = 4, shared = [converters])]
    fn converter_1(mut cx: converter_1::Context) {
        cx.shared
            .converters
            .lock(|converters| exchange(converters, 1));
    }

    #[task(binds = USART6, priority = 4, shared = [converters])]
    fn converter_2(mut cx: converter_2::Context) {
        cx.shared
            .converters
            .lock(|converters| exchange(converters, 2));
    }

    #[task(binds = UART4, priority = 4, shared = [encoders])]
    fn encoder(mut cx: encoder::Context) {
        cx.shared.encoders.lock(|encoders| {
            if let Some(byte) = encoders.line().interrupt() {
                encoders.receive(byte, time::now_us());
            }
        });
    }

    fn exchange(converters: &mut BridgeConverters<ChipLine, 3>, chip: usize) {
        if let Some(byte) = converters.line(chip).and_then(ChipLine::interrupt) {
            converters.receive(chip, byte, time::now_us());
        }
    }
}
