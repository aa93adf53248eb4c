//! `kill -9` at any moment of a capture: the run opens, and the loss is at most a second.
//!
//! `PALPUS_KILLS=200` makes it two hundred moments instead of the few that every test run makes.

use palpus_host::link::board;
use palpus_host::link::connection::{Connection, decode_wire};
use palpus_host::link::host_clock::HostClock;
use palpus_host::link::port::DEFAULT_BAUD;
use palpus_host::run::points::points;
use palpus_host::run::reader::{Run, RunItem};
use palpus_protocol::BoardMessage;
use palpus_tests::bench_board::{BenchBoard, BenchSettings};
use palpus_tests::kill::{CHILD, capture_if_child, start_child};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::{BufRead, BufReader};
use std::time::Duration;

#[test]
fn child_that_captures() {
    capture_if_child();
}

#[test]
fn a_killed_capture_opens_and_loses_at_most_a_second() {
    if std::env::var(CHILD).is_ok() {
        return;
    }
    let kills: usize = std::env::var("PALPUS_KILLS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(4);
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let bench = BenchBoard::start(BenchSettings::new("index", 0));
    {
        let clock = HostClock::start();
        let mut connection = Connection::open(bench.path(), DEFAULT_BAUD, clock).unwrap();
        board::tare(&mut connection, 20, false).unwrap();
    }
    bench.press(true);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (mut opened, mut largest_loss_s, mut complete): (usize, f64, usize) = (0, 0.0, 0);
    for kill in 0..kills {
        let at_start = bench.sent().len();
        let mut child = start_child("child_that_captures", "index", bench.path(), &output);
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        assert!(
            lines.any(|line| line.is_ok_and(|l| l == "running")),
            "child {kill} captures"
        );
        std::thread::sleep(Duration::from_millis(rng.random_range(0..2_500)));
        let before = bench.sent().len();
        child.kill().unwrap();
        child.wait().unwrap();

        let run = Run::open(&output).unwrap();
        assert_eq!(run.fingers, ["index"], "kill {kill}");
        complete += usize::from(run.complete);
        opened += 1;
        let mut last = None;
        run.each(|item| {
            if let RunItem::Frame { wire, .. } = item
                && let Ok(BoardMessage::Contact(contact)) = decode_wire(&wire)
            {
                last = Some(contact.board_time_us);
            }
        })
        .unwrap();
        let result = points(std::slice::from_ref(&output), None).unwrap();
        assert!(!result.reports[0].complete || run.complete);
        // From the last contact kept, or the first made for this child if none was, to the last one made for it.
        let sent = bench.sent();
        let times: Vec<u64> = sent[at_start..before]
            .iter()
            .filter_map(|frame| match decode_wire(&frame[..frame.len() - 1]) {
                Ok(BoardMessage::Contact(contact)) => Some(contact.board_time_us),
                _ => None,
            })
            .collect();
        if let (Some(&first), Some(&latest)) = (times.first(), times.last()) {
            let loss_s = latest.saturating_sub(last.unwrap_or(first)) as f64 * 1e-6;
            largest_loss_s = largest_loss_s.max(loss_s);
            assert!(loss_s <= 1.0, "kill {kill}: {loss_s} s lost");
        }
    }
    println!(
        "{kills} kills: {opened} runs open, {complete} complete, largest loss {largest_loss_s:.3} s"
    );
    assert_eq!(opened, kills);
}
