//! Output of the solver: maps, and a report of facts.

use rilievo_scene::{ConfidenceMap, DepthMap, LinearImage, NormalMap};
use serde::{Deserialize, Serialize};

/// Shape of one view.
#[derive(Clone, Debug, PartialEq)]
pub struct SolvedView {
    /// The view's name.
    pub name: String,
    /// Depth along the optical axis, 0 outside the mask.
    pub depth: DepthMap,
    /// Unit normals in the camera frame, zero outside the mask.
    pub normal: NormalMap,
    /// The image that the shape explains.
    pub rendered: LinearImage,
    /// How well data and anchors determine each pixel, 0 to 1.
    pub confidence: ConfidenceMap,
}

/// Result of [`super::solve`].
#[derive(Clone, Debug)]
pub struct ShadingSolution {
    /// One entry per view of the problem, in its order.
    pub views: Vec<SolvedView>,
    /// Facts.
    pub report: PaperReport,
}

/// Why an iteration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Termination {
    /// The energy changed by less than the tolerance.
    Converged,
    /// The penalty schedule came to its end.
    ScheduleEnded,
    /// The largest number of iterations was reached.
    MaxIterations,
}

/// One iteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct IterationRecord {
    /// Grid level, 0 is the image's own resolution.
    pub level: usize,
    /// Penalty.
    pub beta: f64,
    /// Sum of squared intensity residuals at the slopes of the z-step's depth (or of θ, where the
    /// splitting has no cheaper one).
    pub energy: f64,
    /// RMS of ∇z − θ.
    pub primal_residual: f64,
    /// RMS of the change of ∇z.
    pub dual_residual: f64,
}

/// Facts on one view.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewReport {
    /// The view's name.
    pub name: String,
    /// Pixels inside the mask.
    pub num_pixels: usize,
    /// Pixels left out of the shading term because a channel is clipped.
    pub num_saturated: usize,
    /// Pixels left out because they are darker than the shadow level.
    pub num_shadowed: usize,
    /// Pixels left out because their intensity is not finite.
    pub num_not_finite: usize,
    /// Pixels at which the gradient was cut.
    pub num_depth_breaks: usize,
    /// Anchors that were used.
    pub num_anchors: usize,
    /// Anchors that were rejected as outliers.
    pub num_anchors_rejected: usize,
    /// RMS difference of image and re-rendered result.
    pub rms_rendered: f64,
    /// The same at the start.
    pub rms_start: f64,
    /// Median smaller singular value of the shading Jacobian over slopes, per intensity unit:
    /// how well one pixel determines its own normal.
    pub informativeness: f64,
    /// First penalty.
    pub beta_start: f64,
    /// Sum of squared intensity residuals.
    pub energy_shading: f64,
    /// Weighted prior term.
    pub energy_prior: f64,
    /// Weighted area term.
    pub energy_area: f64,
    /// Iterations in order.
    pub iterations: Vec<IterationRecord>,
    /// Why they ended.
    pub termination: Option<Termination>,
    /// Seconds in the start, θ-steps, z-steps and everything else.
    pub seconds: StepSeconds,
}

/// Wall time by step, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepSeconds {
    /// Start shape and set-up.
    pub start: f64,
    /// θ-steps.
    pub theta: f64,
    /// z-steps.
    pub z: f64,
    /// All.
    pub total: f64,
}

/// Facts on a solve.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PaperReport {
    /// Per view.
    pub views: Vec<ViewReport>,
    /// Matches between views, and how many were used.
    pub num_matches: usize,
    /// Matches rejected as outliers.
    pub num_matches_rejected: usize,
    /// Estimated standard deviation of a match, pixels.
    pub match_sigma_px: Option<f64>,
}
