//! The penalty's schedule, computed from the lighting, the noise, and what holds the low frequencies.
//!
//! **Rule.** Let `s₁ ≥ s₂` be the singular values of the shading Jacobian `∂S/∂(p, q)` (channels by
//! two), medians over pixels at the start, and `σ` the noise of intensities. Across the direction of
//! `s₂` a pixel knows its slope to `σ/s₂`. Where that is much less than the slopes of a start may err
//! (`D`), the pixel determines its own normal: the penalty may start low, `0.12 s₂²`, so that shading
//! moves the surface freely, and a search over normals may leave the start. Where it is much more
//! (grey images: `s₂ = 0`), the image is explained along one direction and says nothing across it;
//! only a penalty stronger than shading, `10 s₁²`, keeps the start across while it corrects along.
//! Where anchors hold the low frequencies, the start across is known to be right and need not be
//! kept as tightly: `2 s₁²`. In between the logarithms are mixed by
//!
//! ```text
//! t = s₂² D² / (s₂² D² + σ²),   ln β₀ = (1 − t) ln(2 s₁² or 10 s₁²) + t ln(0.12 s₂²).
//! ```
//!
//! The penalty ends at `15 s₁²`, where ∇y and θ agree to a fraction of what shading resolves, and
//! grows geometrically between; every level runs over its own part of that range. All scales with
//! squared intensity, so that nothing needs tuning per data set.
//!
//! Source: rilievo's own; the penalties of the paper's later code and of He et al. (`he2000`) adapt
//! to residuals instead, which says nothing on what the image leaves open.

use super::pixels::{Pixels, Slopes};
use super::splitting::LevelSchedule;
use rilievo_numerics::robust::median;

/// Slopes by which a start may err.
const START_SLOPE_ERROR: f64 = 0.3;
/// The penalty's end in units of `s₁²`.
const BETA_END: f64 = 15.0;
/// Its start where pixels determine their normals, in units of `s₂²`.
const DETERMINED_START: f64 = 0.12;
/// Its start where they do not, in units of `s₁²`: with anchors, and with nothing but the start.
const ANCHORED_START: f64 = 2.0;
const UNANCHORED_START: f64 = 10.0;
/// Share at and above which single pixels determine their normals, so that a search pays.
const SEARCH_SHARE: f64 = 0.5;

/// What one pixel says about its slopes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Informativeness {
    /// Median squared singular values of the shading Jacobian, larger and smaller.
    pub(crate) squared: [f64; 2],
    /// The share `t` of the rule.
    pub(crate) share: f64,
}

impl Informativeness {
    pub(crate) fn of(pixels: &Pixels, [p, q]: &Slopes, sigma: f64) -> Self {
        let (mut large, mut small) = (Vec::new(), Vec::new());
        for k in (0..pixels.len).step_by(1 + pixels.len / 5000) {
            if pixels.weight[k] == 0.0 {
                continue;
            }
            let facet = pixels.facet(k, [p[k], q[k]]);
            let (mut a, mut b, mut d) = (0.0_f64, 0.0_f64, 0.0_f64);
            for c in 0..pixels.channels {
                let (_, [jp, jq]) = facet.shade(&pixels.light(c, k));
                let (jp, jq) = (f64::from(jp), f64::from(jq));
                a += jp * jp;
                b += jp * jq;
                d += jq * jq;
            }
            let mean = 0.5 * (a + d);
            let root = (0.25 * (a - d).powi(2) + b * b).sqrt();
            large.push(mean + root);
            small.push((mean - root).max(0.0));
        }
        let squared = [
            median(&mut large).unwrap_or(0.0).max(1e-12),
            median(&mut small).unwrap_or(0.0),
        ];
        let signal = squared[1] * START_SLOPE_ERROR * START_SLOPE_ERROR;
        Self {
            squared,
            share: signal / (signal + sigma * sigma),
        }
    }

