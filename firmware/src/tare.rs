//! The zero of every gauge: taken on command, followed while nothing is touched.
//!
//! Drift of the zero is the largest error of such a sensor: 50 mN of bias cost 5 mm at 0.5 N. So a
//! tare is taken over many periods, is refused when the readings have not settled, and is then
//! followed, slowly, whenever the tip has been free for a while. How far it has gone since is in
//! the statistics.
//!
//! Following is limited in rate, not only filtered: a light touch that grows slower than the limit
//! would otherwise be taken for drift. The limit is a fifth of the noise a second (3 mN/s at 15 mN
//! of noise), ten times a bad warm-up drift and a hundredth of the slowest approach of a finger.

use heapless::Vec;
use palpus_protocol::{MAX_GAUGES, Refusal, TareRequest, Tared};

/// Most periods a tare may average over.
pub const MAX_TARE_SAMPLES: u16 = 2000;
/// Rounds of averaging before a tare that does not settle is given up: creep after a release dies
/// away within seconds.
const ROUNDS: u8 = 3;
/// The tip must be free this long before the zero is followed, us: what the gauges need to recover
/// from a load.
const FREE_BEFORE_FOLLOWING_US: u32 = 250_000;
/// Time constant of following, s.
const FOLLOW_TIME_S: f32 = 5.0;
/// Largest rate of following, in standard deviations of the gauge's noise per second.
const FOLLOW_RATE_PER_S: f32 = 0.2;
/// Drift beyond this many standard deviations is remarked upon.
const DRIFT_REMARK: f32 = 10.0;

/// What came of a period of taring.
#[derive(Clone, Debug, PartialEq)]
pub enum TareProgress {
    /// No tare is being taken.
    Idle,
    /// More periods are needed.
    Running,
    /// The zero is new.
    Done(Tared),
    /// The zero is what it was.
    Failed(Refusal),
}

/// A tare being taken.
#[derive(Clone, Debug)]
struct Round {
    request: TareRequest,
    gauges: usize,
    round: u8,
    periods: u32,
    taken: u16,
    bad: [u32; MAX_GAUGES],
    /// First reading of the round; sums are of the differences to it, exact in integers (24-bit
    /// counts, 2000 periods).
    reference: [i32; MAX_GAUGES],
    first_half: [i64; MAX_GAUGES],
    sum: [i64; MAX_GAUGES],
    squares: [i64; MAX_GAUGES],
}

impl Round {
    const fn new(request: TareRequest, gauges: usize) -> Self {
        Self {
            request,
            gauges,
            round: 1,
            periods: 0,
            taken: 0,
            bad: [0; MAX_GAUGES],
            reference: [0; MAX_GAUGES],
            first_half: [0; MAX_GAUGES],
            sum: [0; MAX_GAUGES],
            squares: [0; MAX_GAUGES],
        }
    }

    fn add(&mut self, counts: &[i32; MAX_GAUGES]) {
        if self.taken == 0 {
            self.reference = *counts;
        }
        for gauge in 0..self.gauges {
            // Counts of more than 24 bits would overflow the squares; no bridge converter has them,
            // and saturating keeps the arithmetic whole.
            let limit = 1 << 25;
            let difference =
                (i64::from(counts[gauge]) - i64::from(self.reference[gauge])).clamp(-limit, limit);
            if self.taken < self.request.samples / 2 {
                self.first_half[gauge] += difference;
            }
            self.sum[gauge] += difference;
            self.squares[gauge] += difference * difference;
        }
        self.taken += 1;
    }

    /// Mean (as difference to the reference) and standard deviation, counts.
    fn mean_and_noise(&self, gauge: usize) -> (f32, f32) {
        let n = f64::from(self.taken);
        let mean = self.sum[gauge] as f64 / n;
        let variance = (self.squares[gauge] as f64 / n - mean * mean).max(0.0);
        (mean as f32, libm::sqrt(variance) as f32)
    }

