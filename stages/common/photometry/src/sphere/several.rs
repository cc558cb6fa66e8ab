//! Several spheres in one scene: one scale from all of them.
//!
//! # Problem
//! Sphere `k`, of stated radius `R_k`, was located by itself and shows the radius `r_k` in the
//! world's unit, so that one unit is `s_k = R_k / r_k` metres with a relative standard deviation
//! `σ_k` from its outlines. A stated radius has an error of its own, `σ_R`. All mean one number:
//! ```text
//! ln s = Σ w_k ln s_k / Σ w_k,   w_k = 1 / (σ_k² + σ_R²)
//! ```
//! # Steps
//! 1. Two spheres cannot stand in one place: of two that do, the less certain one is the other one
//!    marked twice.
//! 2. The sphere that differs most from the mean of the others, in standard deviations of the
//!    difference, contradicts them where these are more than three. Of three or more it is outvoted
//!    and the rest is compared again; of two neither is known to be wrong, and both count, or there
//!    is no scale where they are so far apart that a mean would be neither. Where a sphere stands
//!    depends on no scale, so that each keeps its place in the world's own unit.
//! 3. The standard deviation of `s` is that of the outlines or that of the scatter between the
//!    spheres, whichever is larger.

use super::error::SphereError;
use super::locate::{ScaleEstimate, SphereFit};
use nalgebra::Point3;
use rilievo_scene::LocatedSphere;
use serde::{Deserialize, Serialize};

/// A sphere whose scale the others contradict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaleContradiction {
    /// Its name.
    pub sphere: String,
    /// The scale that it gives over that of the others.
    pub ratio: f64,
    /// Relative standard deviation of the ratio.
    pub sigma: f64,
    /// What became of it.
    pub outcome: ScaleOutcome,
}

/// What becomes of scales that contradict each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScaleOutcome {
    /// Most others agree without this one: it does not count.
    Outvoted,
    /// Of two, both count.
    Averaged,
    /// The two have no mean worth the name: there is no scale.
    NoScale,
}

/// The scale of the world from all spheres.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CommonScale {
    /// The weighted mean; `None` where no sphere determines a scale, or two contradict each other.
    pub estimate: Option<ScaleEstimate>,
    /// Spheres that contradict the others.
    pub contradictions: Vec<ScaleContradiction>,
}

/// Relative standard deviation of a stated radius: a calliper reads a tenth of a millimetre. Less takes
/// its error for a contradiction.
const RADIUS_SIGMA: f64 = 0.003;
/// Standard deviations of a difference beyond which two scales contradict each other.
pub(super) const MAX_DEVIATIONS: f64 = 3.0;
/// Two scales that differ by more than this factor have no mean worth the name: another unit, a
/// diameter for a radius.
const MAX_RATIO: f64 = 1.25;

