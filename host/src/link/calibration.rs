//! From known loads to a calibration matrix.
//!
//! A table of loads has a header and one row per load:
//!
//! ```text
//! fx,fy,fz,mx,my,mz,g1,g2,g3,g4,g5,g6
//! 0,0,5,0,0,0,1203,-411,87,-96,2104,38
//! ```
//!
//! Forces in N and moments in N mm at the sensor's origin, as the object pushes on the tip; `g1` and on are tared
//! gauge counts. Columns may stand in any order, other columns and lines that begin with `#` are skipped. Without
//! the `g` columns the table only names loads, to be put on one after the other.
//!
//! The matrix M minimises the sum of squares of `M g - load`, by singular values of the counts (columns scaled to
//! unit length). With more than six gauges only the six strongest directions are used, since six numbers can't tell
//! more apart. A set that can't determine the matrix is refused before, by the loads themselves: each of the six
//! axes has to be loaded, and in combinations that keep them apart ([`MIN_SPREAD`]).

use nalgebra::{DMatrix, DVector};
use palpus_protocol::{Calibration, CalibrationError, MAX_GAUGES, WRENCH_AXES};
use std::path::{Path, PathBuf};

/// Names of the axes, in the order of a wrench.
pub const AXES: [&str; WRENCH_AXES] = ["fx", "fy", "fz", "mx", "my", "mz"];
/// Units of the axes.
pub const UNITS: [&str; WRENCH_AXES] = ["N", "N", "N", "N mm", "N mm", "N mm"];
/// Least ratio of smallest to largest singular value of the loads, each axis scaled to unit length. Six loads
/// along the axes have 1; pushing only within 3 degrees of one line has 0.03 and multiplies noise by 30.
pub const MIN_SPREAD: f64 = 0.03;
/// Largest condition number of the gauge counts. A sensor's own is below 100; beyond this, gauges are missing or
/// wired twice.
pub const MAX_CONDITION: f64 = 1e4;

/// One known load.
#[derive(Clone, Debug, PartialEq)]
pub struct Load {
    /// Force, N, and moment, N mm, at the sensor's origin.
    pub wrench: [f64; WRENCH_AXES],
    /// Tared counts of each gauge; empty if still to be measured.
    pub counts: Vec<f64>,
}

/// Why no matrix comes of a set of loads.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// The file can't be read.
    #[error("can't read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A line is not as it should be.
    #[error("{path}, line {line}: {reason}")]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong, with the value.
        reason: String,
    },
    /// There are too few loads.
    #[error(
        "{loads} loads can't determine {gauges} gauges: measure at least {gauges}, better {better}, different loads"
    )]
    TooFew {
        /// Loads given.
        loads: usize,
        /// Gauges.
        gauges: usize,
        /// What would be good.
        better: usize,
    },
    /// There are too few or too many gauges.
    #[error("{gauges} gauges: six axes need 6 to {MAX_GAUGES}")]
    Gauges {
        /// Gauges given.
        gauges: usize,
    },
    /// A load or a count is infinite or not a number.
    #[error("load {load} holds a value that is not finite: measure it again")]
    NotFinite {
        /// Place of the load, from 1.
        load: usize,
    },
    /// An axis is never loaded.
    #[error("no load has any {axis}: add loads along it, both ways")]
    Unloaded {
        /// The axis.
        axis: &'static str,
    },
    /// The loads do not tell the axes apart.
    #[error(
        "the loads don't tell the axes apart (spread {spread:.4}, at least {MIN_SPREAD} is needed): {combination} never changes on its own; add loads that change it"
    )]
    Spread {
        /// Smallest over largest singular value.
        spread: f64,
        /// What the loads never change.
        combination: String,
    },
    /// The gauges do not tell the loads apart.
    #[error(
        "the gauges don't tell the loads apart (condition number {condition:.3e}, at most {MAX_CONDITION:e}): a gauge is missing, stuck or wired twice; see `palpus board PORT stats`"
    )]
    Condition {
        /// Largest over smallest singular value.
        condition: f64,
    },
    /// The result is not a usable calibration.
    #[error(transparent)]
    Unusable(#[from] CalibrationError),
}

