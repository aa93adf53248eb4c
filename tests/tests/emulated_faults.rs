//! Faults on the emulated board, one at a time: each is detected, reported with its reason, and survived without a break in the stream.

use palpus_host::hand::Hand;
use palpus_host::link::clock::{ClockEvent, ClockFilter, RoundTrip};
use palpus_protocol::{BoardMessage, Command, Contact, ContactFlags, Outcome, TareRequest};
use palpus_tests::emulator::ads122u04::ChipFault;
use palpus_tests::emulator::amt21::EncoderFault;
use palpus_tests::emulator::{
    Bench, Board, Client, GaugeFault, HostLine, Motion, SlidingFinger, client, hand_file,
};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant, SystemTime};

/// Longest wait for anything, on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

struct Rig {
    world: Arc<Mutex<SlidingFinger>>,
    board: Board,
    line: HostLine,
    client: Client,
}

impl Rig {
    /// A board that is calibrated and tared, its finger down, its contacts streaming.
    fn start() -> Self {
        let hand = Hand::read(&hand_file()).expect("the shipped hand");
        let (_, finger) = hand.finger("index").expect("its index finger");
        let world = Arc::new(Mutex::new(SlidingFinger::new(
            finger.clone(),
            Motion::STANDARD,
        )));
        let mut board =
            Board::start(Bench::new(Box::new(Arc::clone(&world)))).expect("the emulated board");
        let line = HostLine::new(board.take_host().expect("the host's socket"))
            .expect("a pseudo-terminal");
        let mut client = Client::open(line.path()).expect("the line");
        client
            .request(Command::SetCalibration(SlidingFinger::calibration(3)))
            .expect("a calibration");
        match client.request(Command::Tare(TareRequest {
            samples: 100,
            force: false,
        })) {
            Ok(Outcome::Tared(_)) => {}
            other => panic!("{other:?}"),
        }
        let rig = Self {
            world,
            board,
            line,
            client,
        };
        rig.world().set_down();
        let mut rig = rig;
        rig.client.start_contacts().expect("a stream");
        rig.good_again("at the start");
        rig
    }

    fn world(&self) -> MutexGuard<'_, SlidingFinger> {
        self.world.lock().expect("the world")
    }

    /// Waits for a contact from now on that fits.
    fn until(&self, what: &str, fits: impl Fn(&Contact) -> bool) -> Contact {
        let seen = self.client.messages().len();
        self.client
            .wait(PATIENCE, |messages| {
                client::contacts(messages.get(seen..)?)
                    .into_iter()
                    .rev()
                    .find(|contact| fits(contact))
            })
            .unwrap_or_else(|| {
                let last = self
                    .client
                    .contacts()
                    .last()
                    .map(|contact| contact.flags.names().collect::<Vec<_>>());
                panic!("{what}: never came; last contact {last:?}")
            })
    }

    fn flagged(&self, what: &str, flags: ContactFlags) {
        let contact = self.until(what, |contact| contact.flags.intersects(flags));
        assert!(!contact.is_valid());
        println!("{what}: {:?}", contact.flags.names().collect::<Vec<_>>());
    }

    /// Waits for ten valid contacts in a row.
    fn good_again(&self, after: &str) {
        let seen = self.client.messages().len();
        let good = self.client.wait(PATIENCE, |messages| {
            let contacts = client::contacts(messages.get(seen..)?);
            contacts
                .windows(10)
                .any(|row| row.iter().all(Contact::is_valid))
                .then_some(())
        });
        assert!(
            good.is_some(),
            "{after}: contacts stayed invalid: {:?}",
            self.client.contacts().last()
        );
    }

    /// The board's own words.
    fn told(&self, part: &str) {
        let told = self.client.wait(PATIENCE, |messages| {
            messages
                .iter()
                .any(|message| matches!(message, BoardMessage::Log(log) if log.text.contains(part)))
                .then_some(())
        });
        assert!(told.is_some(), "the board never said {part:?}");
    }

    fn lost(&self) -> u32 {
        self.client
            .contacts()
            .windows(2)
            .map(|pair| pair[1].lost_since(pair[0].sequence))
            .sum()
    }
}

