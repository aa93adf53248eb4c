//! Householder factorisation of tall, narrow, possibly rank-deficient matrices, kept in the compact form
//! Q = I - V T V^T (Schreiber and Van Loan 1989) so that Q can be applied to large matrices by products.

use faer::{Accum, Mat, MatMut, Par, linalg::matmul::matmul, reborrow::*};

use pulp::{Arch, NullaryFnOnce};

use super::dense::Dense;

/// Columns whose remainder is smaller than this against the largest column are taken as dependent.
const RANK_TOLERANCE: f64 = 1e-10;
/// Columns that are worked on at once where only the lower triangle is wanted.
const PANEL: usize = 64;

/// `A P = Q R` with column pivoting, cut at the numerical rank.
pub(super) struct Orthogonal {
    /// Reflector directions, one per column.
    v: Mat<f64>,
    /// Upper triangular factor of the compact form.
    t: Mat<f64>,
    /// Upper triangular factor, rank x columns.
    r: Mat<f64>,
    /// Column of the input behind each column of `r`.
    order: Vec<usize>,
}

impl Orthogonal {
    /// Factors `a`.
    pub(super) fn new(a: Mat<f64>) -> Self {
        Arch::new().dispatch(Factoring(a))
    }

    #[inline(always)]
    fn factored(mut a: Mat<f64>) -> Self {
        let (rows, columns) = (a.nrows(), a.ncols());
        let mut order: Vec<usize> = (0..columns).collect();
        let mut v = Mat::<f64>::zeros(rows, columns.min(rows));
        let mut beta = Vec::with_capacity(columns);
        let mut largest = 0.0_f64;
        for step in 0..columns.min(rows) {
            let norm = |j: usize| {
                let rest = &a.col_as_slice(j)[step..];
                dot(rest, rest)
            };
            let (mut pivot, mut best) = (step, norm(step));
            for j in step + 1..columns {
                let candidate = norm(j);
                if candidate > best {
                    (pivot, best) = (j, candidate);
                }
            }
            let length = best.sqrt();
            largest = largest.max(length);
            if length.is_nan() || length <= RANK_TOLERANCE * largest || length == 0.0 {
                break;
            }
            if pivot != step {
                order.swap(pivot, step);
                for i in 0..rows {
                    let other = a[(i, step)];
                    a[(i, step)] = a[(i, pivot)];
                    a[(i, pivot)] = other;
                }
            }
            let head = if a[(step, step)] >= 0.0 {
                -length
            } else {
                length
            };
            let direction = &mut v.col_as_slice_mut(step)[step..];
            direction.copy_from_slice(&a.col_as_slice(step)[step..]);
            direction[0] -= head;
            let factor = 2.0 / dot(direction, direction);
            for j in step + 1..columns {
                let column = &mut a.col_as_slice_mut(j)[step..];
                let along = factor * dot(direction, column);
                for (x, d) in column.iter_mut().zip(&*direction) {
                    *x -= along * d;
                }
            }
            let column = &mut a.col_as_slice_mut(step)[step..];
            column.fill(0.0);
            column[0] = head;
            beta.push(factor);
        }
        let rank = beta.len();
        let v = v.subcols(0, rank).to_owned();
        let mut t = Mat::<f64>::zeros(rank, rank);
        for j in 0..rank {
            t[(j, j)] = beta[j];
            let dots: Vec<f64> = (0..j)
                .map(|k| dot(&v.col_as_slice(k)[j..], &v.col_as_slice(j)[j..]))
                .collect();
            for i in 0..j {
                let sum: f64 = (i..j).map(|k| t[(i, k)] * dots[k]).sum();
                t[(i, j)] = -beta[j] * sum;
            }
        }
        let r = a.submatrix(0, 0, rank, columns).to_owned();
        Self { v, t, r, order }
    }

    /// Number of independent columns.
    pub(super) fn rank(&self) -> usize {
        self.t.nrows()
    }

    /// `x <- Q^T x`.
    pub(super) fn apply_transposed(&self, x: &mut [f64]) {
        self.apply_with(x, true);
    }

    /// `x <- Q x`.
    pub(super) fn apply(&self, x: &mut [f64]) {
        self.apply_with(x, false);
    }

    fn apply_with(&self, x: &mut [f64], transposed: bool) {
        let rank = self.rank();
        let projected: Vec<f64> = (0..rank).map(|j| dot(self.v.col_as_slice(j), x)).collect();
        for j in 0..rank {
            let weight: f64 = (0..rank)
                .map(|k| {
                    projected[k]
                        * if transposed {
                            self.t[(k, j)]
                        } else {
                            self.t[(j, k)]
                        }
                })
                .sum();
            for (x, v) in x.iter_mut().zip(self.v.col_as_slice(j)) {
                *x -= weight * v;
            }
        }
    }

