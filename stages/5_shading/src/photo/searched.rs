//! Dense search at a finer level, where photos disagree too much to be compared pixel by pixel.
//!
//! Gloss, bounce and dirt make two photos of one point differ; the match term's σ_m grows with that
//! disagreement, and single pixels lose their hold on the surface. The correlation of patches cancels
//! gain and offset and still tells depth to a fraction of a pixel. So the tangent planes of the solved
//! surface are searched around once more, and the surface starts again from the depths that another view
//! confirms, fused over all views.
//!
//! The search knows no smoothness, and so finds the breaks that a plate bridges; gaps behind nearer
//! surfaces are continued (`edges`).

use super::course::Course;
use super::report::StepReport;
use super::solve::FUSION_PX;
use crate::error::ShadingError;
use rilievo_numerics::solver_set::SolverSet;
use rilievo_scene::PosedViews;
use rilievo_stereo::patchmatch::{PatchCost, Planes};
use rilievo_stereo::start;
use std::time::Instant;

/// Fusions of the searched surfaces: every view's search errs by itself, their mean errs less. The second
/// takes in what the first brought near.
const NUM_FUSIONS: usize = 2;
/// Distance within which they are fused, footprints: searched depths scatter more than solved ones.
const SEARCHED_FUSION_PX: f64 = 2.0 * FUSION_PX;

impl Course<'_> {
    /// The surface at level `at`, searched around `depths`.
    pub(crate) fn search_again(
        &mut self,
        at: usize,
        solvers: &SolverSet,
        depths: &[Vec<f64>],
        posed: &PosedViews,
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let began = Instant::now();
        self.tell("searching depth again", 0, 1)?;
        let level = self.scene.level(at);
        let tangent = |i: usize| Planes::tangent(&level.views[i], &depths[i]);
        let cost = PatchCost::Correlation;
        let searched = self.dense_search(at, posed, cost, Some(&tangent), |planes| {
            start::log_depths(&planes)
        })?;
        let found = self.found(at, solvers, &searched)?;
        self.show(at, "searched", &found.surface)?;
        let mut surface = found.surface;
        for _ in 0..NUM_FUSIONS {
            surface = self.fused(at, &surface, SEARCHED_FUSION_PX)?;
        }
        self.report.finer_search_scatter_px = Some(found.scatter_px);
        self.report.steps.push(StepReport {
            level: at,
            kind: "finer search".to_owned(),
            seconds: began.elapsed().as_secs_f64(),
            ..StepReport::default()
        });
        self.show(at, "searched, fused", &surface)?;
        Ok(surface)
    }
}
