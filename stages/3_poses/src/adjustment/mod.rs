//! Bundle adjustment.
//!
//! Minimises `E = Σ_k ρ(|π(c_k, P_k, X_k) − x_k| / σ_k) + Σ ρ_q((q − q₀)/σ_q)` over poses `P` (rotation,
//! centre), points `X` and, where asked, intrinsics `q` of each camera group with priors; `ρ` a robust
//! loss, `σ_k` the standard deviation of an observation in pixels. `ρ_q` is Cauchy's: what EXIF says of a
//! focal length is either nearly right or, after cropping or for another sensor, plainly wrong.
//! Levenberg-Marquardt with iterated weights ([`rilievo_numerics::least_squares`]); the step by the
//! Schur complement of the points ([`schur`]).
//!
//! The gauge is fixed by one view (all six parameters) and one coordinate of the centre farthest
//! from it, unless enough views are held fixed anyway.

mod bundle;
mod factor;
mod layout;
mod schur;

pub(crate) use bundle::{AdjustedCamera, AdjustedView, Bundle, Observation};

use crate::error::PosesError;
use factor::Method;
use layout::Layout;
use rilievo_numerics::least_squares::{
    DampedProblem, DampedStep, LeastSquaresError, LeastSquaresOptions, SolveReport,
    levenberg_marquardt,
};
use rilievo_numerics::robust::RobustLoss;
use schur::{Covariances, Step, System};

/// Loss of a model that still grows, with outliers about, and of one that is complete; of the
/// reprojection error over its standard deviation.
const GROWING_LOSS: RobustLoss = RobustLoss::Cauchy(3.0);
pub(crate) const FINAL_LOSS: RobustLoss = RobustLoss::Cauchy(2.0);

/// When to stop and how to treat outliers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BundleOptions {
    pub loss: RobustLoss,
    pub max_num_iterations: usize,
    /// Stop when the cost falls by less than this share.
    pub relative_cost_change: f64,
}

impl BundleOptions {
    /// While the model grows.
    pub fn growing() -> Self {
        Self {
            loss: GROWING_LOSS,
            max_num_iterations: 30,
            relative_cost_change: 1e-4,
        }
    }

    /// Of a complete model.
    pub fn complete(relative_cost_change: f64) -> Self {
        Self {
            loss: FINAL_LOSS,
            max_num_iterations: 50,
            relative_cost_change,
        }
    }
}

impl Bundle {
    /// Moves everything by a step; what was seen is shared, not copied.
    fn retract(&self, layout: &Layout, step: &Step) -> Self {
        let mut moved = self.clone();
        for (view, columns) in moved.views.iter_mut().zip(&layout.views) {
            let mut tangent = [0.0; 6];
            let mut any = false;
            for (value, column) in tangent.iter_mut().zip(columns) {
                if let Some(column) = column {
                    *value = step.reduced[*column];
                    any = true;
                }
            }
            if any {
                view.pose = view.pose.retract(&tangent);
            }
        }
        for (camera, columns) in moved.cameras.iter_mut().zip(&layout.cameras) {
            for (deviation, column) in camera.deviation.iter_mut().zip(columns) {
                if let Some(column) = column {
                    *deviation += step.reduced[*column];
                }
            }
        }
        for (point, delta) in moved.points.iter_mut().zip(&step.points) {
            *point += delta;
        }
        moved
    }

    /// Minimises the cost in place.
    ///
    /// # Errors
    /// When the start has no finite cost, or the normal matrix is singular however damped.
    pub fn adjust(&mut self, options: &BundleOptions) -> Result<SolveReport, PosesError> {
        let layout = Layout::new(self);
        let problem = Problem {
            layout: &layout,
            method: Method::new(&layout.pattern),
            loss: options.loss,
        };
        let solver_options = LeastSquaresOptions {
            max_num_iterations: options.max_num_iterations,
            relative_cost_change: options.relative_cost_change,
            ..LeastSquaresOptions::default()
        };
        let solved = levenberg_marquardt(&problem, self.clone(), &solver_options);
        let (adjusted, report) =
            solved.map_err(|error: LeastSquaresError| PosesError::Adjustment {
                num_views: self.views.len(),
                reason: error.to_string(),
            })?;
        *self = adjusted;
        Ok(report)
    }

    /// Covariances of poses `(ω, δ)` and points for observations of unit variance, in the gauge
    /// that is fixed; `None` when the normal matrix is singular.
    pub fn covariances(&self, loss: RobustLoss) -> Option<Covariances> {
        let layout = Layout::new(self);
        let method = Method::new(&layout.pattern);
        System::build(self, &layout, loss).covariances(&layout, &method)
    }
}

/// A bundle as a problem of the solver.
struct Problem<'a> {
    layout: &'a Layout,
    method: Method<'a>,
    loss: RobustLoss,
}

impl DampedProblem for Problem<'_> {
    type State = Bundle;
    type System = System;
    type Step = Step;

    fn cost(&self, bundle: &Bundle) -> f64 {
        bundle.cost(self.loss)
    }

    fn linearize(&self, bundle: &Bundle) -> System {
        System::build(bundle, self.layout, self.loss)
    }

    fn solve(&self, system: &System, damping: f64) -> Option<DampedStep<Step>> {
        let step = system.solve(&self.method, damping)?;
        Some(DampedStep {
            norm: step.norm(),
            predicted_decrease: step.predicted_decrease,
            step,
        })
    }

    fn retract(&self, bundle: &Bundle, step: &Step) -> Bundle {
        bundle.retract(self.layout, step)
    }
}

#[cfg(test)]
mod tests;
