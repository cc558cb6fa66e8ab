//! How far away the light is.
//!
//! From another place of the object a lamp nearby lies in another direction, and shines with another strength. The
//! environment is fitted at nearer and nearer distances, as long as each leaves less unexplained than the one before; what
//! is left, a smooth function of one over the distance, gives the distance by a parabola. It has to explain the photos
//! better than a light that is endlessly far: the squares of the residuals are compared sample by sample, and samples of
//! all views near one place count as one, since their errors have the same causes. A place is expected to gain in
//! proportion to its weight: those of a sphere, whose points weigh most in the fit, gain more without being less certain.

use nalgebra::Vector3;
use rilievo_numerics::robust::median;
use rilievo_photometry::visibility::MAX_OFFSET;
use std::collections::BTreeMap;

/// Radius of the object over the distance of the light. Nearer than the last, a lamp would stand before the lens.
const CANDIDATES: [f32; 5] = [0.0, 0.1, 0.2, 0.3, 0.4];
/// Standard deviations by which a finite distance has to be better.
const MIN_SIGNIFICANCE: f64 = 3.0;
/// Side of the cubes in which samples count as one, as a share of the object's radius.
const CUBE: f32 = 0.2;
/// Cubes below which nothing can be said.
const MIN_CUBES: usize = 10;
/// Residual that counts as the largest, in medians: shadow and gloss that the light does not explain tell nothing of its
/// distance.
const MAX_RESIDUAL: f64 = 3.0;

/// What a sample says of a light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Evidence {
    /// Relative to the intensity.
    pub residual: f32,
    /// In the fit.
    pub weight: f32,
    /// World.
    pub place: Vector3<f32>,
}

/// One over the distance of the light in the world's unit, 0 where it may be endlessly far. `radius` is the object's,
/// `reach` that of all that is lit. `evidence` returns that of the same samples under the best light at a nearness.
pub(crate) fn nearness(
    radius: f32,
    reach: f32,
    evidence: &dyn Fn(f32) -> Option<Vec<Evidence>>,
) -> f32 {
    let Some(far) = evidence(0.0) else {
        return 0.0;
    };
    let mut sizes: Vec<f64> = far.iter().map(|e| f64::from(e.residual)).collect();
    let limit = MAX_RESIDUAL * median(&mut sizes).unwrap_or(0.0);
    let weights: Vec<f64> = far.iter().map(|e| f64::from(e.weight)).collect();
    let losses = |evidence: &[Evidence]| -> Vec<f64> {
        let squares = evidence
            .iter()
            .map(|e| f64::from(e.residual).min(limit).powi(2));
        squares
            .zip(&weights)
            .map(|(square, w)| w * square)
            .collect()
    };
    let cubes: Vec<[i32; 3]> = far
        .iter()
        .map(|e| [0, 1, 2].map(|c| (e.place[c] / (CUBE * radius)).floor() as i32))
        .collect();
    let far = losses(&far);
    let mut tried = vec![(0.0, far.iter().sum::<f64>())];
    for share in &CANDIDATES[1..] {
        let nearness = share / radius;
        if nearness * reach > MAX_OFFSET {
            break;
        }
        let Some(evidence) = evidence(nearness) else {
            break;
        };
        let loss = losses(&evidence).iter().sum();
        let is_better = tried.last().is_some_and(|before| loss < before.1);
        tried.push((f64::from(nearness), loss));
        if !is_better {
            break;
        }
    }
    let least = (0..tried.len()).min_by(|&a, &b| tried[a].1.total_cmp(&tried[b].1));
    let Some(least) = least.filter(|&k| k > 0) else {
        return 0.0;
    };
    let best = match tried.get(least + 1) {
        Some(&after) => vertex(tried[least - 1], tried[least], after),
        None => tried[least].0,
    };
    let Some(near) = evidence(best as f32) else {
        return 0.0;
    };
    if significance(&cubes, &weights, &far, &losses(&near)) < MIN_SIGNIFICANCE {
        return 0.0;
    }
    best as f32
}

/// Where the parabola through three points at equal distances is lowest, the middle one being the lowest of them.
fn vertex(before: (f64, f64), middle: (f64, f64), after: (f64, f64)) -> f64 {
    let bend = before.1 - 2.0 * middle.1 + after.1;
    if bend <= 0.0 {
        return middle.0;
    }
    middle.0 + 0.5 * (middle.0 - before.0) * (before.1 - after.1) / bend
}

