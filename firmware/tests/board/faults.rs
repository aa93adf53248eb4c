//! Faults of gauges, encoders, chips and clocks: each a reason, a count and a line, and each passes.

use crate::bench::*;
use palpus_firmware::front_end::{JointSample, JointState};
use palpus_firmware::store::RamStore;
use palpus_firmware::{Board, BoardConfig, BoardError};
use palpus_protocol::*;

#[test]
fn every_gauge_fault_is_a_reason_a_count_and_a_line_and_passes() {
    for (fault, reason, name) in [
        (
            GaugeFlags::SATURATED,
            ContactFlags::GAUGE_SATURATED,
            "gauge 4: saturated",
        ),
        (GaugeFlags::OPEN, ContactFlags::GAUGE_OPEN, "gauge 4: open"),
        (
            GaugeFlags::STUCK,
            ContactFlags::GAUGE_STUCK,
            "gauge 4: stuck",
        ),
        (
            GaugeFlags::MISSING,
            ContactFlags::GAUGE_MISSING,
            "gauge 4: missing",
        ),
        (GaugeFlags::LATE, ContactFlags::GAUGE_LATE, "gauge 4: late"),
    ] {
        let mut bench = Bench::<RamStore>::ready();
        bench.board.gauges_mut().counts = counts(push(3.0, 10.0));
        bench.ask(STREAM);
        bench.run(10);
        bench.contacts();
        let (_, before) = bench.statistics();
        bench.board.gauges_mut().flags[4] = fault;
        bench.run(10);
        let contacts = bench.contacts();
        assert!(
            contacts
                .iter()
                .all(|contact| !contact.is_valid() && contact.flags.contains(reason)),
            "{name}"
        );
        let (_, after) = bench.statistics();
        let counted = |counts: &GaugeCounts| {
            [
                counts.saturated,
                counts.open,
                counts.stuck,
                counts.missing,
                counts.late,
            ]
        };
        let rises: u32 =
            counted(&after[4]).iter().sum::<u32>() - counted(&before[4]).iter().sum::<u32>();
        assert_eq!((rises, after[4].good - before[4].good), (10, 0), "{name}");
        assert_eq!(after[3].good - before[3].good, 10);
        bench.board.gauges_mut().flags[4] = GaugeFlags::none();
        bench.run(3);
        let recovered = bench.contacts();
        assert!(recovered.last().expect("some").is_valid());
        let lines = bench.logs();
        assert_eq!(
            lines.iter().filter(|line| *line == name).count(),
            1,
            "{lines:?}"
        );
        assert!(lines.iter().any(|line| line == "all gauges good again"));
    }
}

#[test]
fn gauges_that_fail_together_are_told_together_and_once() {
    let mut bench = Bench::<RamStore>::ready();
    bench.run(1);
    for gauge in 0..6 {
        bench.board.gauges_mut().flags[gauge] = GaugeFlags::LATE;
    }
    bench.board.gauges_mut().flags[3] = GaugeFlags::LATE.union(GaugeFlags::SATURATED);
    bench.run(5);
    bench.board.gauges_mut().flags[2] = GaugeFlags::MISSING;
    bench.run(5);
    let told = [
        "gauge 3: saturated",
        "gauges 0 1 2 3 4 5: late",
        "gauge 2: missing",
    ];
    let lines = bench.logs();
    assert_eq!(lines[lines.len() - told.len()..], told);
}

#[test]
fn the_board_itself_sees_stuck_and_late_gauges() {
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().noise = 0;
    bench.run(22);
    let flags = bench.board.last_contact().expect("one").flags;
    assert!(flags.contains(ContactFlags::GAUGE_STUCK));
    bench.board.gauges_mut().noise = 1;
    bench.run(1);
    assert!(
        !bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .intersects(ContactFlags::GAUGE_STUCK)
    );
    bench.board.gauges_mut().age_us = 7_600;
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .contains(ContactFlags::GAUGE_LATE)
    );
}

#[test]
fn old_and_saturated_readings_have_their_own_names_and_are_not_called_stuck() {
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().noise = 0;
    bench.board.gauges_mut().flags[2] = GaugeFlags::SATURATED;
    bench.run(40);
    let (_, gauges) = bench.statistics();
    assert!(gauges[2].saturated == 40 && gauges[2].stuck == 0);
    assert!(gauges[1].saturated == 0 && gauges[1].stuck > 0);
    // A front end that has nothing new returns its last reading: late, not stuck.
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().noise = 0;
    let read_us = bench.now_us;
    for _ in 0..40 {
        bench.board.gauges_mut().age_us = bench.now_us + PERIOD_US - read_us;
        bench.run(1);
    }
    let (_, gauges) = bench.statistics();
    assert!(gauges[0].stuck == 0 && gauges[0].late == 39, "{gauges:?}");
    // Nor does one that has nothing new of one gauge alone, while the others go on.
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().noise = 0;
    bench.board.gauges_mut().flags[5] = GaugeFlags::LATE;
    bench.run(40);
    let (_, gauges) = bench.statistics();
    assert!(gauges[5].stuck == 0 && gauges[5].late == 40, "{gauges:?}");
    assert!(gauges[4].stuck > 0, "{gauges:?}");
}