    /// Whether the halves of the round agree.
    ///
    /// With noise alone their difference is 2 / sqrt(n) standard deviations; a steady slope makes
    /// it 1.7 and a step in the middle 2, whatever their size. The limit lies between, three and
    /// more deviations above chance; with fewer than 32 readings the two can't be told apart.
    fn has_settled(&self) -> bool {
        let n = f32::from(self.taken);
        let half = f32::from(self.request.samples / 2);
        if self.taken < 32 {
            return true;
        }
        (0..self.gauges).all(|gauge| {
            let (_, noise) = self.mean_and_noise(gauge);
            let first = self.first_half[gauge] as f32 / half;
            let second = (self.sum[gauge] - self.first_half[gauge]) as f32 / (n - half);
            (first - second).abs() <= noise * (0.75 + 6.0 / libm::sqrtf(n)) + 2.0
        })
    }
}

/// Zero of all gauges.
#[derive(Clone, Debug)]
pub struct Tare {
    gauges: usize,
    period_us: u32,
    taken: bool,
    /// Offset is `base + fine`: the base holds the 24 bits, so that small steps are not lost in
    /// `f32`.
    base: [i32; MAX_GAUGES],
    fine: [f32; MAX_GAUGES],
    fine_when_taken: [f32; MAX_GAUGES],
    noise: [f32; MAX_GAUGES],
    noise_floor: [f32; MAX_GAUGES],
    free_for_us: u32,
    round: Option<Round>,
}

impl Tare {
    /// No tare taken: the zero is at count 0.
    pub const fn new(gauges: usize, period_us: u32) -> Self {
        Self {
            gauges: if gauges > MAX_GAUGES {
                MAX_GAUGES
            } else {
                gauges
            },
            period_us,
            taken: false,
            base: [0; MAX_GAUGES],
            fine: [0.0; MAX_GAUGES],
            fine_when_taken: [0.0; MAX_GAUGES],
            noise: [0.0; MAX_GAUGES],
            noise_floor: [1.0; MAX_GAUGES],
            free_for_us: 0,
            round: None,
        }
    }

    /// Noise of each gauge below which it is taken to be this large, counts: what the expected
    /// noise of the wrench comes to.
    pub fn set_noise_floor(&mut self, floor_counts: &[f32; MAX_GAUGES]) {
        self.noise_floor = floor_counts.map(|floor| floor.max(1.0));
    }

    /// Whether a tare has been taken.
    pub const fn is_taken(&self) -> bool {
        self.taken
    }

    /// Whether one is being taken.
    pub const fn is_running(&self) -> bool {
        self.round.is_some()
    }

    /// Standard deviation of each gauge when the tare was taken, counts; zeros before.
    pub const fn noise_counts(&self) -> &[f32; MAX_GAUGES] {
        &self.noise
    }

    /// Counts less the zero. Entries beyond the gauges are 0.
    pub fn apply(&self, counts: &[i32; MAX_GAUGES]) -> [f32; MAX_GAUGES] {
        let mut tared = [0.0; MAX_GAUGES];
        for gauge in 0..self.gauges {
            tared[gauge] =
                (i64::from(counts[gauge]) - i64::from(self.base[gauge])) as f32 - self.fine[gauge];
        }
        tared
    }

    /// Zero of a gauge, counts.
    pub fn offset_counts(&self, gauge: usize) -> i32 {
        let (Some(base), Some(fine)) = (self.base.get(gauge), self.fine.get(gauge)) else {
            return 0;
        };
        base.saturating_add(libm::roundf(*fine) as i32)
    }

    /// How far the zero of a gauge has been followed since it was taken, counts.
    pub fn drift_counts(&self, gauge: usize) -> f32 {
        match (self.fine.get(gauge), self.fine_when_taken.get(gauge)) {
            (Some(fine), Some(taken)) => fine - taken,
            _ => 0.0,
        }
    }

