//! Three boards whose clocks run 100 ppm fast, 100 ppm slow and nearly true, on lines that are late by 0 to 5 ms in each
//! direction, agree within 0.2 ms after ten seconds.
//!
//! The session, the protocol, the firmware and the line's faults are the real ones; time is simulated
//! ([`palpus_tests::simulated_line`]), so that the figures do not depend on the machine.

use palpus_host::link::connection::Connection;
use palpus_host::link::port::DEFAULT_BAUD;
use palpus_host::link::session::{LinkEvent, Session, SessionSettings};
use palpus_protocol::Streams;
use palpus_tests::bench_board::BenchSettings;
use palpus_tests::fault_line::{Faults, LineFaults};
use palpus_tests::simulated_line::{SimulatedLine, host_us, simulated_clock};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Clocks of the boards.
const DRIFTS: [f64; 3] = [100e-6, -100e-6, 30e-6];
/// Lateness of each direction, at most, us.
const LATE_US: u32 = 5_000;
/// From when on they have to agree, and how long each run is, s of board time after the start.
const FROM_S: f64 = 10.0;
const TO_S: f64 = 30.0;
/// Sets of three boards.
const SETS: u64 = 60;

/// How a set of three boards fared, in us.
#[derive(Default)]
struct Figures {
    squares: f64,
    count: u64,
    worst: f64,
    /// Between the boards, 5 ms by 5 ms.
    apart_squares: f64,
    apart_count: u64,
    apart_worst: f64,
}

/// By how much the times given to a board's contacts are off, by the number of the 5 ms they were made in.
fn errors_us(
    number: usize,
    seed: u64,
    baud: Option<u32>,
    faults: LineFaults,
) -> BTreeMap<i64, f64> {
    let clock = simulated_clock();
    let bench = BenchSettings {
        drift: DRIFTS[number],
        start_us: 1_000_000 + 70_000_000 * number as u64,
        clock,
        ..BenchSettings::new("index", number as u8)
    };
    let line = SimulatedLine::new(bench.clone(), baud, faults, 3 * seed + number as u64);
    // By the name the session knows whether bytes take their time.
    let name = if baud.is_some() {
        "/dev/ttyUSB0"
    } else {
        "/dev/ttyACM0"
    };
    let mut connection = Connection::new(name, Box::new(line), clock);
    connection.number_from(1_000_000_000);
    let settings = SessionSettings {
        finger: "index".into(),
        port: name.into(),
        baud: baud.unwrap_or(DEFAULT_BAUD),
        streams: Streams {
            contact_every: 1,
            raw_every: 0,
        },
    };
    let session = Session::over(connection, settings).expect("the board answers");
    let stop = AtomicBool::new(false);
    let mut errors = BTreeMap::new();
    let began_us = host_us(&bench, bench.start_us);
    let mut sink = |event: LinkEvent| {
        if let LinkEvent::Frame {
            sampled_us,
            contact: Some(contact),
            ..
        } = event
        {
            let true_us = host_us(&bench, contact.board_time_us);
            let since_s = (true_us - began_us) * 1e-6;
            if since_s >= FROM_S {
                errors.insert(
                    (since_s * 200.0).round() as i64,
                    sampled_us as f64 - true_us,
                );
            }
            stop.fetch_or(since_s >= TO_S, Ordering::Relaxed);
        }
        true
    };
    let status = session.run(&stop, &mut sink, &mut |_| {});
    assert_eq!(
        (status.reconnects, status.reboots, status.dropped_by_host),
        (0, 0, 0)
    );
    errors
}

fn three_boards(seed: u64, baud: Option<u32>, faults: LineFaults, figures: &mut Figures) {
    let errors = [0, 1, 2].map(|number| errors_us(number, seed, baud, faults));
    for error in errors.iter().flat_map(BTreeMap::values) {
        figures.squares += error * error;
        figures.count += 1;
        figures.worst = figures.worst.max(error.abs());
    }
    for time in errors[0].keys() {
        let at: Vec<f64> = errors.iter().filter_map(|e| e.get(time).copied()).collect();
        if at.len() < errors.len() {
            continue;
        }
        let highest = at.iter().copied().fold(f64::MIN, f64::max);
        let apart = highest - at.iter().copied().fold(f64::MAX, f64::min);
        figures.apart_squares += apart * apart;
        figures.apart_count += 1;
        figures.apart_worst = figures.apart_worst.max(apart);
    }
}

fn all_sets(what: &str, baud: Option<u32>, damage: f64) -> Figures {
    let faults = Faults {
        late_us: LATE_US,
        ..Faults::mixed(damage)
    };
    let faults = LineFaults {
        to_host: faults,
        to_board: faults,
    };
    let mut figures = Figures::default();
    for seed in 0..SETS {
        three_boards(seed, baud, faults, &mut figures);
    }
    let rms = |squares: f64, count: u64| (squares / count as f64).sqrt();
    println!(
        "{what}: {} contacts, off by {:.0} us rms, {:.0} us at worst; three boards apart by {:.0} us rms, {:.0} us at worst",
        figures.count,
        rms(figures.squares, figures.count),
        figures.worst,
        rms(figures.apart_squares, figures.apart_count),
        figures.apart_worst,
    );
    assert!(figures.apart_count > 500 * SETS);
    figures
}

#[test]
fn three_boards_agree_within_200_us_after_10_s_of_5_ms_jitter_and_100_ppm() {
    let figures = all_sets("USB", None, 0.0);
    assert!(figures.apart_worst < 200.0, "{} us", figures.apart_worst);
}

#[test]
fn so_they_do_with_damaged_bytes_and_on_a_slow_line() {
    // With one byte in a thousand damaged a twentieth of the frames is lost. On the slow line contacts leave room for 21
    // round trips a second, whose answers wait for the contact before them; the contacts themselves show the way back.
    let damaged = all_sets("USB, 0.1 % of the bytes damaged", None, 0.001);
    assert!(damaged.apart_worst < 200.0, "{} us", damaged.apart_worst);
    let slow = all_sets("UART at 115 200 Bd", Some(DEFAULT_BAUD), 0.0);
    assert!(slow.apart_worst < 200.0, "{} us", slow.apart_worst);
}
