//! Photos.
use crate::error::IoError;
use rilievo_scene::DecodedPhoto;
use std::path::Path;

/// Whether a file name has the ending of a photo that can be decoded.
pub fn is_photo_name(_path: &Path) -> bool {
    false
}

/// Decodes a photo, sample by sample as stored: nothing is linearised, rotated or scaled.
///
/// # Errors
/// When the file cannot be read or is no usable photo.
pub fn decode_photo(path: &Path) -> Result<DecodedPhoto, IoError> {
    Err(IoError::input(path, "not yet"))
}
