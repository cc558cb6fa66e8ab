//! Stage 5: coupled multi-view shape from shading to depth and normal maps.

mod confidence;
mod error;
mod levels;
mod linearized;
mod matches;
mod model;
mod options;
pub mod photo;
mod pixels;
mod posed;
mod prepare;
mod problem;
mod result;
mod schedule;
mod solution;
mod solver;
mod splitting;
mod start;
mod theta;

pub use error::ShadingError;
pub use options::{
    Coupling, HarmonicOrder, PenaltySchedule, Projection, ShadingModel, ShadingOptions, Splitting,
    StartShape,
};
pub use problem::{
    DepthAnchor, DepthPrior, PixelLighting, ShadingProblem, ShadingView, ViewLight, ViewMatches,
};
pub use solution::{
    IterationRecord, ShadingReport, ShadingSolution, SolvedView, StepSeconds, Termination,
    ViewReport,
};

use rilievo_scene::{LightingCalibration, Observer, PhotoSet, PosedViews, ShadedViews};

/// Solves the views of a problem.
///
/// # Errors
/// See [`ShadingError`].
pub fn solve(
    problem: &ShadingProblem,
    options: &ShadingOptions,
    observer: &dyn Observer,
) -> Result<ShadingSolution, ShadingError> {
    solver::solve(problem, options, observer)
}

/// Dense shape of every posed view, from photos, poses with anchors, and lighting.
///
/// One posed view alone is solved by the paper's model, whatever `options.model` says: agreement
/// between photos needs two.
///
/// # Errors
/// See [`ShadingError`].
pub fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &ShadingOptions,
    observer: &dyn Observer,
) -> Result<(ShadedViews, ShadingReport), ShadingError> {
    options.validate()?;
    if options.model == ShadingModel::Photo && posed.views.len() > 1 {
        let (shaded, facts) = photo::run(photos, posed, lighting, &options.photo, observer)?;
        let report = ShadingReport {
            photo: Some(facts),
            ..ShadingReport::default()
        };
        return Ok((shaded, report));
    }
    posed::run(photos, posed, lighting, options, observer)
}
