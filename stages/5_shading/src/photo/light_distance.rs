//! How far away the light is.
//!
//! From another place of the object a lamp nearby lies in another direction, and shines with another strength. The
//! environment is fitted at several distances, and what the best of them leaves unexplained, a smooth function of one over
//! the distance, gives the distance by a parabola. It has to explain the photos better than a light that is endlessly far:
//! the squares of the residuals are compared sample by sample, and blocks of neighbouring samples count as one, since their
//! errors have the same causes.

use rilievo_numerics::robust::median;

/// Radius of the object over the distance of the light. Nearer than the last, a lamp would stand before the lens.
const CANDIDATES: [f32; 5] = [0.0, 0.1, 0.2, 0.3, 0.4];
/// Share of the distance up to which something may lie from the middle of the object and be lit by the dome.
const MAX_REACH: f32 = 0.8;
/// Standard deviations by which a finite distance has to be better.
const MIN_SIGNIFICANCE: f64 = 3.0;
/// Neighbouring samples whose errors count as one.
const BLOCK: usize = 50;
/// Residual that counts as the largest, in medians: shadow and gloss that the light does not explain tell nothing of its
/// distance.
const MAX_RESIDUAL: f64 = 3.0;

/// One over the distance of the light in the world's unit, 0 where it may be endlessly far. `radius` is the object's,
/// `reach` that of all that is lit. `residuals` returns those of all samples, in an order in which neighbours follow each
/// other, under the best light at a nearness.
pub(crate) fn nearness(
    radius: f32,
    reach: f32,
    residuals: &dyn Fn(f32) -> Option<Vec<f32>>,
) -> f32 {
    let Some(far) = residuals(0.0) else {
        return 0.0;
    };
    let mut sizes: Vec<f64> = far.iter().map(|&r| f64::from(r)).collect();
    let limit = MAX_RESIDUAL * median(&mut sizes).unwrap_or(0.0);
    let squares = |residuals: Vec<f32>| -> Vec<f64> {
        let limited = residuals.into_iter().map(|r| f64::from(r).min(limit));
        limited.map(|r| r * r).collect()
    };
    let far = squares(far);
    let mut tried = vec![(0.0, mean(&far))];
    for share in &CANDIDATES[1..] {
        let nearness = share / radius;
        if nearness * reach > MAX_REACH {
            break;
        }
        let Some(residuals) = residuals(nearness) else {
            break;
        };
        tried.push((f64::from(nearness), mean(&squares(residuals))));
    }
    let least = (0..tried.len()).min_by(|&a, &b| tried[a].1.total_cmp(&tried[b].1));
    let Some(least) = least.filter(|&k| k > 0) else {
        return 0.0;
    };
    let best = match tried.get(least + 1) {
        Some(&after) => vertex(tried[least - 1], tried[least], after),
        None => tried[least].0,
    };
    let Some(near) = residuals(best as f32) else {
        return 0.0;
    };
    if significance(&far, &squares(near)) < MIN_SIGNIFICANCE {
        return 0.0;
    }
    best as f32
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Where the parabola through three points at equal distances is lowest, the middle one being the lowest of them.
fn vertex(before: (f64, f64), middle: (f64, f64), after: (f64, f64)) -> f64 {
    let bend = before.1 - 2.0 * middle.1 + after.1;
    if bend <= 0.0 {
        return middle.0;
    }
    middle.0 + 0.5 * (middle.0 - before.0) * (before.1 - after.1) / bend
}

/// Mean difference of the values in blocks over its standard deviation.
fn significance(far: &[f64], near: &[f64]) -> f64 {
    let blocks = far.chunks(BLOCK).zip(near.chunks(BLOCK));
    let gains: Vec<f64> = blocks.map(|(far, near)| mean(far) - mean(near)).collect();
    let count = gains.len() as f64;
    let gain = mean(&gains);
    let squares: Vec<f64> = gains.iter().map(|g| (g - gain).powi(2)).collect();
    let variance = squares.iter().sum::<f64>() / (count - 1.0).max(1.0);
    gain / (variance / count).sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals that are least at a nearness, with an error of their own that is the same at all.
    fn bowl(at: f32, depth: f32) -> impl Fn(f32) -> Option<Vec<f32>> {
        move |nearness| {
            let own = |i: usize| 0.02 + 0.01 * ((i * 7919) % 101) as f32 / 101.0;
            let part = |i: usize| 1.0 + 0.5 * ((i / BLOCK * 31) % 7) as f32 / 7.0;
            let miss = (nearness - at).powi(2);
            Some((0..2000).map(|i| own(i) + depth * part(i) * miss).collect())
        }
    }

    #[test]
    fn the_least_residual_is_found_between_the_candidates() {
        for at in [0.5, 0.77, 1.3] {
            let found = nearness(0.25, 0.3, &bowl(at, 0.1));
            assert!((found - at).abs() < 0.03, "{found} for {at}");
        }
        // What is lit bounds the distance from below.
        assert!(nearness(0.25, 0.9, &bowl(1.3, 0.1)) <= 0.8 / 0.9);
    }

    #[test]
    fn a_far_light_and_one_that_explains_little_more_are_endlessly_far() {
        assert_eq!(nearness(0.25, 0.3, &bowl(0.0, 0.1)), 0.0);
        assert_eq!(nearness(0.25, 0.3, &|_| None), 0.0);
        // Better in the mean, by less than blocks differ.
        let noisy = |nearness: f32| {
            let block = |i: usize| {
                if (i / BLOCK).is_multiple_of(2) {
                    1.0
                } else {
                    -0.9
                }
            };
            let value = |i: usize| 0.05 - 0.01 * nearness * block(i);
            Some((0..2000).map(value).collect())
        };
        assert_eq!(nearness(0.25, 0.3, &noisy), 0.0);
    }
}