/// A calibration with what is known of its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The calibration, sealed.
    pub calibration: Calibration,
    /// Root mean square of the residuals of each axis, N and N mm.
    pub residual_rms: [f64; WRENCH_AXES],
    /// Largest residual of each axis, N and N mm.
    pub residual_max: [f64; WRENCH_AXES],
    /// Largest load of each axis, N and N mm.
    pub load_max: [f64; WRENCH_AXES],
    /// Condition number of the gauge counts (columns scaled to unit length, six strongest directions).
    pub condition: f64,
    /// Spread of the loads, 1 at best, at least [`MIN_SPREAD`].
    pub spread: f64,
    /// Number of loads.
    pub loads: usize,
}

/// Reads a table of loads.
///
/// # Errors
/// [`CalibrateError::Read`], [`CalibrateError::Line`].
pub fn read_loads(path: &Path) -> Result<Vec<Load>, CalibrateError> {
    let text = std::fs::read_to_string(path).map_err(|source| CalibrateError::Read {
        path: path.into(),
        source,
    })?;
    parse_loads(&text, path)
}

/// Reads a table of loads from text; `path` serves messages.
///
/// # Errors
/// [`CalibrateError::Line`].
pub fn parse_loads(text: &str, path: &Path) -> Result<Vec<Load>, CalibrateError> {
    let wrong = |line: usize, reason: String| CalibrateError::Line {
        path: path.into(),
        line,
        reason,
    };
    let mut lines = text
        .lines()
        .zip(1..)
        .map(|(line, number)| (line.trim().trim_start_matches('\u{feff}'), number))
        .filter(|(line, _)| !line.is_empty() && !line.starts_with('#'));
    let (header, header_line) = lines.next().ok_or_else(|| {
        wrong(
            1,
            format!("no header; it should be `{},g1,g2,…`", AXES.join(",")),
        )
    })?;
    let names: Vec<String> = header
        .split(',')
        .map(|name| name.trim().to_ascii_lowercase())
        .collect();
    let column = |name: &str| names.iter().position(|n| n == name);
    let mut axes = [0; WRENCH_AXES];
    for (place, axis) in axes.iter_mut().zip(AXES) {
        *place = column(axis).ok_or_else(|| {
            wrong(
                header_line,
                format!("no column `{axis}` in the header `{header}`"),
            )
        })?;
    }
    let gauges: Vec<usize> = (1..).map_while(|k| column(&format!("g{k}"))).collect();
    let mut loads = Vec::new();
    for (line, number) in lines {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.len() != names.len() {
            let reason = format!("{} fields, the header has {}", fields.len(), names.len());
            return Err(wrong(number, reason));
        }
        let value = |place: usize| -> Result<f64, CalibrateError> {
            fields[place]
                .parse::<f64>()
                .ok()
                .filter(|v| v.is_finite())
                .ok_or_else(|| {
                    let reason = format!(
                        "`{}` in column `{}` is not a finite number",
                        fields[place], names[place]
                    );
                    wrong(number, reason)
                })
        };
        let mut wrench = [0.0; WRENCH_AXES];
        for (target, &place) in wrench.iter_mut().zip(&axes) {
            *target = value(place)?;
        }
        let counts = gauges
            .iter()
            .map(|&place| value(place))
            .collect::<Result<_, _>>()?;
        loads.push(Load { wrench, counts });
    }
    Ok(loads)
}

