//! Sparse symmetric positive definite systems, by the Cholesky factorisation with approximate minimum degree.
//!
//! One thread: the blocking of more would change the last bits.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::cholesky::{
    SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, Index, MatMut, Par, Side};
use std::collections::BTreeMap;

/// Solves `A x = b` in the place of each `b`. `entries` holds the lower triangle of `A` by column and row, the diagonal
/// complete. `None` where `A` is not positive definite.
pub fn solve(entries: &BTreeMap<(usize, usize), f64>, right_sides: &mut [Vec<f64>]) -> Option<()> {
    let n = right_sides.first()?.len();
    if n == 0 {
        return Some(());
    }
    let mut starts = vec![0; n + 1];
    entries
        .keys()
        .for_each(|(column, _)| starts[column + 1] += 1);
    (0..n).for_each(|k| starts[k + 1] += starts[k]);
    let rows: Vec<usize> = entries.keys().map(|(_, row)| *row).collect();
    let values: Vec<f64> = entries.values().copied().collect();
    let pattern = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
    let analysed = factorize_symbolic_cholesky(
        pattern,
        Side::Lower,
        SymmetricOrdering::Amd,
        Default::default(),
    );
    let symbolic = analysed.ok()?;
    solve_analysed(
        &symbolic,
        SparseColMatRef::new(pattern, &values),
        right_sides,
    )
}

/// Solves `A x = b` in the place of each `b` with an order and analysis of the pattern of `A`'s lower triangle; `None` where
/// `A` is not positive definite.
pub(crate) fn solve_analysed<I: Index>(
    symbolic: &SymbolicCholesky<I>,
    lower: SparseColMatRef<'_, I, f64>,
    right_sides: &mut [Vec<f64>],
) -> Option<()> {
    let mut factor = vec![0.0; symbolic.len_val()];
    let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
    let factored = symbolic.factorize_numeric_llt(
        &mut factor,
        lower,
        Side::Lower,
        Default::default(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        Default::default(),
    );
    let llt = factored.ok()?;
    for right in right_sides.iter_mut() {
        let scratch = symbolic.solve_in_place_scratch::<f64>(1, Par::Seq);
        let rows = right.len();
        llt.solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(right, rows, 1),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
        );
    }
    let finite = right_sides.iter().flatten().all(|v| v.is_finite());
    finite.then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bent_beam_has_its_shape_and_a_singular_one_has_none() {
        // Second differences squared, both ends held in place and in slope: x(t) = t³ stays.
        let n = 400;
        let mut entries: BTreeMap<(usize, usize), f64> = BTreeMap::new();
        let mut right = vec![0.0; n];
        let known = |k: isize| (k as f64 / n as f64).powi(3);
        for middle in -1..=n as isize {
            let row = [(middle - 1, 1.0), (middle, -2.0), (middle + 1, 1.0)];
            // The second difference of a cubic is 6 t / n².
            let target = 6.0 * (middle as f64 / n as f64) / (n * n) as f64;
            let of = |k: isize| (0..n as isize).contains(&k).then_some(k as usize);
            for (i, a) in row {
                let Some(i) = of(i) else { continue };
                right[i] += a * target;
                for (j, b) in row {
                    match of(j) {
                        Some(j) if j <= i => *entries.entry((j, i)).or_default() += a * b,
                        Some(_) => {}
                        None => right[i] -= a * b * known(j),
                    }
                }
            }
        }
        let mut sides = [right];
        solve(&entries, &mut sides).expect("it is held at both ends");
        for (k, x) in sides[0].iter().enumerate() {
            assert!((x - known(k as isize)).abs() < 1e-7, "{k}: {x}");
        }
        let singular = BTreeMap::from([((0, 0), 1.0), ((0, 1), 1.0), ((1, 1), 1.0)]);
        assert_eq!(solve(&singular, &mut [vec![1.0, 2.0]]), None);
    }
}