    /// Whether a gauge has drifted enough to say so.
    pub fn has_drifted(&self) -> bool {
        (0..self.gauges)
            .any(|gauge| self.drift_counts(gauge).abs() > DRIFT_REMARK * self.gauge_noise(gauge))
    }

    fn gauge_noise(&self, gauge: usize) -> f32 {
        self.noise[gauge].max(self.noise_floor[gauge])
    }

    /// Begins to take a tare; the caller has judged whether the tip is free.
    pub fn begin(&mut self, request: TareRequest) -> Result<(), Refusal> {
        if self.round.is_some() {
            Err(Refusal::Busy)
        } else if request.samples == 0 || request.samples > MAX_TARE_SAMPLES {
            Err(Refusal::SampleCount)
        } else {
            self.round = Some(Round::new(request, self.gauges));
            Ok(())
        }
    }

    /// Takes one period's counts; `good` says which gauges may be used. A period with a bad gauge
    /// is left out.
    pub fn advance(
        &mut self,
        counts: &[i32; MAX_GAUGES],
        good: &[bool; MAX_GAUGES],
    ) -> TareProgress {
        let Some(round) = &mut self.round else {
            return TareProgress::Idle;
        };
        round.periods += 1;
        let mut all_good = true;
        for gauge in 0..round.gauges {
            if !good[gauge] {
                all_good = false;
                round.bad[gauge] += 1;
            }
        }
        if all_good {
            round.add(counts);
        } else if round.periods > 2 * u32::from(round.request.samples) + 10 {
            // More than every other period was bad: name the worst gauge.
            let worst = (0..round.gauges)
                .max_by_key(|&gauge| round.bad[gauge])
                .unwrap_or(0);
            self.round = None;
            return TareProgress::Failed(Refusal::GaugeFaulty(worst as u8));
        }
        if round.taken < round.request.samples {
            return TareProgress::Running;
        }
        if !round.request.force && !round.has_settled() {
            if round.round < ROUNDS {
                *round = Round {
                    round: round.round + 1,
                    ..Round::new(round.request, round.gauges)
                };
                return TareProgress::Running;
            }
            self.round = None;
            return TareProgress::Failed(Refusal::Unsettled);
        }
        self.finish()
    }

    fn finish(&mut self) -> TareProgress {
        let Some(round) = self.round.take() else {
            return TareProgress::Idle;
        };
        let mut offset_counts = Vec::new();
        let mut noise_counts = Vec::new();
        for gauge in 0..self.gauges {
            let (mean, noise) = round.mean_and_noise(gauge);
            let whole = libm::floorf(mean);
            self.base[gauge] = round.reference[gauge].saturating_add(whole as i32);
            self.fine[gauge] = mean - whole;
            self.fine_when_taken[gauge] = self.fine[gauge];
            self.noise[gauge] = noise;
            // Both hold MAX_GAUGES, and there are no more gauges than that.
            let _ = offset_counts.push(self.offset_counts(gauge));
            let _ = noise_counts.push(noise);
        }
        self.taken = true;
        self.free_for_us = 0;
        TareProgress::Done(Tared {
            samples: round.taken,
            offset_counts,
            noise_counts,
        })
    }

    /// Follows the zero for one period if the tip has been free for a while; `free` is whether it
    /// is now, with all gauges good.
    pub fn follow(&mut self, tared: &[f32; MAX_GAUGES], free: bool) {
        if !free || !self.taken || self.round.is_some() {
            self.free_for_us = 0;
            return;
        }
        self.free_for_us = self.free_for_us.saturating_add(self.period_us);
        if self.free_for_us < FREE_BEFORE_FOLLOWING_US {
            return;
        }
        let period_s = self.period_us as f32 * 1e-6;
        for gauge in 0..self.gauges {
            let largest = FOLLOW_RATE_PER_S * period_s * self.gauge_noise(gauge);
            self.fine[gauge] +=
                (tared[gauge] * (period_s / FOLLOW_TIME_S)).clamp(-largest, largest);
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    const GOOD: [bool; MAX_GAUGES] = [true; MAX_GAUGES];

    fn counts(values: [i32; 2]) -> [i32; MAX_GAUGES] {
        let mut counts = [0; MAX_GAUGES];
        counts[..2].copy_from_slice(&values);
        counts
    }

    /// Deterministic noise, uniform in +-300.
    fn noise(state: &mut u64) -> i32 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*state >> 33) as i32 % 601 - 300
    }