/// Estimates the matrix that turns counts into loads.
///
/// # Errors
/// [`CalibrateError`]: loads or gauges that can't determine it.
pub fn estimate(loads: &[Load], id: u32) -> Result<Estimate, CalibrateError> {
    let gauges = loads.first().map_or(0, |load| load.counts.len());
    if !(WRENCH_AXES..=MAX_GAUGES).contains(&gauges)
        || loads.iter().any(|load| load.counts.len() != gauges)
    {
        return Err(CalibrateError::Gauges { gauges });
    }
    let is_finite = |load: &Load| {
        load.wrench
            .iter()
            .chain(&load.counts)
            .all(|v| v.is_finite())
    };
    if let Some(place) = loads.iter().position(|load| !is_finite(load)) {
        return Err(CalibrateError::NotFinite { load: place + 1 });
    }
    if loads.len() < gauges {
        return Err(CalibrateError::TooFew {
            loads: loads.len(),
            gauges,
            better: 3 * gauges,
        });
    }
    let wrenches = DMatrix::from_fn(loads.len(), WRENCH_AXES, |row, axis| {
        loads[row].wrench[axis]
    });
    let counts = DMatrix::from_fn(loads.len(), gauges, |row, gauge| loads[row].counts[gauge]);
    let spread = check_loads(&wrenches)?;
    let (solution, condition) = least_squares(&counts, &wrenches)?;
    let matrix: Vec<f32> = (0..WRENCH_AXES)
        .flat_map(|axis| (0..gauges).map(move |gauge| (axis, gauge)))
        .map(|(axis, gauge)| solution[(gauge, axis)] as f32)
        .collect();
    let calibration = Calibration::sealed(id, gauges as u8, &matrix)?;
    let residuals = &counts * &solution - &wrenches;
    let per_axis = |measure: &dyn Fn(DVector<f64>) -> f64, of: &DMatrix<f64>| {
        let mut values = [0.0; WRENCH_AXES];
        for (axis, value) in values.iter_mut().enumerate() {
            *value = measure(of.column(axis).into_owned());
        }
        values
    };
    let rms = |column: DVector<f64>| (column.norm_squared() / column.len() as f64).sqrt();
    let largest = |column: DVector<f64>| column.amax();
    Ok(Estimate {
        calibration,
        residual_rms: per_axis(&rms, &residuals),
        residual_max: per_axis(&largest, &residuals),
        load_max: per_axis(&largest, &wrenches),
        condition,
        spread,
        loads: loads.len(),
    })
}

/// Each column divided by its length, and the lengths.
fn scaled(matrix: &DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let lengths: Vec<f64> = matrix.column_iter().map(|c| c.norm()).collect();
    let mut unit = matrix.clone();
    for (mut column, &length) in unit.column_iter_mut().zip(&lengths) {
        if length > 0.0 {
            column /= length;
        }
    }
    (unit, lengths)
}

/// Singular values in descending order with their right singular vectors.
fn right_singular(matrix: &DMatrix<f64>) -> Vec<(f64, DVector<f64>)> {
    // By the eigenvalues of the small Gram matrix: columns are scaled, so the squares do no harm down to 1e-8.
    let eigen = (matrix.transpose() * matrix).symmetric_eigen();
    let mut pairs: Vec<(f64, DVector<f64>)> = eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
        .map(|(&value, vector)| (value.max(0.0).sqrt(), vector.into_owned()))
        .collect();
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    pairs
}

fn check_loads(wrenches: &DMatrix<f64>) -> Result<f64, CalibrateError> {
    let (unit, lengths) = scaled(wrenches);
    if let Some(axis) = lengths.iter().position(|&length| length == 0.0) {
        return Err(CalibrateError::Unloaded { axis: AXES[axis] });
    }
    let singular = right_singular(&unit);
    let (largest, (smallest, direction)) = (singular[0].0, &singular[WRENCH_AXES - 1]);
    let spread = smallest / largest;
    if spread >= MIN_SPREAD {
        return Ok(spread);
    }
    // In the loads' own units, the strongest part as 1.
    let parts: Vec<f64> = (0..WRENCH_AXES)
        .map(|k| direction[k] / lengths[k])
        .collect();
    let strongest = (0..WRENCH_AXES)
        .max_by(|&a, &b| direction[a].abs().total_cmp(&direction[b].abs()))
        .unwrap_or(0);
    let combination: Vec<String> = (0..WRENCH_AXES)
        .filter(|&k| direction[k].abs() > 0.1)
        .map(|k| format!("{:+.3} {}", parts[k] / parts[strongest], AXES[k]))
        .collect();
    Err(CalibrateError::Spread {
        spread,
        combination: combination.join(" "),
    })
}

