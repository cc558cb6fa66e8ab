//! Tests of the formats from outside: hostile bytes, missing keys, other programs' files.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

mod fuzz;
mod missing_keys;
mod mutations;
mod python_guide;
mod shared_data;
