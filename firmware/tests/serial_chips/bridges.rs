//! The ADS122U04's driver.

use crate::ads122u04::{ChipFault, Input};
use crate::rig::{PERIOD_US, Rig};
use palpus_firmware::front_end::GaugeFrontEnd;
use palpus_firmware::front_end::ads122u04::Counters;
use palpus_protocol::GaugeFlags;
use proptest::prelude::*;

#[test]
fn six_gauges_are_set_up_in_one_period_and_read_in_every_other() {
    let mut rig = Rig::new();
    rig.run(400);
    // The first sample finds nothing, the second a chip that was being set up; the third holds the second period.
    assert_eq!(rig.bad(1), [1; 6]);
    assert_eq!(rig.bad(2), [0; 6]);
    assert_eq!(rig.bridges.counters(), [Counters::default(); 3]);
    assert_eq!(rig.bridges.chip_resets(), 0);
    for chip in &rig.converters {
        assert_eq!((chip.resets_seen, chip.conversions), (1, 2 * 399));
    }
    // A sample's time is in the middle of what it measured: two conversions, 1.0 ms and 2.6 ms after the period's start.
    for (number, sample) in rig.samples.iter().enumerate().skip(2) {
        let age_us = number as u64 * PERIOD_US - sample.time_us;
        assert!((3_000..4_000).contains(&age_us), "{age_us}");
    }
}

#[test]
fn conversions_up_to_a_third_longer_are_read_at_the_first_question() {
    // The chip's clock is good to 2 %.
    for per_cent in [0, 2, 30] {
        let mut rig = Rig::running();
        for chip in &mut rig.converters {
            chip.fault = ChipFault::Slow(per_cent);
        }
        rig.run(50);
        assert_eq!(rig.bad(5), [0; 6], "{per_cent} %");
        assert_eq!(rig.bridges.counters(), [Counters::default(); 3]);
    }
}

#[test]
fn slower_conversions_are_asked_for_again_and_what_is_too_late_is_late() {
    let mut rig = Rig::running();
    for chip in &mut rig.converters {
        chip.fault = ChipFault::Slow(50);
    }
    let samples = rig.samples.len() + 1;
    rig.run(50);
    // Time for one more question: the first channel has its result, where no register is read before; the second has none in time.
    let bad = rig.bad(samples);
    assert!(
        [bad[0], bad[2], bad[4]].iter().all(|&bad| bad <= 17),
        "{bad:?}"
    );
    for sample in &rig.samples[samples..] {
        assert!(sample.flags[1] == GaugeFlags::LATE && sample.flags[3] == GaugeFlags::LATE);
    }
    assert_eq!(rig.bridges.chip_resets(), 0);
    for counters in rig.bridges.counters() {
        assert!(counters.not_ready >= 16, "{counters:?}");
    }
}

#[test]
fn a_reset_at_any_moment_is_found_counted_and_mended_within_four_periods() {
    for phase_us in (0..PERIOD_US).step_by(41) {
        let mut rig = Rig::running();
        rig.run_to(rig.now_us + phase_us);
        rig.converters[1].power_on();
        rig.run(8);
        let bad = rig.bad(5);
        assert!(
            bad[2] + bad[3] > 0 && bad[2] <= 4 && bad[3] <= 4,
            "{phase_us}: {bad:?}"
        );
        assert_eq!([bad[0], bad[1], bad[4], bad[5]], [0; 4], "{phase_us}");
        assert_eq!(rig.bridges.chip_resets(), 1, "{phase_us}");
        let samples = rig.samples.len();
        rig.run(50);
        assert_eq!(rig.bad(samples), [0; 6], "{phase_us}");
    }
}

#[test]
fn a_register_that_changes_is_found_by_reading_it_back() {
    // Data rate, turbo mode, and reference; check sums and counter; current sources; gain and inputs, between two conversions.
    for (register, bits) in [
        (1, 0x20),
        (1, 0x10),
        (1, 0x06),
        (2, 0x20),
        (2, 0x40),
        (3, 0x40),
        (0, 0x0e),
    ] {
        let mut rig = Rig::running();
        rig.run_to(rig.now_us + 4_800);
        rig.converters[0].upset(register, bits);
        rig.run(12);
        let bad = rig.bad(5);
        if register == 0 {
            // Written anew before every conversion.
            assert_eq!((bad, rig.bridges.chip_resets()), ([0; 6], 0));
            continue;
        }
        assert_eq!(
            rig.bridges.chip_resets(),
            1,
            "register {register} ^ {bits:#x}"
        );
        assert!(
            bad[0] > 0 && bad[0] <= 7,
            "register {register} ^ {bits:#x}: {bad:?}"
        );
        assert_eq!(bad[2..], [0; 4]);
        let samples = rig.samples.len();
        rig.run(20);
        assert_eq!(rig.bad(samples), [0; 6]);
    }
}

