//! Order statistics of the robust estimators. They stand here because this crate imports nothing
//! but the scene's types.

/// Factor from the median absolute deviation to the standard deviation of a normal distribution.
pub(crate) const SIGMA_FROM_MAD: f64 = 1.482_602_218_505_602;

/// Quantile (0 to 1, nearest rank) of values without NaN; `None` when empty. Reorders the slice.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let rank = ((values.len() - 1) as f64 * share.clamp(0.0, 1.0)).round() as usize;
    let (_, value, _) = values.select_nth_unstable_by(rank, f64::total_cmp);
    Some(*value)
}
