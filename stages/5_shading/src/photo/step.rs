//! One Gauss-Newton step on the log depth of one view.
//!
//! `min_ζ Σ ρ(r_match) + Σ ρ(r_consensus) + Σ ρ(r_shading) + Σ r_outline² + α Σ ρ(turns)`; every term is linearised
//! around the current depth and the increment solves the thirteen-point normal equations.

use super::matching::{self, MatchOptions, MatchTerms};
use super::rim;
use super::shading::ShadingTerm;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::{PlateError, PlateSystem};
use rilievo_stereo::consensus;
use rilievo_stereo::plate::{self, RobustPlate};
use rilievo_stereo::surfaces::Surfaces;

/// Weights of a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepOptions {
    pub matching: MatchOptions,
    /// Standard deviation of the log depth against the other views' surfaces; 0 is off.
    pub sigma_consensus: f64,
    /// Factor of the increments, which [`Self::max_step`] bounds afterwards.
    pub step_factor: f64,
    /// Weight of squared turns of the normal from a pixel to the next.
    pub plate_weight: f64,
    /// Turn, radians, beyond which the penalty grows only linearly.
    pub plate_threshold: f64,
    /// Largest change of log depth.
    pub max_step: f64,
}

/// What a step did.
#[derive(Clone, Debug)]
pub(crate) struct StepOutcome {
    /// New log depths.
    pub depth: Vec<f64>,
    /// Terms of the photos' agreement before the step.
    pub matches: MatchTerms,
}

/// Improves view `index` from its log depths `depth`, against the `surfaces` of all views.
pub(crate) fn improve(
    surfaces: &Surfaces,
    index: usize,
    solver: &PlateSolver,
    depth: &[f64],
    shading: Option<&ShadingTerm>,
    options: &StepOptions,
) -> Result<StepOutcome, PlateError> {
    let level = surfaces.level;
    let view = &level.views[index];
    let n = view.pixels.len();
    let mut matches = matching::terms(level, index, depth, &surfaces.rasters, &options.matching);
    if options.sigma_consensus > 0.0 {
        let (mut h, mut b) = (vec![0.0; n], vec![0.0; n]);
        consensus::add_terms(
            surfaces,
            index,
            depth,
            options.sigma_consensus,
            2.0 * options.matching.visible_tolerance,
            (&mut h, &mut b),
        );
        for i in 0..n {
            matches.hessian[i] += h[i];
            matches.rhs[i] += b[i];
        }
    }
    let mut system = PlateSystem::new(n);
    for i in 0..n {
        // A tiny pull to the current depth keeps unseen islands solvable.
        system.coefficients[i][0] += matches.hessian[i] + 1e-6;
        system.rhs[i] += matches.rhs[i];
    }
    plate::add_robust_plate(
        view,
        &mut system,
        options.plate_weight,
        &RobustPlate {
            depth,
            threshold: options.plate_threshold,
        },
    );
    rim::add_terms(view, depth, &matches.num_visible, &mut system);
    if let Some(shading) = shading {
        shading.add(view, depth, &mut system);
    }
    let increment = solver.solve(&system)?;
    let depth = depth
        .iter()
        .zip(&increment)
        .map(|(z, d)| z + (options.step_factor * d).clamp(-options.max_step, options.max_step))
        .collect();
    Ok(StepOutcome { depth, matches })
}
