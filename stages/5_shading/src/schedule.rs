//! The penalty's course, computed from the lighting and the noise.
//!
//! **Rule.** Let `s₁ ≥ s₂` be the singular values of the shading Jacobian `∂S/∂(p, q)` (channels by
//! two), medians over pixels at the start, and `σ` the noise of intensities. Across the direction of
//! `s₂` a pixel knows its slope to `σ/s₂`. Where that is much less than the slopes of a start may err
//! (`D`), the pixel determines its own normal: the penalty may start low, `s₂²/8`, so that shading
//! moves the surface freely. Where it is much more (grey images: `s₂ = 0`), the image is explained
//! along one direction and says nothing across it: only a penalty as strong as the shading itself,
//! `2 s₁²`, keeps the start across while it corrects along. In between the logarithms are mixed by
//!
//! ```text
//! t = s₂² D² / (s₂² D² + 4 σ²),   ln β₀ = (1 − t) ln(2 s₁²) + t ln(s₂²/8).
//! ```
//!
//! The penalty ends at a multiple of `s₁²`, where ∇y and θ agree to a fraction of what shading can
//! tell, and grows geometrically between. Everything scales with squared intensity, so the rule
//! needs no tuning per data set. Source: METHOD 4 (the measured optima that the rule reproduces).

use crate::levels::Level;
use crate::model::Facet;
use crate::pixels::Pixels;
use crate::splitting::{Course, Schedule};
use rilievo_numerics::robust::median;

/// Slopes by which a start may err.
const START_SLOPE_ERROR: f64 = 0.3;
/// The penalty's end in units of `s₁²`.
const BETA_END: f64 = 15.0;
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
    pub(crate) fn of(pixels: &Pixels, p: &[f32], q: &[f32], sigma: f64) -> Self {
        let (mut large, mut small) = (Vec::new(), Vec::new());
        for k in (0..pixels.len).step_by(1 + pixels.len / 5000) {
            if pixels.weight[k] == 0.0 {
                continue;
            }
            let facet = Facet::new([pixels.ray_x[k], pixels.ray_y[k]], [p[k], q[k]]);
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
            share: signal / (signal + 4.0 * sigma * sigma),
        }
    }

    /// First penalty.
    pub(crate) fn beta_start(&self) -> f64 {
        let ambiguous = (2.0 * self.squared[0]).ln();
        let determined = (self.squared[1] / 8.0).max(1e-6 * self.squared[0]).ln();
        ((1.0 - self.share) * ambiguous + self.share * determined).exp()
    }
}

/// The automatic schedule for a ladder of levels.
pub(crate) fn automatic(levels: &[Level], known: &Informativeness) -> Schedule {
    let determined = known.share >= SEARCH_SHARE;
    let beta_start = known.beta_start();
    let end = BETA_END * known.squared[0];
    let mut courses: Vec<Course> = (0..levels.len())
        .map(|level| Course {
            num_iterations: match (level, determined) {
                (0, true) => 24,
                (0, false) => 30,
                _ => 20,
            },
            num_search_iterations: if determined && level + 1 == levels.len() {
                10
            } else {
                0
            },
        })
        .collect();
    courses.reverse();
    let total: usize = courses.iter().map(|c| c.num_iterations).sum();
    let growth = (end / beta_start).max(2.0).powf(1.0 / total.max(1) as f64);
    Schedule {
        beta_start,
        growth,
        courses,
    }
}
