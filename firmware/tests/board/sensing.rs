//! From gauge counts to contacts on the wire, and the zero that is kept meanwhile.

use crate::bench::*;
use palpus_firmware::store::RamStore;
use palpus_protocol::*;

#[test]
fn a_push_becomes_a_contact_where_it_was() {
    let mut bench = Bench::<RamStore>::ready();
    assert_eq!(bench.ask(STREAM), Outcome::Done);
    for degrees in [0.0, 20.0, -45.0, 80.0] {
        bench.board.gauges_mut().counts = counts(push(3.0, degrees));
        bench.heard.clear();
        bench.run(20);
        let contacts = bench.contacts();
        assert_eq!(contacts.len(), 20);
        let expected = [
            20.0 * degrees.to_radians().sin(),
            0.0,
            20.0 * degrees.to_radians().cos(),
        ];
        for contact in contacts {
            assert!(
                contact.is_valid(),
                "{:?}",
                contact.flags.names().collect::<Vec<_>>()
            );
            // 10 counts of noise are half a mN and 10 uN m: some hundredths of a mm at 3 N.
            for axis in 0..3 {
                assert!(
                    (f64::from(contact.point_mm[axis]) - expected[axis]).abs() < 0.05,
                    "{contact:?}"
                );
                assert!((f64::from(contact.normal[axis]) - expected[axis] / 20.0).abs() < 0.0025);
            }
            assert!(
                (contact.normal_force_n - 3.0).abs() < 5e-3 && contact.tangential_force_n < 5e-3
            );
            assert!(contact.sigma_mm > 0.1 && contact.sigma_mm < 0.3);
            assert!(
                contact
                    .flags
                    .contains(ContactFlags::LOADED.union(ContactFlags::CALIBRATION_VOLATILE))
            );
            assert!((contact.joint_angles_rad[2] - 0.3).abs() < 6e-6);
        }
    }
}

#[test]
fn contacts_are_numbered_without_gaps_and_timed_by_their_sample() {
    let mut bench = Bench::<RamStore>::ready();
    assert_eq!(
        bench.ask(Command::Start(Streams {
            contact_every: 3,
            raw_every: 5
        })),
        Outcome::Done
    );
    let began = bench.now_us;
    bench.run(30);
    let contacts = bench.contacts();
    assert_eq!(contacts.len(), 10);
    for (index, contact) in contacts.iter().enumerate() {
        assert_eq!(contact.sequence, index as u32);
        // The first period after the start is sent, then every third; the front end's samples are
        // 500 us old.
        assert_eq!(
            contact.board_time_us,
            began + PERIOD_US * (1 + 3 * index as u64) - 500
        );
    }
    let raw: Vec<_> = bench
        .heard
        .iter()
        .filter_map(|m| {
            if let BoardMessage::RawGauges(raw) = m {
                Some(raw)
            } else {
                None
            }
        })
        .collect();
    assert_eq!(raw.len(), 6);
    assert_eq!((raw[5].sequence, raw[0].gauges.len()), (5, GAUGES));
    for (gauge, value) in raw[0].gauges.iter().enumerate() {
        assert!((value.counts - ZERO[gauge]).abs() <= 10 && value.tared_counts.abs() <= 15);
    }
    assert_eq!(bench.ask(Command::Stop), Outcome::Done);
    bench.heard.clear();
    bench.run(10);
    assert!(bench.heard.is_empty(), "{:?}", bench.heard);
}

#[test]
fn nothing_is_valid_before_calibration_and_tare() {
    let mut bench = Bench::new();
    bench.ask(STREAM);
    bench.run(1);
    let flags = bench.contacts()[0].flags;
    assert!(flags.contains(ContactFlags::CALIBRATION_MISSING.union(ContactFlags::NOT_TARED)));
    bench.ask(Command::Stop);
    bench.ask(Command::SetCalibration(calibration(7)));
    bench.ask(STREAM);
    bench.run(1);
    let flags = bench.contacts().last().expect("one").flags;
    assert!(
        flags.contains(ContactFlags::NOT_TARED)
            && !flags.intersects(ContactFlags::CALIBRATION_MISSING)
    );
}

#[test]
fn slow_drift_is_followed_and_remarked_and_a_touch_is_not() {
    let mut bench = Bench::<RamStore>::ready();
    // 1 mN a second for two minutes: 120 mN, far beyond what would count as a load at once.
    for second in 0..120 {
        bench.board.gauges_mut().counts =
            counts([0.0, 0.0, 0.001 * f64::from(second), 0.0, 0.0, 0.0]);
        bench.run(200);
        assert!(
            bench
                .board
                .last_contact()
                .is_some_and(|contact| !contact.flags.contains(ContactFlags::LOADED)),
            "{second} s"
        );
    }
    let (_, gauges) = bench.statistics();
    // 0.119 N less the lag of 5 s, at 20 000 counts per N.
    assert!((gauges[2].drift_counts - 2280).abs() < 60, "{gauges:?}");
    // A touch of 0.3 N is a load at once and is not followed.
    let drift = gauges[2].drift_counts;
    bench.board.gauges_mut().counts = counts([0.0, 0.0, 0.119 - 0.3, 0.0, 0.0, 0.0]);
    bench.run(2000);
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| contact.flags.contains(ContactFlags::LOADED))
    );
    let (_, gauges) = bench.statistics();
    assert!((gauges[2].drift_counts - drift).abs() <= 1);
}

#[test]
fn without_a_calibration_the_zero_stays_where_it_was_taken() {
    let mut bench = Bench::new();
    assert!(matches!(
        bench.ask(Command::Tare(TareRequest {
            samples: 50,
            force: false
        })),
        Outcome::Tared(_)
    ));
    bench.board.gauges_mut().counts = counts([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]);
    bench.run(2000);
    let (_, gauges) = bench.statistics();
    assert!(
        gauges.iter().all(|gauge| gauge.drift_counts == 0),
        "{gauges:?}"
    );
}
