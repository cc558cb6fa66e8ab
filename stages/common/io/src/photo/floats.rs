//! Photos of floating-point samples.

use super::names::file_name;
use rilievo_scene::{DecodedPhoto, ExifFacts, Samples};
use std::path::Path;

/// A photo of floating-point samples that are proportional to light, without alpha and EXIF.
pub(super) fn of_floats(
    path: &Path,
    (width, height, channels): (usize, usize, usize),
    data: Vec<f32>,
    encoding_reason: &str,
) -> DecodedPhoto {
    DecodedPhoto {
        file_name: file_name(path),
        width,
        height,
        channels,
        samples: Samples::F32(data),
        linear_by_metadata: true,
        saturates_at_white: false,
        encoding_reason: encoding_reason.to_owned(),
        profile_curve: None,
        alpha: None,
        exif: ExifFacts::default(),
    }
}
