//! Robust losses for iteratively re-weighted least squares.
//!
//! A loss acts on the residual `r` through `ρ(r)`; its IRLS weight is `ρ'(r) / r`, so that
//! `½ Σ w r²` has the gradient of `Σ ρ(r)` at the current point.

use serde::{Deserialize, Serialize};

/// A robust loss with its scale, in the unit of the residual.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobustLoss {
    /// `ρ = r²/2`.
    Squared,
    /// Quadratic up to the scale, linear beyond.
    Huber(f64),
    /// `ρ = s²/2 ln(1 + r²/s²)`; redescending.
    Cauchy(f64),
    /// `ρ = s²/2 · r²/(r²+s²)`; redescending, bounded.
    GemanMcClure(f64),
}

impl RobustLoss {
    /// `ρ(r)`.
    #[inline]
    pub fn cost(self, r: f64) -> f64 {
        let r2 = r * r;
        match self {
            Self::Squared => 0.5 * r2,
            Self::Huber(s) if r.abs() <= s => 0.5 * r2,
            Self::Huber(s) => s * (r.abs() - 0.5 * s),
            Self::Cauchy(s) => 0.5 * s * s * (r2 / (s * s)).ln_1p(),
            Self::GemanMcClure(s) => 0.5 * s * s * r2 / (r2 + s * s),
        }
    }

    /// `ρ'(r) / r`, 1 at `r = 0`.
    #[inline]
    pub fn weight(self, r: f64) -> f64 {
        match self {
            Self::Squared => 1.0,
            Self::Huber(s) if r.abs() <= s => 1.0,
            Self::Huber(s) => s / r.abs(),
            Self::Cauchy(s) => 1.0 / (1.0 + r * r / (s * s)),
            Self::GemanMcClure(s) => {
                let t = s * s / (r * r + s * s);
                t * t
            }
        }
    }
}

/// Weight of Tukey's biweight at a residual in units of its scale, beyond which it is 0.
#[inline]
pub fn tukey_weight(t: f64) -> f64 {
    if t.abs() < 1.0 {
        (1.0 - t * t).powi(2)
    } else {
        0.0
    }
}

/// Weight `ρ'(r) / r` of a loss that is quadratic up to 1 and `½ (1 + 2 ln |r|)` beyond: far values hardly pull.
#[inline]
pub fn log_weight(r: f64) -> f64 {
    if r.abs() < 1.0 { 1.0 } else { 1.0 / (r * r) }
}

/// Median of finite values; `None` when there is none. Reorders the slice.
pub fn median(values: &mut [f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// Quantile (0 to 1, nearest rank) of values without NaN; `None` when empty. Reorders the slice.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let rank = ((values.len() - 1) as f64 * share.clamp(0.0, 1.0)).round() as usize;
    let (_, value, _) = values.select_nth_unstable_by(rank, f64::total_cmp);
    Some(*value)
}

/// Factor from the median absolute deviation to the standard deviation of a normal distribution.
pub const SIGMA_FROM_MAD: f64 = 1.482_602_218_505_602;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_derivative_of_the_cost() {
        for loss in [
            RobustLoss::Squared,
            RobustLoss::Huber(0.7),
            RobustLoss::Cauchy(0.7),
            RobustLoss::GemanMcClure(0.7),
        ] {
            for r in [-3.0, -0.5, 0.1, 0.69, 0.72, 5.0] {
                let h = 1e-6;
                let numeric = (loss.cost(r + h) - loss.cost(r - h)) / (2.0 * h);
                let analytic = loss.weight(r) * r;
                assert!(
                    (numeric - analytic).abs() < 1e-8,
                    "{loss:?} at {r}: {numeric} {analytic}"
                );
            }
        }
    }

    #[test]
    fn quantiles_of_a_known_sequence() {
        let mut values: Vec<f64> = (0..101).rev().map(f64::from).collect();
        assert_eq!(median(&mut values), Some(50.0));
        assert_eq!(quantile(&mut values, 0.9), Some(90.0));
        assert_eq!(median(&mut []), None);
    }
}
