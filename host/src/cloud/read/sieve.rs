//! Which rows become points: the one place that judges a row, whatever file it came from.

use super::ReadError;
use crate::Vec3;
use crate::cloud::{Cloud, OrientedPoint, RejectedRow};

/// Largest magnitude of a coordinate that is taken for a length. Beyond it, products of three differences
/// of coordinates leave the range of `f64`.
pub const LARGEST: f64 = 1e100;

/// One row as found in a file.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Row {
    /// Position.
    pub position: [f64; 3],
    /// Normal of any length.
    pub normal: [f64; 3],
    /// Standard deviation of the position.
    pub sigma: Option<f64>,
    /// Finger number.
    pub finger: Option<f64>,
    /// Microseconds since the Unix epoch.
    pub time_us: Option<f64>,
}

/// Collects the usable rows of one file.
pub(super) struct Sieve<'a> {
    file: &'a str,
    cloud: Cloud,
}

impl<'a> Sieve<'a> {
    /// Nothing yet.
    pub fn new(file: &'a str) -> Self {
        Self {
            file,
            cloud: Cloud::default(),
        }
    }

    /// Takes the row that stands in the given line or record (from 1), or notes why not.
    pub fn put(&mut self, line: usize, row: &Row) {
        match judge(row) {
            Ok(point) => self.cloud.points.push(point),
            Err(reason) => {
                let file = self.file.to_owned();
                self.cloud.rejected.push(RejectedRow { file, line, reason });
            }
        }
    }

    /// The points, unless there are none or most rows are unusable.
    pub fn finish(self) -> Result<Cloud, ReadError> {
        let (good, bad) = (self.cloud.points.len(), self.cloud.rejected.len());
        match self.cloud.rejected.first() {
            Some(first) if bad > good => Err(ReadError::MostlyBad {
                file: self.file.to_owned(),
                bad,
                rows: bad + good,
                line: first.line,
                reason: first.reason.clone(),
            }),
            _ if good == 0 => Err(ReadError::NoPoints {
                file: self.file.to_owned(),
            }),
            _ => Ok(self.cloud),
        }
    }
}

fn judge(row: &Row) -> Result<OrientedPoint, String> {
    for (values, names) in [
        (row.position, ["x", "y", "z"]),
        (row.normal, ["nx", "ny", "nz"]),
    ] {
        for (value, name) in values.iter().zip(names) {
            if value.is_nan() {
                return Err(format!("{name} is NaN"));
            }
            if value.is_infinite() {
                return Err(format!("{name} is {value}"));
            }
            if value.abs() > LARGEST {
                return Err(format!("{name} is {value:e}, beyond {LARGEST:e}"));
            }
        }
    }
    // Scaled by the largest component first, so that tiny normals keep their direction.
    let normal = Vec3::from(row.normal);
    let scale = normal.amax();
    if scale == 0.0 {
        return Err("normal is 0 0 0".to_owned());
    }
    let unit = (normal / scale).normalize();
    if !unit.iter().all(|c| c.is_finite()) {
        let [x, y, z] = row.normal;
        return Err(format!(
            "normal is {x:e} {y:e} {z:e}, too short for a direction"
        ));
    }
    let whole = |value: Option<f64>| value.filter(|v| v.fract() == 0.0);
    Ok(OrientedPoint {
        position: Vec3::from(row.position),
        normal: unit,
        sigma: row.sigma.filter(|s| s.is_finite() && *s > 0.0),
        finger: whole(row.finger)
            .filter(|v| (0.0..=f64::from(u16::MAX)).contains(v))
            .map(|v| v as u16),
        // Whole f64 below 2^53 are exact.
        time_us: whole(row.time_us)
            .filter(|v| v.abs() < 9e15)
            .map(|v| v as i64),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(position: [f64; 3], normal: [f64; 3]) -> Row {
        Row {
            position,
            normal,
            ..Row::default()
        }
    }

    #[test]
    fn bad_rows_are_named() {
        let up = [0.0, 0.0, 1.0];
        let cases = [
            (row([f64::NAN, 0.0, 0.0], up), "x is NaN"),
            (row([0.0, f64::INFINITY, 0.0], up), "y is inf"),
            (row([0.0, 0.0, -1e200], up), "z is -1e200"),
            (row([0.0; 3], [0.0, f64::NAN, 1.0]), "ny is NaN"),
            (row([0.0; 3], [0.0; 3]), "normal is 0 0 0"),
        ];
        for (row, part) in cases {
            let reason = judge(&row).unwrap_err();
            assert!(reason.contains(part), "{reason}");
        }
    }

    #[test]
    fn normals_of_any_length_become_unit() {
        for scale in [1e-320, 1e-200, 1.0, 1e90] {
            let point = judge(&row([0.0; 3], [scale, 0.0, -scale])).unwrap();
            assert!((point.normal.norm() - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn half_bad_is_taken_and_more_is_refused() {
        let good = row([0.0; 3], [0.0, 0.0, 1.0]);
        let bad = row([0.0; 3], [0.0; 3]);
        let mut sieve = Sieve::new("f.xyz");
        sieve.put(1, &good);
        sieve.put(2, &bad);
        let cloud = sieve.finish().unwrap();
        assert_eq!((cloud.points.len(), cloud.rejected[0].line), (1, 2));
        let mut sieve = Sieve::new("f.xyz");
        sieve.put(1, &good);
        sieve.put(4, &bad);
        sieve.put(7, &bad);
        let error = sieve.finish().unwrap_err().to_string();
        assert_eq!(
            error,
            "f.xyz: 2 of 3 rows are unusable, first line 4: normal is 0 0 0; \
             export the file again with valid points and normals"
        );
    }

    #[test]
    fn doubtful_extras_count_as_unknown() {
        let mut given = row([0.0; 3], [0.0, 0.0, 1.0]);
        given.sigma = Some(-1.0);
        given.finger = Some(70000.0);
        given.time_us = Some(1.5);
        let point = judge(&given).unwrap();
        assert_eq!(
            (point.sigma, point.finger, point.time_us),
            (None, None, None)
        );
        given.sigma = Some(0.1);
        given.finger = Some(2.0);
        given.time_us = Some(1.7e15);
        let point = judge(&given).unwrap();
        assert_eq!(point.sigma, Some(0.1));
        assert_eq!(
            (point.finger, point.time_us),
            (Some(2), Some(1_700_000_000_000_000))
        );
    }
}