/// Minimises |counts X - wrenches|, with the six strongest directions of the counts; also their condition number.
fn least_squares(
    counts: &DMatrix<f64>,
    wrenches: &DMatrix<f64>,
) -> Result<(DMatrix<f64>, f64), CalibrateError> {
    let (unit, lengths) = scaled(counts);
    let singular = right_singular(&unit);
    let condition = singular[0].0 / singular[WRENCH_AXES - 1].0;
    if condition.is_nan() || condition > MAX_CONDITION || lengths.contains(&0.0) {
        return Err(CalibrateError::Condition { condition });
    }
    let right_side = unit.transpose() * wrenches;
    let mut solution = DMatrix::zeros(counts.ncols(), WRENCH_AXES);
    for (value, vector) in &singular[..WRENCH_AXES] {
        solution += vector * (vector.transpose() * &right_side) / (value * value);
    }
    for (gauge, &length) in lengths.iter().enumerate() {
        for axis in 0..WRENCH_AXES {
            solution[(gauge, axis)] /= length;
        }
    }
    Ok((solution, condition))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn path() -> &'static Path {
        Path::new("loads.csv")
    }

    /// Gauge counts per N and N mm of a sensor with crosstalk.
    fn sensor(gauges: usize, seed: u64) -> DMatrix<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        DMatrix::from_fn(gauges, WRENCH_AXES, |gauge, axis| {
            let scale = if axis < 3 { 20_000.0 } else { 1_000.0 };
            let own = if gauge % WRENCH_AXES == axis {
                1.0
            } else {
                0.0
            };
            scale * (own + rng.random_range(-0.2..0.2))
        })
    }

    fn loads(sensor: &DMatrix<f64>, count: usize, noise: f64, seed: u64) -> Vec<Load> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|_| {
                let mut wrench = [0.0; WRENCH_AXES];
                for (axis, value) in wrench.iter_mut().enumerate() {
                    let most = if axis < 3 { 10.0 } else { 200.0 };
                    *value = rng.random_range(-most..most);
                }
                let exact = sensor * DVector::from_row_slice(&wrench);
                let counts = exact
                    .iter()
                    .map(|c| c + noise * rng.random_range(-1.7..1.7))
                    .collect();
                Load { wrench, counts }
            })
            .collect()
    }

    #[test]
    fn exact_loads_give_the_inverse_of_the_sensor() {
        for gauges in [6, 8] {
            let sensor = sensor(gauges, 1);
            let estimate = estimate(&loads(&sensor, 30, 0.0, 2), 7).unwrap();
            assert_eq!(estimate.calibration.id, 7);
            let matrix = DMatrix::from_row_iterator(
                WRENCH_AXES,
                gauges,
                estimate.calibration.matrix.iter().map(|&v| f64::from(v)),
            );
            let identity = matrix * &sensor;
            for row in 0..WRENCH_AXES {
                for column in 0..WRENCH_AXES {
                    let expected = f64::from(u8::from(row == column));
                    let scale = if (row < 3) == (column < 3) { 1.0 } else { 20.0 };
                    assert!((identity[(row, column)] - expected).abs() < 1e-4 * scale);
                }
            }
            for axis in 0..WRENCH_AXES {
                assert!(estimate.residual_rms[axis] < 1e-6 * estimate.load_max[axis]);
            }
            assert!(estimate.spread > 0.3 && estimate.condition < 100.0);
        }
    }

    #[test]
    fn noise_shows_in_the_residuals_and_averages_out_of_the_matrix() {
        let sensor = sensor(6, 3);
        let estimate = estimate(&loads(&sensor, 400, 100.0, 4), 1).unwrap();
        // 100 counts of noise at about 20 000 counts per N: 5 mN.
        for axis in 0..3 {
            assert!((0.002..0.02).contains(&estimate.residual_rms[axis]));
        }
        let clean = loads(&sensor, 20, 0.0, 5);
        for load in &clean {
            for axis in 0..3 {
                let force: f64 = (0..6)
                    .map(|g| f64::from(estimate.calibration.matrix[axis * 6 + g]) * load.counts[g])
                    .sum();
                assert!((force - load.wrench[axis]).abs() < 0.005);
            }
        }
    }

    #[test]
    fn loads_that_determine_nothing_are_refused() {
        let sensor = sensor(6, 6);
        let all = loads(&sensor, 30, 10.0, 7);
        assert!(matches!(
            estimate(&all[..5], 1),
            Err(CalibrateError::TooFew { loads: 5, .. })
        ));
        let mut no_mz = all.clone();
        no_mz.iter_mut().for_each(|load| load.wrench[5] = 0.0);
        assert!(matches!(
            estimate(&no_mz, 1),
            Err(CalibrateError::Unloaded { axis: "mz" })
        ));
        // Pushed at one point only: the moments follow from the force.
        let mut one_point = all.clone();
        for load in &mut one_point {
            let [x, y, z, ..] = load.wrench;
            let arm = [3.0, -4.0, 35.0];
            load.wrench[3] = arm[1] * z - arm[2] * y;
            load.wrench[4] = arm[2] * x - arm[0] * z;
            load.wrench[5] = arm[0] * y - arm[1] * x;
            let exact = &sensor * DVector::from_row_slice(&load.wrench);
            load.counts = exact.iter().map(|c| c + 5.0).collect();
        }
        let refusal = estimate(&one_point, 1).unwrap_err().to_string();
        assert!(refusal.contains("never changes on its own"), "{refusal}");
        // A gauge wired twice.
        let mut twice = all.clone();
        twice
            .iter_mut()
            .for_each(|load| load.counts[3] = load.counts[2]);
        assert!(matches!(
            estimate(&twice, 1),
            Err(CalibrateError::Condition { .. })
        ));
        let mut broken = all.clone();
        broken[3].counts[1] = f64::NAN;
        assert!(matches!(
            estimate(&broken, 1),
            Err(CalibrateError::NotFinite { load: 4 })
        ));
        assert!(matches!(
            estimate(&[], 1),
            Err(CalibrateError::Gauges { gauges: 0 })
        ));
    }

    #[test]
    fn tables_are_read_and_what_is_wrong_is_named() {
        let text = "# bench of May\n FX,fy,fz,mx,my,mz,note,g1,g2\n1,2,3,4,5,6,x,-7,8.5\n\n";
        let loads = parse_loads(text, path()).unwrap();
        assert_eq!(loads.len(), 1);
        assert_eq!(loads[0].wrench, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(loads[0].counts, [-7.0, 8.5]);
        for (text, expected) in [
            ("", "no header"),
            ("fx,fy,fz,mx,my\n", "no column `mz`"),
            ("fx,fy,fz,mx,my,mz\n1,2,3,4,5\n", "line 2: 5 fields"),
            ("fx,fy,fz,mx,my,mz\n1,2,3,4,5,nan\n", "`nan` in column `mz`"),
            ("fx,fy,fz,mx,my,mz\n1,2,x,4,5,6\n", "`x` in column `fz`"),
        ] {
            let error = parse_loads(text, path()).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
