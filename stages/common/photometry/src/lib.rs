//! What light does to a matte surface: spherical harmonics, their rotation and their fits, and the
//! geometry of the reference sphere from which they are read.
//!
//! * [`harmonics`]: the nine coefficients of eq. 1 in another frame, and their robust fit.
//! * [`samples`]: what the photos show of the sphere.
//! * [`sphere`]: outline, normals, detection and position of a sphere in perspective.
//! * [`surface_check`]: whether a light was the right one for the surface found under it.
//! * [`visibility`]: lighting of every point from what it sees of the environment.
//!
//! Shared by stages 3 (metric scale), 4 (lighting) and 5 (per-pixel lighting).

pub mod harmonics;
pub mod samples;
pub mod sphere;
pub mod surface_check;
pub mod visibility;
