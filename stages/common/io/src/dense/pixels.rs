//! The pixels of a stored map: how many its size claims, and their values.

use crate::claims::MAX_PIXELS;
use crate::error::IoError;
use std::path::Path;

/// Number of pixels of a claimed size that can be one.
pub(super) fn num_pixels(path: &Path, width: usize, height: usize) -> Result<usize, IoError> {
    width
        .checked_mul(height)
        .filter(|&n| n > 0 && n as u64 <= MAX_PIXELS)
        .ok_or_else(|| IoError::input(path, format!("its size is {width} x {height} pixels")))
}

/// Little-endian floats; `bytes` holds whole ones.
pub(super) fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}
