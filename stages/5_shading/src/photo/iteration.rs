//! One outer iteration: Gauss-Newton rounds over all views under fixed weights and a fixed light.

use super::course::Course;
use super::light::Light;
use super::matching::{Likeness, MatchOptions};
use super::memory;
use super::report::StepReport;
use super::shading::{ShadingTerm, ShadingWeights};
use super::step::{self, StepOptions, StepOutcome};
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_numerics::solver_set::SolverSet;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::plate;
use rilievo_stereo::surfaces::Surfaces;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// The match term's σ_m over the median residual between the photos: the ratio that photos keep whose disagreement is
/// nothing but noise and the search's scatter.
const SIGMA_SHARE_OF_RESIDUAL: f64 = 0.47;
/// Side of the area of alike residuals up to which that share holds, pixels: JPEG's and interpolation's in sharp photos.
const USUAL_SIDE: f64 = 5.0;
/// Correlation of neighbouring residuals beyond which they are held to be no more alike.
const MAX_CORRELATION: f64 = 0.95;
/// Least σ_m: a seventeenth of a step of an 8-bit photo at mid grey.
const MIN_SIGMA_MATCH: f64 = 0.001;
/// Largest factor of σ_s for errors that the photos share: σ_s is then 1.4 standard deviations of the light's residual.
const MAX_SHARED_ERROR: f64 = 3.0;

/// Weights of one outer iteration.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct IterationWeights {
    /// Factor of the match term's σ_m.
    pub sigma_match_factor: f64,
    /// Standard deviation of the depth against another view that faces the surface as well, pixel
    /// footprints.
    pub consensus_px: f64,
    /// Depth difference to a view that sees the point, pixel footprints.
    pub visible_px: f64,
    /// Factor of the increments in the first and every other round: each view goes part of the way to where the views
    /// agree, since the others' surfaces are held fixed meanwhile. Half of the views move at once, and would swing
    /// against each other by long steps alone: the rounds between damp what swings.
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
    visible_px: 3.5,
    long_step: 1.0,
    plate: 90.0,
    plate_threshold: 0.05,
    shading: None,
};

/// Weights of the outer iterations with shading: shading starts weak, on a light fitted to a rough shape, and grows.
///
/// `σ_s = share · r (1 + (r/r₀)²)` of the light's median residual `r`: where the light explains the
/// photos as well as it can (2 to 3 %), shading weighs fully; at a residual of 20 % (pigment, dirt,
/// gloss) it is down-weighted to nothing: the misfit is pigment, dirt or gloss, not shape. Chroma is held
/// to its own noise by the same factor `σ_s / r`.
pub(crate) fn iteration_weights(iteration: usize, residual: f64) -> IterationWeights {
    // Residual at which the model's error outweighs relief.
    const LARGEST_RESIDUAL: f64 = 0.08;
    // Shading's share of the residual; the correction's sigma, pixels; the plate's weight and its Huber
    // threshold; consensus and visibility, footprints.
    let table = [
        (0.57, 0.0, 90.0, 0.02, 0.9, 3.5),
        (0.6, 0.0, 90.0, 0.02, 0.9, 3.5),
        (0.5, 8.0, 180.0, 0.05, 0.62, 3.5),
    ];
    let (share, correction_px, plate, plate_threshold, consensus_px, visible_px) =
        table[iteration.min(table.len() - 1)];
    let share = share * (1.0 + (residual / LARGEST_RESIDUAL).powi(2));
    IterationWeights {
        sigma_match_factor: 1.0,
        consensus_px,
        visible_px,
        long_step: 1.0,
        plate,
        plate_threshold,
        shading: Some(ShadingWeights {
            sigma: share * residual,
            chroma_share: share,
            threshold: 2.0,
            correction_px,
            max_correction: 0.15,
            chroma_noise: None,
        }),
    }
}

/// Weights of a step at a level of focal length `focal`, pixels; lengths in footprints of a pixel.
pub(crate) fn step_weights(
    focal: f64,
    sigma_match: f64,
    weights: &IterationWeights,
) -> StepOptions {
    let footprint = 1.0 / focal;
    StepOptions {
        matching: MatchOptions {
            sigma: weights.sigma_match_factor * sigma_match,
            threshold: 2.0,
            visible_tolerance: weights.visible_px * footprint,
            gain_field_px: 8.0,
            left_out: None,
        },
        sigma_consensus: weights.consensus_px * footprint,
        step_factor: 1.0,
        plate_weight: weights.plate,
        plate_threshold: weights.plate_threshold,
        max_step: 9.0 * footprint,
    }
}