    /// `A <- Q^T A Q` for a symmetric `A` stored in full, of which only the lower triangle is right afterwards.
    pub(super) fn conjugate(&self, a: &mut Dense) {
        let (n, rank) = (a.rows(), self.rank());
        let mut av = Mat::<f64>::zeros(n, rank);
        product(av.as_mut(), Accum::Replace, a.view(), self.v.as_ref(), 1.0);
        // A - Y V^T - V Y^T + V (T^T V^T Y) V^T = A - X V^T - V X^T with X = Y - V T^T (V^T Y) / 2
        let mut left = Dense::unwritten(n, 2 * rank);
        let (mut x, mut v) = left.view_mut().split_at_col_mut(rank);
        v.copy_from(&self.v);
        product(
            x.rb_mut(),
            Accum::Replace,
            av.as_ref(),
            self.t.as_ref(),
            1.0,
        );
        let mut vy = Mat::<f64>::zeros(rank, rank);
        let mut s = Mat::<f64>::zeros(rank, rank);
        product(vy.as_mut(), Accum::Replace, self.v.transpose(), x.rb(), 1.0);
        product(
            s.as_mut(),
            Accum::Replace,
            self.t.transpose(),
            vy.as_ref(),
            1.0,
        );
        product(x.rb_mut(), Accum::Add, self.v.as_ref(), s.as_ref(), -0.5);
        let mut right = Dense::unwritten(n, 2 * rank);
        let (mut first, mut second) = right.view_mut().split_at_col_mut(rank);
        first.copy_from(&self.v);
        second.copy_from(x);
        // [X V] [V X]^T at once, below the diagonal in panels of columns.
        let (left, right) = (left.view(), right.view());
        let mut a = a.view_mut();
        for start in (0..n).step_by(PANEL) {
            let width = PANEL.min(n - start);
            product(
                a.rb_mut().submatrix_mut(start, start, n - start, width),
                Accum::Add,
                left.subrows(start, n - start),
                right.subrows(start, width).transpose(),
                -1.0,
            );
        }
    }

    /// `B <- [0 B] Q^T` for a `B` that lacks the first `rank` columns (they are zero).
    pub(super) fn complete_right(&self, b: &Mat<f64>) -> Mat<f64> {
        let (rows, rank) = (b.nrows(), self.rank());
        let n = rank + b.ncols();
        let mut full = Mat::<f64>::zeros(rows, n);
        full.as_mut().subcols_mut(rank, b.ncols()).copy_from(b);
        let lower = self.v.submatrix(rank, 0, n - rank, rank);
        let mut bv = Mat::<f64>::zeros(rows, rank);
        let mut bvt = Mat::<f64>::zeros(rows, rank);
        product(bv.as_mut(), Accum::Replace, b.as_ref(), lower, 1.0);
        product(
            bvt.as_mut(),
            Accum::Replace,
            bv.as_ref(),
            self.t.transpose(),
            1.0,
        );
        product(
            full.as_mut(),
            Accum::Add,
            bvt.as_ref(),
            self.v.transpose(),
            -1.0,
        );
        full
    }

    /// The `u` with `R^T u = row` (a row in the input's column order), dependent columns left out.
    pub(super) fn transposed_solve(&self, row: &[f64]) -> Vec<f64> {
        let mut u = vec![0.0; self.rank()];
        for i in 0..self.rank() {
            let known: f64 = (0..i).map(|j| self.r[(j, i)] * u[j]).sum();
            u[i] = (row[self.order[i]] - known) / self.r[(i, i)];
        }
        u
    }

    /// The coefficients c that minimise |R c - `top`|^2 + `ridge`^2 |c|^2, in the input's column order.
    pub(super) fn coefficients(&self, top: &[f64], ridge: f64) -> Vec<f64> {
        let (rank, columns) = (self.rank(), self.r.ncols());
        let mut stacked = Mat::<f64>::zeros(rank + columns, columns);
        stacked.as_mut().subrows_mut(0, rank).copy_from(&self.r);
        for i in 0..columns {
            stacked[(rank + i, i)] = ridge;
        }
        let factor = Self::new(stacked);
        let mut right = vec![0.0; rank + columns];
        right[..rank].copy_from_slice(&top[..rank]);
        factor.apply_transposed(&mut right);
        let mut c = vec![0.0; columns];
        for i in (0..factor.rank()).rev() {
            let known: f64 = (i + 1..factor.rank())
                .map(|j| factor.r[(i, j)] * c[self.order[factor.order[j]]])
                .sum();
            c[self.order[factor.order[i]]] = (right[i] - known) / factor.r[(i, i)];
        }
        c
    }
}