    /// Whether single pixels determine their normals.
    pub(crate) fn determined(&self) -> bool {
        self.share >= SEARCH_SHARE
    }

    /// First penalty.
    pub(crate) fn beta_start(&self, anchored: bool) -> f64 {
        let factor = if anchored {
            ANCHORED_START
        } else {
            UNANCHORED_START
        };
        let ambiguous = (factor * self.squared[0]).ln();
        let determined = (DETERMINED_START * self.squared[1])
            .max(1e-6 * self.squared[0])
            .ln();
        ((1.0 - self.share) * ambiguous + self.share * determined).exp()
    }
}

/// What one level does: iterations, and the part of the penalty's range (in logarithms, 0 to 1).
struct Part {
    num_iterations: usize,
    from: f64,
    to: f64,
}

const fn part(num_iterations: usize, from: f64, to: f64) -> Part {
    Part {
        num_iterations,
        from,
        to,
    }
}

/// Parts by level, finest first. Determined pixels may start low on every level; ambiguous ones
/// must not be loosened again once a coarse level has settled them; and without anchors coarse
/// levels would only drift.
const DETERMINED: [Part; 4] = [
    part(60, 0.0, 1.0),
    part(20, 0.0, 0.7),
    part(20, 0.0, 0.5),
    part(20, 0.0, 0.5),
];
const ANCHORED: [Part; 4] = [
    part(24, 0.2, 1.0),
    part(20, 0.1, 0.7),
    part(20, 0.0, 0.5),
    part(20, 0.0, 0.5),
];
const UNANCHORED: [Part; 2] = [part(30, 0.2, 1.0), part(20, 0.1, 0.7)];
/// Iterations with a search on the coarsest level.
const NUM_SEARCH_ITERATIONS: usize = 15;

/// The schedules for a ladder of levels, coarsest first.
pub(crate) fn level_schedules(
    num_levels: usize,
    known: &Informativeness,
    anchored: bool,
) -> Vec<LevelSchedule> {
    let determined = known.determined();
    let parts: &[Part] = match (determined, anchored) {
        (true, _) => &DETERMINED,
        (false, true) => &ANCHORED,
        (false, false) => &UNANCHORED,
    };
    let num_levels = num_levels.min(parts.len());
    let (start, end) = (known.beta_start(anchored), BETA_END * known.squared[0]);
    let at = |x: f64| start.powf(1.0 - x) * end.powf(x);
    (0..num_levels)
        .rev()
        .map(|level| {
            let part = &parts[level];
            let coarsest = level + 1 == num_levels;
            LevelSchedule {
                beta_start: at(part.from),
                growth: (at(part.to) / at(part.from)).powf(1.0 / part.num_iterations as f64),
                num_iterations: part.num_iterations,
                num_search_iterations: if determined && coarsest {
                    NUM_SEARCH_ITERATIONS
                } else {
                    0
                },
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_light_starts_stiff_and_three_different_lights_start_loose() {
        let grey = Informativeness {
            squared: [0.1, 0.0],
            share: 0.0,
        };
        let colour = Informativeness {
            squared: [0.4, 0.04],
            share: 0.9,
        };
        assert!((grey.beta_start(true) - 0.2).abs() < 1e-12);
        assert!((grey.beta_start(false) - 1.0).abs() < 1e-12);
        assert!(
            colour.beta_start(false) < 0.01,
            "{}",
            colour.beta_start(false)
        );
        assert_eq!(level_schedules(4, &grey, false).len(), 2);
        let schedules = level_schedules(3, &colour, true);
        assert_eq!(schedules.len(), 3);
        assert_eq!(schedules[0].num_search_iterations, NUM_SEARCH_ITERATIONS);
        for schedule in schedules {
            let end = schedule.beta_start * schedule.growth.powi(schedule.num_iterations as i32);
            assert!(end <= 15.0 * 0.4 * 1.0001, "{end}");
        }
    }
}
