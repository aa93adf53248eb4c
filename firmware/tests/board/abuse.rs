//! Whatever happens in whatever order, a board goes on.

use crate::bench::*;
use palpus_protocol::*;
use proptest::prelude::*;

fn any_command() -> impl Strategy<Value = Command> {
    let floats = proptest::collection::vec(any::<f32>(), 0..=48);
    prop_oneof![
        any::<u32>().prop_map(Command::Ping),
        any::<[u8; 2]>().prop_map(|[contact_every, raw_every]| Command::Start(Streams {
            contact_every,
            raw_every
        })),
        Just(Command::Stop),
        any::<(u16, bool)>().prop_map(|(samples, force)| Command::Tare(TareRequest {
            samples: samples % 60,
            force
        })),
        Just(Command::GetCalibration),
        (any::<u32>(), any::<u8>(), floats, any::<bool>()).prop_map(
            |(id, gauges, values, seal)| {
                let mut calibration = Calibration {
                    id,
                    gauges,
                    matrix: values.into_iter().collect(),
                    crc: 0,
                };
                if seal {
                    calibration.crc = calibration.computed_crc();
                }
                Command::SetCalibration(calibration)
            }
        ),
        any::<u64>().prop_map(|host_send_us| Command::TimeSync(TimeSyncRequest { host_send_us })),
        Just(Command::Statistics),
    ]
}

/// One thing that may happen to a board.
#[derive(Clone, Debug)]
enum Happening {
    Garbage(Vec<u8>),
    Command(u32, Command),
    Damaged(Command, usize, u8),
    Tick(u64),
    Counts([i32; 8], [u8; 8]),
    Listen,
}

fn happening() -> impl Strategy<Value = Happening> {
    prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..300).prop_map(Happening::Garbage),
        (0u32..20, any_command()).prop_map(|(id, command)| Happening::Command(id, command)),
        (any_command(), any::<usize>(), 1u8..)
            .prop_map(|(command, place, mask)| Happening::Damaged(command, place, mask)),
        prop_oneof![Just(PERIOD_US), 0..100_000u64, any::<u64>()].prop_map(Happening::Tick),
        any::<([i32; 8], [u8; 8])>().prop_map(|(counts, flags)| Happening::Counts(counts, flags)),
        Just(Happening::Listen),
    ]
}

proptest! {
    /// Whatever happens, the board goes on: it still answers, and every frame it sends is whole and
    /// readable.
    #[test]
    fn nothing_stops_a_board(happenings in proptest::collection::vec(happening(), 0..60)) {
        let mut bench = Bench::new();
        for happening in happenings {
            match happening {
                Happening::Garbage(bytes) => bench.board.receive(&bytes, bench.now_us),
                Happening::Command(request_id, command) => bench.send(Request { request_id, command }),
                Happening::Damaged(command, place, mask) => {
                    let mut out = [0; MAX_FRAME_BYTES];
                    let length = HostMessage::from(Request { request_id: 3, command }).encode(&mut out).expect("room");
                    out[place % length] ^= mask;
                    bench.board.receive(&out[..length], bench.now_us);
                }
                Happening::Tick(elapsed) => {
                    bench.now_us = bench.now_us.saturating_add(elapsed);
                    bench.board.tick(bench.now_us.max(500));
                    bench.board.tick_ended(bench.now_us);
                }
                Happening::Counts(counts, flags) => {
                    bench.board.gauges_mut().noise = 0;
                    bench.board.gauges_mut().counts = counts;
                    bench.board.gauges_mut().flags = flags.map(GaugeFlags::from_bits);
                }
                Happening::Listen => bench.listen(),
            }
            while bench.board.take_event().is_some() {}
        }
        bench.board.receive(&[DELIMITER], bench.now_us);
        bench.listen();
        bench.heard.clear();
        bench.send(Identify { request_id: 77 });
        bench.listen();
        let answered = matches!(&bench.heard[..], [BoardMessage::Identity(identity)] if identity.request_id == 77);
        prop_assert!(answered);
    }
}
