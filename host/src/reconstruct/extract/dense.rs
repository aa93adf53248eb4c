//! Dense matrices of the local fits, column by column, in memory that each thread uses again for its next ones.
//!
//! Two ways were weighed: the linear algebra library's own matrices, which are filled number by number through a closure and whose
//! megabytes go back to the system and come back zeroed for every factorisation (a tenth of a whole
//! reconstruction), and these.

use std::cell::RefCell;

use faer::{MatMut, MatRef};

/// Columns start at multiples of so many numbers (a cache line).
const ALIGNED: usize = 8;
/// Most matrices' memory that a thread keeps: a fit holds so many at once.
const KEPT: usize = 4;

/// Whether numbers that are read before they are written are to be seen in what comes out.
const POISON: bool = cfg!(test);

thread_local! {
    static SPARE: RefCell<Vec<Vec<f64>>> = const { RefCell::new(Vec::new()) };
}

/// A dense matrix.
#[derive(Debug)]
pub(super) struct Dense {
    values: Vec<f64>,
    rows: usize,
    columns: usize,
}

impl Dense {
    /// A matrix of any numbers, to be written before it is read.
    pub(super) fn unwritten(rows: usize, columns: usize) -> Self {
        let mut values = SPARE
            .with_borrow_mut(|spare| spare.pop())
            .unwrap_or_default();
        values.resize(rows.next_multiple_of(ALIGNED) * columns, 0.0);
        if POISON {
            values.fill(f64::NAN);
        }
        Self {
            values,
            rows,
            columns,
        }
    }

    /// Numbers from the start of one column to that of the next.
    fn stride(&self) -> usize {
        self.rows.next_multiple_of(ALIGNED)
    }

    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    pub(super) fn column(&self, j: usize) -> &[f64] {
        &self.values[j * self.stride()..][..self.rows]
    }

    pub(super) fn column_mut(&mut self, j: usize) -> &mut [f64] {
        let start = j * self.stride();
        &mut self.values[start..][..self.rows]
    }

    pub(super) fn view(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice_with_stride(
            &self.values,
            self.rows,
            self.columns,
            self.stride(),
        )
    }

    pub(super) fn view_mut(&mut self) -> MatMut<'_, f64> {
        let (rows, columns, stride) = (self.rows, self.columns, self.stride());
        MatMut::from_column_major_slice_with_stride_mut(&mut self.values, rows, columns, stride)
    }
}

impl Drop for Dense {
    fn drop(&mut self) {
        let values = std::mem::take(&mut self.values);
        // A thread that ends has let go of its spare ones already.
        let _ = SPARE.try_with(|spare| {
            let mut spare = spare.borrow_mut();
            if spare.len() < KEPT {
                spare.push(values);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_those_of_the_view_also_in_memory_that_was_used_before() {
        drop(Dense::unwritten(20, 20));
        for (rows, columns) in [(9, 5), (16, 3), (30, 40)] {
            let mut dense = Dense::unwritten(rows, columns);
            for j in 0..columns {
                for (i, x) in dense.column_mut(j).iter_mut().enumerate() {
                    *x = (100 * i + j) as f64;
                }
            }
            assert_eq!(dense.rows(), rows);
            dense.view_mut()[(2, 1)] = -1.0;
            assert_eq!(dense.column(1)[2], -1.0);
            assert_eq!(
                dense.view()[(rows - 1, columns - 1)],
                (100 * (rows - 1) + columns - 1) as f64
            );
        }
    }
}