    fn request(samples: u16, force: bool) -> TareRequest {
        TareRequest { samples, force }
    }

    /// Runs a tare over what `reading` gives for each period; returns its end and the number of
    /// periods.
    fn run(
        tare: &mut Tare,
        request: TareRequest,
        mut reading: impl FnMut(u32) -> [i32; 2],
    ) -> (TareProgress, u32) {
        tare.begin(request).expect("accepted");
        let mut period = 0;
        loop {
            let progress = tare.advance(&counts(reading(period)), &GOOD);
            period += 1;
            if progress != TareProgress::Running {
                return (progress, period);
            }
        }
    }

    #[test]
    fn the_mean_becomes_zero_and_the_noise_is_known() {
        let mut tare = Tare::new(2, 5000);
        let mut state = 3;
        let (progress, periods) = run(&mut tare, request(200, false), |_| {
            [4_000_000 + noise(&mut state), -70_000]
        });
        let TareProgress::Done(tared) = progress else {
            panic!("{progress:?}")
        };
        assert_eq!((periods, tared.samples), (200, 200));
        // Uniform in +-300: 173 counts of standard deviation, 12 of the mean.
        assert!(
            (tared.offset_counts[0] - 4_000_000).abs() < 40 && tared.offset_counts[1] == -70_000
        );
        assert!((tared.noise_counts[0] - 173.0).abs() < 20.0 && tared.noise_counts[1] == 0.0);
        let zero = tare.apply(&counts([4_000_000, -70_000]));
        assert!(zero[0].abs() < 40.0 && zero[1] == 0.0 && zero[2] == 0.0);
        assert!(tare.is_taken() && !tare.is_running());
    }

    #[test]
    fn readings_that_settle_later_are_waited_for() {
        let mut tare = Tare::new(2, 5000);
        let mut state = 5;
        // Creep of 20 000 counts dying away over the first round.
        let (progress, periods) = run(&mut tare, request(200, false), |period| {
            let creep = 20_000.0 * (-f64::from(period) / 40.0).exp();
            [creep as i32 + noise(&mut state), 0]
        });
        let TareProgress::Done(tared) = progress else {
            panic!("{progress:?}")
        };
        assert_eq!(periods, 400);
        assert!(tared.offset_counts[0].abs() < 120);
    }

    #[test]
    fn readings_that_never_settle_are_refused_unless_forced() {
        let mut state = 7;
        let mut slope = |period: u32| [period as i32 * 20 + noise(&mut state), 0];
        let mut tare = Tare::new(2, 5000);
        assert_eq!(
            run(&mut tare, request(200, false), &mut slope),
            (TareProgress::Failed(Refusal::Unsettled), 600)
        );
        assert!(!tare.is_taken());
        assert!(matches!(
            run(&mut tare, request(200, true), &mut slope).0,
            TareProgress::Done(_)
        ));
    }

    #[test]
    fn chance_does_not_refuse_a_tare() {
        let mut state = 11;
        for samples in [1, 2, 31, 32, 50, 200, 2000] {
            for _ in 0..20 {
                let mut tare = Tare::new(2, 5000);
                let (progress, periods) = run(&mut tare, request(samples, false), |_| {
                    [noise(&mut state), noise(&mut state)]
                });
                assert!(matches!(progress, TareProgress::Done(_)));
                assert_eq!(periods, u32::from(samples));
            }
        }
    }

