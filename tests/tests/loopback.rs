//! Capture over real pseudo-terminals from boards that run the real firmware library.

use palpus_host::hand::Hand;
use palpus_host::link::board;
use palpus_host::link::connection::Connection;
use palpus_host::link::host_clock::{HostClock, wall_us};
use palpus_host::link::port::DEFAULT_BAUD;
use palpus_host::run::RunError;
use palpus_host::run::capture::{
    CaptureError, CaptureEvent, CaptureSettings, CaptureSummary, End, capture,
};
use palpus_host::run::points::points;
use palpus_protocol::{
    BoardMessage, Decoder, Frame, HostMessage, MAX_FRAME_BYTES, PROTOCOL_VERSION,
};
use palpus_tests::bench_board::{
    BenchBoard, BenchSettings, RADIUS_MM, firmware, pressed_at, pseudo_terminal,
};
use palpus_tests::fault_line::{FaultLine, Faults, LineFaults};
use palpus_tests::fuzz::framed;
use palpus_tests::outcome::palpus;
use serialport::SerialPort;
use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::time::{Duration, Instant};

fn hand() -> Vec<(String, String)> {
    vec![(
        "three_finger.urdf".into(),
        Hand::THREE_FINGER_URDF.to_owned(),
    )]
}

fn finger_names() -> Vec<String> {
    let hand = Hand::from_sources(&hand()).unwrap();
    hand.fingers().iter().map(|f| f.name.clone()).collect()
}

fn settings(fingers: &[(String, String)], output: &Path) -> CaptureSettings {
    CaptureSettings::every_contact(fingers.to_vec(), hand(), output.into())
}

/// Three boards, tared and pressed.
fn boards(count: usize) -> Vec<(String, BenchBoard)> {
    let boards: Vec<(String, BenchBoard)> = finger_names()
        .into_iter()
        .take(count)
        .enumerate()
        .map(|(k, name)| {
            let mut bench = BenchSettings::new(&name, k as u8);
            bench.drift = [80e-6, -50e-6, 20e-6][k % 3];
            bench.start_us = 1_000_000 + 7_000_000 * k as u64;
            (name, BenchBoard::start(bench))
        })
        .collect();
    for (_, bench) in &boards {
        tare(bench.path());
        bench.press(true);
    }
    boards
}

fn tare(path: &str) {
    let mut connection = Connection::open(path, DEFAULT_BAUD, HostClock::start()).unwrap();
    board::tare(&mut connection, 20, false).unwrap();
}

fn ports(boards: &[(String, BenchBoard)]) -> Vec<(String, String)> {
    boards
        .iter()
        .map(|(name, bench)| (name.clone(), bench.path().to_owned()))
        .collect()
}

fn quiet(_: CaptureEvent<'_>) {}

/// Where the board's contact at this time lies in the world, by the truth.
fn truth(finger: &palpus_host::hand::Finger, board_us: u64) -> ([f64; 3], [f64; 3]) {
    let (n, angles) = pressed_at(board_us);
    let normal = palpus_host::Vec3::from(n);
    let world = finger.world_contact(&angles, &(normal * RADIUS_MM), &normal);
    (world.position_mm.into(), world.normal.into())
}

#[test]
fn three_boards_are_captured_and_placed_without_a_loss() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(3);
    let mut settings = settings(&ports(&boards), &output);
    settings.points = Some(1_500);
    let summary = capture(&settings, &AtomicBool::new(false), &mut quiet).unwrap();
    assert_eq!(summary.end, End::Points);
    for (name, status) in &summary.progress.fingers {
        assert_eq!(status.lost, 0, "{name}: {status:?}");
        assert_eq!(status.bad, 0, "{name}");
        assert_eq!(status.out_of_order, 0, "{name}");
        assert_eq!(status.dropped_by_host, 0, "{name}");
        assert_eq!(status.valid, status.contacts, "{name}");
        assert!(status.round_trips > 4, "{name}");
    }
    assert_eq!(
        std::fs::metadata(&output).unwrap().len(),
        summary.progress.safe_bytes
    );

    let result = points(&[output], None).unwrap();
    let report = &result.reports[0];
    assert!(report.complete && report.damage.is_empty());
    assert!(result.cloud.points.len() >= 1_500);
    for (finger, (_, status)) in report.fingers.iter().zip(&summary.progress.fingers) {
        assert_eq!(finger.contacts, status.contacts);
        assert_eq!(finger.valid, status.valid);
        assert_eq!((finger.lost, finger.unreadable), (0, 0));
    }
    // Every point lies a tip's radius from some place of the tip's centre at its time: within the path that the
    // truth takes near that time.
    let hand = Hand::from_sources(&hand()).unwrap();
    for point in result.cloud.points.iter().step_by(29) {
        let finger = &hand.fingers()[usize::from(point.finger.unwrap())];
        let reach = finger.tip_pose_mm(&[0.0, 0.5, -0.8]).translation.vector;
        assert!((point.position - reach).norm() < 200.0);
        assert!((point.normal.norm() - 1.0).abs() < 1e-6);
        assert!(point.sigma.unwrap() < 0.5);
    }
}