#[test]
fn joint_faults_are_reasons_and_pass() {
    let mut bench = Bench::<RamStore>::ready();
    for state in [JointState::Missing, JointState::BadCheck] {
        bench.board.joints_mut().0.states[1] = state;
        bench.run(4);
        assert!(
            bench
                .board
                .last_contact()
                .expect("one")
                .flags
                .contains(ContactFlags::JOINT_INVALID)
        );
        bench.board.joints_mut().0.states[1] = JointState::Good;
        bench.run(1);
        assert!(
            !bench
                .board
                .last_contact()
                .expect("one")
                .flags
                .intersects(ContactFlags::JOINT_INVALID)
        );
    }
    assert_eq!(bench.board.statistics(0, 0).joint_errors, 8);
    // Two joints at once are one line; one that goes on being bad is not told again.
    for _ in 0..3 {
        bench.board.joints_mut().0.states =
            [JointState::BadCheck, JointState::Good, JointState::BadCheck];
        bench.run(1);
    }
    bench.board.joints_mut().0.states[2] = JointState::Missing;
    bench.run(1);
    let told = [
        "joint 1: no answer",
        "all joint angles good again",
        "joint 1: wrong check bits",
        "all joint angles good again",
        "joints 0 2: wrong check bits",
        "joint 2: no answer",
    ];
    let lines = bench.logs();
    assert_eq!(lines[lines.len() - told.len()..], told);
}

#[test]
fn a_chip_reset_is_counted_and_told() {
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().resets = 2;
    bench.run(2);
    assert_eq!(bench.board.statistics(0, 0).chip_resets, 2);
    assert_eq!(
        bench
            .logs()
            .iter()
            .filter(|line| line.starts_with("converter reset"))
            .count(),
        1
    );
}

#[test]
fn skipped_and_uneven_periods_are_counted() {
    let mut bench = Bench::<RamStore>::ready();
    bench.run(400);
    let (steady, _) = bench.statistics();
    assert_eq!(
        (
            steady.rate_millihertz,
            steady.jitter_rms_us,
            steady.overruns,
            steady.tick_max_us
        ),
        (200_000, 0, 0, 100)
    );
    bench.now_us += 3 * PERIOD_US;
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .contains(ContactFlags::LATE_SAMPLE)
    );
    let (late, _) = bench.statistics();
    assert_eq!((late.overruns, late.late_ticks), (3, 1));
    assert!(
        bench
            .logs()
            .iter()
            .any(|line| line == "3 periods without a sample")
    );
    // 300 us early and late by turns: 600 us from period to period.
    for step in 0..600 {
        bench.now_us += PERIOD_US;
        bench.board.tick(if step % 2 == 0 {
            bench.now_us - 300
        } else {
            bench.now_us + 300
        });
    }
    bench.now_us += PERIOD_US;
    let (uneven, _) = bench.statistics();
    assert_eq!(
        (uneven.jitter_rms_us, uneven.jitter_max_us, uneven.overruns),
        (600, 600, 3)
    );
}

#[test]
fn wrong_configurations_are_refused() {
    let tip = TipGeometry {
        semi_axes_mm: [20.0; 3],
        centre_offset_mm: [0.0; 3],
    };
    let sound = BoardConfig::new([0; 12], 0, "a name far too long for sixteen bytes", tip);
    assert_eq!(sound.finger_name.as_str(), "a name far too l");
    let make = |config: BoardConfig| {
        let gauges = Gauges {
            counts: [0; MAX_GAUGES],
            flags: [GaugeFlags::none(); MAX_GAUGES],
            age_us: 0,
            resets: 0,
            noise: 0,
        };
        Board::new(
            config,
            gauges,
            Joints(JointSample::default()),
            RamStore::new(),
            0,
        )
        .err()
    };
    assert_eq!(make(sound.clone()), None);
    assert_eq!(
        make(BoardConfig {
            period_us: 0,
            ..sound.clone()
        }),
        Some(BoardError::Period)
    );
    let flat = TipGeometry {
        semi_axes_mm: [20.0, 0.0, 20.0],
        ..tip
    };
    assert_eq!(
        make(BoardConfig { tip: flat, ..sound }),
        Some(BoardError::Tip)
    );
}
