//! Tests of the stage as a whole.

mod asset;
mod damaged;
mod sphere;
