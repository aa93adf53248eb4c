//! What the link does under each kind of fault: a table of sent, accepted, lost and wrongly accepted frames.
//!
//! `cargo run --release -p palpus-tests --example link_faults -- [SECONDS [FAULT]]`: so many seconds per fault (10),
//! only those whose name holds FAULT. What the link noted under way goes to stderr.

use palpus_host::hand::Hand;
use palpus_host::link::board;
use palpus_host::link::connection::{Connection, decode_wire};
use palpus_host::link::host_clock::HostClock;
use palpus_host::link::port::DEFAULT_BAUD;
use palpus_host::run::capture::{CaptureSettings, capture};
use palpus_host::run::reader::{Run, RunItem};
use palpus_protocol::BoardMessage;
use palpus_tests::bench_board::{BenchBoard, BenchSettings};
use palpus_tests::fault_line::{FaultLine, Faults, LineFaults};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seconds: f64 = std::env::args().nth(1).map_or(Ok(10.0), |s| s.parse())?;
    let none = Faults::NONE;
    let cases = [
        ("none", "", none),
        ("bit flips", "0.1 %", Faults { flip: 1e-3, ..none }),
        ("bit flips", "1 %", Faults { flip: 1e-2, ..none }),
        ("bytes lost", "1 %", Faults { drop: 1e-2, ..none }),
        (
            "bytes doubled",
            "1 %",
            Faults {
                double: 1e-2,
                ..none
            },
        ),
        ("bytes swapped", "1 %", Faults { swap: 1e-2, ..none }),
        (
            "bursts of noise",
            "0.05 %",
            Faults {
                burst: 5e-4,
                ..none
            },
        ),
        (
            "writes cut short",
            "0.1 %",
            Faults {
                truncate: 1e-3,
                ..none
            },
        ),
        (
            "stalls to 50 ms",
            "0.02 %",
            Faults {
                stall: 2e-4,
                ..none
            },
        ),
        ("all of these", "1 %", Faults::mixed(1e-2)),
        (
            "wrong baud rate",
            "",
            Faults {
                garbage: true,
                ..none
            },
        ),
        (
            "nobody reads",
            "",
            Faults {
                blocked: true,
                ..none
            },
        ),
    ];
    let only = std::env::args().nth(2).unwrap_or_default();
    println!(
        "| fault, both ways | per byte | s | contacts made | accepted | lost and counted | of them dropped by the board, which could not send | frames seen damaged | wrongly accepted | first contact after |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let folder = std::env::temp_dir().join(format!("palpus-link-faults-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let wanted = |(_, case): &(usize, (&str, &str, Faults))| case.0.contains(&only);
    for (number, (name, rate, faults)) in cases.into_iter().enumerate().filter(wanted) {
        let row = measure(&folder, number as u64, faults, seconds)?;
        println!("| {name} | {rate} | {seconds} | {row} |");
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}

fn measure(
    folder: &Path,
    seed: u64,
    faults: Faults,
    seconds: f64,
) -> Result<String, Box<dyn std::error::Error>> {
    let output = folder.join(format!("run{seed}.mcap"));
    let link = folder.join(format!("line{seed}-board0"));
    let bench = BenchBoard::start(BenchSettings::new("index", 0));
    let clock = HostClock::start();
    let mut connection = Connection::open(bench.path(), DEFAULT_BAUD, clock)?;
    board::tare(&mut connection, 50, false)?;
    drop(connection);
    bench.press(true);
    let line = FaultLine::start(bench.path(), &link, LineFaults::default(), seed);
    let settings = CaptureSettings {
        replace: true,
        ..CaptureSettings::every_contact(
            vec![("index".into(), link.to_string_lossy().into_owned())],
            vec![("three_finger.urdf".into(), Hand::THREE_FINGER_URDF.into())],
            output.clone(),
        )
    };
    let stop = AtomicBool::new(false);
    let mut cleared_us = 0;
    let summary = std::thread::scope(|scope| {
        let thread = scope.spawn(|| capture(&settings, &stop, &mut |_| {}));
        std::thread::sleep(Duration::from_secs(1));
        line.set_faults(LineFaults {
            to_host: faults,
            to_board: faults,
        });
        std::thread::sleep(Duration::from_secs_f64(seconds));
        line.set_faults(LineFaults::default());
        cleared_us = clock.now_us();
        std::thread::sleep(Duration::from_secs(5));
        stop.store(true, Ordering::Relaxed);
        thread.join()
    });
    let summary = summary.map_err(|_| "the capture panicked")??;
    line.finish();
    let mut connection = Connection::open(bench.path(), DEFAULT_BAUD, clock)?;
    let dropped = board::statistics(&mut connection)?.board.contacts_dropped;
    let sent: BTreeSet<Vec<u8>> = bench
        .sent()
        .into_iter()
        .map(|mut frame| {
            frame.pop();
            frame
        })
        .collect();
    let (mut wrong, mut recovery_us, mut range) = (0, None, None::<(u32, u32)>);
    Run::open(&output)?.each(|item| {
        let (wire, received_ns) = match item {
            RunItem::Frame {
                wire, received_ns, ..
            } => (wire, received_ns),
            RunItem::Event(event) => {
                eprintln!("{}: {}", event.name, event.message);
                return;
            }
            RunItem::Link { .. } => return,
        };
        wrong += u64::from(!sent.contains(&wire));
        if let Ok(BoardMessage::Contact(contact)) = decode_wire(&wire) {
            range = Some((range.map_or(contact.sequence, |r| r.0), contact.sequence));
            let received_us = (received_ns / 1_000) as i64;
            if received_us >= cleared_us && recovery_us.is_none() {
                recovery_us = Some(received_us - cleared_us);
            }
        }
    })?;
    let status = &summary.progress.fingers[0].1;
    let made = range.map_or(0, |(first, last)| u64::from(last.wrapping_sub(first)) + 1);
    let balance = if made == status.contacts + status.lost {
        ""
    } else {
        " DOES NOT BALANCE"
    };
    Ok(format!(
        "{made} | {} | {}{balance} | {dropped} | {} | {wrong} | {}",
        status.contacts,
        status.lost,
        status.bad,
        recovery_us.map_or("never".into(), |us| format!("{:.1} ms", us as f64 * 1e-3))
    ))
}
