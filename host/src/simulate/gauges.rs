//! The strain gauges of a fingertip's sensor: a wrench in, counts out, and the bench on which they were
//! calibrated.
//!
//! Six gauges, each answering mostly to one axis of the wrench and a little to the others (crosstalk). On top
//! come an offset (the reason for a tare), a drift, white noise, and rounding to the converter's counts. The
//! calibration matrix the board is given is estimated by least squares from known loads on these very gauges,
//! as on a real bench; without noise that is the inverse of the sensitivity.

use super::noise::normal_deviate;
use crate::Vec3;
use nalgebra::{Matrix6, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Gauges of a sensor.
pub(crate) const GAUGES: usize = 6;

/// Counts per newton: a 24-bit converter at gain 128 and 3.3 V resolves 3.07 nV; a bridge of 1 mV/V at 50 N gives
/// 66 uV per newton.
const COUNTS_PER_N: f64 = 21_500.0;
/// Counts per newton millimetre: the same bridge for 1 N m.
const COUNTS_PER_N_MM: f64 = 1_075.0;
/// Largest count of a 24-bit converter.
const FULL_SCALE: f64 = 8_388_607.0;
/// Loads on the calibration bench: enough that their noise averages to well below that of one reading.
const BENCH_LOADS: usize = 240;

/// What is wrong with real gauges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugeFaults {
    /// Standard deviation of each reading, counts.
    pub noise_counts: f64,
    /// Largest share of another axis that a gauge picks up.
    pub crosstalk: f64,
    /// Standard deviation of each gauge's offset, counts.
    pub offset_counts: f64,
    /// Standard deviation of the random walk of each offset after one minute, counts.
    pub drift_counts_per_root_minute: f64,
}

/// The gauges of one sensor.
#[derive(Clone, Debug)]
pub(crate) struct Gauges {
    sensitivity: Matrix6<f64>,
    calibration: Matrix6<f64>,
    offset: Vector6<f64>,
    faults: GaugeFaults,
    random: ChaCha8Rng,
}

/// What the gauges say, and which of them are at the end of their range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Reading {
    pub counts: [i32; GAUGES],
    pub saturated: [bool; GAUGES],
}

impl Gauges {
    /// Gauges made and calibrated from `seed`.
    pub(crate) fn new(faults: GaugeFaults, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let scale = Vector6::new(
            COUNTS_PER_N,
            COUNTS_PER_N,
            COUNTS_PER_N,
            COUNTS_PER_N_MM,
            COUNTS_PER_N_MM,
            COUNTS_PER_N_MM,
        );
        let mut sensitivity = Matrix6::zeros();
        for gauge in 0..GAUGES {
            for axis in 0..6 {
                let share = if gauge == axis {
                    1.0
                } else {
                    faults.crosstalk * random.random_range(-1.0..1.0)
                };
                // Crosstalk is a share of what the gauge makes of its own axis at full load on both: 50 N
                // and 1 N m load a gauge equally.
                sensitivity[(gauge, axis)] = share * scale[axis];
            }
        }
        let offset = Vector6::from_fn(|_, _| faults.offset_counts * normal_deviate(&mut random));
        let mut gauges = Self {
            sensitivity,
            calibration: Matrix6::zeros(),
            offset,
            faults,
            random,
        };
        gauges.calibration = gauges.bench();
        gauges
    }

    /// Estimates the calibration matrix (wrench per count) from readings under known loads.
    fn bench(&mut self) -> Matrix6<f64> {
        let (mut counts_squared, mut wrench_counts) = (Matrix6::zeros(), Matrix6::zeros());
        for _ in 0..BENCH_LOADS {
            // Loads up to 10 N and 200 N mm. The bench tares, and holds each load long enough to average
            // sixteen readings.
            let load = Vector6::from_fn(|axis, _| {
                let most = if axis < 3 { 10.0 } else { 200.0 };
                self.random.random_range(-most..most)
            });
            let noise = Vector6::from_fn(|_, _| {
                self.faults.noise_counts * 0.25 * normal_deviate(&mut self.random)
            });
            let counts = self.sensitivity * load + noise;
            counts_squared += counts * counts.transpose();
            wrench_counts += load * counts.transpose();
        }
        // Six axes of gauges that answer to six axes of loads: the normal matrix is regular unless crosstalk
        // makes two gauges alike.
        match counts_squared.try_inverse() {
            Some(inverse) => wrench_counts * inverse,
            None => Matrix6::zeros(),
        }
    }

