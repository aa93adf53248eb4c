//! Requests and their answers: each done once, answered each time, refused with a reason.

use crate::bench::*;
use palpus_firmware::store::{CalibrationStore, RECORD_BYTES, RamStore, StoreError};
use palpus_protocol::*;

#[test]
fn a_board_says_who_it_is_when_it_starts_and_when_asked() {
    let mut bench = Bench::new();
    bench.listen();
    let Some(BoardMessage::Identity(first)) = bench.heard.first() else {
        panic!("{:?}", bench.heard)
    };
    assert_eq!(
        (
            first.request_id,
            first.finger_name.as_str(),
            first.period_us
        ),
        (0, "index", 5000)
    );
    assert_eq!(
        (first.schema_hash, first.gauges, first.calibration_id),
        (SCHEMA_HASH, 6, 0)
    );
    bench.heard.clear();
    bench.send(Identify { request_id: 9 });
    bench.listen();
    assert!(
        matches!(&bench.heard[..], [BoardMessage::Identity(identity)] if identity.request_id == 9)
    );
}

#[test]
fn a_repeated_request_is_done_once_and_answered_each_time() {
    let mut bench = Bench::<RamStore>::ready();
    let tare = Request {
        request_id: 5000,
        command: Command::Tare(TareRequest {
            samples: 50,
            force: false,
        }),
    };
    // Three copies before it is done, three after: one tare, four equal answers.
    for _ in 0..3 {
        bench.send(tare.clone());
        bench.run(10);
    }
    let first = bench.outcome_of(5000);
    assert!(matches!(first, Outcome::Tared(_)));
    for _ in 0..3 {
        bench.send(tare.clone());
        assert_eq!(bench.outcome_of(5000), first);
    }
    assert_eq!(
        bench
            .logs()
            .iter()
            .filter(|line| line.starts_with("tared"))
            .count(),
        1
    );
    assert_eq!(bench.board.statistics(0, 0).requests_repeated, 5);
    // The same id with another content is another request.
    bench.send(Request {
        request_id: 5000,
        command: Command::Stop,
    });
    assert_eq!(bench.outcome_of(5000), Outcome::Done);
}

#[test]
fn a_delayed_copy_of_start_does_not_undo_stop() {
    let mut bench = Bench::<RamStore>::ready();
    let start = Request {
        request_id: 6000,
        command: STREAM,
    };
    bench.send(start.clone());
    bench.send(Request {
        request_id: 6001,
        command: Command::Stop,
    });
    bench.send(start);
    assert_eq!(bench.board.streams(), Streams::default());
}

#[test]
fn tare_is_refused_in_contact_unless_forced() {
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().counts = counts(push(0.2, 10.0));
    bench.run(2);
    let refused = bench.ask(Command::Tare(TareRequest {
        samples: 20,
        force: false,
    }));
    assert_eq!(refused, Outcome::Refused(Refusal::InContact));
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| contact.flags.contains(ContactFlags::LOADED))
    );
    assert!(matches!(
        bench.ask(Command::Tare(TareRequest {
            samples: 20,
            force: true
        })),
        Outcome::Tared(_)
    ));
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| !contact.flags.contains(ContactFlags::LOADED))
    );
    assert_eq!(
        bench.ask(Command::Tare(TareRequest {
            samples: 0,
            force: true
        })),
        Outcome::Refused(Refusal::SampleCount)
    );
}

#[test]
fn contacts_during_a_tare_are_marked_and_a_second_tare_waits() {
    let mut bench = Bench::<RamStore>::ready();
    bench.send(Request {
        request_id: 1,
        command: Command::Tare(TareRequest {
            samples: 100,
            force: false,
        }),
    });
    bench.run(5);
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| contact.flags.contains(ContactFlags::TARING))
    );
    assert_eq!(
        bench.ask(Command::Tare(TareRequest {
            samples: 10,
            force: false
        })),
        Outcome::Refused(Refusal::Busy)
    );
    assert!(matches!(bench.outcome_of(1), Outcome::Tared(_)));
}

/// Memory that outlives the power, as long as it is told to.
#[derive(Clone, Default)]
struct Flash {
    slots: RamStore,
    broken: bool,
}

impl CalibrationStore for Flash {
    fn is_permanent(&self) -> bool {
        true
    }

    fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES] {
        self.slots.read(slot)
    }

    fn write(&mut self, slot: usize, record: &[u8; RECORD_BYTES]) -> Result<(), StoreError> {
        if self.broken {
            Err(StoreError::NotWritable)
        } else {
            self.slots.write(slot, record)
        }
    }
}