/// Gain of all cubes over its standard error as that of a ratio: a cube's deviation is what it gains beyond its weight's
/// share of the gain of all. 0 of few cubes.
fn significance(cubes: &[[i32; 3]], weights: &[f64], far: &[f64], near: &[f64]) -> f64 {
    let mut sums: BTreeMap<[i32; 3], (f64, f64)> = BTreeMap::new();
    for (k, &cube) in cubes.iter().enumerate() {
        let (gain, weight) = sums.entry(cube).or_default();
        *gain += far[k] - near[k];
        *weight += weights[k];
    }
    if sums.len() < MIN_CUBES {
        return 0.0;
    }
    let add = |a: (f64, f64), b: &(f64, f64)| (a.0 + b.0, a.1 + b.1);
    let (gain, weight) = sums.values().fold((0.0, 0.0), add);
    let ratio = gain / weight;
    let deviations = sums.values().map(|(gain, weight)| gain - ratio * weight);
    let count = sums.len() as f64;
    let variance = deviations.map(|d| d * d).sum::<f64>() * count / (count - 1.0);
    gain / variance.sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples in 8 x 5 x 1 cubes of an object of radius .25, with what each leaves.
    fn samples(residual: impl Fn(usize, usize) -> f32) -> Option<Vec<Evidence>> {
        let evidence = (0..2000).map(|i| {
            let cube = i / 50;
            Evidence {
                residual: residual(i, cube),
                weight: 1.0,
                place: 0.05 * Vector3::new((cube % 8) as f32 + 0.5, (cube / 8) as f32 + 0.5, 0.5),
            }
        });
        Some(evidence.collect())
    }

    /// Residuals that are least at a nearness, with an error of their own that is the same at all.
    fn bowl(at: f32) -> impl Fn(f32) -> Option<Vec<Evidence>> {
        move |nearness| {
            let miss = 0.1 * (nearness - at).powi(2);
            samples(|i, cube| {
                let own = 0.02 + 0.01 * ((i * 7919) % 101) as f32 / 101.0;
                own + miss * (1.0 + 0.5 * ((cube * 31) % 7) as f32 / 7.0)
            })
        }
    }

    #[test]
    fn the_least_residual_is_found_between_the_candidates() {
        for at in [0.5, 0.77, 1.3] {
            let found = nearness(0.25, 0.3, &bowl(at));
            assert!((found - at).abs() < 0.03, "{found} for {at}");
        }
        // What is lit bounds the distance from below: candidates are .4, .8, 1.2 and 1.6.
        let found = nearness(0.25, 0.8 * MAX_OFFSET, &bowl(1.3));
        assert!((found - 1.2).abs() < 1e-5, "{found}");
    }

    #[test]
    fn a_far_light_and_one_that_explains_little_more_are_endlessly_far() {
        assert_eq!(nearness(0.25, 0.3, &bowl(0.0)), 0.0);
        assert_eq!(nearness(0.25, 0.3, &|_| None), 0.0);
        // Better in the mean, by less than places differ.
        let noisy = |nearness: f32| {
            let part = |cube: usize| if cube.is_multiple_of(2) { 1.0 } else { -0.9 };
            samples(|_, cube| 0.05 - 0.01 * nearness * part(cube))
        };
        assert_eq!(nearness(0.25, 0.3, &noisy), 0.0);
        // Better everywhere, but in too few places.
        let few = |nearness: f32| bowl(0.8)(nearness).map(|mut all| all.drain(..400).collect());
        assert_eq!(nearness(0.25, 0.3, &few), 0.0);
    }

    /// A few heavy places that gain unequally do not hide that all places gain.
    #[test]
    fn heavy_places_do_not_hide_that_all_gain() {
        let heavy = |nearness: f32| {
            let heavier = |(i, e): (usize, Evidence)| Evidence {
                weight: if i < 150 { 40.0 } else { 1.0 },
                residual: if i < 50 { 2.0 * e.residual } else { e.residual },
                ..e
            };
            let all = bowl(0.8)(nearness)?.into_iter().enumerate();
            Some(all.map(heavier).collect())
        };
        let found = nearness(0.25, 0.3, &heavy);
        assert!((found - 0.8).abs() < 0.03, "{found}");
    }
}