#[test]
fn emulated_faults_are_each_detected_told_and_survived() {
    let mut rig = Rig::start();

    rig.world().faults[2] = GaugeFault::Saturated;
    rig.flagged("gauge 2 saturates", ContactFlags::GAUGE_SATURATED);
    rig.world().faults[2] = GaugeFault::None;
    rig.good_again("saturation");
    rig.told("gauge 2: saturated");

    rig.world().faults[5] = GaugeFault::Open;
    rig.flagged("gauge 5 opens", ContactFlags::GAUGE_OPEN);
    rig.world().faults[5] = GaugeFault::None;
    rig.good_again("an open gauge");
    rig.told("gauge 5: saturated open");

    rig.board.bench().converters[0].stuck_at[1] = Some(123_456);
    rig.flagged("gauge 1 sticks", ContactFlags::GAUGE_STUCK);
    rig.board.bench().converters[0].stuck_at[1] = None;
    rig.good_again("a stuck gauge");
    rig.told("gauge 1: stuck");

    let resets = rig.client.statistics().expect("statistics").chip_resets;
    rig.board.bench().converters[1].power_on();
    rig.flagged(
        "converter 1 resets",
        ContactFlags::GAUGE_LATE.union(ContactFlags::GAUGE_MISSING),
    );
    rig.good_again("a reset");
    rig.told("converter reset and set up again");
    assert!(rig.client.statistics().expect("statistics").chip_resets > resets);

    rig.board.bench().converters[2].fault = ChipFault::Silent;
    rig.flagged("converter 2 is silent", ContactFlags::GAUGE_MISSING);
    rig.board.bench().converters[2].fault = ChipFault::None;
    rig.good_again("silence");

    rig.board.bench().converters[2].fault = ChipFault::Stalled;
    rig.flagged(
        "converter 2 stalls",
        ContactFlags::GAUGE_LATE.union(ContactFlags::GAUGE_MISSING),
    );
    rig.board.bench().converters[2].fault = ChipFault::None;
    rig.good_again("a stall");

    // One answer in five is wrong: asked for again within the period.
    rig.board.bench().converters[0].fault = ChipFault::BadBits(5);
    rig.good_again("bad bits, which are read again");
    rig.board.bench().converters[0].fault = ChipFault::None;

    rig.board.bench().encoders[1].fault = EncoderFault::BadCheckBits;
    rig.flagged(
        "encoder 1 has wrong check bits",
        ContactFlags::JOINT_INVALID,
    );
    rig.board.bench().encoders[1].fault = EncoderFault::None;
    rig.good_again("wrong check bits");
    rig.told("joint 1: no good angle");

    rig.board.bench().encoders[2].fault = EncoderFault::Silent;
    rig.flagged("encoder 2 is silent", ContactFlags::JOINT_INVALID);
    rig.board.bench().encoders[2].fault = EncoderFault::None;
    rig.good_again("a silent encoder");
    rig.told("joint 2: no good angle");

    // Garbage of every kind, then a question that is answered.
    let mut noise = 1_u32;
    for _ in 0..40 {
        let garbage: Vec<u8> = (0..97)
            .map(|_| {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (noise >> 24) as u8
            })
            .collect();
        rig.client.send_raw(&garbage).expect("the line");
    }
    rig.client.send_raw(&[0]).expect("the line");
    assert!(matches!(
        rig.client.request(Command::Ping(99)),
        Ok(Outcome::Pong(99))
    ));
    let statistics = rig.client.statistics().expect("statistics");
    println!(
        "garbage: {} bad frames, {} good",
        statistics.frames_bad, statistics.frames_received
    );
    assert!(statistics.frames_bad > 0);
    rig.good_again("garbage");

    // Until here not one frame was lost.
    assert_eq!(
        (rig.lost(), rig.client.damaged(), rig.line.dropped()),
        (0, 0, 0)
    );

    // The host does not read for 10 s: the board goes on sampling, what was lost is counted exactly, the stream goes on.
    let before = rig.client.statistics().expect("statistics");
    rig.client.pause(true);
    std::thread::sleep(Duration::from_secs(10));
    rig.client.pause(false);
    rig.good_again("ten seconds without reading");
    let after = rig.client.statistics().expect("statistics");
    let contacts = rig.client.contacts();
    let (first, last) = (contacts[0].sequence, contacts[contacts.len() - 1].sequence);
    let made = last.wrapping_sub(first) as usize + 1;
    println!(
        "ten seconds without reading: {} contacts lost and counted, {} bytes dropped",
        rig.lost(),
        rig.line.dropped()
    );
    assert!(rig.lost() > 1_000 && rig.line.dropped() > 0);
    assert_eq!(made, contacts.len() + rig.lost() as usize);
    let periods = (after.board_time_us - before.board_time_us) / 5_000;
    let ran = u64::from(after.ticks - before.ticks) + u64::from(after.overruns - before.overruns);
    assert!(ran.abs_diff(periods) <= 2, "{ran} of {periods} periods");

    // The clock jumps: the board stands still for 2 s while the host's time goes on.
    let mut clock = ClockFilter::new();
    let mut compare = |client: &mut Client| {
        let now_us = || {
            SystemTime::UNIX_EPOCH
                .elapsed()
                .map_or(0, |time| time.as_micros() as i64)
        };
        let sent_us = now_us();
        let answer = client.time_sync(sent_us as u64).expect("a time");
        assert_eq!(answer.host_send_us, sent_us as u64);
        clock.add(RoundTrip {
            sent_us,
            board_received_us: answer.board_receive_us as i64,
            board_sent_us: answer.board_send_us as i64,
            received_us: now_us(),
        })
    };
    // A slow answer may be doubted for a while; before the jump none may pass for one.
    for _ in 0..10 {
        let event = compare(&mut rig.client);
        assert!(!matches!(event, ClockEvent::Jumped { .. }), "{event:?}");
    }
    rig.board.freeze(true);
    std::thread::sleep(Duration::from_secs(2));
    rig.board.freeze(false);
    let deadline = Instant::now() + PATIENCE;
    let jumped = loop {
        if let ClockEvent::Jumped { by_us } = compare(&mut rig.client) {
            break by_us;
        }
        assert!(Instant::now() < deadline, "the jump was never noticed");
    };
    println!("the clock jumped by {jumped} us");
    // A slow answer may be doubted for a while; before the jump none may pass for one.
    for _ in 0..10 {
        let event = compare(&mut rig.client);
        assert!(!matches!(event, ClockEvent::Jumped { .. }), "{event:?}");
    }
    rig.good_again("a clock jump");
}
