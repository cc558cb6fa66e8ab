//! Levenberg-Marquardt, for problems of any structure and for small dense ones.
//!
//! Minimises `E(x) = Σ ρ(r_k(x))` over a manifold with the Gauss-Newton matrix `H = JᵀWJ` and the
//! gradient `g = JᵀWr`. A step solves `(H + λ diag H) δ = −g`; `λ` shrinks by the gain ratio
//! `(E − E⁺) / (−gᵀδ − ½ δᵀHδ)` and doubles ever faster on rejection (Nielsen's rule: Madsen, Nielsen,
//! Tingleff, "Methods for non-linear least squares problems", 2004, eq. 2.21).
//!
//! The driver [`levenberg_marquardt`] damps, accepts and stops; a [`DampedProblem`] linearises,
//! solves for the step in its own way (sparse, by blocks) and moves its state. For a handful of
//! parameters [`minimize`] does the solving, given `H` and `g`.

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// A problem with `N` tangent parameters.
pub trait LeastSquaresProblem<const N: usize> {
    /// Where the cost is evaluated.
    type State: Clone;

    /// Gauss-Newton matrix and gradient at a state of finite cost.
    fn linearize(&self, state: &Self::State) -> (SMatrix<f64, N, N>, SVector<f64, N>);

    /// Cost; infinite where it is undefined.
    fn cost(&self, state: &Self::State) -> f64;

    /// The state moved by a tangent step.
    fn retract(&self, state: &Self::State, step: &SVector<f64, N>) -> Self::State;
}

/// A step and what the quadratic model says of it.
#[derive(Clone, Debug)]
pub struct DampedStep<S> {
    /// The step.
    pub step: S,
    /// Its length in the tangent space.
    pub norm: f64,
    /// Decrease of the cost that the model predicts.
    pub predicted_decrease: f64,
}

/// A problem that solves its own damped normal equations.
pub trait DampedProblem {
    /// Where the cost is evaluated.
    type State;
    /// Normal equations at a state.
    type System;
    /// A step of all parameters.
    type Step;

    /// Cost; infinite where it is undefined.
    fn cost(&self, state: &Self::State) -> f64;

    /// Normal equations at a state.
    fn linearize(&self, state: &Self::State) -> Self::System;

    /// The step with the diagonal multiplied by `1 + damping`; `None` when the system is singular.
    fn solve(&self, system: &Self::System, damping: f64) -> Option<DampedStep<Self::Step>>;

    /// The state moved by a step.
    fn retract(&self, state: &Self::State, step: &Self::Step) -> Self::State;
}

/// When to stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LeastSquaresOptions {
    /// Upper bound on the iterations; too few leave the minimum unreached.
    pub max_num_iterations: usize,
    /// Stop when the cost falls by less than this share in an accepted step.
    pub relative_cost_change: f64,
    /// Damping at the start, relative to the diagonal.
    pub initial_damping: f64,
}

impl Default for LeastSquaresOptions {
    fn default() -> Self {
        Self {
            max_num_iterations: 50,
            relative_cost_change: 1e-10,
            initial_damping: 1e-4,
        }
    }
}

/// Why a solver stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Termination {
    /// The cost no longer changes.
    Converged,
    /// The limit on iterations was reached.
    MaxIterations,
    /// No step lowers the cost any more, at the limit of the arithmetic.
    NoProgress,
}

/// One accepted or rejected step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct IterationRecord {
    /// Cost after the step (before it, when rejected).
    pub cost: f64,
    /// Damping used.
    pub damping: f64,
    /// Length of the step in the tangent space.
    pub step_norm: f64,
    /// Whether it was taken.
    pub accepted: bool,
}

/// Outcome of a solve as data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SolveReport {
    /// Why it ended.
    pub termination: Termination,
    /// Cost at the start.
    pub initial_cost: f64,
    /// Cost at the end.
    pub final_cost: f64,
    /// Steps, in order.
    pub iterations: Vec<IterationRecord>,
}

/// Why a solve is impossible.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LeastSquaresError {
    /// The cost at the start is not a number.
    #[error("the cost at the initial state is {cost}")]
    InvalidStart {
        /// What it is.
        cost: f64,
    },
    /// The damped normal matrix is not positive definite at any damping.
    #[error("the normal matrix is singular after {num_iterations} iterations")]
    Singular {
        /// Iterations done.
        num_iterations: usize,
    },
}

/// Damping beyond which a step is too short to change anything.
const MAX_DAMPING: f64 = 1e12;

/// Nielsen's damping rule.
#[derive(Clone, Copy, Debug)]
struct Damping {
    /// Current damping, relative to the diagonal of the normal matrix.
    lambda: f64,
    growth: f64,
}

impl Damping {
    /// Starts at a given damping.
    fn new(lambda: f64) -> Self {
        Self {
            lambda,
            growth: 2.0,
        }
    }

    /// After a step that lowered the cost by `gain_ratio` times the predicted amount.
    fn accept(&mut self, gain_ratio: f64) {
        let shrink = 1.0 - (2.0 * gain_ratio - 1.0).powi(3);
        self.lambda = (self.lambda * shrink.clamp(1.0 / 3.0, 2.0)).max(1e-15);
        self.growth = 2.0;
    }

    /// After a rejected step; `false` once the damping is past all use.
    fn reject(&mut self) -> bool {
        self.lambda *= self.growth;
        self.growth *= 2.0;
        self.lambda < MAX_DAMPING
    }
}

