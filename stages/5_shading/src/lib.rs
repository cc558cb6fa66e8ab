//! Stage 5: coupled multi-view shape from shading to depth and normal maps.
//!
//! **In**: views with linear images, masks, cameras, lighting, and whatever is known of depth (a
//! start, anchors, matches with other views, a depth prior). **Out**: depth, normals, re-rendered image
//! and confidence per view, and a report of energies, residuals and times.
//!
//! **Method.** Per view, over the log depth `z̃` (eq. 7, 8),
//!
//! ```text
//! min  Σ_pixels w Σ_c (ρ^c l^c·h(n(∇z̃)) − I^c)² + ν Σ d + μ Σ (z̃ − z̃₀)² + Σ_anchors (z̃ − z̃_a)² σ_I²/σ_a²
//! ```
//!
//! 1. [`solve`] checks the views and gathers usable pixels (`prepare`); matches between posed views are
//!    triangulated, and false ones rejected, into anchors (`matches`).
//! 2. The start is a robust thin plate through the anchors, a given depth, or a plane (`start`).
//! 3. Full splitting: θ-step per pixel (`theta`, on the model of `model`), z-step by multigrid on the
//!    corner grid of `rilievo_numerics`, on a ladder of resolutions (`levels`, `splitting`), with a
//!    penalty whose course follows from lighting, noise and anchors (`schedule`).
//! 4. Normals are drawn from the surface's slopes towards what each pixel says; confidence (`confidence`)
//!    and maps (`result`) follow.
//!
//! The paper's own splitting and the fixed point without one stand beside it (`linearized`). [`run`]
//! builds the problem from posed views (`posed`), or hands them to the photographs' own model
//! ([`photo`]).
//!
//! Source: Quéau, Mélou, Durou, Cremers, ICCV 2017 (`queau2017`).

#[cfg(test)]
// Tests in the sources share scenes with those outside.
extern crate self as rilievo_shading;

mod breaks;
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

pub use error::{LightMisfit, ShadingError};
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

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 13;

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
        let (shaded, mut facts) = photo::run(photos, posed, lighting, &options.photo, observer)?;
        let report = ShadingReport {
            light: std::mem::take(&mut facts.light),
            photo: Some(facts),
            ..ShadingReport::default()
        };
        return Ok((shaded, report));
    }
    photos.check()?;
    posed.check_with(photos)?;
    lighting.check(posed)?;
    let (shaded, mut report) = posed::run(photos, posed, lighting, options, observer)?;
    report.light.clone_from(&lighting.views);
    Ok((shaded, report))
}