    #[test]
    fn wrong_requests_and_a_second_one_are_refused() {
        let mut tare = Tare::new(2, 5000);
        assert_eq!(tare.begin(request(0, true)), Err(Refusal::SampleCount));
        assert_eq!(tare.begin(request(2001, true)), Err(Refusal::SampleCount));
        assert_eq!(tare.begin(request(10, false)), Ok(()));
        assert_eq!(tare.begin(request(10, false)), Err(Refusal::Busy));
    }

    #[test]
    fn a_faulty_gauge_is_named() {
        let mut tare = Tare::new(2, 5000);
        tare.begin(request(10, true)).expect("accepted");
        let mut good = GOOD;
        good[1] = false;
        for _ in 0..30 {
            assert_eq!(tare.advance(&counts([0, 0]), &good), TareProgress::Running);
        }
        assert_eq!(
            tare.advance(&counts([0, 0]), &good),
            TareProgress::Failed(Refusal::GaugeFaulty(1))
        );
        assert_eq!(tare.advance(&counts([0, 0]), &good), TareProgress::Idle);
    }

    /// A tare at 0 with a noise of 300 counts, then `seconds` of a reading; returns the zero.
    fn follow(seconds: f32, reading: impl Fn(f32) -> i32, free: bool) -> f32 {
        let mut tare = Tare::new(1, 5000);
        let mut period = 0;
        tare.begin(request(200, true)).expect("accepted");
        while tare.is_running() {
            period += 1;
            tare.advance(
                &counts([if period % 2 == 0 { 300 } else { -300 }, 0]),
                &GOOD,
            );
        }
        for step in 0..(seconds * 200.0) as u32 {
            let tared = tare.apply(&counts([reading(step as f32 / 200.0), 0]));
            tare.follow(&tared, free);
        }
        tare.drift_counts(0)
    }

    #[test]
    fn slow_drift_is_followed_while_free_and_only_then() {
        // 30 counts a second, a tenth of the noise: followed with a lag of rate x time constant.
        let drift = |t: f32| (30.0 * t) as i32;
        assert!((follow(60.0, drift, true) - (1800.0 - 150.0)).abs() < 15.0);
        assert_eq!(follow(60.0, drift, false), 0.0);
    }

    #[test]
    fn following_waits_until_the_tip_has_been_free_for_a_while() {
        let mut tare = Tare::new(1, 5000);
        assert!(matches!(
            run(&mut tare, request(1, true), |_| [0, 0]).0,
            TareProgress::Done(_)
        ));
        let tared = [100.0; MAX_GAUGES];
        // 50 periods are the quarter of a second; a touch in between starts the wait anew.
        for _ in 0..2 {
            for _ in 0..49 {
                tare.follow(&tared, true);
            }
            tare.follow(&tared, false);
        }
        for _ in 0..49 {
            tare.follow(&tared, true);
        }
        assert_eq!(tare.drift_counts(0), 0.0);
        tare.follow(&tared, true);
        assert!(tare.drift_counts(0) > 0.0);
    }

    #[test]
    fn a_slow_touch_is_not_swallowed() {
        // 10 sigma within 5 s, slower than any finger approaches: less than 1 sigma is followed.
        let touch = |t: f32| (600.0 * t) as i32;
        assert!(follow(5.0, touch, true) <= 301.0);
    }

    #[test]
    fn extreme_counts_do_not_overflow() {
        let mut tare = Tare::new(1, 5000);
        tare.begin(request(2000, true)).expect("accepted");
        let mut flip = false;
        while tare.is_running() {
            flip = !flip;
            tare.advance(&counts([if flip { i32::MIN } else { i32::MAX }, 0]), &GOOD);
        }
        assert!(tare.apply(&counts([i32::MAX, 0]))[0].is_finite());
    }
}