#[test]
fn points_lie_where_the_tip_was_pressed() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(1);
    let mut settings = settings(&ports(&boards), &output);
    settings.points = Some(300);
    capture(&settings, &AtomicBool::new(false), &mut quiet).unwrap();
    let run = palpus_host::run::reader::Run::open(&output).unwrap();
    let hand = run.read_hand().unwrap().unwrap();
    let (_, finger) = hand.finger(&boards[0].0).unwrap();
    let result = points(std::slice::from_ref(&output), None).unwrap();
    let mut times = Vec::new();
    run.each(|item| {
        if let palpus_host::run::reader::RunItem::Frame { wire, .. } = item
            && let Ok(BoardMessage::Contact(contact)) =
                palpus_host::link::connection::decode_wire(&wire)
        {
            times.push(contact.board_time_us);
        }
    })
    .unwrap();
    assert_eq!(times.len(), result.cloud.points.len());
    let mut worst: f64 = 0.0;
    for (point, &board_us) in result.cloud.points.iter().zip(&times) {
        let (position, normal) = truth(finger, board_us);
        worst = worst.max((point.position - palpus_host::Vec3::from(position)).norm());
        assert!(point.normal.dot(&palpus_host::Vec3::from(normal)) > 0.999_999);
    }
    // Counts of 0.1 mN and 1 N um, angles of 10 urad at 400 mm, points of 2 um: a few microns.
    assert!(worst < 0.02, "worst {worst} mm");
}

#[test]
fn what_is_given_wrongly_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(2);
    let ports = ports(&boards);
    let never = AtomicBool::new(false);

    let swapped = vec![
        (ports[0].0.clone(), ports[1].1.clone()),
        (ports[1].0.clone(), ports[0].1.clone()),
    ];
    let error = capture(&settings(&swapped, &output), &never, &mut quiet).unwrap_err();
    assert!(matches!(error, CaptureError::Swapped { .. }), "{error}");
    assert!(!output.exists());

    let unknown = vec![("seventh".to_owned(), ports[0].1.clone())];
    let error = capture(&settings(&unknown, &output), &never, &mut quiet).unwrap_err();
    assert!(
        matches!(error, CaptureError::UnknownFinger { .. }),
        "{error}"
    );

    let twice = vec![ports[0].clone(), (ports[1].0.clone(), ports[0].1.clone())];
    let error = capture(&settings(&twice, &output), &never, &mut quiet).unwrap_err();
    assert!(matches!(error, CaptureError::Twice { .. }), "{error}");

    let gone = vec![(ports[0].0.clone(), "/dev/no-such-port".to_owned())];
    let error = capture(&settings(&gone, &output), &never, &mut quiet).unwrap_err();
    assert!(matches!(error, CaptureError::Link { .. }), "{error}");

    std::fs::write(&output, "mine").unwrap();
    let error = capture(&settings(&ports, &output), &never, &mut quiet).unwrap_err();
    assert!(
        matches!(error, CaptureError::Run(RunError::Exists { .. })),
        "{error}"
    );
    assert_eq!(std::fs::read(&output).unwrap(), b"mine");

    // A folder that is not there, and one in which nobody may make a file.
    let nowhere = folder.path().join("missing").join("run.mcap");
    for output in [nowhere.as_path(), Path::new("/proc/run.mcap")] {
        let error = capture(&settings(&ports, output), &never, &mut quiet).unwrap_err();
        assert!(
            matches!(error, CaptureError::Run(RunError::Create { .. })),
            "{error}"
        );
    }
}