/// The common scale of located spheres.
pub fn common_scale(fits: &[SphereFit]) -> CommonScale {
    let mut active: Vec<(&str, ScaleEstimate)> = fits
        .iter()
        .filter_map(|fit| Some((fit.sphere.name.as_str(), fit.scale?)))
        .collect();
    let mut contradictions = Vec::new();
    if let [(_, only)] = active[..] {
        return CommonScale {
            estimate: Some(only),
            contradictions,
        };
    }
    let variance = |s: &ScaleEstimate| s.relative_sigma.powi(2) + RADIUS_SIGMA.powi(2);
    while active.len() > 1 {
        let against_others = |k: usize| {
            let others = active.iter().enumerate().filter(|(j, _)| *j != k);
            let (mean, sum) = weighted_mean(others.map(|(_, (_, s))| (s, 1.0 / variance(s))));
            let own = &active[k].1;
            let sigma = (variance(own) + 1.0 / sum).sqrt();
            (own.metres_per_unit.ln() - mean, sigma)
        };
        let worst = (0..active.len())
            .map(|k| (k, against_others(k)))
            .max_by(|(_, a), (_, b)| (a.0.abs() / a.1).total_cmp(&(b.0.abs() / b.1)));
        let Some((k, (difference, sigma))) =
            worst.filter(|(_, (d, sigma))| d.abs() > MAX_DEVIATIONS * sigma)
        else {
            break;
        };
        let outcome = if active.len() > 2 {
            ScaleOutcome::Outvoted
        } else if difference.abs() > MAX_RATIO.ln() {
            ScaleOutcome::NoScale
        } else {
            ScaleOutcome::Averaged
        };
        contradictions.push(ScaleContradiction {
            sphere: active[k].0.to_owned(),
            ratio: difference.exp(),
            sigma,
            outcome,
        });
        match outcome {
            ScaleOutcome::Outvoted => active.remove(k),
            ScaleOutcome::Averaged => break,
            ScaleOutcome::NoScale => {
                active.clear();
                break;
            }
        };
    }
    if active.is_empty() {
        return CommonScale {
            estimate: None,
            contradictions,
        };
    }
    let weighted = || active.iter().map(|(_, s)| (s, 1.0 / variance(s)));
    let (mean, sum) = weighted_mean(weighted());
    // What makes an outline seem wider is the same for all spheres: their deviations add up and do not average out.
    let outlines: f64 = weighted().map(|(s, w)| w / sum * s.relative_sigma).sum();
    let scatter: f64 = weighted()
        .map(|(s, w)| w / sum * (s.metres_per_unit.ln() - mean).powi(2))
        .sum();
    let between = scatter / (active.len() as f64 - 1.0).max(1.0);
    CommonScale {
        estimate: Some(ScaleEstimate {
            metres_per_unit: mean.exp(),
            relative_sigma: outlines.max(between.sqrt()),
        }),
        contradictions,
    }
}

/// Weighted mean of the logarithms, and the sum of the weights.
fn weighted_mean<'a>(terms: impl Iterator<Item = (&'a ScaleEstimate, f64)>) -> (f64, f64) {
    let (sum, weight) = terms.fold((0.0, 0.0), |(sum, weight), (s, w)| {
        (sum + w * s.metres_per_unit.ln(), weight + w)
    });
    (sum / weight, weight)
}

/// Share of the sum of two radii below which the distance of two centres is no distance between
/// two balls.
const MIN_APART: f64 = 0.8;

/// Whether two spheres would stand in one place.
pub fn overlap(a: &LocatedSphere, b: &LocatedSphere) -> bool {
    let between = Point3::from(a.center_in_world) - Point3::from(b.center_in_world);
    between.norm() < MIN_APART * (a.radius + b.radius)
}

