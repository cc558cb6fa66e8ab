//! Kinds of the robust fit.

/// How [`super::fit_robust`] and its kin look at the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FitOptions {
    /// Iterations of each phase.
    pub max_num_iterations: usize,
    /// Whether starts that leave out a part of the samples are followed too, so that a shadow over
    /// half of them is recognised.
    pub seeks_shadows: bool,
    /// Condition number above which nine coefficients give way to four. The visible half of a
    /// sphere has about 25, half of that half 150; beyond 1000 one percent of noise becomes
    /// hundreds.
    pub max_condition: f64,
}

impl FitOptions {
    /// What a light is fitted with.
    pub const THOROUGH: Self = Self {
        max_num_iterations: 15,
        seeks_shadows: true,
        max_condition: 1000.0,
    };
    /// What brightness is described with that holds no shadow, or on many candidates.
    pub const QUICK: Self = Self {
        max_num_iterations: 5,
        seeks_shadows: false,
        ..Self::THOROUGH
    };
    /// What brightness is explained with, however few normals there are: rounding swamps a fit of a
    /// larger condition number.
    pub const EXPLAINING: Self = Self {
        seeks_shadows: false,
        max_condition: 1e16,
        ..Self::THOROUGH
    };
}

/// Residuals beyond this many `σ` are damped in the convex phase. Less biases the fit by throwing
/// away good samples, more lets shadows through.
pub(super) const HUBER_SIGMAS: f64 = 1.5;
/// Scale of the redescending phases in `σ`; influence falls beyond it, and ends at 1.5 times it.
pub(super) const REDESCENDING_SIGMAS: f64 = 3.0;
/// Brightness, as a share of the mean, below which noise no longer falls with it. Less lets the
/// darkest samples decide, more lets faint shadows on dark parts through.
pub(super) const NOISE_FLOOR: f64 = 0.3;
/// The share of samples, at least, that is taken as good when starts are sought.
pub(super) const START_QUANTILE: f64 = 0.6;
/// Share of the samples that each partial start leaves out.
pub(super) const START_LEFT_OUT: f64 = 0.35;
