//! Cholesky factorisation of the reduced system.
//!
//! Few views all see each other: their matrix is dense. Of many, each meets its neighbours only; the
//! matrix is factored sparse then, ordered by approximate minimum degree, and of its inverse only what
//! covariances ask for is computed, where that is the faster way: with `S = L Lᵀ` and `Z = S⁻¹`, from the last column to the first,
//! `Z_ij = −Σ_{k>j} L_kj Z_ik / L_jj` and `Z_jj = (1/L_jj − Σ_{k>j} L_kj Z_kj) / L_jj`, which stays among
//! the entries of `L` (Takahashi, Fagan, Chen, "Formation of a sparse bus impedance matrix", 1973).
//!
//! One thread: the blocking of more would change the last bits.

use super::layout::Pattern;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::{factor, inverse, solve};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::simplicial::SymbolicSimplicialCholesky;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, Mat, MatMut, Par, Side};

/// Fewer columns are dense.
const MIN_NUM_SPARSE_COLUMNS: usize = 200;
/// Share of the lower triangle beyond which the matrix is dense.
const MAX_SPARSE_FILL: f64 = 0.4;

/// How matrices of one pattern are factored.
pub(crate) struct Method<'a> {
    pattern: &'a Pattern,
    symbolic: Option<SymbolicCholesky<usize>>,
}

impl<'a> Method<'a> {
    /// Chooses by size and fill.
    pub fn new(pattern: &'a Pattern) -> Self {
        let n = pattern.num_columns();
        let fill = pattern.len() as f64 / (0.5 * (n * (n + 1)) as f64);
        if n < MIN_NUM_SPARSE_COLUMNS || fill > MAX_SPARSE_FILL {
            Self::dense(pattern)
        } else {
            Self::sparse(pattern)
        }
    }

    /// Dense whatever the pattern.
    pub fn dense(pattern: &'a Pattern) -> Self {
        Self {
            pattern,
            symbolic: None,
        }
    }

    /// Sparse where the analysis has the memory for it.
    pub fn sparse(pattern: &'a Pattern) -> Self {
        Self {
            pattern,
            symbolic: analyse(pattern, SupernodalThreshold::default()),
        }
    }

    /// Entries of the matrices.
    pub fn pattern(&self) -> &Pattern {
        self.pattern
    }

    /// Solves in place; `None` when the matrix is not positive definite.
    pub fn solve(&self, values: &[f64], right: &mut [f64]) -> Option<()> {
        let n = right.len();
        if n == 0 {
            return Some(());
        }
        let column = MatMut::from_column_major_slice_mut(right, n, 1);
        match &self.symbolic {
            None => {
                let factor = dense_factor(self.pattern, values)?;
                solve_dense(&factor, column);
            }
            Some(symbolic) => {
                let mut factor = vec![0.0; symbolic.len_val()];
                sparse_factor(symbolic, self.pattern, values, &mut factor)?;
                let scratch = symbolic.solve_in_place_scratch::<f64>(1, Par::Seq);
                LltRef::new(symbolic, &factor).solve_in_place_with_conj(
                    Conj::No,
                    column,
                    Par::Seq,
                    MemStack::new(&mut MemBuffer::new(scratch)),
                );
            }
        }
        right.iter().all(|v| v.is_finite()).then_some(())
    }

    /// The inverse at the entries of the pattern; `None` when the matrix is not positive definite.
    pub fn inverse(&self, values: &[f64]) -> Option<Vec<f64>> {
        let n = self.pattern.num_columns();
        if self.symbolic.is_some()
            && let Some(symbolic) = analyse(self.pattern, SupernodalThreshold::FORCE_SIMPLICIAL)
            && let SymbolicCholeskyRaw::Simplicial(structure) = symbolic.raw()
            && num_selected(structure) * SELECTED_OVER_DENSE < (n as f64).powi(3)
        {
            return selected_inverse(self.pattern, &symbolic, structure, values);
        }
        let mut inverse = Mat::<f64>::zeros(n, n);
        if n > 0 {
            let factor = dense_factor(self.pattern, values)?;
            let mut memory = MemBuffer::new(inverse::inverse_scratch::<f64>(n, Par::Seq));
            inverse::inverse(
                inverse.as_mut(),
                factor.as_ref(),
                Par::Seq,
                MemStack::new(&mut memory),
            );
        }
        Some(
            entries(self.pattern)
                .map(|(row, column, _)| inverse[(row, column)])
                .collect(),
        )
    }
}

/// Row, column and place of every entry.
fn entries(pattern: &Pattern) -> impl Iterator<Item = (usize, usize, usize)> {
    pattern
        .column_starts
        .windows(2)
        .enumerate()
        .flat_map(move |(column, range)| {
            (range[0]..range[1]).map(move |at| (pattern.rows[at], column, at))
        })
}

