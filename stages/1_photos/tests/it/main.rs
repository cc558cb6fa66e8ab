//! Tests of the stage as a whole.

mod real_photos;
mod stage;
