//! The image that is flashed, on an emulated board, against emulated chips: a finger slides over a ball for 60 s of board time.

use palpus_host::hand::Hand;
use palpus_protocol::{Command, Contact, ContactFlags, Outcome, StorePlace, TareRequest};
use palpus_tests::emulator::{
    Bench, Board, Client, DefmtLog, HostLine, Memory, Motion, SlidingFinger, client, hand_file,
};
use std::sync::{Arc, Mutex};
use std::time::Duration;

#[test]
fn sixty_seconds_of_contacts_without_a_gap() {
    let hand = Hand::read(&hand_file()).expect("the shipped hand");
    let (_, finger) = hand.finger("index").expect("its index finger");
    let motion = Motion::STANDARD;
    let world = Arc::new(Mutex::new(SlidingFinger::new(finger.clone(), motion)));
    let mut board =
        Board::start(Bench::new(Box::new(Arc::clone(&world)))).expect("the emulated board");
    let memory = Memory::new(board.take_qtest().expect("a test socket"));
    let log = DefmtLog::start(&Board::image(), memory).expect("the log");
    let line =
        HostLine::new(board.take_host().expect("the host's socket")).expect("a pseudo-terminal");

    let mut client = Client::open(line.path()).expect("the line");
    let identity = client.identify().expect("an identity");
    assert_eq!((identity.gauges, identity.period_us), (6, 5_000));
    match client.request(Command::SetCalibration(SlidingFinger::calibration(77))) {
        // The emulated flash does not keep what is written, and the board says so.
        Ok(Outcome::CalibrationStored(stored)) => {
            assert_eq!((stored.id, stored.place), (77, StorePlace::RamOnly))
        }
        other => panic!("{other:?}"),
    }
    match client.request(Command::Tare(TareRequest {
        samples: 200,
        force: false,
    })) {
        Ok(Outcome::Tared(tared)) => assert_eq!(tared.samples, 200),
        other => panic!("{other:?}"),
    }
    world.lock().expect("the world").set_down();
    client.start_contacts().expect("a stream");
    let last = client.wait(Duration::from_secs(240), |messages| {
        let contacts = client::contacts(messages);
        let (first, last) = (contacts.first()?, contacts.last()?);
        (last.board_time_us - first.board_time_us >= 60_000_000).then_some(*last)
    });
    assert!(last.is_some(), "60 s of board time took more than 240 s");
    let statistics = client.statistics().expect("statistics");
    let contacts = client.contacts();

    let gaps: u32 = contacts
        .windows(2)
        .map(|pair| pair[1].lost_since(pair[0].sequence))
        .sum();
    assert_eq!((gaps, client.damaged(), line.dropped()), (0, 0, 0));

    let mut worst_mm = 0.0_f64;
    let mut valid = 0;
    let touching = |contact: &&Contact| contact.flags.contains(ContactFlags::LOADED);
    for contact in contacts
        .iter()
        .filter(touching)
        .filter(|contact| contact.is_valid())
    {
        let joints = contact.joint_angles_rad.map(f64::from);
        let truth = SlidingFinger::true_contact_mm(finger, &motion, &joints, 20.0);
        let point = nalgebra::Vector3::from(contact.point_mm.map(f64::from));
        worst_mm = worst_mm.max((point - truth).norm());
        valid += 1;
    }
    let loaded = contacts.iter().filter(touching).count();
    println!(
        "{} contacts, {loaded} loaded, {valid} valid, farthest from the truth {worst_mm:.4} mm",
        contacts.len()
    );
    println!("{statistics:?}");
    assert!(worst_mm < 0.1, "a contact is {worst_mm} mm from the truth");
    // Answers of the emulated chips that a busy machine delays leave a contact invalid, and marked so.
    assert!(valid > 10_000, "{valid} of {loaded} contacts are valid");

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
