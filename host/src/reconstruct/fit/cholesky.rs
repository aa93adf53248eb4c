//! Sparse Cholesky factors of one pattern, many values: ordering, symbolic factorisation and memory are made once.
//!
//! The unknowns come in blocks (the coordinates of a control point), all with the same neighbours. Two ways were
//! weighed: ordering the scalar pattern, or ordering the blocks and expanding. The second finds the same elimination
//! with a ninth of the entries, and is taken. Factor and scratch memory stay allocated between rounds: clearing fresh pages
//! for them had cost a sixth of the time of a reconstruction with 300 patches.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::prelude::*;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, Par, Side, Spec};

/// A symmetric positive definite matrix of fixed pattern, factored anew for each set of values.
pub struct Cholesky {
    pattern: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    scratch: MemBuffer,
}

/// Pattern of a symmetric matrix of square blocks: the rows (>= column) of column c stand in
/// `rows[starts[c] .. starts[c + 1]]` in ascending order, the diagonal first.
pub struct BlockPattern<'a> {
    /// Start of each column, and the end.
    pub starts: &'a [usize],
    /// Block rows.
    pub rows: &'a [u32],
    /// Rows and columns of each block.
    pub size: usize,
}

impl Cholesky {
    /// Orders and lays out; right-hand sides of [`Self::solve`] will have at most `right_sides` columns.
    ///
    /// # Errors
    /// When the memory does not suffice; the text is for people.
    pub fn new(blocks: &BlockPattern, right_sides: usize) -> Result<Self, String> {
        let failed = |e| format!("{e:?}");
        let count = blocks.starts.len() - 1;
        let of_blocks = SymbolicSparseColMat::new_checked(
            count,
            count,
            blocks.starts.to_vec(),
            None,
            blocks.rows.iter().map(|r| *r as usize).collect(),
        );
        let (mut forward, mut inverse) = (vec![0; count], vec![0; count]);
        let need = amd::order_maybe_unsorted_scratch::<usize>(count, blocks.rows.len());
        let mut scratch = MemBuffer::try_new(need).map_err(|_| "out of memory".to_owned())?;
        amd::order_maybe_unsorted(
            &mut forward,
            &mut inverse,
            of_blocks.as_ref(),
            amd::Control::default(),
            MemStack::new(&mut scratch),
        )
        .map_err(failed)?;
        let expand = |order: &[usize]| -> Vec<usize> {
            let each = order.iter();
            each.flat_map(|b| (0..blocks.size).map(move |k| blocks.size * b + k))
                .collect()
        };
        let (forward, inverse) = (expand(&forward), expand(&inverse));
        let pattern = blocks.scalar();
        let symbolic = factorize_symbolic_cholesky(
            pattern.as_ref(),
            Side::Lower,
            SymmetricOrdering::Custom(PermRef::new_checked(&forward, &inverse, forward.len())),
            CholeskySymbolicParams::default(),
        )
        .map_err(failed)?;
        let need = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default())
            .or(symbolic.solve_in_place_scratch::<f64>(right_sides, Par::Seq));
        Ok(Self {
            factor: vec![0.0; symbolic.len_val()],
            scratch: MemBuffer::try_new(need).map_err(|_| "out of memory".to_owned())?,
            pattern,
            symbolic,
        })
    }

    /// Start of each scalar column among the entries of the lower triangle.
    pub fn columns(&self) -> &[usize] {
        self.pattern.col_ptr()
    }

    /// Number of entries of the lower triangle.
    pub fn entries(&self) -> usize {
        self.pattern.row_idx().len()
    }

    /// Factors the matrix whose lower triangle has these `values`, column by column.
    ///
    /// # Errors
    /// When the matrix is not positive definite.
    pub fn factor(&mut self, values: &[f64]) -> Result<(), String> {
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(self.pattern.as_ref(), values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.scratch),
                Spec::default(),
            )
            .map(|_| ())
            .map_err(|e| format!("{e:?}"))
    }

    /// Replaces the right-hand sides by the solutions for the matrix factored last.
    pub fn solve(&mut self, right: &mut Mat<f64>) {
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            right.as_mut(),
            Par::Seq,
            MemStack::new(&mut self.scratch),
        );
    }
}

impl BlockPattern<'_> {
    /// The pattern of the scalar lower triangle.
    fn scalar(&self) -> SymbolicSparseColMat<usize> {
        let (count, size) = (self.starts.len() - 1, self.size);
        let mut columns = Vec::with_capacity(size * count + 1);
        let mut indices = Vec::with_capacity(size * size * self.rows.len());
        columns.push(0);
        for column in 0..count {
            for k in 0..size {
                for row in &self.rows[self.starts[column]..self.starts[column + 1]] {
                    let row = *row as usize;
                    let first = if row == column { k } else { 0 };
                    indices.extend((first..size).map(|i| size * row + i));
                }
                columns.push(indices.len());
            }
        }
        SymbolicSparseColMat::new_checked(size * count, size * count, columns, None, indices)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_satisfy_the_equations_for_each_set_of_values() {
        // Blocks 0-1-2 in a chain and 0-3, two by two.
        let blocks = BlockPattern {
            starts: &[0, 3, 5, 6, 7],
            rows: &[0, 1, 3, 1, 2, 2, 3],
            size: 2,
        };
        let mut cholesky = Cholesky::new(&blocks, 1).unwrap();
        assert_eq!(cholesky.entries(), 4 * 3 + 3 * 4);
        for shift in [4.0, 9.0] {
            let pattern = blocks.scalar();
            let mut dense = Mat::<f64>::zeros(8, 8);
            let mut values = Vec::new();
            for column in 0..8 {
                let range = pattern.col_ptr()[column]..pattern.col_ptr()[column + 1];
                for &row in &pattern.row_idx()[range] {
                    let value = if row == column {
                        shift
                    } else {
                        ((row * 5 + column) as f64).sin()
                    };
                    values.push(value);
                    dense[(row, column)] = value;
                    dense[(column, row)] = value;
                }
            }
            cholesky.factor(&values).unwrap();
            let right = Mat::from_fn(8, 1, |i, _| (i as f64).cos());
            let mut solution = right.clone();
            cholesky.solve(&mut solution);
            let back = &dense * &solution;
            for i in 0..8 {
                assert!((back[(i, 0)] - right[(i, 0)]).abs() < 1e-12);
            }
        }
        assert!(cholesky.factor(&vec![-1.0; cholesky.entries()]).is_err());
    }
}
