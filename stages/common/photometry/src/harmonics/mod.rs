//! Nine harmonics per channel: rotation into another frame, and robust fits.
//!
//! # Problem
//! A matte surface under distant light shows `I = l · h(n)` (eq. 1 of the paper) with
//! `h(n) = [n1, n2, n3, 1, n1n2, n1n3, n2n3, n1²−n2², 3n3²−1]`. Two things are needed of `l`:
//! * [`rotate`]: `l_b` with `l_b · h(R n) = l_a · h(n)` for all unit `n` and a rotation `R`
//!   (`b_from_a`). Exact, because each order of harmonics is closed under rotation.
//! * [`fit_robust`]: `min over l of Σ_i w_i ρ((l · h(n_i) − I_i) / σ)` from samples of which some
//!   are shadowed, clipped, dirty or lit by their surroundings.

mod fit;
#[cfg(test)]
mod fit_tests;
mod least_squares;
mod options;
mod reading;
mod rotation;
mod starts;

pub(crate) use fit::fit_with;
pub use fit::{FitError, HarmonicsFit, LightingFit, fit_lighting, fit_robust};
pub(crate) use options::FitOptions;
pub use reading::Reading;
pub use rotation::{dominant_direction, rotate, rotate_harmonics};