/// Mean angle between the normals of two surfaces over all views of a level, degrees.
pub(crate) fn mean_turn_deg(level: &Level, from: &[Vec<f64>], to: &[Vec<f64>]) -> f64 {
    let turns: Vec<f64> = (0..level.views.len())
        .into_par_iter()
        .map(|i| plate::mean_turn(&level.views[i], &from[i], &to[i]))
        .collect();
    (turns.iter().sum::<f64>() / turns.len().max(1) as f64).to_degrees()
}

/// What was left between the photos when the last round of a step began.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MatchLeft {
    /// Median relative residual.
    residual: f64,
    /// Its correlation with the neighbouring pixel's.
    correlation: f64,
}

impl MatchLeft {
    pub(crate) fn of(step: &StepReport) -> Option<Self> {
        Some(Self {
            residual: step.match_residual?,
            correlation: step.match_correlation.unwrap_or(0.0),
        })
    }

    /// The match term's σ_m once shading has shaped the surface. Disagreement, from which σ_m follows at first, counts
    /// what varies slowly over the photos too, and that the gain fields take up. Where neighbouring residuals are alike,
    /// as in blurred photos, there is less to learn than there are pixels: an area of `((1 + ρ) / (1 - ρ))²` of them
    /// counts as one.
    pub(crate) fn sigma(self) -> f64 {
        let rho = self.correlation.min(MAX_CORRELATION);
        let side = (1.0 + rho) / (1.0 - rho);
        let share = SIGMA_SHARE_OF_RESIDUAL * (side / USUAL_SIDE).max(1.0);
        (share * self.residual).max(MIN_SIGMA_MATCH)
    }

    /// Factor of shading's σ_s at the finer levels, 1 to 3. What the light leaves in the photos (`light_residual`) is
    /// partly their noise, which differs between them and which their mean reduces, and partly what they share: fine
    /// pigment, light that the model lacks. The more the light's residual outweighs the residual between the photos, the
    /// less is noise, and what is shared neither a mean nor a neighbouring pixel reduces. The light's residual is that of
    /// the coarse level, which has little noise; the one between photos is of the level in work or the one before.
    pub(crate) fn shared_error(self, light_residual: f64) -> f64 {
        (light_residual / self.residual.max(f64::MIN_POSITIVE)).clamp(1.0, MAX_SHARED_ERROR)
    }
}

/// A view after a Gauss-Newton round.
#[derive(Serialize, Deserialize)]
struct Improved {
    /// New log depths.
    depth: Vec<f64>,
    /// Mean change of log depth, and mean turn of the normals, radians.
    moved: f64,
    turned: f64,
    /// Some of the relative residuals between the photos.
    residuals: Vec<f64>,
    likeness: Likeness,
    /// Share of the pixels that no source sees.
    seen_alone: f64,
}

impl Improved {
    fn of(view: &LevelView, before: &[f64], outcome: StepOutcome) -> Self {
        let matches = &outcome.matches;
        let alone = matches.num_visible.iter().filter(|&&n| n == 0).count();
        Self {
            moved: plate::mean_move(before, &outcome.depth),
            turned: plate::mean_turn(view, before, &outcome.depth),
            residuals: matches.some_residuals().collect(),
            likeness: matches.likeness,
            seen_alone: alone as f64 / matches.num_visible.len().max(1) as f64,
            depth: outcome.depth,
        }
    }
}