/// By how much the wall clock of one test is set.
static SET_BY_US: AtomicI64 = AtomicI64::new(0);

#[test]
fn setting_the_computers_clock_moves_no_contact_and_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(1);
    let settings = CaptureSettings {
        clock: HostClock::of(|| wall_us() + SET_BY_US.load(Ordering::Relaxed), 1.0),
        ..settings(&ports(&boards), &output)
    };
    capture_during(&settings, |wait_until| {
        wait_until("it runs", &|p| p.contacts(0) > 100);
        SET_BY_US.store(-3_600_000_000, Ordering::Relaxed);
        wait_until("it goes on", &|p| p.contacts(0) > 300);
    });
    let (mut said, mut times) = (Vec::new(), Vec::new());
    let run = palpus_host::run::reader::Run::open(&output).unwrap();
    run.each(|item| match item {
        palpus_host::run::reader::RunItem::Event(event) => said.push(event.message),
        palpus_host::run::reader::RunItem::Frame { received_ns, .. } => times.push(received_ns),
        palpus_host::run::reader::RunItem::Link { .. } => {}
    })
    .unwrap();
    assert!(
        said.iter().any(|text| text.contains("set by -3600.0")),
        "{said:?}"
    );
    // Messages are written as they were received.
    assert!(times.is_sorted() && times[times.len() - 1] - times[0] < 600_000_000_000);
}

#[test]
fn a_board_of_another_version_is_named_and_still_says_who_it_is() {
    // A board that only answers `identify`, as one of the next protocol version would.
    let (mut near, device) = pseudo_terminal();
    let path = device.name().unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&stop);
    let board = std::thread::spawn(move || {
        let mut decoder = Decoder::new();
        let mut buffer = [0; 256];
        while !told.load(Ordering::Relaxed) {
            let count = near.read(&mut buffer).unwrap_or(0);
            for &byte in &buffer[..count] {
                let Some(Ok(frame)) = decoder.push(byte) else {
                    continue;
                };
                if let Ok(HostMessage::Identify(asked)) = HostMessage::try_from(frame) {
                    let _ = near.write_all(&identity_of_the_next_version(asked.request_id));
                }
            }
        }
    });
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let fingers = [(finger_names().remove(0), path.clone())];
    let error = capture(
        &settings(&fingers, &output),
        &AtomicBool::new(false),
        &mut quiet,
    )
    .unwrap_err()
    .to_string();
    let (ours, theirs) = (PROTOCOL_VERSION, PROTOCOL_VERSION + 1);
    for part in [
        format!("version {theirs}"),
        format!("this side {ours}"),
        format!("palpus board {path} info"),
    ] {
        assert!(error.contains(&part), "{part}: {error}");
    }
    assert!(!output.exists());
    let info = palpus(folder.path(), &["board", &path, "info"]);
    assert_eq!(info.code, 0, "{info:?}");
    assert!(info.stdout.contains("0.9.9"), "{}", info.stdout);
    let stats = palpus(folder.path(), &["board", &path, "stats"]);
    assert_eq!(stats.code, 5, "{stats:?}");
    stop.store(true, Ordering::Relaxed);
    board.join().unwrap();
}

