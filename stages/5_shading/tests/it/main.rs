//! Tests of the stage as a whole.

mod damaged;
mod photo_model;
mod posed;
mod solver;