#[test]
fn a_calibration_outlives_the_power_and_can_be_read_back() {
    let mut bench = Bench::with_store(Flash::default());
    assert_eq!(
        bench.ask(Command::GetCalibration),
        Outcome::Refused(Refusal::NoCalibration)
    );
    let stored = bench.ask(Command::SetCalibration(calibration(7)));
    assert_eq!(
        stored,
        Outcome::CalibrationStored(CalibrationStored {
            id: 7,
            place: StorePlace::Permanent
        })
    );
    let flash = bench.board.store_mut().clone();
    let mut again = Bench::with_store(flash);
    again.listen();
    assert!(
        again
            .heard
            .iter()
            .any(|m| matches!(m, BoardMessage::Identity(identity) if identity.calibration_id == 7))
    );
    assert_eq!(
        again.ask(Command::GetCalibration),
        Outcome::Calibration(calibration(7))
    );
}

#[test]
fn a_store_that_can_not_be_written_is_told_and_the_calibration_used() {
    let mut bench = Bench::with_store(Flash {
        broken: true,
        ..Flash::default()
    });
    let stored = bench.ask(Command::SetCalibration(calibration(7)));
    assert_eq!(
        stored,
        Outcome::CalibrationStored(CalibrationStored {
            id: 7,
            place: StorePlace::RamOnly
        })
    );
    assert_eq!(
        (
            bench.board.calibration_id(),
            bench.board.statistics(0, 0).store_failures
        ),
        (7, 1)
    );
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .contains(ContactFlags::CALIBRATION_VOLATILE)
    );
    assert!(bench.logs().iter().any(|line| line.contains("kept in RAM")));
}

#[test]
fn calibrations_that_can_not_be_used_are_refused_with_the_reason() {
    let mut bench = Bench::<RamStore>::ready();
    let sound = calibration(8);
    let mut refused =
        |calibration: Calibration| match bench.ask(Command::SetCalibration(calibration)) {
            Outcome::Refused(refusal) => refusal,
            other => panic!("{other:?}"),
        };
    assert_eq!(
        refused(Calibration {
            crc: sound.crc ^ 1,
            ..sound.clone()
        }),
        Refusal::CalibrationCrc
    );
    let two = Calibration::sealed(8, 2, &[1.0; 12]).expect("sound");
    assert_eq!(refused(two), Refusal::CalibrationShape(6));
    let mut infinite = Calibration {
        matrix: sound.matrix.clone(),
        ..sound.clone()
    };
    infinite.matrix[3] = f32::INFINITY;
    infinite.crc = infinite.computed_crc();
    assert_eq!(refused(infinite), Refusal::CalibrationValue);
    let mut nameless = Calibration {
        id: 0,
        ..sound.clone()
    };
    nameless.crc = nameless.computed_crc();
    assert_eq!(refused(nameless), Refusal::CalibrationValue);
    assert_eq!(bench.board.calibration_id(), 7);
    bench.ask(STREAM);
    assert_eq!(
        bench.ask(Command::SetCalibration(sound)),
        Outcome::Refused(Refusal::Streaming)
    );
}

#[test]
fn time_sync_answers_with_the_moments_of_receipt_and_of_leaving() {
    let mut bench = Bench::<RamStore>::ready();
    bench.send(Request {
        request_id: 1,
        command: Command::TimeSync(TimeSyncRequest { host_send_us: 123 }),
    });
    let received = bench.now_us;
    bench.now_us += 1700;
    let time = TimeSyncAnswer {
        host_send_us: 123,
        board_receive_us: received,
        board_send_us: bench.now_us,
    };
    assert_eq!(bench.outcome_of(1), Outcome::Time(time));
}

#[test]
fn a_host_of_another_version_learns_who_the_board_is() {
    let mut bench = Bench::<RamStore>::ready();
    let [low, high] = SCHEMA_TAG.to_le_bytes();
    for envelope in [
        [MAGIC, 9, low, high, 0x82],
        [MAGIC, PROTOCOL_VERSION, !low, high, 0x82],
    ] {
        let mut raw = envelope.to_vec();
        raw.extend([1, 2, 3]);
        raw.extend(CRC.checksum(&raw).to_le_bytes());
        let mut stuffed = vec![0; raw.len() + 2];
        cobs::encode(&raw, &mut stuffed);
        bench.heard.clear();
        // Ten of them make one answer.
        for _ in 0..10 {
            bench.board.receive(&stuffed, bench.now_us);
        }
        bench.listen();
        let identities = bench
            .heard
            .iter()
            .filter(|m| matches!(m, BoardMessage::Identity(_)))
            .count();
        assert_eq!(identities, 1);
        assert!(
            bench
                .logs()
                .iter()
                .any(|line| line.contains("the other side")),
            "{:?}",
            bench.logs()
        );
    }
    assert_eq!(bench.board.statistics(0, 0).frames_refused, 20);
}
