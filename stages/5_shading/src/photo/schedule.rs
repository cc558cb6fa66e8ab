//! Weights of the terms, from the first surface to the photos' own pixels.

use super::matching::{self, MatchOptions};
use super::report::StepReport;
use super::shading::ShadingWeights;
use super::step::StepOptions;
use serde::{Deserialize, Serialize};

/// The match term's σ_m over the median residual between the photos: the ratio that photos keep
/// whose disagreement is nothing but noise and the search's scatter.
const SIGMA_SHARE_OF_RESIDUAL: f64 = 0.47;
/// Side of the area of alike residuals up to which that share holds, pixels: JPEG's and
/// interpolation's in sharp photos.
const USUAL_SIDE: f64 = 5.0;
/// Correlation of neighbouring residuals beyond which they are held to be no more alike.
const MAX_CORRELATION: f64 = 0.95;
/// Least σ_m: a seventeenth of a step of an 8-bit photo at mid grey.
const MIN_SIGMA_MATCH: f64 = 0.001;
/// Largest factor of σ_s for errors that the photos share: σ_s is then 1.4 standard deviations of
/// the light's residual.
const MAX_SHARED_ERROR: f64 = 3.0;

/// Depth difference within which a view sees a point, pixel footprints.
const VISIBLE_PX: f64 = 3.5;
/// σ_c at the finest level of all, footprints: only noise separates the views there, and averaging
/// removes it. Less flattens fine detail.
const FINEST_CONSENSUS_PX: f64 = 0.3;
/// Factor of σ_m around a searched surface: the patch search has fixed the depth, and residuals of
/// single pixels are noisy.
const SEARCHED_SIGMA_MATCH_FACTOR: f64 = 3.0;
/// Factor of every other increment at finer levels: without it they end half-way to where the views
/// agree. A surface that was searched again is rough, and longer steps would follow its noise.
const LONG_STEP: f64 = 2.0;
/// Factor of shading's standard deviations at finer levels, whose single pixels are noisier.
const FINER_NOISE: f64 = 1.4;
/// Standard deviation of the shading correction's Gaussian at finer levels, pixels.
const FINER_CORRECTION_PX: f64 = 12.0;
/// Light residual at which the model's error outweighs relief.
const LARGEST_RESIDUAL: f64 = 0.08;

/// An outer iteration with shading. Shading starts weak, on a light fitted to a rough shape, and
/// grows.
struct ScheduleStep {
    /// σ_s over the light's median residual, where that is small.
    shading_share: f64,
    /// Standard deviation of the shading correction's Gaussian, pixels; 0 is off.
    correction_px: f64,
    plate: f64,
    plate_threshold: f64,
    consensus_px: f64,
}

/// The last one serves all further iterations.
const SCHEDULE: [ScheduleStep; 3] = [
    ScheduleStep {
        shading_share: 0.57,
        correction_px: 0.0,
        plate: 90.0,
        plate_threshold: 0.02,
        consensus_px: 0.9,
    },
    ScheduleStep {
        shading_share: 0.6,
        correction_px: 0.0,
        plate: 90.0,
        plate_threshold: 0.02,
        consensus_px: 0.9,
    },
    ScheduleStep {
        shading_share: 0.5,
        correction_px: 8.0,
        plate: 180.0,
        plate_threshold: 0.05,
        consensus_px: 0.62,
    },
];

/// Weights of one outer iteration.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct IterationWeights {
    /// Factor of the match term's σ_m.
    pub sigma_match_factor: f64,
    /// Standard deviation of the depth against another view that faces the surface as well, pixel
    /// footprints.
    pub consensus_px: f64,
    /// Factor of the increments in the first and every other round: each view goes part of the way
    /// to where the views agree, since the others' surfaces are held fixed meanwhile. Half of the
    /// views move at once, and would swing against each other by long steps alone: the rounds
    /// between damp what swings.
    pub long_step: f64,
    /// Weight of squared turns of the normal from a pixel to the next.
    pub plate: f64,
    /// Turn at which the plate turns linear, radians.
    pub plate_threshold: f64,
    /// Shading, where it takes part.
    pub shading: Option<ShadingWeights>,
}

/// Agreement alone.
pub(crate) const PHOTOS_ONLY: IterationWeights = IterationWeights {
    sigma_match_factor: 1.0,
    consensus_px: 0.9,
    long_step: 1.0,
    plate: 90.0,
    plate_threshold: 0.05,
    shading: None,
};

impl IterationWeights {
    /// Weights of an outer iteration with shading.
    ///
    /// `σ_s = share · r (1 + (r/r₀)²)` of the light's median residual `r`: where the light explains
    /// the photos as well as it can (2 to 3 %), shading weighs fully; at a residual of 20 % it is
    /// down-weighted to nothing: the misfit is pigment, dirt or gloss, not shape. Chroma is held to
    /// its own noise by the same factor `σ_s / r`.
    pub fn with_shading(iteration: usize, residual: f64) -> Self {
        let step = &SCHEDULE[iteration.min(SCHEDULE.len() - 1)];
        let share = step.shading_share * (1.0 + (residual / LARGEST_RESIDUAL).powi(2));
        Self {
            consensus_px: step.consensus_px,
            plate: step.plate,
            plate_threshold: step.plate_threshold,
            shading: Some(ShadingWeights {
                sigma: share * residual,
                chroma_share: share,
                threshold: 2.0,
                correction_px: step.correction_px,
                max_correction: 0.15,
                chroma_noise: None,
            }),
            ..PHOTOS_ONLY
        }
    }

