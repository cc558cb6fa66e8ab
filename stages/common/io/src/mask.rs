//! Masks.
use crate::error::IoError;
use rilievo_scene::Mask;
use std::path::Path;

/// Reads a mask: white (at least half) is object.
///
/// # Errors
/// When the file cannot be read or is no image.
pub fn read_mask(path: &Path) -> Result<Mask, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Writes a mask as an 8-bit grey PNG, 255 inside.
///
/// # Errors
/// When the file cannot be written.
pub fn write_mask(path: &Path, _mask: &Mask) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}
