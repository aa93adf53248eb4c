//! The AMT21's driver.

use crate::amt21::EncoderFault;
use crate::rig::{PERIOD_US, Rig};
use palpus_firmware::front_end::JointState;
use palpus_firmware::front_end::amt21::{Counters, QUIET_PERIODS};

/// Whether the angles from this sample on are all good and of the period before.
fn all_fresh(rig: &Rig, from: usize) -> bool {
    let fresh = rig
        .angles
        .iter()
        .enumerate()
        .skip(from)
        .all(|(number, sample)| sample.time_us == (number as u64 - 1) * PERIOD_US);
    fresh && rig.bad_joints(from) == [0; 3]
}

#[test]
fn three_angles_are_read_in_every_period() {
    let mut rig = Rig::new();
    rig.run(400);
    assert!(all_fresh(&rig, 1));
    assert_eq!(rig.bus.counters(), Counters::default());
}

#[test]
fn three_questions_and_answers_take_a_fifth_of_a_period() {
    let mut rig = Rig::running();
    // Three times three bytes and a turn round, and a beat to spare.
    rig.run_to(rig.now_us + 3 * (3 * 87 + 17) + 100);
    rig.lines[3].cut();
    rig.run(2);
    assert!(all_fresh(&rig, 1));
}

#[test]
fn wrong_check_bits_once_are_asked_for_again() {
    let mut rig = Rig::running();
    rig.encoders[1].fault = EncoderFault::BadCheckBits;
    // The first answer of encoder 1 has passed by then, the second not.
    rig.run_to(rig.now_us + 278 + 300);
    rig.encoders[1].fault = EncoderFault::None;
    rig.run(3);
    assert!(all_fresh(&rig, 1));
    assert_eq!(rig.bus.counters().check_errors, 1);
}

#[test]
fn wrong_check_bits_are_told_for_their_joint_and_pass() {
    let mut rig = Rig::running();
    rig.encoders[1].fault = EncoderFault::BadCheckBits;
    let samples = rig.angles.len() + 1;
    rig.run(30);
    for sample in &rig.angles[samples..] {
        assert_eq!(
            sample.states,
            [JointState::Good, JointState::BadCheck, JointState::Good]
        );
    }
    assert_eq!(rig.bad_joints(1), [0, 29, 0]);
    rig.encoders[1].fault = EncoderFault::None;
    let samples = rig.angles.len() + 1;
    rig.run(30);
    assert!(all_fresh(&rig, samples));
}

#[test]
fn a_silent_encoder_is_missing_and_the_others_are_still_read() {
    for joint in 0..3 {
        let mut rig = Rig::running();
        rig.encoders[joint].fault = EncoderFault::Silent;
        let samples = rig.angles.len() + 1;
        rig.run(100);
        let bad = rig.bad_joints(1);
        for other in 0..3 {
            assert_eq!(bad[other] > 90, other == joint, "joint {joint}: {bad:?}");
            // Angles of the others go on: read in every fifth period.
            let angles: Vec<f32> = rig.angles[samples..]
                .iter()
                .map(|sample| sample.angles_rad[other])
                .collect();
            let changes = angles.windows(2).filter(|pair| pair[0] != pair[1]).count();
            let rounds = 99 / (usize::from(QUIET_PERIODS) + 1);
            if other == joint {
                assert_eq!(changes, 0);
            } else {
                assert!(
                    changes >= rounds - 1,
                    "joint {other} beside {joint}: {changes}"
                );
            }
        }
        rig.encoders[joint].fault = EncoderFault::None;
        let samples = rig.angles.len() + usize::from(QUIET_PERIODS) + 2;
        rig.run(30);
        assert!(all_fresh(&rig, samples), "joint {joint}");
    }
}

#[test]
fn a_bus_that_is_held_low_gives_no_angle() {
    let mut rig = Rig::running();
    let samples = rig.angles.len() + 1;
    for encoder in &mut rig.encoders {
        encoder.fault = EncoderFault::Silent;
    }
    for _ in 0..400 {
        rig.lines[3].answer(&[0, 0], rig.now_us);
        rig.run_to(rig.now_us + 250);
    }
    // Nothing is taken for an angle; what was known grows old or is bad.
    for (number, sample) in rig.angles.iter().enumerate().skip(samples) {
        let fresh = sample.time_us == (number as u64 - 1) * PERIOD_US;
        assert!(
            !(fresh && sample.states == [JointState::Good; 3]),
            "sample {number}"
        );
    }
    rig.bad_joints(1);
    rig.lines[3].cut();
    for encoder in &mut rig.encoders {
        encoder.fault = EncoderFault::None;
    }
    let samples = rig.angles.len() + usize::from(QUIET_PERIODS) + 2;
    rig.run(30);
    assert!(all_fresh(&rig, samples));
}

#[test]
fn bytes_too_many_never_become_an_angle() {
    // Two of these three pass for an answer by their check bits.
    for bytes in [&[0x3f_u8][..], &[0xab, 0x61], &[0x00, 0xc0], &[0xff; 5]] {
        for phase_us in (0..PERIOD_US).step_by(29) {
            let mut rig = Rig::running();
            rig.run_to(rig.now_us + phase_us);
            rig.lines[3].answer(bytes, rig.now_us);
            rig.run(20);
            rig.bad_joints(1);
            let samples = rig.angles.len() - 9;
            assert!(all_fresh(&rig, samples), "{phase_us} {bytes:x?}");
        }
    }
}

#[test]
fn bytes_that_are_lost_are_missed_and_pass() {
    for phase_us in (0..PERIOD_US).step_by(29) {
        let mut rig = Rig::running();
        rig.run_to(rig.now_us + phase_us);
        rig.lines[3].cut();
        rig.run(20);
        rig.bad_joints(1);
        let samples = rig.angles.len() - 9;
        assert!(all_fresh(&rig, samples), "{phase_us}");
    }
}
