//! Cameras without lens distortion, for the formats that hold no other.

use crate::cameras::CameraEntry;
use crate::error::IoError;
use std::path::Path;

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
