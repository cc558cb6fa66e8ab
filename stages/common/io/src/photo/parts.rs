//! Parts of decoded photos: alpha channels as masks, and photos of floating-point samples.

use super::names::file_name;
use rilievo_scene::{DecodedPhoto, ExifFacts, Mask, Samples};
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

/// The alpha channel as a mask; an alpha that is opaque everywhere marks nothing.
pub(super) fn alpha_mask(
    width: usize,
    height: usize,
    opaque: impl Iterator<Item = bool>,
) -> Option<Mask> {
    let data: Vec<bool> = opaque.collect();
    if data.iter().all(|&inside| inside) {
        return None;
    }
    Mask::from_vec(width, height, data)
}
