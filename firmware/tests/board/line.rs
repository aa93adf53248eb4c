//! What goes over the line, how much of it, and what becomes of the rest.

use crate::bench::*;
use palpus_firmware::store::RamStore;
use palpus_protocol::*;

#[test]
fn a_host_that_stops_reading_loses_the_oldest_and_knows_how_many() {
    let mut bench = Bench::<RamStore>::ready();
    bench.ask(STREAM);
    bench.contacts();
    // Ten seconds without listening.
    let before = bench.board.statistics(0, 0);
    for _ in 0..2000 {
        bench.now_us += PERIOD_US;
        bench.board.tick(bench.now_us);
    }
    bench.listen();
    let contacts = bench.contacts();
    let after = bench.board.statistics(0, 0);
    assert_eq!(contacts.len(), 64);
    // The newest is there, and the gap before the first is exactly what the board says it dropped.
    assert_eq!(contacts[63].board_time_us, bench.now_us - 500);
    assert_eq!(
        contacts[0].lost_since(before.contacts.wrapping_sub(1)),
        after.contacts_dropped - before.contacts_dropped
    );
    assert_eq!(after.contacts_dropped - before.contacts_dropped, 2000 - 64);
    assert_eq!(after.contact_queue_high_water, 64);
    assert!(
        contacts
            .windows(2)
            .all(|pair| pair[1].lost_since(pair[0].sequence) == 0)
    );
}

#[test]
fn replies_do_not_hold_up_contacts() {
    let mut bench = Bench::<RamStore>::ready();
    bench.ask(STREAM);
    bench.contacts();
    for _ in 0..4 {
        bench.now_us += PERIOD_US;
        bench.board.tick(bench.now_us);
    }
    for number in 0..4 {
        bench.send(Request {
            request_id: 1000 + number,
            command: Command::Ping(number),
        });
    }
    bench.heard.clear();
    bench.listen();
    let kinds: Vec<u8> = bench.heard.iter().map(BoardMessage::kind).collect();
    // The answer to the start went last, so a contact is next.
    assert_eq!(kinds, [2, 7, 2, 7, 2, 7, 2, 7]);
}

#[test]
fn bytes_one_by_one_are_the_frames() {
    let (mut whole, mut single) = (Bench::<RamStore>::ready(), Bench::<RamStore>::ready());
    let mut frames = Vec::new();
    let mut bytes = Vec::new();
    for bench in [&mut whole, &mut single] {
        bench.send(Request {
            request_id: 1,
            command: STREAM,
        });
        for _ in 0..5 {
            bench.now_us += PERIOD_US;
            bench.board.tick(bench.now_us);
        }
    }
    while let Some(frame) = whole.board.take_frame(whole.now_us) {
        frames.extend_from_slice(frame);
    }
    while single.board.has_output() {
        bytes.extend(single.board.next_byte(single.now_us));
    }
    assert_eq!(frames, bytes);
    assert!(frames.len() > 5 * CONTACT_FRAME_BYTES && single.board.next_byte(0).is_none());
}

/// Runs a board for ten seconds on a line of so many baud; returns its statistics and the contacts
/// that came through.
fn ten_seconds_on_a_line(baud: u64, period_us: u64, streams: Streams) -> (Statistics, u32) {
    let mut bench = Bench::<RamStore>::ready_with_period(period_us as u32);
    bench.ask(Command::Start(streams));
    bench.heard.clear();
    let (mut bits, mut contacts) = (0, 0);
    for tick in 0..10_000_000 / period_us {
        bench.now_us += period_us;
        bench.board.tick(bench.now_us);
        // Clocks are compared and statistics asked for once a second, as a host does.
        if (tick * period_us).is_multiple_of(1_000_000) {
            let request_id = 10_000 + tick as u32;
            bench.send(Request {
                request_id,
                command: Command::TimeSync(TimeSyncRequest {
                    host_send_us: bench.now_us,
                }),
            });
            bench.send(Request {
                request_id: request_id + 1,
                command: Command::Statistics,
            });
        }
        // Eight bits, a start and a stop bit per byte; an idle line saves nothing up.
        bits += baud * period_us;
        while bits >= 10_000_000 {
            let Some(byte) = bench.board.next_byte(bench.now_us) else {
                bits = 0;
                break;
            };
            bits -= 10_000_000;
            if let Some(frame) = bench.decoder.push(byte) {
                contacts += u32::from(matches!(
                    BoardMessage::try_from(frame.expect("undamaged")),
                    Ok(BoardMessage::Contact(_))
                ));
            }
        }
    }
    (bench.board.statistics(0, 0), contacts)
}

#[test]
fn a_line_of_115_200_baud_carries_200_contacts_a_second_and_more() {
    let (statistics, contacts) = ten_seconds_on_a_line(
        115_200,
        5000,
        Streams {
            contact_every: 1,
            raw_every: 20,
        },
    );
    assert_eq!(
        (
            statistics.contacts,
            statistics.contacts_dropped,
            statistics.raw_dropped
        ),
        (2000, 0, 0)
    );
    assert_eq!(
        (statistics.replies_dropped, statistics.rate_millihertz),
        (0, 200_000)
    );
    assert!(
        contacts >= 1998 && statistics.contact_queue_high_water <= 8,
        "{contacts} {statistics:?}"
    );
}

#[test]
fn a_line_of_921_600_baud_carries_a_thousand_contacts_a_second() {
    let (statistics, contacts) = ten_seconds_on_a_line(
        921_600,
        1000,
        Streams {
            contact_every: 1,
            raw_every: 20,
        },
    );
    assert_eq!(
        (
            statistics.contacts,
            statistics.contacts_dropped,
            statistics.raw_dropped
        ),
        (10_000, 0, 0)
    );
    assert_eq!(
        (statistics.overruns, statistics.rate_millihertz),
        (0, 1_000_000)
    );
    assert!(contacts >= 9998, "{contacts}");
}

#[test]
fn what_a_line_can_not_carry_is_dropped_and_counted() {
    let (statistics, contacts) = ten_seconds_on_a_line(
        57_600,
        5000,
        Streams {
            contact_every: 1,
            raw_every: 0,
        },
    );
    // Room for 120 contacts a second of 200, less the replies.
    assert!((1150..=1200).contains(&contacts), "{contacts}");
    // Sent, dropped or still waiting: nothing else can have become of them. One may be half sent.
    let accounted = contacts + statistics.contacts_dropped;
    assert!(
        (2000 - 65..=2000 - 64).contains(&accounted),
        "{accounted} {statistics:?}"
    );
}
