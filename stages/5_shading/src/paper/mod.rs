//! The paper's model: distant harmonics on every view, depth held by anchors.
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
//! builds the problem from posed views (`posed`).
//!
//! Source: Quéau, Mélou, Durou, Cremers, ICCV 2017 (`queau2017`).

mod breaks;
mod confidence;
mod levels;
mod linearized;
mod matches;
mod model;
mod options;
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

pub use options::{HarmonicOrder, PaperOptions, Projection, Splitting, StartShape};
pub use problem::{
    DepthAnchor, DepthPrior, PixelLighting, ShadingProblem, ShadingView, ViewLight, ViewMatches,
};
pub use solution::{
    IterationRecord, PaperReport, ShadingSolution, SolvedView, StepSeconds, Termination, ViewReport,
};

use crate::error::ShadingError;
use rilievo_scene::{LightingCalibration, Observer, PhotoSet, PosedViews, ShadedViews};

/// Solves the views of a problem.
///
/// # Errors
/// See [`ShadingError`].
pub fn solve(
    problem: &ShadingProblem,
    options: &PaperOptions,
    observer: &dyn Observer,
) -> Result<ShadingSolution, ShadingError> {
    solver::solve(problem, options, observer)
}

/// Dense shape of every posed view, from photos, poses with anchors, and lighting.
///
/// # Errors
/// See [`ShadingError`].
pub fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &PaperOptions,
    observer: &dyn Observer,
) -> Result<(ShadedViews, PaperReport), ShadingError> {
    options.validate()?;
    photos.check()?;
    posed.check_with(photos)?;
    lighting.check(posed)?;
    posed::run(photos, posed, lighting, options, observer)
}