    /// With the nearness of the finest level of all.
    pub fn at_finest(self) -> Self {
        Self {
            consensus_px: FINEST_CONSENSUS_PX,
            ..self
        }
    }

    /// Weights at a level finer than that of the outer iterations, from those of the last of them;
    /// `is_searched`: depth was searched there again.
    pub fn finer(self, is_searched: bool, is_finest: bool, shared_error: f64) -> Self {
        let (sigma_match_factor, long_step) = if is_searched {
            (SEARCHED_SIGMA_MATCH_FACTOR, 1.0)
        } else {
            (1.0, LONG_STEP)
        };
        let weights = Self {
            sigma_match_factor,
            long_step,
            consensus_px: PHOTOS_ONLY.consensus_px,
            plate_threshold: PHOTOS_ONLY.plate_threshold,
            // Chroma keeps to its own noise, which is measured per level.
            shading: self.shading.map(|shading| ShadingWeights {
                sigma: shading.sigma * (FINER_NOISE * shared_error),
                chroma_share: shading.chroma_share * FINER_NOISE,
                correction_px: FINER_CORRECTION_PX,
                ..shading
            }),
            ..self
        };
        if is_finest {
            weights.at_finest()
        } else {
            weights
        }
    }

    /// With the plate for a surface whose normals typically turn by `scale` radians from a pixel to
    /// the next.
    pub fn with_turns(self, scale: Option<f64>) -> Self {
        scale.map_or(self, |scale| Self {
            plate: 0.5 / (scale * scale),
            plate_threshold: scale,
            ..self
        })
    }

    /// The weights of a Gauss-Newton step at a level of focal length `focal`, pixels.
    pub fn of_step(&self, focal: f64, sigma_match: f64) -> StepOptions {
        let footprint = 1.0 / focal;
        StepOptions {
            matching: MatchOptions {
                sigma: self.sigma_match_factor * sigma_match,
                threshold: 2.0,
                visible_tolerance: VISIBLE_PX * footprint,
                gain_field_px: 8.0,
                left_out: None,
            },
            sigma_consensus: self.consensus_px * footprint,
            step_factor: 1.0,
            plate_weight: self.plate,
            plate_threshold: self.plate_threshold,
            max_step: 9.0 * footprint,
        }
    }
}

/// The residual between the photos when the last round of a step began.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MatchLeft {
    /// Median relative residual.
    residual: f64,
    /// Its correlation with the neighbouring pixel's.
    correlation: f64,
}

impl MatchLeft {
    pub fn of(step: &StepReport) -> Option<Self> {
        Some(Self {
            residual: step.match_residual?,
            correlation: step.match_correlation.unwrap_or(0.0),
        })
    }

    /// The match term's σ_m once shading has shaped the surface. Disagreement, from which σ_m follows
    /// at first, also counts what varies slowly over the photos, which the gain fields take up.
    ///
    /// Alike residuals, as in blurred photos, count as one pixel.
    pub fn sigma(self) -> f64 {
        let share = SIGMA_SHARE_OF_RESIDUAL * (self.alike_px() / USUAL_SIDE).max(1.0);
        (share * self.residual).max(MIN_SIGMA_MATCH)
    }

    /// Whether the photos hold detail at this level that they do not hold at half its resolution. There alike residuals
    /// are half as wide; where they still are no narrower than those of a sharp photo, all detail is in that level. All
    /// views count alike: where most are blurred, the sharp one's detail has no other to confirm it.
    pub fn has_detail(self) -> bool {
        self.alike_px() < 2.0 * USUAL_SIDE
    }

    fn alike_px(self) -> f64 {
        matching::alike_px(self.correlation.min(MAX_CORRELATION))
    }

    /// Factor of shading's σ_s at the finer levels, 1 to 3.
    ///
    /// The light's residual is partly noise, which differs between the photos and which their mean
    /// reduces, and partly shared: fine pigment, light that the model lacks. The more it outweighs
    /// the residual between the photos, the less of it is noise, and neither a mean nor a
    /// neighbouring pixel reduces the rest. The light's residual is that of the coarse level, which
    /// has little noise; the one between photos is of the level at hand or the one before.
    pub fn shared_error(self, light_residual: f64) -> f64 {
        (light_residual / self.residual.max(f64::MIN_POSITIVE)).clamp(1.0, MAX_SHARED_ERROR)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_that_are_alike_weigh_less_and_shared_ones_make_shading_weigh_less() {
        let left = |residual, correlation| MatchLeft {
            residual,
            correlation,
        };
        let sharp = left(0.02, 0.3).sigma();
        assert!((sharp - SIGMA_SHARE_OF_RESIDUAL * 0.02).abs() < 1e-12);
        // (1 + 0.8) / (1 - 0.8) = 9 pixels.
        let blurred = left(0.02, 0.8).sigma();
        assert!((blurred / sharp - 9.0 / USUAL_SIDE).abs() < 1e-12);
        assert_eq!(left(0.02, 1.0).sigma(), left(0.02, 0.99).sigma());
        assert_eq!(left(0.0, 0.0).sigma(), MIN_SIGMA_MATCH);
        // (1 + 0.85) / (1 - 0.85) = 12.3 pixels.
        assert_eq!(
            [0.3, 0.8, 0.85].map(|rho| left(0.02, rho).has_detail()),
            [true, true, false]
        );
        assert_eq!(left(0.02, 0.3).shared_error(0.01), 1.0);
        assert_eq!(left(0.02, 0.3).shared_error(0.04), 2.0);
        assert_eq!(left(0.0, 0.0).shared_error(0.04), MAX_SHARED_ERROR);
        assert_eq!(left(0.0, 0.0).shared_error(0.0), 1.0);
    }
}
