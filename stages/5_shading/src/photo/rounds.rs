//! One outer iteration: Gauss-Newton rounds over all views under fixed weights and a fixed light.

use super::light::Light;
use super::matching::Likeness;
use super::memory;
use super::report::StepReport;
use super::schedule::{IterationWeights, MatchLeft};
use super::shading::ShadingTerm;
use super::solver::Solver;
use super::step::{self, StepOptions, StepOutcome};
use super::steps::PhotoStep;
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_numerics::solver_set::SolverSet;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::plate;
use rilievo_stereo::surfaces::Surfaces;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Mean change of depth in a round, pixel footprints, below which an outer iteration may end.
/// Smaller costs rounds that change nothing that the photos show.
const STILL_PX: f64 = 0.1;
/// Mean turn of the normals in a round, degrees, below which an outer iteration with shading may
/// end: a tenth of what normals err in the end.
const STILL_DEG: f64 = 0.4;

/// Mean angle between the normals of two surfaces over all views of a level, degrees.
fn mean_turn_deg(level: &Level, from: &[Vec<f64>], to: &[Vec<f64>]) -> f64 {
    let turns: Vec<f64> = (0..level.views.len())
        .into_par_iter()
        .map(|i| plate::mean_turn(&level.views[i], &from[i], &to[i]))
        .collect();
    (turns.iter().sum::<f64>() / turns.len().max(1) as f64).to_degrees()
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

impl Solver<'_> {
    /// The weights of a Gauss-Newton step at a level.
    pub fn step_options(&self, at: usize, weights: &IterationWeights) -> StepOptions {
        let sigma_match = match self.last_match() {
            Some(last) if weights.shading.is_some() => last.sigma(),
            _ => self.report.sigma_match,
        };
        weights.of_step(self.scene.level(at).focal(), sigma_match)
    }

    /// The residual between photos that agree in the last step. For levels solved as a whole photos that disagree have
    /// none: on a surface that the patch search made rough, it measures the roughness too.
    pub fn last_match(&self) -> Option<MatchLeft> {
        let mut steps = self.report.steps.iter().rev();
        steps
            .find_map(MatchLeft::of)
            .filter(|_| !self.photos_disagree())
    }

    /// Gauss-Newton rounds over all views, until one hardly changes depth, and where shading takes
    /// part normals (without it they follow the photos' noise for ever). Views of even and odd
    /// number take turns, so that two views never swap their surfaces. Returns the mean turn of the
    /// normals in all rounds, degrees.
    pub fn rounds(
        &mut self,
        at: usize,
        solvers: &SolverSet,
        depths: &mut [Vec<f64>],
        weights: &IterationWeights,
        light: Option<&Light>,
        step: PhotoStep,
    ) -> Result<f64, ShadingError> {
        let began = Instant::now();
        let options = self.step_options(at, weights);
        let mut record = StepReport {
            level: at,
            step,
            sigma_match: options.matching.sigma,
            sigma_shading: weights.shading.map_or(0.0, |s| s.sigma),
            ..StepReport::default()
        };
        let start = depths.to_vec();
        let mut seen_alone = vec![0.0; depths.len()];
        let max_num_rounds = self.options.effort.max_num_rounds;
        for round in 0..max_num_rounds {
            self.progress(step, round, max_num_rounds)?;
            let is_long = round % 2 == 0;
            let options = StepOptions {
                step_factor: if is_long { weights.long_step } else { 1.0 },
                ..options
            };
            let (scene, level) = (&self.scene, self.scene.level(at));
            let (mut moved, mut turned, mut residuals) = (0.0, 0.0, Vec::new());
            let mut likeness = Likeness::default();
            for parity in 0..2 {
                let surfaces = Surfaces::new(level, depths, self.reading())
                    .with_certainty(self.certainty.as_deref());
                let views: Vec<usize> = (parity..level.views.len()).step_by(2).collect();
                let improved = self.divided_among(&views, memory::solve_bytes(level), |i| {
                    let (view, depth) = (&level.views[i], &depths[i]);
                    let of_view = light.map(|light| light.of(i, scene.harmonics(light, i, at)));
                    let term = of_view
                        .as_ref()
                        .zip(weights.shading)
                        .map(|(light, weights)| {
                            ShadingTerm::new(level, i, depth, &surfaces.rasters, light, &weights)
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
            let is_still = record.moved_px < STILL_PX;
            let keeps_normals = light.is_none() || record.turned_deg < STILL_DEG;
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
        self.show(at, step.message(), depths)?;
        Ok(turned)
    }
}
