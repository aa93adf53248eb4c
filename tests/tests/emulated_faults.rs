//! Faults on the emulated board, one at a time: each is detected, told with its reason, and survived without a break in the stream.
//!
//! Nothing here is timed by the wall. A fault stays until the board has marked a contact for it and has told it; then it ends, and the
//! contacts have to become valid again. All of that is waited for in board time. Other tests on the same machine make the emulated
//! chips late now and then: that is marked by the board as what it is, and no test asks that it never happens.
//!
//! The host's clock of the comparison of clocks is the board's own stream, which goes on with the board. The wall does not: an emulated
//! board stands still whenever the machine does something else, and each time its clock would rightly be said to have jumped.

use palpus_host::hand::{Finger, Hand};
use palpus_host::link::clock::{ClockEvent, ClockFilter, RoundTrip};
use palpus_protocol::{
    BoardMessage, Command, Contact, ContactFlags, GaugeCounts, Outcome, TareRequest,
};
use palpus_tests::emulator::ads122u04::ChipFault;
use palpus_tests::emulator::amt21::EncoderFault;
use palpus_tests::emulator::{
    Bench, Board, Client, GaugeFault, HostLine, Motion, SlidingFinger, hand_file,
};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// Longest board time that anything may take, us.
const LIMIT_US: u64 = 30_000_000;

/// Real time after which a stream that stands still is taken for dead.
const DEAD: Duration = Duration::from_secs(120);

struct Rig {
    finger: Finger,
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
        let mut rig = Self {
            finger: finger.clone(),
            world,
            board,
            line,
            client,
        };
        rig.world().set_down();
        rig.client.start_contacts().expect("a stream");
        rig.good_from(0, "the start");
        rig
    }

    fn world(&self) -> MutexGuard<'_, SlidingFinger> {
        self.world.lock().expect("the world")
    }

    /// Where what comes next will be found.
    fn now(&self) -> usize {
        self.client.messages().len()
    }

    /// The first of the messages from `mark` on in which something is found.
    fn first<T>(
        &self,
        mark: usize,
        what: &str,
        mut find: impl FnMut(&BoardMessage) -> Option<T>,
    ) -> T {
        let (mut next, mut began_us) = (mark, None);
        let found = self.client.wait(DEAD, |messages| {
            while let Some(message) = messages.get(next) {
                next += 1;
                if let Some(found) = find(message) {
                    return Some(Ok(found));
                }
                if let BoardMessage::Contact(contact) = message {
                    let began_us = *began_us.get_or_insert(contact.board_time_us);
                    if contact.board_time_us.saturating_sub(began_us) > LIMIT_US {
                        return Some(Err(contact.flags.names().collect::<Vec<_>>()));
                    }
                }
            }
            None
        });
        match found {
            Some(Ok(found)) => found,
            Some(Err(flags)) => panic!("{what}: not within 30 s; last contact {flags:?}"),
            None => panic!("{what}: the stream stands still"),
        }
    }

    /// The board's own words.
    fn told(&self, mark: usize, words: &str) {
        self.first(mark, &format!("the board says {words:?}"), |message| {
            matches!(message, BoardMessage::Log(log) if log.text.contains(words)).then_some(())
        });
    }

    /// Ten valid contacts in a row.
    fn good_from(&self, mark: usize, after: &str) {
        let mut row = 0;
        self.first(mark, &format!("good contacts after {after}"), |message| {
            if let BoardMessage::Contact(contact) = message {
                row = if contact.is_valid() { row + 1 } else { 0 };
            }
            (row == 10).then_some(())
        });
    }

    /// Breaks something until the board has marked a contact with one of the flags and has said the words; mends it until contacts are
    /// good again and the board has said so.
    fn fault(
        &self,
        what: &str,
        flags: ContactFlags,
        words: &str,
        good_words: &str,
        set: impl Fn(&Self, bool),
    ) {
        let mark = self.now();
        set(self, true);
        let contact = self.first(mark, what, |message| match message {
            BoardMessage::Contact(contact) if contact.flags.intersects(flags) => Some(*contact),
            _ => None,
        });
        assert!(!contact.is_valid());
        self.told(mark, words);
        println!("{what}: {:?}", contact.flags.names().collect::<Vec<_>>());
        let mark = self.now();
        set(self, false);
        self.good_from(mark, what);
        self.told(mark, good_words);
    }

    fn gauge_fault(
        &mut self,
        what: &str,
        flags: ContactFlags,
        words: &str,
        count: fn(&GaugeCounts) -> u32,
        gauges: &[usize],
        set: impl Fn(&Self, bool),
    ) {
        let before = self.client.gauge_statistics().expect("statistics");
        self.fault(what, flags, words, "all gauges good again", set);
        let after = self.client.gauge_statistics().expect("statistics");
        for gauge in gauges {
            assert!(
                count(&after[*gauge]) > count(&before[*gauge]),
                "{what}: gauge {gauge} counts {:?} before, {:?} after",
                before[*gauge],
                after[*gauge]
            );
        }
    }

    /// Gauges that have counted something, of all gauges.
    fn counted(&mut self, count: fn(&GaugeCounts) -> u32) -> Vec<usize> {
        let counts = self.client.gauge_statistics().expect("statistics");
        (0..counts.len())
            .filter(|&gauge| count(&counts[gauge]) > 0)
            .collect()
    }

    /// Largest distance of the valid contacts from `mark` on from the truth, mm.
    fn worst_mm(&self, mark: usize) -> f64 {
        let messages = self.client.messages();
        messages[mark..]
            .iter()
            .filter_map(|message| match message {
                BoardMessage::Contact(contact) if contact.is_valid() => Some(contact),
                _ => None,
            })
            .map(|contact| {
                let joints = contact.joint_angles_rad.map(f64::from);
                let truth =
                    SlidingFinger::true_contact_mm(&self.finger, &Motion::STANDARD, &joints, 20.0);
                (nalgebra::Vector3::from(contact.point_mm.map(f64::from)) - truth).norm()
            })
            .fold(0.0, f64::max)
    }
}

