//! Hours of three fingers on bad lines: memory, losses, error of the clocks' alignment.
//!
//! `cargo run --release -p palpus-tests --example endurance -- [MINUTES] [SPEED]`: so many minutes of board time (6),
//! which passes `SPEED` times (1) as fast as time. One byte in a hundred is damaged in both directions, and every
//! five minutes one finger's cable is pulled for ten seconds and comes back under another name. All that the
//! machine adds, and every time-out of the link, then counts `SPEED` times in board time, so the figures of a fast
//! run are no better than those of a slow one.
//!
//! Nothing is remembered of what was sent: a contact that was accepted has to lie where the tip was pressed at its
//! time, and accepted and lost ones have to make up all that the board made.

use palpus_host::hand::Hand;
use palpus_host::link::board;
use palpus_host::link::connection::{Connection, decode_wire};
use palpus_host::link::host_clock::{HostClock, wall_us};
use palpus_host::link::port::DEFAULT_BAUD;
use palpus_host::run::capture::{CaptureEvent, CaptureProgress, CaptureSettings, capture};
use palpus_host::run::reader::{Run, RunItem};
use palpus_protocol::BoardMessage;
use palpus_tests::bench_board::{BenchBoard, BenchSettings, RADIUS_MM, pressed_at};
use palpus_tests::fault_line::{FaultLine, Faults, LineFaults};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Share of bytes that are damaged.
const DAMAGE: f64 = 0.01;
/// Board time between two pulled cables, s.
const HANG_UP_EVERY_S: f64 = 300.0;
/// Board time for which a cable stays out, s.
const OUT_S: f64 = 10.0;
/// Clocks of the three boards.
const DRIFTS: [f64; 3] = [100e-6, -100e-6, 40e-6];
/// A contact further from where the tip was pressed is no contact that was made, mm and radians.
const FALSE_CONTACT: f64 = 0.05;
/// Contacts before this much of a run are left out of the alignment's error, s.
const SETTLED_S: f64 = 10.0;

struct Finger {
    name: String,
    bench: BenchBoard,
    line: FaultLine,
    plugs: usize,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let argument = |n: usize, default: f64| {
        let given = std::env::args().nth(n);
        given.map_or(Ok(default), |text| text.parse::<f64>())
    };
    let (minutes, speed) = (argument(1, 6.0)?, argument(2, 1.0)?);
    let clock = HostClock::of(wall_us, speed);
    let folder = std::env::temp_dir().join(format!("palpus-endurance-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let output = folder.join("run.mcap");
    let mut fingers = start(&folder, clock)?;
    let settings = CaptureSettings {
        clock,
        ..CaptureSettings::every_contact(
            fingers
                .iter()
                .map(|f| (f.name.clone(), name_of(&folder, f).display().to_string()))
                .collect(),
            vec![("three_finger.urdf".into(), Hand::THREE_FINGER_URDF.into())],
            output.clone(),
        )
    };
    println!("{minutes} min of board time at {speed} times the speed of time");
    println!("| board time, min | resident memory, MB | contacts | lost | damaged | reconnects |");
    println!("|---|---|---|---|---|---|");
    let stop = AtomicBool::new(false);
    let latest = Mutex::new(CaptureProgress::default());
    let mut largest_mb: f64 = 0.0;
    let mut hang_ups = 0;
    let summary = std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            capture(&settings, &stop, &mut |event| {
                if let CaptureEvent::Progress(progress) = event
                    && let Ok(mut latest) = latest.lock()
                {
                    latest.clone_from(progress);
                }
            })
        });
        // The lines are clean while the boards are found.
        while latest.lock().is_ok_and(|p| p.fingers.is_empty()) && !thread.is_finished() {
            std::thread::sleep(Duration::from_millis(10));
        }
        let noisy = Faults::mixed(DAMAGE);
        for finger in &fingers {
            finger.line.set_faults(LineFaults {
                to_host: noisy,
                to_board: noisy,
            });
        }
        let began_us = clock.now_us();
        let passed_s = || (clock.now_us() - began_us) as f64 * 1e-6;
        let sleep_s = |board_s: f64| std::thread::sleep(Duration::from_secs_f64(board_s / speed));
        let mut next_hang_up_s = 0.5 * HANG_UP_EVERY_S;
        let mut next_line_s = 60.0;
        while passed_s() < 60.0 * minutes && !thread.is_finished() {
            if passed_s() >= next_hang_up_s {
                next_hang_up_s += HANG_UP_EVERY_S;
                let which = hang_ups % fingers.len();
                let finger = &mut fingers[which];
                hang_ups += 1;
                finger.line.hang_up();
                sleep_s(OUT_S);
                finger.plugs += 1;
                finger.line.come_back(&name_of(&folder, finger));
            }
            largest_mb = largest_mb.max(resident_mb());
            if passed_s() >= next_line_s {
                next_line_s = if next_line_s < 600.0 {
                    600.0
                } else {
                    next_line_s + 600.0
                };
                if let Ok(progress) = latest.lock() {
                    print_line(passed_s(), &progress);
                }
            }
            sleep_s(1.0);
        }
        for finger in &fingers {
            finger.line.set_faults(LineFaults::default());
        }
        // The last losses are known once a later contact has come.
        std::thread::sleep(Duration::from_secs(5));
        stop.store(true, Ordering::Relaxed);
        thread.join()
    });
    let summary = summary.map_err(|_| "the capture panicked")??;
    print_line(60.0 * minutes, &summary.progress);
    println!("largest resident memory {largest_mb:.1} MB, {hang_ups} cables pulled");
    examine(&output, &fingers, &summary.progress)?;
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}

fn name_of(folder: &Path, finger: &Finger) -> std::path::PathBuf {
    folder.join(format!("{}-board{}", finger.name, finger.plugs))
}

