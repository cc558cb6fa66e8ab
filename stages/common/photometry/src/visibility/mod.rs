//! Lighting of every point of a surface: which part of the environment it sees, and what its
//! neighbourhood sends instead.
//!
//! A matte point with normal `n` has the intensity `(4/K) Σ_k L_k max(0, n·d_k)` over `K` uniform
//! directions `d_k`, where `L_k` is the radiance that arrives along `d_k`, times albedo over 4. Where light is near
//! ([`Dome`]) the directions differ from place to place, and each term has a weight `R² cos θ_k / r_k²`.
//! Rays that meet the object, a sphere or the ground bring the radiance *seen in the photos* there:
//! every bounce at once. The others bring the environment, one unknown per cell.
//! With a smooth horizon, `max(0, x)` replaced by `3h/32 + x/2 + 15x²/(32h)` for `|x| < h` where `x`
//! is taken at the current normal, the sum is a quadratic polynomial of `n`, and as `|n| = 1` it is
//! exactly the nine harmonics of eq. 1, one set per point.
//!
//! Steps: [`Dome`] gives the directions; [`Volume`] carves the solid from the views' depth maps and colours its surface;
//! [`Surroundings`] casts rays against it, spheres and ground; [`transfer`] sums what is hit and notes
//! what is not; [`fit_environment`] finds the environment, non-negative and slightly smooth;
//! [`Transfer::harmonics`] gives the coefficients.

mod dome;
mod environment;
mod surroundings;
mod transfer;
mod volume;

pub use dome::{Dome, MAX_OFFSET, Ray, directions};
pub use environment::{EnvironmentFit, EnvironmentSample, fit_environment};
pub use surroundings::{EmittingSphere, Ground, Surroundings};
pub use transfer::{HORIZON, Transfer, transfer};
pub use volume::{DepthView, Volume};
