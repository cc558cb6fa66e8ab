//! How a cost grows.

/// Exponent `e` of `cost ~ number^e`: the slope of the logarithms, by least squares over the costs
/// above zero.
pub fn exponent(points: impl IntoIterator<Item = (usize, f64)>) -> f64 {
    let points = points.into_iter().filter(|(_, cost)| *cost > 0.0);
    let points: Vec<[f64; 2]> = points
        .map(|(n, cost)| [(n as f64).ln(), cost.ln()])
        .collect();
    let mean = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64);
    let (mut xy, mut xx) = (0.0, 0.0);
    for [x, y] in points {
        xy += (x - mean[0]) * (y - mean[1]);
        xx += (x - mean[0]).powi(2);
    }
    xy / xx
}

/// Quantile of values; NaN of none.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    rilievo_numerics::robust::quantile(values, share).unwrap_or(f64::NAN)
}

/// Mean of values; NaN of none.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