fn dense_factor(pattern: &Pattern, values: &[f64]) -> Option<Mat<f64>> {
    let n = pattern.num_columns();
    let mut matrix = Mat::<f64>::zeros(n, n);
    for (row, column, at) in entries(pattern) {
        matrix[(row, column)] = values[at];
    }
    let scratch = factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, faer::Spec::default());
    factor::cholesky_in_place(
        matrix.as_mut(),
        factor::LltRegularization::default(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        faer::Spec::default(),
    )
    .ok()?;
    Some(matrix)
}

fn solve_dense(factor: &Mat<f64>, right: MatMut<'_, f64>) {
    let scratch = solve::solve_in_place_scratch::<f64>(factor.nrows(), right.ncols(), Par::Seq);
    let mut memory = MemBuffer::new(scratch);
    solve::solve_in_place(factor.as_ref(), right, Par::Seq, MemStack::new(&mut memory));
}

fn symbolic_of(pattern: &Pattern) -> SymbolicSparseColMatRef<'_, usize> {
    let n = pattern.num_columns();
    SymbolicSparseColMatRef::new_checked(n, n, &pattern.column_starts, None, &pattern.rows)
}

fn analyse(pattern: &Pattern, threshold: SupernodalThreshold) -> Option<SymbolicCholesky<usize>> {
    let params = CholeskySymbolicParams {
        supernodal_flop_ratio_threshold: threshold,
        ..CholeskySymbolicParams::default()
    };
    factorize_symbolic_cholesky(
        symbolic_of(pattern),
        Side::Lower,
        SymmetricOrdering::Amd,
        params,
    )
    .ok()
}

fn sparse_factor(
    symbolic: &SymbolicCholesky<usize>,
    pattern: &Pattern,
    values: &[f64],
    factor: &mut [f64],
) -> Option<()> {
    let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
    symbolic
        .factorize_numeric_llt(
            factor,
            SparseColMatRef::new(symbolic_of(pattern), values),
            Side::Lower,
            Default::default(),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
            Default::default(),
        )
        .ok()?;
    Some(())
}

/// Time of a term of the recurrence over that of a term of a dense inverse, which works by blocks.
const SELECTED_OVER_DENSE: f64 = 20.0;

/// Terms of the recurrence.
fn num_selected(structure: &SymbolicSimplicialCholesky<usize>) -> f64 {
    let (starts, rows) = (structure.col_ptr(), structure.row_idx());
    let length = |&column: &usize| (starts[column + 1] - starts[column]) as f64;
    rows.iter().map(length).sum()
}

/// Entries of the inverse by Takahashi's recurrence.
fn selected_inverse(
    pattern: &Pattern,
    symbolic: &SymbolicCholesky<usize>,
    structure: &SymbolicSimplicialCholesky<usize>,
    values: &[f64],
) -> Option<Vec<f64>> {
    let mut l = vec![0.0; symbolic.len_val()];
    sparse_factor(symbolic, pattern, values, &mut l)?;
    let (starts, rows) = (structure.col_ptr(), structure.row_idx());
    let n = pattern.num_columns();
    let mut z = vec![0.0; l.len()];
    // Place of a row in the column at hand, and `Σ_k L_kj Z_ik` per row.
    let mut place = vec![usize::MAX; n];
    let mut sums = vec![0.0; n];
    for j in (0..n).rev() {
        let below = starts[j] + 1..starts[j + 1];
        for (k, &row) in rows[below.clone()].iter().enumerate() {
            place[row] = k;
            sums[k] = 0.0;
        }
        for (k, at_k) in below.clone().enumerate() {
            let column = rows[at_k];
            for at in starts[column]..starts[column + 1] {
                let i = place[rows[at]];
                if i == usize::MAX {
                    continue;
                }
                sums[i] += l[at_k] * z[at];
                if i != k {
                    sums[k] += l[below.start + i] * z[at];
                }
            }
        }
        let diagonal = l[starts[j]];
        let mut rest = 1.0 / diagonal;
        for (k, at) in below.enumerate() {
            z[at] = -sums[k] / diagonal;
            rest -= l[at] * z[at];
            place[rows[at]] = usize::MAX;
        }
        z[starts[j]] = rest / diagonal;
    }
    let ordered = symbolic.perm().map(|perm| perm.arrays().1);
    let ordered = |k: usize| ordered.map_or(k, |inverse| inverse[k]);
    entries(pattern)
        .map(|(row, column, _)| {
            let (a, b) = (ordered(row), ordered(column));
            let (column, row) = (a.min(b), a.max(b));
            let of_column = &rows[starts[column]..starts[column + 1]];
            Some(z[starts[column] + of_column.binary_search(&row).ok()?])
        })
        .collect()
}
