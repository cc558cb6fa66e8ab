//! Tests of the stage as a whole.

mod common;
mod damaged;
mod fallbacks;
mod rungs;
