//! What formats hold of a camera: poses as matrices, axes that point another way, and no lens
//! distortion.

use crate::cameras::CameraEntry;
use crate::error::IoError;
use nalgebra::{Matrix3, Point3, Vector3};
use std::path::Path;

/// Turns camera axes x right, y down, z forward into x right, y up, z backward, and back.
pub(super) fn flip() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))
}

/// Rows of the matrix `[R | C]`, world from camera.
pub(super) fn rows_of(rotation: &Matrix3<f64>, center: &Point3<f64>) -> [[f64; 4]; 3] {
    std::array::from_fn(|i| {
        let [x, y, z] = [0, 1, 2].map(|j| rotation[(i, j)]);
        [x, y, z, center[i]]
    })
}

/// Refuses a camera whose lens has more than OpenCV's five coefficients.
pub(super) fn refuse_wide_lens(
    path: &Path,
    entry: &CameraEntry,
    format: &str,
) -> Result<(), IoError> {
    if entry.intrinsics.distortion.is_plain() {
        return Ok(());
    }
    let reason = format!("{format} has no lens model like that of {}", entry.name());
    Err(IoError::input(path, reason).with_hint("choose cameras, colmap or colmap-binary"))
}

/// Refuses a camera with lens distortion, which a format without cannot hold.
pub(super) fn refuse_distortion(
    path: &Path,
    entry: &CameraEntry,
    format: &str,
) -> Result<(), IoError> {
    if entry.intrinsics.distortion.is_none() {
        return Ok(());
    }
    let reason = format!(
        "{format} has no lens distortion, which {} has",
        entry.name()
    );
    Err(IoError::input(path, reason)
        .with_hint("undistort the photos first, or choose another format"))
}
