//! Photographs' own model: shading under per-pixel light beside the photos' agreement with each other.
//!
//! On real photographs distant harmonics miss a tenth of the intensity and more, and bend the surface;
//! the photos' agreement under a static light holds it. Per view, unknown the log depth `ζ` of every
//! masked pixel:
//!
//! `min Σ_j ρ((I_j(x'(ζ)) − I_i(x))/σ_m) + Σ ρ((l·h(n(∇ζ)) − Ĩ(1+e))/σ_s)
//!  + Σ_j w_ij ρ(r_ij/σ_c) + α Σ ρ(D²ζ)`:
//!
//! agreement with the source views (`matching`), shading with nine coefficients a pixel (`shading`),
//! nearness to the other views' surfaces (`consensus`), a weak robust thin plate (`plate`); and
//! outermost pixels that turn away (`rim`).
//!
//! What needs no light stands in `rilievo_stereo`.
//!
//! Steps: dense search inside the visual hull (`search`, `patchmatch`); exposure gains and the
//! photos' disagreement (`gains`), from which the weights follow; a start that the views agree on
//! (`start`); Gauss-Newton rounds (`step`) over the terms `matching`, `consensus`, `plate`, `rim`
//! and `shading` against the other views' `surfaces`, first without shading, then in outer
//! iterations of light and shape (`environment`, `distant`) at half the coarse resolution and at
//! the coarse one, where the slow error that the views' searches share is taken off before each light but
//! the first (`searched_depths`), with the pigment divided out (`albedo`) and shading judged by photos that are
//! left out (`validation`); finer levels, searched once more where photos disagree (fused before
//! they are solved) and fused at the end (`consensus`); relief at the photos' own pixels, tile by
//! tile (`relief`); and what shape, light and pigment explain of the photos (`appearance`,
//! `confidence`).

mod albedo;
mod appearance;
mod chroma;
mod confidence;
#[cfg(test)]
mod consensus_tests;
mod contradiction;
#[cfg(test)]
mod derivative_tests;
mod distant;
mod environment;
mod findings;
mod hidden_light;
mod known_light;
mod light;
mod light_distance;
#[cfg(test)]
mod light_tests;
mod lit;
mod matching;
mod memory;
mod options;
mod output;
mod progress;
mod relief;
#[cfg(test)]
mod relief_tests;
mod relief_tiles;
mod relight;
#[cfg(test)]
mod rendered_tests;
mod report;
mod rim;
#[cfg(test)]
mod rim_tests;
mod rounds;
mod schedule;
mod search;
mod shading;
mod shape;
mod solve;
mod solver;
#[cfg(test)]
mod solvers_tests;
#[cfg(test)]
mod sphere_tests;
mod step;
mod steps;
mod surround;
mod validation;
mod views;

pub use memory::Sizes;
pub use options::{Effort, PhotoOptions};
pub use output::ShapedViews;
pub use report::{LightFacts, PhotoReport, PhotoViewReport, StepReport};
pub use solver::Probe;
pub use steps::{ExpectedStep, PhotoStep, forecast};
pub use validation::ValidationReport;

use crate::error::ShadingError;
use crate::surroundings::Surroundings;
use rilievo_scene::{LightingCalibration, PhotoSet, PosedViews};

/// Dense shape of all posed views, at least two.
///
/// Of `lighting` the samples, the kind and which spheres were rejected are used: the environment is fitted on
/// samples and object, with shadow and bounce, again after every change of the shape. Its harmonics serve to
/// refuse a light from elsewhere that the photos contradict (`contradiction`). After every outer iteration and every
/// round of relief the state goes to the checkpoint, and a run with the same input goes on from what it finds there.
///
/// # Errors
/// See [`ShadingError`].
pub fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &PhotoOptions,
    surroundings: Surroundings<'_>,
) -> Result<(ShapedViews, PhotoReport), ShadingError> {
    run_probed(photos, posed, lighting, options, surroundings, None)
}

/// [`run`], with the shape after every step handed to `probe`: for measuring which step does what.
///
/// # Errors
/// See [`ShadingError`].
pub fn run_probed(
    photos: &PhotoSet,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &PhotoOptions,
    surroundings: Surroundings<'_>,
    probe: Option<&Probe<'_>>,
) -> Result<(ShapedViews, PhotoReport), ShadingError> {
    options.validate()?;
    photos.check()?;
    posed.check_with(photos)?;
    lighting.check(posed)?;
    memory::refuse_too_little(photos, posed, options)?;
    let scene = views::load(photos, posed, options, surroundings.scratch)?;
    solve::solve(scene, posed, lighting, options, surroundings, probe)
}