fn start(folder: &Path, clock: HostClock) -> Result<Vec<Finger>, Box<dyn std::error::Error>> {
    let hand = Hand::from_sources(&[("hand".into(), Hand::THREE_FINGER_URDF.into())])?;
    let mut fingers = Vec::new();
    for (k, finger) in hand.fingers().iter().enumerate() {
        let bench = BenchBoard::start(BenchSettings {
            drift: DRIFTS[k % DRIFTS.len()],
            start_us: 1_000_000 + 70_000_000 * k as u64,
            clock,
            remembers: false,
            ..BenchSettings::new(&finger.name, k as u8)
        });
        let mut connection = Connection::open(bench.path(), DEFAULT_BAUD, clock)?;
        board::tare(&mut connection, 50, false)?;
        drop(connection);
        bench.press(true);
        let link = folder.join(format!("{}-board0", finger.name));
        fingers.push(Finger {
            name: finger.name.clone(),
            line: FaultLine::start(bench.path(), &link, LineFaults::default(), k as u64),
            bench,
            plugs: 0,
        });
    }
    Ok(fingers)
}

fn print_line(board_s: f64, progress: &CaptureProgress) {
    let all = |count: fn(&palpus_host::link::session::LinkStatus) -> u64| -> u64 {
        progress.fingers.iter().map(|(_, s)| count(s)).sum()
    };
    println!(
        "| {:.0} | {:.1} | {} | {} | {} | {} |",
        board_s / 60.0,
        resident_mb(),
        all(|s| s.contacts),
        all(|s| s.lost),
        all(|s| s.bad + s.unreadable),
        all(|s| s.reconnects),
    );
}

/// Memory of this process, boards and lines included.
fn resident_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    let kb = line.and_then(|l| l.split_whitespace().next()?.parse::<f64>().ok());
    kb.unwrap_or(f64::NAN) * 1e-3
}

/// What the reading of a finger's frames finds.
#[derive(Clone, Default)]
struct Found {
    accepted: u64,
    wrong: u64,
    range: Option<(u32, u32)>,
    squares: f64,
    worst_us: f64,
    /// Sum and number of alignment errors by second.
    by_second: std::collections::BTreeMap<i64, (f64, u32)>,
}

fn examine(
    output: &Path,
    fingers: &[Finger],
    progress: &CaptureProgress,
) -> Result<(), Box<dyn std::error::Error>> {
    let run = Run::open(output)?;
    println!(
        "run of {:.0} MB, complete: {}, {} places damaged",
        std::fs::metadata(output)?.len() as f64 * 1e-6,
        run.complete,
        run.damage.len()
    );
    let mut found = vec![Found::default(); fingers.len()];
    let mut first_us = None;
    run.each(|item| {
        let RunItem::Frame {
            finger,
            sampled_ns,
            wire,
            ..
        } = item
        else {
            return;
        };
        let Ok(BoardMessage::Contact(contact)) = decode_wire(&wire) else {
            return;
        };
        let (bench, found) = (&fingers[finger].bench, &mut found[finger]);
        found.accepted += 1;
        let from = found.range.map_or(contact.sequence, |r| r.0);
        found.range = Some((from, contact.sequence));
        let (normal, angles) = pressed_at(contact.board_time_us);
        let off = |a: f32, b: f64| (f64::from(a) - b).abs() > FALSE_CONTACT;
        let is_false = (0..3).any(|k| {
            off(contact.point_mm[k], RADIUS_MM * normal[k])
                || off(contact.normal[k], normal[k])
                || off(contact.joint_angles_rad[k], angles[k])
        });
        found.wrong += u64::from(is_false);
        let sampled_us = sampled_ns as f64 * 1e-3;
        let since_s = (sampled_us - *first_us.get_or_insert(sampled_us)) * 1e-6;
        if since_s < SETTLED_S {
            return;
        }
        let error_us = sampled_us - bench.host_us(contact.board_time_us);
        found.squares += error_us * error_us;
        found.worst_us = found.worst_us.max(error_us.abs());
        let second = found.by_second.entry(since_s as i64).or_default();
        *second = (second.0 + error_us, second.1 + 1);
    })?;
    println!(
        "| finger | drift, ppm | made | accepted | lost and counted | wrongly accepted | alignment error rms, us | worst, us |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for ((finger, found), (_, status)) in fingers.iter().zip(&found).zip(&progress.fingers) {
        let made = found.range.map_or(0, |(a, b)| u64::from(b - a) + 1);
        let balanced = made == status.contacts + status.lost;
        println!(
            "| {} | {:.1} | {made} | {} | {}{} | {} | {:.0} | {:.0} |",
            finger.name,
            status.drift * 1e6,
            status.contacts,
            status.lost,
            if balanced { "" } else { " DOES NOT BALANCE" },
            found.wrong,
            (found.squares / found.accepted.max(1) as f64).sqrt(),
            found.worst_us,
        );
    }
    // How far the fingers' times of the same moment are apart, second by second.
    let (mut squares, mut worst, mut seconds): (f64, f64, u32) = (0.0, 0.0, 0);
    for second in found[0].by_second.keys() {
        let means: Vec<f64> = found
            .iter()
            .filter_map(|f| f.by_second.get(second).map(|(sum, n)| sum / f64::from(*n)))
            .collect();
        let largest = means.iter().copied().fold(f64::MIN, f64::max);
        let spread = largest - means.iter().copied().fold(f64::MAX, f64::min);
        squares += spread * spread;
        worst = worst.max(spread);
        seconds += 1;
    }
    println!(
        "between fingers, by second: rms {:.0} us, worst {worst:.0} us",
        (squares / f64::from(seconds.max(1))).sqrt()
    );
    Ok(())
}
