//! Checks analytic derivatives against central differences.

/// Largest deviation of an analytic Jacobian from central differences, relative to the larger of 1
/// and the entry's size.
///
/// `residual(x, out)` writes `num_residuals` values; `jacobian` is row-major,
/// `num_residuals × x.len()`.
pub fn jacobian_error(
    x: &[f64],
    num_residuals: usize,
    mut residual: impl FnMut(&[f64], &mut [f64]),
    jacobian: &[f64],
) -> f64 {
    let mut x = x.to_vec();
    let (mut plus, mut minus) = (vec![0.0; num_residuals], vec![0.0; num_residuals]);
    let num_parameters = x.len();
    let mut worst = 0.0_f64;
    for column in 0..num_parameters {
        let at = x[column];
        // Cube root of the machine epsilon balances truncation against rounding.
        let step = 6e-6 * at.abs().max(1.0);
        x[column] = at + step;
        residual(&x, &mut plus);
        x[column] = at - step;
        residual(&x, &mut minus);
        x[column] = at;
        for row in 0..num_residuals {
            let numeric = (plus[row] - minus[row]) / (2.0 * step);
            let analytic = jacobian[row * num_parameters + column];
            let error = (numeric - analytic).abs() / analytic.abs().max(1.0);
            worst = if error.is_nan() {
                f64::INFINITY
            } else {
                worst.max(error)
            };
        }
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tells_a_right_jacobian_from_a_wrong_one() {
        let f = |x: &[f64], out: &mut [f64]| out[0] = x[0].sin() * x[1];
        let right = [0.3_f64.cos() * 2.0, 0.3_f64.sin()];
        assert!(jacobian_error(&[0.3, 2.0], 1, f, &right) < 1e-9);
        assert!(jacobian_error(&[0.3, 2.0], 1, f, &[right[0], 0.0]) > 0.1);
    }
}
