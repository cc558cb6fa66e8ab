//! Tests of the stage as a whole.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

mod damaged;
mod photo_model;
mod posed;
mod solver;