/// An identity's frame with the next version in its envelope and a field more than ours.
fn identity_of_the_next_version(request_id: u32) -> Vec<u8> {
    let bench = BenchSettings::new("index", 0);
    let mut board = firmware(&bench, bench.start_us, &Arc::new(AtomicBool::new(false)));
    let mut wire = board.take_frame(bench.start_us).unwrap().to_vec();
    wire.pop();
    let frame = Frame::open(&mut wire).unwrap();
    let Ok(BoardMessage::Identity(mut identity)) = BoardMessage::try_from(frame) else {
        panic!("what a board says first");
    };
    identity.request_id = request_id;
    identity.firmware_version = "0.9.9".try_into().unwrap();
    let mut out = [0; MAX_FRAME_BYTES];
    let length = BoardMessage::from(identity).encode(&mut out).unwrap();
    let frame = Frame::open(&mut out[..length - 1]).unwrap();
    let body = [frame.body, &[1, 2, 3]].concat();
    framed(PROTOCOL_VERSION + 1, 0x1234, frame.kind, &body)
}

#[test]
fn a_full_disk_ends_the_capture_with_what_there_was() {
    let full = Path::new("/dev/full");
    if !full.exists() {
        return;
    }
    let boards = boards(1);
    let mut settings = settings(&ports(&boards), full);
    settings.replace = true;
    settings.duration = Some(Duration::from_secs(5));
    let error = capture(&settings, &AtomicBool::new(false), &mut quiet).unwrap_err();
    assert!(
        matches!(error, CaptureError::Run(RunError::Write { .. })),
        "{error}"
    );
}

/// Sets a flag when it goes, whether all went well or not: whoever waits for it must not wait for ever.
struct AtLast<'a>(&'a AtomicBool);

impl Drop for AtLast<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Captures in a thread while `act` does things to the line; stops after it.
fn capture_during(
    settings: &CaptureSettings,
    act: impl FnOnce(&dyn Fn(&str, &dyn Fn(&Progress) -> bool)),
) -> CaptureSummary {
    let stop = AtomicBool::new(false);
    let latest: std::sync::Mutex<Progress> = std::sync::Mutex::default();
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            capture(settings, &stop, &mut |event| {
                if let CaptureEvent::Progress(progress) = event {
                    *latest.lock().unwrap() = Progress(progress.fingers.clone());
                }
            })
        });
        let wait_until = |what: &str, done: &dyn Fn(&Progress) -> bool| {
            let start = Instant::now();
            while !done(&latest.lock().unwrap()) {
                assert!(!thread.is_finished(), "the capture ended before: {what}");
                assert!(
                    start.elapsed() < Duration::from_secs(60),
                    "waited in vain: {what}"
                );
                std::thread::sleep(Duration::from_millis(5));
            }
        };
        {
            let _stopped = AtLast(&stop);
            act(&wait_until);
        }
        thread.join().unwrap().unwrap()
    })
}

#[derive(Clone, Default)]
struct Progress(Vec<(String, palpus_host::link::session::LinkStatus)>);

impl Progress {
    fn contacts(&self, finger: usize) -> u64 {
        self.0.get(finger).map_or(0, |(_, s)| s.contacts)
    }

    fn status(&self, finger: usize) -> palpus_host::link::session::LinkStatus {
        self.0
            .get(finger)
            .map(|(_, s)| s.clone())
            .unwrap_or_default()
    }
}

/// Frames of a finger in a run, in order.
fn wire_frames(output: &Path, finger: usize) -> Vec<Vec<u8>> {
    let run = palpus_host::run::reader::Run::open(output).unwrap();
    let mut frames = Vec::new();
    run.each(|item| {
        if let palpus_host::run::reader::RunItem::Frame {
            finger: of, wire, ..
        } = item
            && of == finger
        {
            frames.push(wire);
        }
    })
    .unwrap();
    frames
}