/// Minimises a problem from a start.
///
/// # Errors
/// When the start has no finite cost or the normal matrix is singular however damped.
pub fn levenberg_marquardt<P: DampedProblem>(
    problem: &P,
    start: P::State,
    options: &LeastSquaresOptions,
) -> Result<(P::State, SolveReport), LeastSquaresError> {
    let mut state = start;
    let mut cost = problem.cost(&state);
    if !cost.is_finite() {
        return Err(LeastSquaresError::InvalidStart { cost });
    }
    let mut report = SolveReport {
        termination: Termination::MaxIterations,
        initial_cost: cost,
        final_cost: cost,
        iterations: Vec::new(),
    };
    let mut damping = Damping::new(options.initial_damping);
    let mut system = problem.linearize(&state);
    'outer: for _ in 0..options.max_num_iterations {
        loop {
            let Some(solved) = problem.solve(&system, damping.lambda) else {
                if damping.reject() {
                    continue;
                }
                return Err(LeastSquaresError::Singular {
                    num_iterations: report.iterations.len(),
                });
            };
            let candidate = problem.retract(&state, &solved.step);
            let candidate_cost = problem.cost(&candidate);
            let predicted = solved.predicted_decrease;
            let accepted = candidate_cost < cost;
            report.iterations.push(IterationRecord {
                cost: if accepted { candidate_cost } else { cost },
                damping: damping.lambda,
                step_norm: solved.norm,
                accepted,
            });
            if accepted {
                let change = cost - candidate_cost;
                damping.accept(change / predicted.max(f64::MIN_POSITIVE));
                state = candidate;
                cost = candidate_cost;
                if change <= options.relative_cost_change * cost {
                    report.termination = Termination::Converged;
                    break 'outer;
                }
                system = problem.linearize(&state);
                break;
            }
            // At the minimum rounding decides the sign of the change: that is convergence.
            if predicted <= options.relative_cost_change * cost {
                report.termination = Termination::Converged;
                break 'outer;
            }
            if !damping.reject() {
                report.termination = Termination::NoProgress;
                break 'outer;
            }
        }
    }
    report.final_cost = cost;
    Ok((state, report))
}

/// A small problem solved by Cholesky's factorisation of its dense matrix.
struct DenseOf<'a, const N: usize, P>(&'a P);

impl<const N: usize, P: LeastSquaresProblem<N>> DampedProblem for DenseOf<'_, N, P> {
    type State = P::State;
    type System = (SMatrix<f64, N, N>, SVector<f64, N>);
    type Step = SVector<f64, N>;

    fn cost(&self, state: &Self::State) -> f64 {
        self.0.cost(state)
    }

    fn linearize(&self, state: &Self::State) -> Self::System {
        self.0.linearize(state)
    }

    fn solve(
        &self,
        (hessian, gradient): &Self::System,
        damping: f64,
    ) -> Option<DampedStep<Self::Step>> {
        let mut damped = *hessian;
        for k in 0..N {
            damped[(k, k)] += damping * hessian[(k, k)].max(1e-300);
        }
        let step = -damped.cholesky()?.solve(gradient);
        Some(DampedStep {
            norm: step.norm(),
            predicted_decrease: -gradient.dot(&step) - 0.5 * step.dot(&(hessian * step)),
            step,
        })
    }

    fn retract(&self, state: &Self::State, step: &Self::Step) -> Self::State {
        self.0.retract(state, step)
    }
}

/// Minimises a small dense problem from a start.
///
/// # Errors
/// As [`levenberg_marquardt`].
pub fn minimize<const N: usize, P: LeastSquaresProblem<N>>(
    problem: &P,
    start: P::State,
    options: &LeastSquaresOptions,
) -> Result<(P::State, SolveReport), LeastSquaresError> {
    levenberg_marquardt(&DenseOf::<N, P>(problem), start, options)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Rosenbrock;

    fn residuals(x: &SVector<f64, 2>) -> SVector<f64, 2> {
        SVector::<f64, 2>::new(10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0])
    }

    impl LeastSquaresProblem<2> for Rosenbrock {
        type State = SVector<f64, 2>;

        fn linearize(&self, x: &Self::State) -> (SMatrix<f64, 2, 2>, SVector<f64, 2>) {
            let j = SMatrix::<f64, 2, 2>::new(-20.0 * x[0], 10.0, -1.0, 0.0);
            (j.transpose() * j, j.transpose() * residuals(x))
        }

        fn cost(&self, x: &Self::State) -> f64 {
            0.5 * residuals(x).norm_squared()
        }

        fn retract(&self, x: &Self::State, step: &SVector<f64, 2>) -> Self::State {
            x + step
        }
    }

    #[test]
    fn walks_the_rosenbrock_valley() {
        let (x, report) = minimize(
            &Rosenbrock,
            SVector::<f64, 2>::new(-1.2, 1.0),
            &LeastSquaresOptions::default(),
        )
        .unwrap();
        assert!((x - SVector::<f64, 2>::new(1.0, 1.0)).norm() < 1e-6, "{x}");
        assert!(report.final_cost < 1e-12, "{report:?}");
        assert!(report.initial_cost > report.final_cost);
    }

    #[test]
    fn refuses_a_start_without_cost() {
        let result = minimize(
            &Rosenbrock,
            SVector::<f64, 2>::new(f64::NAN, 1.0),
            &LeastSquaresOptions::default(),
        );
        assert!(matches!(
            result,
            Err(LeastSquaresError::InvalidStart { .. })
        ));
    }
}
