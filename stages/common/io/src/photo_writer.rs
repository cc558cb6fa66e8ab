//! Writes photos as a camera would: 8-bit JPEG with the sRGB curve.

use crate::error::IoError;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use rilievo_scene::{LinearImage, srgb};
use std::path::Path;

/// A linear image as the bytes of a JPEG file; values outside 0 to 1 are clipped, as in a camera.
///
/// # Errors
/// When the image is too large for JPEG; the error names no file.
pub fn encode_photo_jpeg(photo: &LinearImage, quality: u8) -> Result<Vec<u8>, IoError> {
    let samples: Vec<u8> = photo
        .data
        .iter()
        .map(|&linear| srgb::encode_byte(linear))
        .collect();
    let color = if photo.channels == 1 {
        ExtendedColorType::L8
    } else {
        ExtendedColorType::Rgb8
    };
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(&samples, photo.width as u32, photo.height as u32, color)
        .map_err(|error| IoError::write(Path::new("JPEG"), error))?;
    Ok(bytes)
}

/// Writes a linear image as JPEG.
///
/// # Errors
/// When the file cannot be written, or the image is too large for JPEG.
pub fn write_photo_jpeg(path: &Path, photo: &LinearImage, quality: u8) -> Result<(), IoError> {
    let bytes = encode_photo_jpeg(photo, quality).map_err(|error| IoError {
        path: path.to_path_buf(),
        ..error
    })?;
    std::fs::write(path, bytes).map_err(|error| IoError::write(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_photo_decodes_to_the_same_light() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grey.jpg");
        write_photo_jpeg(&path, &LinearImage::filled(64, 48, 3, 0.18), 95).unwrap();
        let decoded = crate::decode_photo(&path).unwrap();
        let rilievo_scene::decoded::Samples::U8(samples) = &decoded.samples else {
            panic!("{:?}", decoded.samples.bits());
        };
        // 18 % grey is 118 in sRGB; JPEG rounds colours by a step.
        let worst = samples.iter().map(|&s| (i32::from(s) - 118).abs()).max();
        assert!(worst.is_some_and(|w| w <= 1), "{worst:?}");
    }
}