#[test]
fn a_noisy_line_loses_frames_counts_them_and_accepts_no_false_one() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(1);
    let link = folder.path().join("board0");
    let line = FaultLine::start(boards[0].1.path(), &link, LineFaults::default(), 11);
    let fingers = vec![(boards[0].0.clone(), link.to_string_lossy().into_owned())];
    let summary = capture_during(&settings(&fingers, &output), |wait_until| {
        wait_until("a clean start", &|p| p.contacts(0) > 50);
        line.set_faults(LineFaults {
            to_host: Faults::mixed(0.01),
            to_board: Faults::mixed(0.01),
        });
        let before = std::cell::Cell::new(0);
        wait_until("a thousand contacts through the noise", &|p| {
            before.set(p.contacts(0));
            p.contacts(0) > 1_000
        });
        line.set_faults(LineFaults {
            to_host: Faults {
                garbage: true,
                ..Faults::NONE
            },
            ..LineFaults::default()
        });
        std::thread::sleep(Duration::from_millis(300));
        line.set_faults(LineFaults::default());
        let reached = before.get();
        wait_until("the stream after garbage", &|p| {
            p.contacts(0) > reached + 200
        });
    });
    let injected = line.finish();
    let status = &summary.progress.fingers[0].1;
    assert!(injected > 100 && status.bad > 50, "{injected} {status:?}");
    assert!(status.lost > 50, "{status:?}");

    // Nothing that was accepted was never sent.
    let sent: BTreeSet<Vec<u8>> = boards[0]
        .1
        .sent()
        .into_iter()
        .map(|mut frame| {
            frame.pop();
            frame
        })
        .collect();
    let frames = wire_frames(&output, 0);
    for frame in &frames {
        assert!(
            sent.contains(frame),
            "a frame was accepted that was never sent"
        );
    }
    // The books balance: what was sent between first and last accepted contact is accepted or lost.
    let numbers: Vec<u32> = frames
        .iter()
        .filter_map(|f| match palpus_host::link::connection::decode_wire(f) {
            Ok(BoardMessage::Contact(c)) => Some(c.sequence),
            _ => None,
        })
        .collect();
    let (first, last) = (numbers[0], *numbers.last().unwrap());
    let made = u64::from(last - first) + 1;
    assert_eq!(status.contacts + status.lost, made, "{status:?}");
    assert_eq!(status.contacts, numbers.len() as u64 - status.duplicates);
}

#[test]
fn an_unplugged_board_is_found_again_under_another_name_and_the_others_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(2);
    let links: Vec<PathBuf> = (0..3)
        .map(|k| folder.path().join(format!("board{k}")))
        .collect();
    let line = FaultLine::start(boards[0].1.path(), &links[0], LineFaults::default(), 1);
    let fingers = vec![
        (boards[0].0.clone(), links[0].to_string_lossy().into_owned()),
        (boards[1].0.clone(), boards[1].1.path().to_owned()),
    ];
    let summary = capture_during(&settings(&fingers, &output), |wait_until| {
        wait_until("both run", &|p| p.contacts(0) > 50 && p.contacts(1) > 50);
        line.hang_up();
        wait_until("the loss is seen", &|p| !p.status(0).connected);
        let other = std::cell::Cell::new(0);
        wait_until("the other is seen", &|p| {
            other.set(p.contacts(1));
            true
        });
        let reached = other.get();
        wait_until("the other goes on", &|p| p.contacts(1) > reached + 100);
        line.come_back(&links[2]);
        wait_until("it is found again", &|p| p.status(0).connected);
        let back = std::cell::Cell::new(0);
        wait_until("it is seen", &|p| {
            back.set(p.contacts(0));
            true
        });
        let reached = back.get();
        wait_until("it streams again", &|p| p.contacts(0) > reached + 100);
    });
    let (first, second) = (
        &summary.progress.fingers[0].1,
        &summary.progress.fingers[1].1,
    );
    assert_eq!(first.reconnects, 1);
    assert_eq!(first.reboots, 0);
    assert!(first.port.ends_with("board2"), "{}", first.port);
    assert_eq!((second.reconnects, second.lost), (0, 0));
    let result = points(&[output], None).unwrap();
    let report = &result.reports[0].fingers[0];
    assert_eq!((report.contacts, report.lost), (first.contacts, first.lost));
    // What the board made while it could not be reached is missing, and said.
    assert!(first.lost > 20, "{first:?}");
}

