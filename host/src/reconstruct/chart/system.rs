//! The normal equations of a chart's fit: sparse, blocks of three coordinates per function.
//!
//! A datum sees the functions that reach its foot point, so the pattern follows the data; entries are added in the
//! order of the data on one thread, which keeps the result the same for any number of threads.

use crate::Vec3;
use faer::linalg::solvers::Solve;
use faer::prelude::*;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use nalgebra::Matrix3;

/// Why a chart's system could not be solved.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChartSystemError {
    /// The factorisation failed.
    #[error(
        "the equations of the chart could not be factored ({0}); use a coarser tolerance or a network (without --surface chart)"
    )]
    Factor(String),
    /// The solution is not finite.
    #[error("the chart has no finite solution; check the input for coinciding or far-off points")]
    NotFinite,
}

/// Weights of functions in a linear form.
pub(super) type Row = Vec<(u32, f64)>;

/// Sums of squares of linear residuals.
#[derive(Clone, Debug)]
pub(super) struct Normal {
    /// Lower triangle: per column the rows (>= column) in rising order, with symmetric blocks xx, xy, xz, yy, yz, zz.
    columns: Vec<Vec<(u32, [f64; 6])>>,
    right: Vec<Vec3>,
}

impl Normal {
    /// Empty sums over so many functions.
    pub fn new(functions: usize) -> Self {
        Self {
            columns: vec![Vec::new(); functions],
            right: vec![Vec3::zeros(); functions],
        }
    }

    fn block(&mut self, a: u32, b: u32) -> &mut [f64; 6] {
        let (column, row) = (a.min(b) as usize, a.max(b));
        let rows = &mut self.columns[column];
        let place = match rows.binary_search_by_key(&row, |r| r.0) {
            Ok(place) => place,
            Err(place) => {
                rows.insert(place, (row, [0.0; 6]));
                place
            }
        };
        &mut rows[place].1
    }

    /// Adds a quadratic form (lower triangle, row by row) on some functions, the same in each direction but for
    /// `metric`.
    pub fn add_form(&mut self, numbers: &[u32], form: &[f64], metric: &Matrix3<f64>) {
        let m = upper(metric);
        let mut slot = 0;
        for (place, a) in numbers.iter().enumerate() {
            for b in &numbers[..=place] {
                for (sum, value) in self.block(*a, *b).iter_mut().zip(m) {
                    *sum += form[slot] * value;
                }
                slot += 1;
            }
        }
    }

    /// Adds the square of `metric^(1/2) (sum of row * point - target)`.
    pub fn add(&mut self, row: &Row, metric: &Matrix3<f64>, target: &Vec3) {
        let m = upper(metric);
        for (place, (a, wa)) in row.iter().enumerate() {
            for (b, wb) in &row[..=place] {
                let product = wa * wb;
                for (sum, value) in self.block(*a, *b).iter_mut().zip(m) {
                    *sum += product * value;
                }
            }
        }
        let pulled = metric * target;
        for (a, weight) in row {
            self.right[*a as usize] += pulled * *weight;
        }
    }

    /// The minimum, with `tether` (relative to the mean diagonal) times the squared distance to `previous`.
    pub fn solve(mut self, tether: f64, previous: &[Vec3]) -> Result<Vec<Vec3>, ChartSystemError> {
        let count = self.columns.len();
        let mut mean = 0.0;
        for column in 0..count as u32 {
            let block = self.block(column, column);
            mean += block[0] + block[3] + block[5];
        }
        mean /= (3 * count).max(1) as f64;
        if !(mean > 0.0 && mean.is_finite()) {
            return Err(ChartSystemError::NotFinite);
        }
        let hold = tether * mean;
        for column in 0..count {
            let block = self.block(column as u32, column as u32);
            for k in [0, 3, 5] {
                block[k] += hold;
            }
            self.right[column] += previous[column] * hold;
        }
        const SLOT: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        let mut triplets = Vec::new();
        for (column, rows) in self.columns.iter().enumerate() {
            for (row, block) in rows {
                let row = *row as usize;
                for k in 0..3 {
                    let first = if row == column { k } else { 0 };
                    triplets.extend(
                        (first..3)
                            .map(|i| Triplet::new(3 * row + i, 3 * column + k, block[SLOT[i][k]])),
                    );
                }
            }
        }
        let failed = |e: String| ChartSystemError::Factor(e);
        let matrix = SparseColMat::try_new_from_triplets(3 * count, 3 * count, &triplets)
            .map_err(|e| failed(format!("{e:?}")))?;
        let symbolic = SymbolicLlt::try_new(matrix.symbolic(), faer::Side::Lower)
            .map_err(|e| failed(format!("{e:?}")))?;
        let factor = Llt::try_new_with_symbolic(symbolic, matrix.as_ref(), faer::Side::Lower)
            .map_err(|e| failed(format!("{e:?}")))?;
        let mut vector = Mat::from_fn(3 * count, 1, |row, _| self.right[row / 3][row % 3]);
        factor.solve_in_place(vector.as_mut());
        let points: Vec<Vec3> = (0..count)
            .map(|n| Vec3::from_fn(|k, _| vector[(3 * n + k, 0)]))
            .collect();
        if points.iter().all(|p| p.iter().all(|x| x.is_finite())) {
            Ok(points)
        } else {
            Err(ChartSystemError::NotFinite)
        }
    }
}

/// Entries xx, xy, xz, yy, yz, zz.
fn upper(m: &Matrix3<f64>) -> [f64; 6] {
    [
        m[(0, 0)],
        m[(0, 1)],
        m[(0, 2)],
        m[(1, 1)],
        m[(1, 2)],
        m[(2, 2)],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coupled_rows_give_the_least_squares_solution() {
        let mut sums = Normal::new(2);
        let skew = Matrix3::new(2.0, 0.5, 0.0, 0.5, 1.0, 0.1, 0.0, 0.1, 3.0);
        let wanted = [Vec3::new(1.0, 2.0, 3.0), Vec3::new(-1.0, 0.5, 0.25)];
        for (a, b) in [(1.0, 0.0), (0.3, 0.7), (0.5, -0.2)] {
            let target = wanted[0] * a + wanted[1] * b;
            sums.add(&vec![(0, a), (1, b)], &skew, &target);
        }
        let found = sums.solve(0.0, &[Vec3::zeros(); 2]).unwrap();
        for (found, wanted) in found.iter().zip(wanted) {
            assert!((found - wanted).norm() < 1e-12);
        }
    }
}