#[test]
fn damaged_answers_are_asked_for_again_and_never_taken() {
    for every in [2, 3, 5, 7] {
        let mut rig = Rig::running();
        rig.converters[2].fault = ChipFault::BadBits(every);
        rig.run(200);
        let bad = rig.bad(5);
        assert!(rig.converters[2].damaged > 50);
        assert_eq!(bad[..4], [0; 4]);
        if every >= 3 {
            // One of two answers in a row is right.
            assert_eq!(bad, [0; 6], "every {every}");
        }
        // The last one may still be on its way.
        let counters = rig.bridges.counters()[2];
        assert!(
            counters.check_errors + counters.strays >= rig.converters[2].damaged - 1,
            "{counters:?}"
        );
        rig.converters[2].fault = ChipFault::BadBits(1);
        let samples = rig.samples.len() + 1;
        rig.run(20);
        assert_eq!(rig.bad(samples)[4..], [19; 2]);
        rig.converters[2].fault = ChipFault::None;
        rig.run(4);
        let samples = rig.samples.len();
        rig.run(20);
        assert_eq!(rig.bad(samples), [0; 6]);
    }
}

#[test]
fn a_missing_chip_is_late_then_missing_and_comes_back() {
    for phase_us in (0..PERIOD_US).step_by(373) {
        let mut rig = Rig::running();
        rig.run_to(rig.now_us + phase_us);
        rig.converters[0].fault = ChipFault::Silent;
        rig.lines[0].cut();
        let samples = rig.samples.len();
        rig.run(30);
        let flags: Vec<GaugeFlags> = rig.samples[samples + 1..]
            .iter()
            .map(|sample| sample.flags[0])
            .collect();
        assert!(flags[..4].iter().all(|flags| !flags.is_good()));
        assert!(
            flags[4..]
                .iter()
                .all(|flags| flags.contains(GaugeFlags::MISSING)),
            "{phase_us}: {flags:?}"
        );
        // The others go on.
        assert_eq!(rig.bad(5)[2..], [0; 4]);
        // A reset is tried in every period, and answered by nobody.
        assert!(rig.bridges.counters()[0].timeouts >= 25);
        rig.converters[0].fault = ChipFault::None;
        rig.converters[0].power_on();
        let samples = rig.samples.len() + 3;
        rig.run(20);
        assert_eq!(rig.bad(samples), [0; 6], "{phase_us}");
    }
}

#[test]
fn a_chip_that_was_never_there_is_missing_and_the_others_are_read() {
    let mut rig = Rig::new();
    rig.converters[1].fault = ChipFault::Silent;
    rig.run(50);
    assert!(
        rig.samples
            .iter()
            .all(|sample| sample.flags[2..4] == [GaugeFlags::MISSING; 2])
    );
    let bad = rig.bad(2);
    assert_eq!([bad[0], bad[1], bad[4], bad[5]], [0; 4]);
}

#[test]
fn conversions_that_stand_still_are_late_and_end_in_a_reset() {
    let mut rig = Rig::running();
    let resets_seen = rig.converters[1].resets_seen;
    rig.converters[1].fault = ChipFault::Stalled;
    let samples = rig.samples.len() + 1;
    rig.run(20);
    assert!(
        rig.samples[samples..]
            .iter()
            .all(|sample| !sample.flags[2].is_good() && !sample.flags[3].is_good())
    );
    assert!(rig.converters[1].resets_seen > resets_seen && rig.bridges.chip_resets() > 0);
    assert_eq!(rig.bad(5)[4..], [0; 2]);
    rig.converters[1].fault = ChipFault::None;
    let samples = rig.samples.len() + 4;
    rig.run(20);
    assert_eq!(rig.bad(samples), [0; 6]);
}

#[test]
fn a_saturated_gauge_is_told_from_an_open_one_and_its_neighbour_is_not_disturbed() {
    let open = GaugeFlags::OPEN.union(GaugeFlags::SATURATED);
    for gauge in [2, 3] {
        for (input, flags) in [
            (Input::Volts(30e-3), GaugeFlags::SATURATED),
            (Input::Volts(-30e-3), GaugeFlags::SATURATED),
            (Input::Open, open),
        ] {
            let mut rig = Rig::running();
            rig.instead[gauge] = Some(input);
            let samples = rig.samples.len() + 1;
            rig.run(60);
            // Known in the first sample, and which of the two in the second.
            assert!(rig.samples[samples].flags[gauge].contains(GaugeFlags::SATURATED));
            for sample in &rig.samples[samples + 1..] {
                assert_eq!(sample.flags[gauge], flags, "gauge {gauge}, {input:?}");
            }
            rig.instead[gauge] = None;
            let samples = rig.samples.len() + 2;
            rig.run(30);
            assert_eq!(rig.bad(samples), [0; 6]);
            let mut others = rig.bad(5);
            others[gauge] = 0;
            assert_eq!(others, [0; 6], "gauge {gauge}, {input:?}");
            assert_eq!(rig.bridges.counters(), [Counters::default(); 3]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Bytes of noise and lost bytes on the lines, at any time: no count is ever taken that was not measured, and five periods later all
    /// is well.
    #[test]
    fn noise_on_the_lines_passes(
        events in proptest::collection::vec((1_u64..3_000, 0_usize..3, proptest::option::of(any::<u8>())), 1..40)
    ) {
        let mut rig = Rig::running();
        for (pause_us, chip, noise) in events {
            rig.run_to(rig.now_us + pause_us);
            match noise {
                Some(byte) => rig.lines[chip].answer(&[byte], rig.now_us),
                None => rig.lines[chip].cut(),
            }
        }
        rig.run(6);
        rig.bad(5);
        let samples = rig.samples.len();
        rig.run(10);
        prop_assert_eq!(rig.bad(samples), [0; 6]);
    }
}
