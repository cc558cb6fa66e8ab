//! COLMAP.
use crate::error::IoError;
use rilievo_scene::PosedViews;
use std::path::Path;

/// Writes `cameras.txt`, `images.txt` and `points3D.txt` into an existing folder.
///
/// # Errors
/// When a file cannot be written.
pub fn write_colmap_text(folder: &Path, _views: &PosedViews) -> Result<(), IoError> {
    Err(IoError::input(folder, "not yet"))
}