/// Contacts missing among these.
fn lost(contacts: &[Contact]) -> u32 {
    contacts
        .windows(2)
        .map(|pair| pair[1].lost_since(pair[0].sequence))
        .sum()
}

fn garbage(rig: &mut Rig) {
    // Garbage of every kind, then a question that is answered.
    let mark = rig.now();
    let before = rig.client.statistics().expect("statistics");
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
    let after = rig.client.statistics().expect("statistics");
    println!(
        "garbage: {} bad frames, {} good",
        after.frames_bad - before.frames_bad,
        after.frames_received - before.frames_received
    );
    assert!(after.frames_bad > before.frames_bad);
    rig.told(mark, "received");
    rig.good_from(mark, "garbage");
}

/// The host does not read for 15 s: the board goes on sampling, what was lost is counted exactly, the stream goes on.
fn host_that_does_not_read(rig: &mut Rig) {
    /// Two conversions in a period at most, 200 periods a second.
    const CONVERSIONS: u32 = 6_000;
    /// Of 3000 contacts at least so many: the line keeps 340, and the system's terminal some 400.
    const LOST: u32 = 1_500;
    let converted = |rig: &Rig| rig.board.bench().converters[0].conversions;
    let before = rig.client.statistics().expect("statistics");
    rig.client.pause(true);
    let began = converted(rig);
    while converted(rig) < began + CONVERSIONS {
        std::thread::sleep(Duration::from_millis(50));
    }
    let mark = rig.now();
    rig.client.pause(false);
    // What the line had kept comes first.
    let late_us = before.board_time_us + 15_000_000;
    rig.first(mark, "a contact after the gap", |message| {
        matches!(message, BoardMessage::Contact(contact) if contact.board_time_us >= late_us)
            .then_some(())
    });
    rig.good_from(rig.now(), "a host that does not read");
    let after = rig.client.statistics().expect("statistics");
    let contacts = rig.client.contacts();
    let (first, last) = (contacts[0].sequence, contacts[contacts.len() - 1].sequence);
    let (made, lost) = (last.wrapping_sub(first) as usize + 1, lost(&contacts));
    println!(
        "a host that does not read: {lost} contacts lost and counted, {} bytes dropped",
        rig.line.dropped()
    );
    assert!(lost >= LOST && rig.line.dropped() > 0, "{lost}");
    assert_eq!(made, contacts.len() + lost as usize);
    let periods = (after.board_time_us - before.board_time_us) / 5_000;
    let ran = u64::from(after.ticks - before.ticks) + u64::from(after.overruns - before.overruns);
    assert!(ran.abs_diff(periods) <= 2, "{ran} of {periods} periods");
}

/// The host's clock is set forward by 2 s: noticed by the third answer, with what it was set by; no answer before or after is doubted.
fn clock_that_jumps(rig: &mut Rig) {
    const EPOCH_US: u64 = 1_700_000_000_000_000;
    /// A comparison that took longer, because this test had to wait for its turn, leaves a clock set by 2 s little to be
    /// noticed by; it is made again, us.
    const QUICK_US: u64 = 100_000;
    let newest_us = |rig: &Rig| {
        let last: Option<Contact> = rig.client.contacts().last().copied();
        last.expect("a stream").board_time_us
    };
    let mut clock = ClockFilter::new();
    let mut compare = |rig: &mut Rig, offset_us: u64| {
        let (sent_us, answer, read_us) = loop {
            let mark = rig.now();
            let sent_us = newest_us(rig) + offset_us;
            let answer = rig.client.time_sync(sent_us).expect("a time");
            assert_eq!(answer.host_send_us, sent_us);
            let read_us = rig.first(
                mark,
                "a contact after the answer",
                |message| match message {
                    BoardMessage::Contact(contact) => (contact.board_time_us
                        >= answer.board_send_us)
                        .then_some(contact.board_time_us),
                    _ => None,
                },
            );
            if read_us + offset_us <= sent_us + QUICK_US {
                break (sent_us, answer, read_us);
            }
        };
        clock.add(RoundTrip {
            sent_us: sent_us as i64,
            board_received_us: answer.board_receive_us as i64,
            board_sent_us: answer.board_send_us as i64,
            received_us: (read_us + offset_us) as i64,
        })
    };
    for _ in 0..20 {
        assert_eq!(compare(rig, EPOCH_US), ClockEvent::Kept);
    }
    let set_us = EPOCH_US + 2_000_000;
    assert_eq!(compare(rig, set_us), ClockEvent::Doubted);
    assert_eq!(compare(rig, set_us), ClockEvent::Doubted);
    let ClockEvent::Jumped { by_us } = compare(rig, set_us) else {
        panic!("the jump was not noticed")
    };
    println!("the clock jumped by {by_us} us");
    // Less what quick round trips leave open.
    assert!((1_700_000..=2_000_000).contains(&by_us), "{by_us}");
    for _ in 0..20 {
        assert_eq!(compare(rig, set_us), ClockEvent::Kept);
    }
}