#[test]
fn a_restarted_board_is_noticed_and_streams_again() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(1);
    let summary = capture_during(&settings(&ports(&boards), &output), |wait_until| {
        wait_until("it runs", &|p| p.contacts(0) > 300);
        boards[0].1.restart();
        wait_until("the restart is seen", &|p| p.status(0).reboots == 1);
        let back = std::cell::Cell::new(0);
        wait_until("it is seen", &|p| {
            back.set(p.contacts(0));
            true
        });
        let reached = back.get();
        wait_until("it streams again", &|p| p.contacts(0) > reached + 100);
    });
    let status = &summary.progress.fingers[0].1;
    assert_eq!((status.reboots, status.lost), (1, 0), "{status:?}");
    let result = points(&[output], None).unwrap();
    let report = &result.reports[0].fingers[0];
    assert_eq!(report.contacts, status.contacts);
    assert_eq!((report.restarts, report.lost), (1, 0));
    // The tare went with the power.
    assert!(report.invalid["not tared"] >= 100);
}

#[test]
fn a_stopped_capture_keeps_everything() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("run.mcap");
    let boards = boards(1);
    let summary = capture_during(&settings(&ports(&boards), &output), |wait_until| {
        wait_until("it runs", &|p| p.contacts(0) > 100);
    });
    assert_eq!(summary.end, End::Stopped);
    let result = points(&[output], None).unwrap();
    assert_eq!(
        result.reports[0].fingers[0].contacts,
        summary.progress.fingers[0].1.contacts
    );
    assert!(result.reports[0].complete);
}

#[test]
fn a_slow_disk_does_not_hold_up_the_boards() {
    // A pipe that nobody reads for a while stands for the disk: it takes 64 kB and then blocks. Between the board and
    // the host is a line that keeps what the driver of a serial port does: without it whoever comes a few hundredths of
    // a second late, on a busy machine, loses contacts to the board's own short queue.
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("run.pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.is_ok_and(|s| s.success()), "mkfifo is there");
    let name = finger_names().remove(0);
    let mut bench = BenchSettings::new(&name, 0);
    bench.period_us = 2_000;
    let bench = BenchBoard::start(bench);
    tare(bench.path());
    bench.press(true);
    let link = folder.path().join("board0");
    let line = FaultLine::start(bench.path(), &link, LineFaults::default(), 2);

    let disk_is_back = Arc::new(AtomicBool::new(false));
    let reader = {
        let (pipe, disk_is_back) = (pipe.clone(), Arc::clone(&disk_is_back));
        std::thread::spawn(move || {
            let mut file = std::fs::File::open(pipe).unwrap();
            while !disk_is_back.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(5));
            }
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).unwrap();
            bytes
        })
    };
    let mut settings = settings(&[(name, link.to_string_lossy().into_owned())], &pipe);
    settings.replace = true;
    let summary = capture_during(&settings, |wait_until| {
        let _in_any_case = AtLast(&disk_is_back);
        // The pipe holds some 700, the line and its two terminals 1540, the board 64: a host that waits for its disk
        // would never come so far.
        wait_until("contacts are taken while the disk takes nothing", &|p| {
            p.contacts(0) > 3_000
        });
    });
    drop(line);
    let status = &summary.progress.fingers[0].1;
    assert_eq!((status.lost, status.dropped_by_host), (0, 0), "{status:?}");

    let output = folder.path().join("run.mcap");
    std::fs::write(&output, reader.join().unwrap()).unwrap();
    let result = points(&[output], None).unwrap();
    assert!(result.reports[0].complete);
    assert_eq!(result.reports[0].fingers[0].contacts, status.contacts);
}