impl Course<'_> {
    /// [`step_weights`] of a level.
    pub(crate) fn step_options(&self, at: usize, weights: &IterationWeights) -> StepOptions {
        let sigma_match = match self.last_match() {
            Some(last) if weights.shading.is_some() => last.sigma(),
            _ => self.report.sigma_match,
        };
        step_weights(self.scene.level(at).focal(), sigma_match, weights)
    }

    /// What was left between photos that agree in the last step. Photos that disagree have none: on a surface that the patch
    /// search made rough, what is left measures the roughness too.
    pub(crate) fn last_match(&self) -> Option<MatchLeft> {
        let mut steps = self.report.steps.iter().rev();
        steps
            .find_map(MatchLeft::of)
            .filter(|_| !self.photos_disagree())
    }

    /// Gauss-Newton rounds over all views, until one changes the surface by less than the options'
    /// tolerances: depth, and where shading takes part normals (without it they follow the photos'
    /// noise for as long as they are let). Views of even and odd number take turns, so that two views
    /// never swap their surfaces. Returns the mean turn of the normals in the outer iteration, degrees.
    pub(crate) fn outer_iteration(
        &mut self,
        at: usize,
        solvers: &SolverSet,
        depths: &mut [Vec<f64>],
        weights: &IterationWeights,
        light: Option<&Light>,
        kind: &str,
    ) -> Result<f64, ShadingError> {
        let began = Instant::now();
        let options = self.step_options(at, weights);
        let mut record = StepReport {
            level: at,
            kind: kind.to_owned(),
            sigma_match: options.matching.sigma,
            sigma_shading: weights.shading.map_or(0.0, |s| s.sigma),
            ..StepReport::default()
        };
        let start = depths.to_vec();
        let mut seen_alone = vec![0.0; depths.len()];
        let max_num_rounds = self.options.max_num_rounds;
        for round in 0..max_num_rounds {
            self.tell(kind, round, max_num_rounds)?;
            let is_long = round % 2 == 0;
            let options = StepOptions {
                step_factor: if is_long { weights.long_step } else { 1.0 },
                ..options
            };
            let (scene, level) = (&self.scene, self.scene.level(at));
            let (mut moved, mut turned, mut residuals) = (0.0, 0.0, Vec::new());
            let mut likeness = Likeness::default();
            for parity in 0..2 {
                let surfaces = Surfaces::new(level, depths, self.reading());
                let views: Vec<usize> = (parity..level.views.len()).step_by(2).collect();
                let improved = self.divided_among(&views, memory::solve_bytes(level), |i| {
                    let (view, depth) = (&level.views[i], &depths[i]);
                    let harmonics = light.map(|light| scene.harmonics(light, i, at));
                    let shading = light.zip(harmonics.as_ref()).zip(weights.shading);
                    let term = shading.map(|((light, harmonics), weights)| {
                        let of_view = light.of(i, harmonics);
                        ShadingTerm::new(level, i, depth, &surfaces.rasters, &of_view, &weights)
                    });
                    let solver = solvers.of(i, &view.pixels);
                    let outcome = solver.and_then(|solver| {
                        step::improve(&surfaces, i, &solver, depth, term.as_ref(), &options)
                    });
                    let outcome = outcome.map_err(|e| self.failed(i, &e))?;
                    Ok(Improved::of(view, depth, outcome))
                })?;
                for (i, improved) in views.into_iter().zip(improved) {
                    moved += improved.moved;
                    turned += improved.turned;
                    residuals.extend(improved.residuals);
                    likeness.add(improved.likeness);
                    seen_alone[i] = improved.seen_alone;
                    depths[i] = improved.depth;
                }
            }
            let level = self.scene.level(at);
            let per_view = 1.0 / level.views.len() as f64;
            record.moved_px = moved * per_view * level.focal();
            record.turned_deg = (turned * per_view).to_degrees();
            record.match_residual = median(&mut residuals);
            record.match_correlation = likeness.correlation();
            record.num_rounds = round + 1;
            let is_still = record.moved_px < self.options.round_move_px;
            let keeps_normals = light.is_none() || record.turned_deg < self.options.round_turn_deg;
            if is_still && keeps_normals {
                break;
            }
        }
        for (view, share) in self.report.views.iter_mut().zip(seen_alone) {
            view.seen_alone = share;
        }
        let turned = mean_turn_deg(self.scene.level(at), &start, depths);
        record.turned_in_all_deg = turned;
        record.seconds = began.elapsed().as_secs_f64();
        self.report.steps.push(record);
        self.show(at, kind, depths)?;
        Ok(turned)
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
        assert_eq!(left(0.02, 0.3).shared_error(0.01), 1.0);
        assert_eq!(left(0.02, 0.3).shared_error(0.04), 2.0);
        assert_eq!(left(0.0, 0.0).shared_error(0.04), MAX_SHARED_ERROR);
        assert_eq!(left(0.0, 0.0).shared_error(0.0), 1.0);
    }
}
