//! The image that is flashed, on an emulated board, against emulated chips: calibrated, tared and captured by `palpus` itself while a finger
//! slides over a ball for 60 s of board time; every contact is held against the truth. A second, quicker run becomes a surface.

use nalgebra::Vector3;
use palpus_host::evaluate::SurfaceLocator;
use palpus_host::export::SurfaceFile;
use palpus_host::hand::{Finger, Hand};
use palpus_host::run::reader::{Run, RunItem};
use palpus_protocol::{
    BoardMessage, Calibration, Command, Contact, ContactFlags, Decoder, Outcome, TareRequest,
};
use palpus_tests::emulator::{
    Bench, Board, Client, DefmtLog, HostLine, Memory, Motion, SlidingFinger, client, hand_file,
};
use palpus_tests::program;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const MOTION: Motion = Motion::STANDARD;

/// Root mean square and largest distance of the loaded, valid contacts from the truth, mm, and how many they are.
fn errors_mm(finger: &Finger, contacts: &[Contact]) -> (f64, f64, usize) {
    let usable =
        |contact: &&Contact| contact.flags.contains(ContactFlags::LOADED) && contact.is_valid();
    let errors: Vec<f64> = contacts
        .iter()
        .filter(usable)
        .map(|contact| {
            let joints = contact.joint_angles_rad.map(f64::from);
            let truth = SlidingFinger::true_contact_mm(finger, &MOTION, &joints, 20.0);
            (Vector3::from(contact.point_mm.map(f64::from)) - truth).norm()
        })
        .collect();
    let (rms_mm, worst_mm) = rms_and_largest(errors.iter().copied());
    (rms_mm, worst_mm, errors.len())
}

/// Tares, sets the finger down, and listens to its contacts for two seconds.
fn short_look(
    line: &HostLine,
    world: &Mutex<SlidingFinger>,
    calibration: Calibration,
) -> Vec<Contact> {
    let mut client = Client::open(line.path()).expect("the line");
    match client.request(Command::SetCalibration(calibration)) {
        Ok(Outcome::CalibrationStored(_)) => {}
        other => panic!("{other:?}"),
    }
    match client.request(Command::Tare(TareRequest {
        samples: 100,
        force: false,
    })) {
        Ok(Outcome::Tared(_)) => {}
        other => panic!("{other:?}"),
    }
    world.lock().expect("the world").set_down();
    client.start_contacts().expect("a stream");
    let enough = client.wait(Duration::from_secs(60), |messages| {
        (client::contacts(messages)
            .iter()
            .filter(|contact| contact.is_valid())
            .count()
            >= 400)
            .then_some(())
    });
    assert!(
        enough.is_some(),
        "no contacts: {:?}",
        client.contacts().last()
    );
    client.request(Command::Stop).expect("a stop");
    world.lock().expect("the world").lift();
    client.contacts()
}

fn frames(run: &Path) -> Vec<Contact> {
    let run = Run::open(run).expect("the run");
    assert!(run.complete && run.damage.is_empty(), "{:?}", run.damage);
    let mut contacts = Vec::new();
    run.each(|item| {
        if let RunItem::Frame { wire, .. } = item {
            let mut decoder = Decoder::new();
            for byte in wire.into_iter().chain([0]) {
                if let Some(Ok(frame)) = decoder.push(byte)
                    && let Ok(BoardMessage::Contact(contact)) = BoardMessage::try_from(frame)
                {
                    contacts.push(contact);
                }
            }
        }
    })
    .expect("its messages");
    contacts
}

