//! Conjugate gradients, preconditioned by symmetric Gauss-Seidel.
//!
//! With `H = L + D + Lᵀ` the preconditioner is `M = (D + L) D⁻¹ (D + Lᵀ)`: positive definite with `H`,
//! no parameter, no memory of its own. Where every pixel's value is measured a plate couples over a few
//! pixels only, so that the number of iterations does not grow with the image.

use crate::conjugate_gradients::{Stop, conjugate_gradients};
use crate::plate_system::{OFFSETS, OUTSIDE, PixelNumbering, PlateError, PlateSystem};

/// Norm of the residual, in that of the preconditioner and relative to the right-hand side's, that
/// ends the iteration.
const TOLERANCE: f64 = 1e-2;
/// Iterations at most: regions without any measured value are left unfinished then.
const MAX_NUM_ITERATIONS: usize = 200;

/// Pixels that the stored half of each row couples with; [`OUTSIDE`] where there is none.
#[derive(Debug)]
pub(super) struct ConjugateGradients {
    later: Vec<[u32; 6]>,
}

impl ConjugateGradients {
    pub(super) fn new(numbering: &PixelNumbering) -> Self {
        let later = (0..numbering.len())
            .map(|i| {
                std::array::from_fn(|k| {
                    let (dx, dy) = OFFSETS[k + 1];
                    numbering.neighbour(i, dx, dy).map_or(OUTSIDE, |j| j as u32)
                })
            })
            .collect();
        Self { later }
    }

    /// Solves `H x = b` from zero.
    pub(super) fn solve(&self, system: &PlateSystem) -> Result<Vec<f64>, PlateError> {
        let n = system.rhs.len();
        let indefinite = PlateError::NotPositiveDefinite { num_unknowns: n };
        if !system.coefficients.iter().all(|row| row[0] > 0.0) {
            return Err(indefinite);
        }
        let mut x = vec![0.0; n];
        let solved = conjugate_gradients(
            &system.rhs,
            &mut x,
            |x, out| self.multiply(system, x, out),
            |r, out| self.precondition(system, r, out),
            Stop {
                tolerance: TOLERANCE,
                max_num_iterations: MAX_NUM_ITERATIONS,
            },
        );
        if solved.is_ok() && x.iter().all(|v| v.is_finite()) {
            Ok(x)
        } else {
            Err(indefinite)
        }
    }

    /// `out = H x`.
    fn multiply(&self, system: &PlateSystem, x: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for (i, (row, later)) in system.coefficients.iter().zip(&self.later).enumerate() {
            let own = x[i];
            let mut sum = row[0] * own;
            for (&j, &c) in later.iter().zip(&row[1..]) {
                if j != OUTSIDE {
                    sum += c * x[j as usize];
                    out[j as usize] += c * own;
                }
            }
            out[i] += sum;
        }
    }

    /// `z = M⁻¹ r`.
    fn precondition(&self, system: &PlateSystem, r: &[f64], z: &mut [f64]) {
        z.copy_from_slice(r);
        // (D + L) y = r, kept as D y.
        for (i, (row, later)) in system.coefficients.iter().zip(&self.later).enumerate() {
            let y = z[i] / row[0];
            for (&j, &c) in later.iter().zip(&row[1..]) {
                if j != OUTSIDE {
                    z[j as usize] -= c * y;
                }
            }
        }
        // (D + Lᵀ) z = D y.
        for (i, (row, later)) in system
            .coefficients
            .iter()
            .zip(&self.later)
            .enumerate()
            .rev()
        {
            let mut sum = z[i];
            for (&j, &c) in later.iter().zip(&row[1..]) {
                if j != OUTSIDE {
                    sum -= c * z[j as usize];
                }
            }
            z[i] = sum / row[0];
        }
    }
}
