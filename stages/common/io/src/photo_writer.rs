//! Writes photos: 8-bit JPEG with the sRGB curve, as a camera would, and linear 16-bit PNG and
//! TIFF, as a developed RAW file.

use crate::error::IoError;
use crate::files::OutputFile;
use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ExtendedColorType, ImageBuffer};
use rilievo_scene::{LinearImage, srgb};
use std::path::Path;

/// Writes a linear image as JPEG; values outside 0 to 1 are clipped, as in a camera.
///
/// # Errors
/// When the file cannot be written, or the image is too large for JPEG.
pub fn write_photo_jpeg(path: &Path, photo: &LinearImage, quality: u8) -> Result<(), IoError> {
    let samples = photo.data.iter().map(|&linear| srgb::encode_byte(linear));
    let samples: Vec<u8> = samples.collect();
    let color = match photo.channels {
        1 => ExtendedColorType::L8,
        _ => ExtendedColorType::Rgb8,
    };
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(&samples, photo.width as u32, photo.height as u32, color)
        .map_err(|error| IoError::write(path, error))?;
    OutputFile::new(path, bytes).write()
}

/// Writes a linear image with 16 bits, proportional to light, as PNG or TIFF by the path's ending;
/// values outside 0 to 1 are clipped.
pub fn write_photo_deep(path: &Path, photo: &LinearImage) -> Result<(), IoError> {
    let deep = |&linear: &f32| (linear.clamp(0.0, 1.0) * 65535.0).round() as u16;
    let samples: Vec<u16> = photo.data.iter().map(deep).collect();
    let (width, height) = (photo.width as u32, photo.height as u32);
    let image = if photo.channels == 1 {
        ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageLuma16)
    } else {
        ImageBuffer::from_raw(width, height, samples).map(DynamicImage::ImageRgb16)
    };
    let image = image.ok_or_else(|| IoError::write(path, "pixels and size do not match"))?;
    image
        .save(path)
        .map_err(|error| IoError::write(path, error))
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

    #[test]
    fn deep_photos_are_linear_to_half_a_step() {
        let folder = tempfile::tempdir().unwrap();
        let mut photo = LinearImage::filled(40, 30, 3, 0.0);
        for (i, value) in photo.data.iter_mut().enumerate() {
            *value = i as f32 / 3600.0;
        }
        for name in ["a.png", "a.tif"] {
            let path = folder.path().join(name);
            write_photo_deep(&path, &photo).unwrap();
            let decoded = crate::decode_photo(&path).unwrap();
            assert!(decoded.linear_by_metadata, "{}", decoded.encoding_reason);
            let rilievo_scene::decoded::Samples::U16(samples) = &decoded.samples else {
                panic!("{:?}", decoded.samples.bits());
            };
            for (sample, value) in samples.iter().zip(&photo.data) {
                let error = (f32::from(*sample) / 65535.0 - value).abs();
                assert!(error < 1e-5, "{sample} {value}");
            }
        }
    }
}