/// Inner product, summed in four lanes.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a4
        .remainder()
        .iter()
        .zip(b4.remainder())
        .map(|(x, y)| x * y)
        .sum();
    let mut lanes = [0.0; 4];
    for (x, y) in a4.zip(b4) {
        for l in 0..4 {
            lanes[l] += x[l] * y[l];
        }
    }
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3]) + rest
}

/// A matrix to be factored; made for each kind of processor.
struct Factoring(Mat<f64>);

impl NullaryFnOnce for Factoring {
    type Output = Orthogonal;

    #[inline(always)]
    fn call(self) -> Orthogonal {
        Orthogonal::factored(self.0)
    }
}

fn product(
    target: MatMut<'_, f64>,
    how: Accum,
    left: faer::MatRef<'_, f64>,
    right: faer::MatRef<'_, f64>,
    factor: f64,
) {
    matmul(target, how, left, right, factor, Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(rows: usize, columns: usize, dependent: bool) -> Mat<f64> {
        Mat::from_fn(rows, columns, |i, j| {
            let j = if dependent && j == columns - 1 { 0 } else { j };
            ((i * 7 + j * 13 + i * j * 5) as f64 * 0.37).sin()
        })
    }

    #[test]
    fn q_is_orthogonal_and_reproduces_the_columns() {
        for dependent in [false, true] {
            let a = sample(12, 4, dependent);
            let q = Orthogonal::new(a.clone());
            assert_eq!(q.rank(), if dependent { 3 } else { 4 });
            for j in 0..4 {
                let mut column: Vec<f64> = a.col(j).iter().copied().collect();
                let norm: f64 = column.iter().map(|x| x * x).sum();
                q.apply_transposed(&mut column);
                let rest: f64 = column[q.rank()..].iter().map(|x| x * x).sum();
                assert!(rest < 1e-24 * norm, "column {j}");
                q.apply(&mut column);
                for i in 0..12 {
                    assert!((column[i] - a[(i, j)]).abs() < 1e-13);
                }
            }
        }
    }

    #[test]
    fn conjugation_and_completion_agree_with_single_vectors() {
        const N: usize = 2 * PANEL + 9;
        let q = Orthogonal::new(sample(N, 3, false));
        let mut expected = Mat::from_fn(N, N, |i, j| {
            ((i + j) as f64).cos() + if i == j { 3.0 } else { 0.0 }
        });
        let mut conjugated = Dense::unwritten(N, N);
        conjugated.view_mut().copy_from(&expected);
        q.conjugate(&mut conjugated);
        for _ in 0..2 {
            for j in 0..N {
                let mut column: Vec<f64> = expected.col(j).iter().copied().collect();
                q.apply_transposed(&mut column);
                for i in 0..N {
                    expected[(i, j)] = column[i];
                }
            }
            expected = expected.transpose().to_owned();
        }
        for j in 0..N {
            for i in j..N {
                assert!((conjugated.column(j)[i] - expected[(i, j)]).abs() < 1e-12);
            }
        }
        let q = Orthogonal::new(sample(9, 3, false));
        let b = sample(5, 6, false);
        let completed = q.complete_right(&b);
        for i in 0..5 {
            let mut row = vec![0.0; 9];
            for j in 0..6 {
                row[3 + j] = b[(i, j)];
            }
            q.apply(&mut row);
            for j in 0..9 {
                assert!((completed[(i, j)] - row[j]).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn coefficients_solve_the_triangular_system_and_the_ridge_fixes_the_rest() {
        let a = sample(10, 4, false);
        let q = Orthogonal::new(a.clone());
        let wanted = [0.5, -1.0, 2.0, 0.25];
        let mut y: Vec<f64> = (0..10)
            .map(|i| (0..4).map(|j| a[(i, j)] * wanted[j]).sum())
            .collect();
        q.apply_transposed(&mut y);
        for (c, w) in q.coefficients(&y, 1e-9).iter().zip(wanted) {
            assert!((c - w).abs() < 1e-9);
        }
        let row: Vec<f64> = (0..4)
            .map(|t| {
                (0..4)
                    .map(|i| q.r[(i, q.order.iter().position(|&o| o == t).unwrap())] * wanted[i])
                    .sum()
            })
            .collect();
        for (u, w) in q.transposed_solve(&row).iter().zip(wanted) {
            assert!((u - w).abs() < 1e-12);
        }
        let q = Orthogonal::new(sample(10, 4, true));
        let mut y = vec![1.0; 10];
        q.apply_transposed(&mut y);
        assert!(q.coefficients(&y, 1e-3).iter().all(|c| c.is_finite()));
    }
}