/// The run as a surface: one piece over the cap that the finger slid over, on the ball within what the encoders allow (a step of 0.38 mrad
/// at 0.4 m of finger is 0.15 mm). In the middle of the spiral nothing was touched: that may be open or closed.
fn becomes_a_surface(run: &str, surface: &str) {
    let report = program::run_json(&["--json", "reconstruct", run, "-o", surface]);
    let found = &report["surface"];
    println!("surface: {found}, error: {}", report["error"]["rms"]);
    let figures = ["components", "genus", "folded_patches"];
    assert_eq!(
        figures.map(|name| found[name].as_i64()),
        [1, 0, 0].map(Some)
    );
    assert!(
        found["borders"]
            .as_i64()
            .is_some_and(|borders| (1..=2).contains(&borders))
    );
    assert!(
        found["g1_max_degrees"]
            .as_f64()
            .is_some_and(|angle| angle < 1e-6)
    );
    assert!(
        report["error"]["rms"]
            .as_f64()
            .is_some_and(|error| error < 0.1)
    );

    let surface = SurfaceFile::read(Path::new(surface))
        .expect("the surface file")
        .surface;
    let places = surface.sample_per_patch(8).expect("places on it").positions;
    let (rms, worst) = rms_and_largest(places.iter().map(|place| place.norm() - MOTION.ball_mm));
    println!(
        "{} places of the surface are off the ball {rms:.4} mm rms, {worst:.4} mm at most",
        places.len()
    );
    assert!(rms < 0.05 && worst < 0.3, "{rms} {worst}");

    // All of the cap is there, up to a turn of the spiral from its edge, and from two turns around its middle.
    let locator = SurfaceLocator::new(surface).expect("a surface to look at");
    let turn_rad = MOTION.pitch_mm / MOTION.ball_mm;
    let (inner, outer) = ((2.0 * turn_rad).cos(), (MOTION.cap_rad - turn_rad).cos());
    let pole = Vector3::from(MOTION.pole).normalize();
    let side = pole.cross(&Vector3::y()).normalize();
    let gaps = (0..2_000).map(|number| {
        // A sunflower's seeds: even over the cap.
        let height = inner - (inner - outer) * (f64::from(number) + 0.5) / 2_000.0;
        let turn = f64::from(number) * core::f64::consts::PI * (3.0 - 5_f64.sqrt());
        let around = side * turn.cos() + pole.cross(&side) * turn.sin();
        let place = (pole * height + around * (1.0 - height * height).sqrt()) * MOTION.ball_mm;
        (locator.foot(&place).expect("a foot").position - place).norm()
    });
    let (rms, worst) = rms_and_largest(gaps);
    println!(
        "2000 places of the touched cap are off the surface {rms:.4} mm rms, {worst:.4} mm at most"
    );
    assert!(rms < 0.05 && worst < 0.3, "{rms} {worst}");
}

/// Root mean square and largest size of some values; the first is no number if one of them is none, or if there are none.
fn rms_and_largest(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut squares, mut largest, mut count) = (0.0, 0.0_f64, 0.0);
    for value in values {
        squares += value * value;
        largest = largest.max(value.abs());
        count += 1.0;
    }
    ((squares / count).sqrt(), largest)
}

