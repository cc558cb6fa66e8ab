//! Depth and normal maps of other programs.
//!
//! | program | file | depth | normals |
//! |---|---|---|---|
//! | COLMAP | `depth_maps/NAME.geometric.bin`, `normal_maps/…` | along the axis, 0: none | camera frame, towards the camera |
//! | OpenMVS | `depthNNNN.dmap`, with its camera | along the axis, 0: none | camera frame, towards the camera |
//!
//! Values are handed on as they stand, also what is no number: whoever uses them counts and drops it.

mod colmap;
mod openmvs;

pub use colmap::{read_colmap_depth, read_colmap_normal};
pub use openmvs::{DmapFile, read_dmap};

use crate::claims::MAX_PIXELS;
use crate::error::IoError;
use std::path::Path;

/// Number of pixels of a claimed size that can be one.
fn num_pixels(path: &Path, width: usize, height: usize) -> Result<usize, IoError> {
    width
        .checked_mul(height)
        .filter(|&n| n > 0 && n as u64 <= MAX_PIXELS)
        .ok_or_else(|| IoError::input(path, format!("its size is {width} x {height} pixels")))
}

/// Little-endian floats; `bytes` holds whole ones.
fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

#[cfg(test)]
mod tests;