    /// The calibration matrix, row by row: N and N mm per count.
    pub(crate) fn calibration(&self) -> Vec<f32> {
        self.calibration
            .transpose()
            .iter()
            .map(|&v| v as f32)
            .collect()
    }

    /// Reads the gauges under a wrench at the sensor (N, N mm); `elapsed_s` since the last reading.
    pub(crate) fn read(&mut self, force_n: &Vec3, moment_n_mm: &Vec3, elapsed_s: f64) -> Reading {
        let wrench = Vector6::new(
            force_n.x,
            force_n.y,
            force_n.z,
            moment_n_mm.x,
            moment_n_mm.y,
            moment_n_mm.z,
        );
        let walk = self.faults.drift_counts_per_root_minute * (elapsed_s / 60.0).sqrt();
        let loaded = self.sensitivity * wrench;
        let mut reading = Reading {
            counts: [0; GAUGES],
            saturated: [false; GAUGES],
        };
        for gauge in 0..GAUGES {
            self.offset[gauge] += walk * normal_deviate(&mut self.random);
            let noise = self.faults.noise_counts * normal_deviate(&mut self.random);
            let count = loaded[gauge] + self.offset[gauge] + noise;
            reading.saturated[gauge] = count.is_nan() || count.abs() >= FULL_SCALE;
            reading.counts[gauge] = count.clamp(-FULL_SCALE, FULL_SCALE).round() as i32;
        }
        reading
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERFECT: GaugeFaults = GaugeFaults {
        noise_counts: 0.0,
        crosstalk: 0.08,
        offset_counts: 0.0,
        drift_counts_per_root_minute: 0.0,
    };

    fn wrench(gauges: &Gauges, counts: [i32; GAUGES]) -> Vector6<f64> {
        let matrix = Matrix6::from_row_iterator(gauges.calibration().into_iter().map(f64::from));
        matrix * Vector6::from(counts.map(f64::from))
    }

    #[test]
    fn calibration_undoes_crosstalk() {
        let mut gauges = Gauges::new(PERFECT, 3);
        let (force, moment) = (Vec3::new(0.3, -1.0, 2.0), Vec3::new(40.0, 5.0, -1.0));
        let counts = gauges.read(&force, &moment, 0.0).counts;
        // The second gauge is not what its own axis alone would make of it.
        assert!((f64::from(counts[1]) + COUNTS_PER_N).abs() > 100.0);
        let got = wrench(&gauges, counts);
        let expected = Vector6::new(0.3, -1.0, 2.0, 40.0, 5.0, -1.0);
        for axis in 0..6 {
            // Half a count of each gauge, and f32.
            let step = if axis < 3 {
                1.0 / COUNTS_PER_N
            } else {
                1.0 / COUNTS_PER_N_MM
            };
            assert!(
                (got[axis] - expected[axis]).abs() < 1.5 * step,
                "axis {axis}: {got}"
            );
        }
    }

    #[test]
    fn noise_offset_and_drift_have_their_sizes() {
        let faults = GaugeFaults {
            noise_counts: 250.0,
            offset_counts: 1e5,
            drift_counts_per_root_minute: 80.0,
            ..PERFECT
        };
        let mut gauges = Gauges::new(faults, 1);
        let zero = Vec3::zeros();
        let n = 4000;
        let readings: Vec<[i32; GAUGES]> = (0..n)
            .map(|_| gauges.read(&zero, &zero, 0.0).counts)
            .collect();
        for gauge in 0..GAUGES {
            let mean = readings.iter().map(|r| f64::from(r[gauge])).sum::<f64>() / f64::from(n);
            let square = readings
                .iter()
                .map(|r| (f64::from(r[gauge]) - mean).powi(2))
                .sum::<f64>();
            assert!(((square / f64::from(n)).sqrt() - 250.0).abs() < 15.0);
            assert!(mean.abs() > 100.0, "an offset of exactly nothing");
        }
        // After 100 minutes in one-second steps each offset has walked by about 800 counts.
        let before = gauges.offset;
        for _ in 0..6000 {
            gauges.read(&zero, &zero, 1.0);
        }
        let walked = (gauges.offset - before).norm() / 6f64.sqrt();
        assert!((250.0..2000.0).contains(&walked), "{walked}");
    }

    #[test]
    fn an_overload_saturates_and_says_so() {
        let mut gauges = Gauges::new(PERFECT, 1);
        let reading = gauges.read(&Vec3::new(0.0, 0.0, 1e4), &Vec3::zeros(), 0.0);
        assert!(reading.saturated[2]);
        assert_eq!(f64::from(reading.counts[2]), FULL_SCALE);
    }
}
