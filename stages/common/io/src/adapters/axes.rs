//! The two ways that cameras' axes point.

use nalgebra::{Matrix3, Vector3};

/// Turns camera axes x right, y down, z forward into x right, y up, z backward, and back.
pub(super) fn flip() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))
}