/// Takes out every sphere that stands in the place of a more certain one; returns it with the
/// other's name.
pub(super) fn without_doubles(fits: &mut Vec<SphereFit>) -> Vec<(String, SphereError)> {
    let mut doubles = Vec::new();
    let spread = |fit: &SphereFit| -> f64 {
        let variance = fit.sphere.center_sigma.iter().map(|s| s * s);
        variance.sum::<f64>()
    };
    let mut first = 0;
    while first < fits.len() {
        let other =
            (first + 1..fits.len()).find(|&k| overlap(&fits[first].sphere, &fits[k].sphere));
        let Some(second) = other else {
            first += 1;
            continue;
        };
        let (kept, gone) = if spread(&fits[second]) < spread(&fits[first]) {
            (second, first)
        } else {
            (first, second)
        };
        let place_of = fits[kept].sphere.name.clone();
        doubles.push((
            fits[gone].sphere.name.clone(),
            SphereError::SamePlace { other: place_of },
        ));
        fits.remove(gone);
    }
    doubles
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(name: &str, metres_per_unit: f64, relative_sigma: f64) -> SphereFit {
        SphereFit {
            sphere: LocatedSphere {
                name: name.to_owned(),
                center_in_world: [metres_per_unit * 100.0, 0.0, 0.0],
                radius: 0.1,
                center_sigma: [relative_sigma; 3],
                seen_in: Vec::new(),
            },
            scale: Some(ScaleEstimate {
                metres_per_unit,
                relative_sigma,
            }),
            views: Vec::new(),
            unused_marks: Vec::new(),
            evidence: Vec::new(),
        }
    }

    #[test]
    fn one_sphere_is_left_as_it_is() {
        let only = fit("the sphere", 2.7, 3e-4);
        let common = common_scale(std::slice::from_ref(&only));
        assert_eq!(common.estimate, only.scale);
    }

    #[test]
    fn spheres_that_agree_share_one_scale() {
        let common = common_scale(&[fit("a", 2.700, 5e-4), fit("b", 2.702, 5e-4)]);
        let estimate = common.estimate.unwrap();
        let error = (estimate.metres_per_unit / 2.701 - 1.0).abs();
        assert!(error < 1e-6, "{error}");
        // The two differ by 0.074 %, half of which is the error of their mean; what both outlines share is more.
        let sigma = estimate.relative_sigma;
        assert!((sigma - 5e-4).abs() < 1e-9, "{sigma}");
        let apart = common_scale(&[fit("a", 2.700, 2e-4), fit("b", 2.702, 2e-4)]);
        let sigma = apart.estimate.unwrap().relative_sigma;
        assert!((sigma - 3.7e-4).abs() < 0.1e-4, "{sigma}");
        assert!(common.contradictions.is_empty());
    }

    #[test]
    fn a_radius_that_is_wrong_by_a_twentieth_is_told_and_of_three_outvoted() {
        let common = common_scale(&[fit("a", 1.0, 5e-4), fit("b", 1.05, 5e-4)]);
        let [found] = &common.contradictions[..] else {
            panic!("{:?}", common.contradictions);
        };
        assert!((found.ratio.ln().abs() - 1.05_f64.ln()).abs() < 1e-9);
        assert_eq!(found.outcome, ScaleOutcome::Averaged);
        let sigma = common.estimate.unwrap().relative_sigma;
        assert!((0.02..0.03).contains(&sigma), "{sigma}");
        let common = common_scale(&[
            fit("a", 1.0, 5e-4),
            fit("b", 1.05, 5e-4),
            fit("c", 1.001, 1e-3),
        ]);
        let [found] = &common.contradictions[..] else {
            panic!("{:?}", common.contradictions);
        };
        let outvoted = found.outcome == ScaleOutcome::Outvoted;
        assert!(found.sphere == "b" && outvoted, "{found:?}");
        let error = (common.estimate.unwrap().metres_per_unit - 1.0).abs();
        assert!(error < 1e-3, "{error}");
    }

    #[test]
    fn two_units_in_one_file_give_no_scale_and_are_told() {
        let common = common_scale(&[fit("a", 1.0, 5e-4), fit("b", 10.0, 5e-4)]);
        assert_eq!(common.estimate, None);
        let [found] = &common.contradictions[..] else {
            panic!("{:?}", common.contradictions);
        };
        assert_eq!(found.outcome, ScaleOutcome::NoScale);
        assert!(
            (found.ratio.ln().abs() - 10_f64.ln()).abs() < 1e-9,
            "{found:?}"
        );
        let mut none = fit("a", 1.0, 5e-4);
        none.scale = None;
        assert_eq!(common_scale(&[none]), CommonScale::default());
    }

    #[test]
    fn one_ball_marked_twice_counts_once() {
        let mut fits = vec![
            fit("a", 1.0, 5e-4),
            fit("b", 2.0, 5e-4),
            fit("c", 1.0005, 4e-4),
        ];
        let doubles = without_doubles(&mut fits);
        let names: Vec<&str> = fits.iter().map(|f| f.sphere.name.as_str()).collect();
        assert_eq!(names, ["b", "c"]);
        assert!(
            matches!(&doubles[..], [(name, SphereError::SamePlace { other })]
                if name == "a" && other == "c"),
            "{doubles:?}"
        );
    }
}
