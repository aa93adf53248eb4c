//! Force and moment from tared gauge counts.

use super::Vec3;
use super::uncertainty::WrenchNoise;
use palpus_protocol::{Calibration, CalibrationError, MAX_GAUGES, WRENCH_AXES};

/// A force and a moment about some origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// Force, N.
    pub force_n: Vec3,
    /// Moment about the origin, N mm.
    pub moment_n_mm: Vec3,
}

impl Wrench {
    /// The same load with its moment about `centre_mm` (given from the old origin): m0 = m - d x f.
    #[must_use]
    pub fn about(&self, centre_mm: &Vec3) -> Self {
        Self {
            force_n: self.force_n,
            moment_n_mm: self.moment_n_mm - centre_mm.cross(&self.force_n),
        }
    }
}

/// Calibration matrix, unpacked for use.
#[derive(Clone, Debug, PartialEq)]
pub struct GaugeMatrix {
    /// Rows Fx, Fy, Fz (N per count), Mx, My, Mz (N mm per count); columns beyond the gauges are
    /// zero.
    rows: [[f32; MAX_GAUGES]; WRENCH_AXES],
}

impl GaugeMatrix {
    /// The matrix of a calibration for `gauges` gauges, once it has been checked.
    pub fn new(calibration: &Calibration, gauges: usize) -> Result<Self, CalibrationError> {
        calibration.check()?;
        if usize::from(calibration.gauges) != gauges {
            return Err(CalibrationError::Shape);
        }
        let mut rows = [[0.0; MAX_GAUGES]; WRENCH_AXES];
        for (row, values) in rows.iter_mut().zip(calibration.matrix.chunks(gauges)) {
            for (entry, value) in row.iter_mut().zip(values) {
                *entry = *value;
            }
        }
        Ok(Self { rows })
    }

    /// The wrench at the sensor's origin; counts of gauges that are not there must be zero.
    pub fn wrench(&self, tared_counts: &[f32; MAX_GAUGES]) -> Wrench {
        let axis = |row: usize| {
            let mut sum = 0.0;
            for gauge in 0..MAX_GAUGES {
                sum += self.rows[row][gauge] * tared_counts[gauge];
            }
            sum
        };
        Wrench {
            force_n: Vec3::new(axis(0), axis(1), axis(2)),
            moment_n_mm: Vec3::new(axis(3), axis(4), axis(5)),
        }
    }

    /// Standard deviation per axis, as (force in N, moment in N mm), that independent noise of the
    /// gauges (counts) makes.
    pub fn noise(&self, noise_counts: &[f32; MAX_GAUGES]) -> (f32, f32) {
        let mean_of = |rows: core::ops::Range<usize>| {
            let mut sum = 0.0;
            for row in rows {
                for gauge in 0..MAX_GAUGES {
                    let part = self.rows[row][gauge] * noise_counts[gauge];
                    sum += part * part;
                }
            }
            libm::sqrtf(sum / 3.0)
        };
        (mean_of(0..3), mean_of(3..6))
    }
}

impl GaugeMatrix {
    /// For each gauge the counts that alone would make the wrench's noise: the smaller of force's
    /// and moment's share; at most 1e6, which is also the answer for a gauge that moves nothing.
    pub fn counts_of(&self, noise: &WrenchNoise) -> [f32; MAX_GAUGES] {
        let mut counts = [0.0; MAX_GAUGES];
        for (gauge, count) in counts.iter_mut().enumerate() {
            let length = |rows: core::ops::Range<usize>| {
                libm::sqrtf(
                    rows.map(|row| self.rows[row][gauge] * self.rows[row][gauge])
                        .sum::<f32>(),
                )
            };
            // Division by zero is infinite, and `min` keeps the finite one.
            *count = (noise.force_n / length(0..3))
                .min(noise.moment_n_mm / length(3..6))
                .min(1e6);
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(gauges: u8, entries: &[f32]) -> GaugeMatrix {
        let calibration = Calibration::sealed(1, gauges, entries).expect("sound");
        GaugeMatrix::new(&calibration, usize::from(gauges)).expect("fits")
    }

    #[test]
    fn rows_are_axes_and_columns_are_gauges() {
        let entries: [f32; 12] = core::array::from_fn(|i| i as f32);
        let wrench = matrix(2, &entries).wrench(&[10.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(wrench.force_n, Vec3::new(1.0, 23.0, 45.0));
        assert_eq!(wrench.moment_n_mm, Vec3::new(67.0, 89.0, 111.0));
    }

    #[test]
    fn a_calibration_for_other_gauges_is_refused() {
        let calibration = Calibration::sealed(1, 2, &[0.0; 12]).expect("sound");
        assert_eq!(
            GaugeMatrix::new(&calibration, 6),
            Err(CalibrationError::Shape)
        );
        let broken = Calibration {
            crc: calibration.crc ^ 1,
            ..calibration
        };
        assert_eq!(GaugeMatrix::new(&broken, 2), Err(CalibrationError::Crc));
    }

    #[test]
    fn a_force_through_the_new_origin_has_no_moment_about_it() {
        let centre = Vec3::new(1.0, -2.0, 35.0);
        let force = Vec3::new(0.3, 0.4, -2.0);
        let wrench = Wrench {
            force_n: force,
            moment_n_mm: centre.cross(&force),
        };
        assert!(wrench.about(&centre).moment_n_mm.norm() < 1e-5);
    }

    #[test]
    fn counts_of_noise_take_the_more_sensitive_axis() {
        let mut entries = [0.0; 12];
        entries[0] = 1e-3;
        entries[6] = 0.1;
        let counts = matrix(2, &entries).counts_of(&WrenchNoise {
            force_n: 0.01,
            moment_n_mm: 0.3,
        });
        assert!((counts[0] - 3.0).abs() < 1e-5 && counts[1] == 1e6);
    }

    #[test]
    fn gauge_noise_adds_in_squares() {
        let mut entries = [0.0; 12];
        entries[0] = 3.0;
        entries[1] = 4.0;
        entries[6] = 2.0;
        let (force, moment) = matrix(2, &entries).noise(&[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((force - 5.0 / 3f32.sqrt()).abs() < 1e-6);
        assert!((moment - 2.0 / 3f32.sqrt()).abs() < 1e-6);
    }
}