/// Waits until the board has long seen that the finger was lifted: it refuses to tare a tip in contact.
fn has_seen(board: &Board) {
    let converted = || board.bench().converters[0].conversions;
    let began = converted();
    while converted() < began + 100 {
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Records so many valid contacts with the program.
fn capture(finger_port: &str, hand: &str, run: &str, points: &str) -> serde_json::Value {
    program::run_json(&[
        "--json",
        "capture",
        "--finger",
        finger_port,
        "--hand",
        hand,
        "-o",
        run,
        "--points",
        points,
    ])
}

#[test]
fn emulated_finger_on_a_ball_from_the_chips_to_the_surface() {
    // Building takes long on a busy machine; before the board is there.
    program::palpus();
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let hand_path = hand_file().to_string_lossy().into_owned();
    let hand = Hand::read(&hand_file()).expect("the shipped hand");
    let (_, finger) = hand.finger("index").expect("its index finger");
    let world = Arc::new(Mutex::new(SlidingFinger::new(finger.clone(), MOTION)));
    let mut board =
        Board::start(Bench::new(Box::new(Arc::clone(&world)))).expect("the emulated board");
    let memory = Memory::new(board.take_qtest().expect("a test socket"));
    let log = DefmtLog::start(&Board::image(), memory).expect("the log");
    let line =
        HostLine::new(board.take_host().expect("the host's socket")).expect("a pseudo-terminal");

    // Calibration round trip: contacts with a matrix that knows no crosstalk, then with one estimated from noisy loads, each
    // the mean of 400 readings (what `calibrate` takes by itself) of 320 counts of noise: 15 mN at 21 500 counts per newton.
    let before = short_look(&line, &world, SlidingFinger::naive_calibration(5));
    let table = world
        .lock()
        .expect("the world")
        .load_table(48, 320.0 / 20.0);
    std::fs::write(path("loads.csv"), table).expect("the loads");
    let estimate = program::run_json(&[
        "--json",
        "board",
        line.path(),
        "calibrate",
        &path("loads.csv"),
        "--id",
        "77",
    ]);
    println!("calibrate: {estimate}");
    let mut client = Client::open(line.path()).expect("the line");
    let calibration = match client.request(Command::GetCalibration) {
        Ok(Outcome::Calibration(calibration)) => calibration,
        other => panic!("{other:?}"),
    };
    assert_eq!((calibration.id, calibration.check()), (77, Ok(())));
    drop(client);
    let after = short_look(&line, &world, calibration);
    let (before_mm, after_mm) = (errors_mm(finger, &before), errors_mm(finger, &after));
    println!(
        "contact error before calibration {before_mm:.3?}, after {after_mm:.3?} (rms mm, max mm, contacts)"
    );
    assert!(
        before_mm.0 > 1.0 && after_mm.1 < 0.1,
        "{before_mm:?} {after_mm:?}"
    );

    // The run: 60 s of board time, captured by the program.
    has_seen(&board);
    let tared = program::run_json(&["--json", "board", line.path(), "tare"]);
    assert_eq!(tared["samples"], 200, "{tared}");
    world.lock().expect("the world").set_down();
    let finger_port = format!("index={}", line.path());
    let run_path = path("run.mcap");
    let captured = capture(&finger_port, &hand_path, &run_path, "12100");
    println!("capture: {captured}");
    let stats = program::run_json(&["--json", "board", line.path(), "stats"]);
    println!("stats: {stats}");
    let contacts = frames(Path::new(&run_path));
    let board_us = contacts.last().map_or(0, |last| last.board_time_us)
        - contacts.first().map_or(0, |first| first.board_time_us);
    assert!(board_us >= 60_000_000, "only {board_us} us of board time");
    let gaps: u32 = contacts
        .windows(2)
        .map(|pair| pair[1].lost_since(pair[0].sequence))
        .sum();
    assert_eq!((gaps, line.dropped()), (0, 0));
    assert_eq!(
        (
            &captured["fingers"][0]["lost"],
            &captured["fingers"][0]["bad"]
        ),
        (&0.into(), &0.into())
    );
    let (rms_mm, worst_mm, valid) = errors_mm(finger, &contacts);
    println!(
        "{} contacts in {:.1} s of board time, {valid} valid, off the truth {rms_mm:.4} mm rms, {worst_mm:.4} mm at most",
        contacts.len(),
        board_us as f64 * 1e-6
    );
    assert!(worst_mm < 0.1, "a contact is {worst_mm} mm from the truth");
    // Answers of the emulated chips that a busy machine delays leave a contact invalid, and marked so.
    assert!(
        valid > 10_000,
        "{valid} of {} contacts are valid",
        contacts.len()
    );

    // In the world the encoders' 14 bits add to it: 0.38 mrad a step at 0.4 m of finger.
    let points =
        palpus_host::run::points::points(&[run_path.clone().into()], None).expect("points");
    let radii: Vec<f64> = points
        .cloud
        .points
        .iter()
        .map(|point| point.position.norm() - MOTION.ball_mm)
        .collect();
    let (rms, _) = rms_and_largest(radii.iter().copied());
    println!(
        "{} points in the world, off the ball {rms:.4} mm rms",
        radii.len()
    );
    assert!(rms < 0.1, "{rms}");

    // A run at the speed at which one explores: contacts 0.6 mm apart, turns 5 mm.
    world.lock().expect("the world").begin_again(120.0);
    has_seen(&board);
    let tared = program::run_json(&["--json", "board", line.path(), "tare"]);
    assert_eq!(tared["samples"], 200, "{tared}");
    world.lock().expect("the world").set_down();
    let run_path = path("quick.mcap");
    let captured = capture(&finger_port, &hand_path, &run_path, "2600");
    assert_eq!(
        (
            &captured["fingers"][0]["lost"],
            &captured["fingers"][0]["bad"]
        ),
        (&0.into(), &0.into())
    );
    becomes_a_surface(&run_path, &path("surface.json"));

    let (lines, _) = log.finish().expect("the log");
    println!("{lines:#?}");
    let has = |part: &str| lines.iter().any(|line| line.message.contains(part));
    assert!(
        has("core at 168000000 Hz")
            && has("calibration 77 in use")
            && has("tared over 200 periods")
    );
    assert!(lines.iter().all(|line| line.level != "malformed"));
}
