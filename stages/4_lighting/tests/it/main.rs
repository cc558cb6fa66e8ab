//! Tests of the stage as a whole.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

mod damaged;
mod rendered_sphere;
mod several_spheres;
mod shape;
mod studio;
