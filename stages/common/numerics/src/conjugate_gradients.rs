//! Preconditioned conjugate gradients for `A x = b` with a symmetric positive definite `A`, of which only
//! products are needed.
//!
//! The residual is measured in the norm of the preconditioner, `rᵀ M⁻¹ r`, which the iteration has at hand.
//! Inner products are summed in order, so that results do not depend on threads.

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Stop {
    /// Norm of the residual over that of `b`.
    pub tolerance: f64,
    /// Iterations at most; what is reached by then is the result.
    pub max_num_iterations: usize,
}

/// The matrix shows itself as not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Indefinite;

/// Improves `x`. `multiply(x, out)` writes `A x`, `precondition(r, out)` writes `M⁻¹ r`.
///
/// # Errors
/// [`Indefinite`]; `x` is then what was reached before.
pub fn conjugate_gradients(
    b: &[f64],
    x: &mut [f64],
    mut multiply: impl FnMut(&[f64], &mut [f64]),
    mut precondition: impl FnMut(&[f64], &mut [f64]),
    stop: Stop,
) -> Result<(), Indefinite> {
    let n = b.len();
    let (mut z, mut product) = (vec![0.0; n], vec![0.0; n]);
    let mut residual = b.to_vec();
    precondition(&residual, &mut z);
    let target = dot(b, &z) * stop.tolerance * stop.tolerance;
    if x.iter().any(|&v| v != 0.0) {
        multiply(x, &mut product);
        for (r, p) in residual.iter_mut().zip(&product) {
            *r -= p;
        }
        precondition(&residual, &mut z);
    }
    let mut direction = z.clone();
    let mut norm2 = dot(&residual, &z);
    for _ in 0..stop.max_num_iterations {
        if norm2 <= target {
            break;
        }
        multiply(&direction, &mut product);
        let curvature = dot(&direction, &product);
        if curvature.is_nan() || curvature <= 0.0 {
            return Err(Indefinite);
        }
        let step = norm2 / curvature;
        for i in 0..n {
            x[i] += step * direction[i];
            residual[i] -= step * product[i];
        }
        precondition(&residual, &mut z);
        let next = dot(&residual, &z);
        let turn = next / norm2;
        norm2 = next;
        for (d, z) in direction.iter_mut().zip(&z) {
            *d = z + turn * *d;
        }
    }
    Ok(())
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