#[test]
fn emulated_faults_are_each_detected_told_and_survived() {
    let mut rig = Rig::start();
    assert!(rig.counted(|counts| counts.saturated).is_empty());

    rig.gauge_fault(
        "gauge 2 saturates",
        ContactFlags::GAUGE_SATURATED,
        "gauge 2: saturated",
        |counts| counts.saturated,
        &[2],
        |rig, on| {
            rig.world().faults[2] = if on {
                GaugeFault::Saturated
            } else {
                GaugeFault::None
            };
        },
    );
    assert_eq!(rig.counted(|counts| counts.saturated), [2]);
    assert!(rig.counted(|counts| counts.open).is_empty());

    rig.gauge_fault(
        "gauge 5 opens",
        ContactFlags::GAUGE_OPEN,
        "gauge 5: open",
        |counts| counts.open,
        &[5],
        |rig, on| {
            rig.world().faults[5] = if on {
                GaugeFault::Open
            } else {
                GaugeFault::None
            };
        },
    );
    assert_eq!(rig.counted(|counts| counts.open), [5]);

    rig.gauge_fault(
        "gauge 1 sticks",
        ContactFlags::GAUGE_STUCK,
        "gauge 1: stuck",
        |counts| counts.stuck,
        &[1],
        |rig, on| rig.board.bench().converters[0].stuck_at[1] = on.then_some(123_456),
    );
    assert_eq!(rig.counted(|counts| counts.stuck), [1]);

    let resets = rig.client.statistics().expect("statistics").chip_resets;
    rig.gauge_fault(
        "converter 1 resets",
        ContactFlags::GAUGE_LATE.union(ContactFlags::GAUGE_MISSING),
        "converter reset and set up again",
        |counts| counts.late + counts.missing,
        &[2, 3],
        |rig, on| {
            if on {
                rig.board.bench().converters[1].power_on();
            }
        },
    );
    assert!(rig.client.statistics().expect("statistics").chip_resets > resets);

    for (what, fault) in [
        ("converter 2 is silent", ChipFault::Silent),
        ("converter 2 stalls", ChipFault::Stalled),
    ] {
        rig.gauge_fault(
            what,
            ContactFlags::GAUGE_MISSING,
            "gauges 4 5: missing",
            |counts| counts.missing,
            &[4, 5],
            |rig, on| {
                rig.board.bench().converters[2].fault = if on { fault } else { ChipFault::None };
            },
        );
    }

    // One answer in five is wrong: asked for again within the period, and never taken for right.
    let mark = rig.now();
    let before = rig.board.bench().converters[0].damaged;
    rig.board.bench().converters[0].fault = ChipFault::BadBits(5);
    rig.first(mark, "two hundred damaged answers", |_| {
        (rig.board.bench().converters[0].damaged >= before + 200).then_some(())
    });
    rig.board.bench().converters[0].fault = ChipFault::None;
    rig.good_from(rig.now(), "damaged answers");
    let worst_mm = rig.worst_mm(mark);
    println!("damaged answers: contacts {worst_mm:.4} mm off at most");
    assert!(worst_mm < 0.1, "{worst_mm}");

    rig.fault(
        "encoder 1 has wrong check bits",
        ContactFlags::JOINT_INVALID,
        "joint 1: wrong check bits",
        "all joint angles good again",
        |rig, on| {
            rig.board.bench().encoders[1].fault = if on {
                EncoderFault::BadCheckBits
            } else {
                EncoderFault::None
            };
        },
    );
    rig.fault(
        "encoder 2 is silent",
        ContactFlags::JOINT_INVALID,
        "joint 2: no answer",
        "all joint angles good again",
        |rig, on| {
            rig.board.bench().encoders[2].fault = if on {
                EncoderFault::Silent
            } else {
                EncoderFault::None
            };
        },
    );

    garbage(&mut rig);
    clock_that_jumps(&mut rig);

    // Until here not one frame was lost.
    assert_eq!(
        (
            lost(&rig.client.contacts()),
            rig.client.damaged(),
            rig.line.dropped()
        ),
        (0, 0, 0)
    );
    host_that_does_not_read(&mut rig);
}
