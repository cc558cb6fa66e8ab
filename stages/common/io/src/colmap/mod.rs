//! COLMAP sparse models: `cameras`, `images` and `points3D`, as text or binary.
//!
//! # Conventions
//! Axes and poses are ours (`cam_from_world`, x right, y down, z forward). COLMAP puts the centre
//! of the first pixel at (0.5, 0.5): principal points and observed pixels are shifted by half a
//! pixel on the way in and out, so that a [`ColmapModel`] in memory has exactly the file's numbers.
//!
//! # Camera models
//! | COLMAP | here |
//! |---|---|
//! | `SIMPLE_PINHOLE` f cx cy, `PINHOLE` fx fy cx cy | no distortion |
//! | `SIMPLE_RADIAL` f cx cy k, `RADIAL` f cx cy k1 k2 | k1 k2 |
//! | `OPENCV` fx fy cx cy k1 k2 p1 p2 | k1 k2 p1 p2 |
//! | `FULL_OPENCV` … k3 k4 k5 k6 | the same, the last three in the denominator |
//! | `OPENCV_FISHEYE` fx fy cx cy k1 k2 k3 k4, `THIN_PRISM_FISHEYE` … k1 k2 p1 p2 k3 k4 sx1 sy1 | the same of the angle |
//! | `SIMPLE_RADIAL_FISHEYE` f cx cy k, `RADIAL_FISHEYE` f cx cy k1 k2, `SIMPLE_FISHEYE`, `FISHEYE` | the same, less of it |
//!
//! Others are refused by name, and so is a lens of 180 degrees and more. Written are `PINHOLE`, `OPENCV`, with more
//! coefficients `FULL_OPENCV`, and of fisheyes `OPENCV_FISHEYE` or `THIN_PRISM_FISHEYE`. Files of rigs and frames beside the model are not needed: the images carry their
//! poses.
//!
//! Source: COLMAP documentation, "Output format"; `src/colmap/scene/reconstruction_io*.cc`.

mod binary;
mod convert;
mod model;
mod text;

pub use binary::binary_files;
pub use model::{CameraModel, ColmapCamera, ColmapImage, ColmapModel, ColmapPoint};
pub use text::{text_files, write_colmap_text};

use crate::error::IoError;
use std::path::Path;

/// Reads a model folder; the binary files are preferred where both kinds are there.
///
/// # Errors
/// When files are missing or damaged, or a camera model is not supported.
pub fn read_model(folder: &Path) -> Result<ColmapModel, IoError> {
    if folder.join("cameras.bin").is_file() {
        return binary::read(folder);
    }
    if folder.join("cameras.txt").is_file() {
        return text::read(folder);
    }
    Err(
        IoError::input(folder, "holds neither cameras.bin nor cameras.txt")
            .with_hint("give the folder of the model itself, often named sparse/0"),
    )
}

#[cfg(test)]
mod tests;
