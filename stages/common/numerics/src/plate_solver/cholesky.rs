//! Sparse Cholesky factorisation whose symbolic part is computed once.

use crate::plate_system::{OFFSETS, PixelNumbering, PlateError, PlateSystem};
use crate::sparse_cholesky::solve_analysed;
use faer::Side;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};

/// Factorisation of systems over one numbering: ordered and analysed once, factorised often.
#[derive(Debug)]
pub(super) struct Cholesky {
    column_starts: Vec<u32>,
    rows: Vec<u32>,
    slots: Vec<u8>,
    symbolic: SymbolicCholesky<u32>,
}

impl Cholesky {
    /// Orders (approximate minimum degree) and analyses.
    ///
    /// # Errors
    /// When the factorisation does not fit its index type or memory.
    pub(super) fn new(numbering: &PixelNumbering) -> Result<Self, PlateError> {
        let n = numbering.len();
        let mut column_starts = Vec::with_capacity(n + 1);
        let (mut rows, mut slots) = (Vec::with_capacity(7 * n), Vec::with_capacity(7 * n));
        column_starts.push(0);
        for i in 0..n {
            for (slot, &(dx, dy)) in OFFSETS.iter().enumerate() {
                if let Some(j) = numbering.neighbour(i, dx, dy) {
                    rows.push(j as u32);
                    slots.push(slot as u8);
                }
            }
            column_starts.push(rows.len() as u32);
        }
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &column_starts, None, &rows);
        let symbolic = factorize_symbolic_cholesky(
            pattern,
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams::default(),
        )
        .map_err(|error| PlateError::Symbolic {
            num_unknowns: n,
            reason: error.to_string(),
        })?;
        Ok(Self {
            column_starts,
            rows,
            slots,
            symbolic,
        })
    }

    /// Solves `H x = b`.
    ///
    /// # Errors
    /// [`PlateError::NotPositiveDefinite`].
    pub(super) fn solve(&self, system: &PlateSystem) -> Result<Vec<f64>, PlateError> {
        let n = system.rhs.len();
        let mut values = Vec::with_capacity(self.rows.len());
        for (i, row) in system.coefficients.iter().enumerate() {
            let range = self.column_starts[i] as usize..self.column_starts[i + 1] as usize;
            values.extend(self.slots[range].iter().map(|&slot| row[slot as usize]));
        }
        let pattern =
            SymbolicSparseColMatRef::new_checked(n, n, &self.column_starts, None, &self.rows);
        let lower = SparseColMatRef::new(pattern, &values);
        let mut x = [system.rhs.clone()];
        let solved = solve_analysed(&self.symbolic, lower, &mut x);
        solved.ok_or(PlateError::NotPositiveDefinite { num_unknowns: n })?;
        let [x] = x;
        Ok(x)
    }
}
