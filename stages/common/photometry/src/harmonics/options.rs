//! Options of the robust fit.

use rilievo_scene::{OptionError, check_ranges};
use serde::{Deserialize, Serialize};

/// Options of [`super::fit_robust`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitOptions {
    /// Order of the harmonics: 2 for nine coefficients, 1 for four.
    pub order: u8,
    /// Residuals beyond this many `σ` are damped in the convex phase. Too small biases the fit by
    /// throwing away good samples, too large lets shadows through.
    pub huber_sigmas: f64,
    /// Scale of the redescending phases in `σ`; influence falls beyond it, and ends at 1.5 times it.
    pub redescending_sigmas: f64,
    /// Brightness, as a share of the mean, below which noise no longer falls with it. Too small
    /// lets the darkest samples decide, too large lets faint shadows on dark parts through.
    pub noise_floor: f64,
    /// Iterations of each phase.
    pub max_num_iterations: usize,
    /// The share of samples, at least, that is taken as good when starts are sought.
    pub start_quantile: f64,
    /// Share of the samples that each partial start leaves out; 0 starts from all samples only.
    pub start_left_out: f64,
    /// Condition number above which nine coefficients give way to four. The visible half of a
    /// sphere has about 25, half of that half 150; beyond 1000 one percent of noise becomes
    /// hundreds.
    pub max_condition: f64,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            order: 2,
            huber_sigmas: 1.5,
            redescending_sigmas: 3.0,
            noise_floor: 0.3,
            max_num_iterations: 15,
            start_quantile: 0.6,
            start_left_out: 0.35,
            max_condition: 1000.0,
        }
    }
}

impl FitOptions {
    /// Condition number that is taken for well conditioned whatever the samples: rounding swamps a fit
    /// before.
    pub const ANY_CONDITION: f64 = 1e16;

    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        check_ranges!(
            self;
            order in 1..=2,
            huber_sigmas in 0.001..=1000.0,
            redescending_sigmas in 0.001..=1000.0,
            noise_floor in 1e-6..=1000.0,
            max_num_iterations in 0..=1000,
            start_quantile in 0.0..=1.0,
            start_left_out in 0.0..=0.899,
            max_condition in 1.0..=Self::ANY_CONDITION,
        )
    }
}
