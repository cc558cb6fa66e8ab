//! Masks as images: white is object.

use crate::error::IoError;
use crate::files::OutputFile;
use crate::mask_values;
use crate::photo;
use image::{ExtendedColorType, ImageEncoder, codecs::png};
use rilievo_scene::{Mask, Samples};
use std::path::Path;

/// Reads a mask: a pixel is object where the mean of its channels is at least half of white.
///
/// Two other habits are understood: an alpha channel that is not opaque everywhere is the mask,
/// whatever the colours; and labels 0 and 1 (nothing brighter in the file) mean 0 and white.
///
/// # Errors
/// When the file cannot be read, is no image, or has more than two values as photos have.
pub fn read_mask(path: &Path) -> Result<Mask, IoError> {
    let image = photo::decode_photo(path)?;
    if let Some(alpha) = image.alpha {
        return Ok(alpha);
    }
    let levels = match image.samples {
        Samples::U8(v) if image.channels == 1 && v.iter().any(|&level| level > 1) => v,
        Samples::U8(v) => levels(&v, image.channels, u8::MAX),
        Samples::U16(v) => levels(&v, image.channels, u16::MAX),
        Samples::F32(v) => levels(&v, image.channels, 1.0),
    };
    mask_values::check(path, &levels, image.width)?;
    let inside = levels.iter().map(|&level| level >= mask_values::BRIGHT);
    Mask::from_vec(image.width, image.height, inside.collect())
        .ok_or_else(|| IoError::input(path, "its pixels do not fill its frame"))
}

/// Mean of each pixel's channels in whole steps of 255; 1 is as good as `white` where nothing is
/// brighter, and what is not a number is 0.
fn levels<T: Copy + Into<f64>>(samples: &[T], channels: usize, white: T) -> Vec<u8> {
    let is_label = samples.iter().all(|&sample| sample.into() <= 1.0);
    let white = if is_label { 1.0 } else { white.into() };
    let scale = 255.0 / (white * channels as f64);
    samples
        .chunks_exact(channels)
        .map(|pixel| {
            let sum: f64 = pixel.iter().map(|&sample| sample.into()).sum();
            (sum * scale + 0.5) as u8
        })
        .collect()
}

/// Writes a mask as an 8-bit grey PNG, 255 inside.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<(), IoError> {
    mask_file(path, mask)?.write()
}

/// A mask as an 8-bit grey PNG, 255 inside, to be written.
///
/// # Errors
/// When the mask has no pixels.
pub fn mask_file(path: &Path, mask: &Mask) -> Result<OutputFile, IoError> {
    let grey: Vec<u8> = mask
        .data
        .iter()
        .map(|&inside| if inside { 255 } else { 0 })
        .collect();
    let bytes = encode_png(&grey, mask.width, mask.height, ExtendedColorType::L8)
        .map_err(|reason| IoError::write(path, reason))?;
    Ok(OutputFile::new(path, bytes))
}

/// A PNG file in memory; the reason where the pixels do not fill the frame.
pub(crate) fn encode_png(
    samples: &[u8],
    width: usize,
    height: usize,
    color: ExtendedColorType,
) -> Result<Vec<u8>, String> {
    let expected = width * height * usize::from(color.bits_per_pixel()) / 8;
    if samples.len() != expected || expected == 0 {
        return Err(format!("{} samples for {width} x {height}", samples.len()));
    }
    let mut bytes = Vec::new();
    png::PngEncoder::new_with_quality(
        &mut bytes,
        png::CompressionType::Fast,
        png::FilterType::Adaptive,
    )
    .write_image(samples, width as u32, height as u32, color)
    .map_err(|error| error.to_string())?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Raster;

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().unwrap()
    }

    fn stripes() -> Mask {
        Raster::from_fn(13, 7, |x, y| (x + 2 * y) % 5 < 2)
    }

    #[test]
    fn masks_survive_the_disk() {
        let folder = folder();
        let path = folder.path().join("m.png");
        write_mask(&path, &stripes()).unwrap();
        assert_eq!(read_mask(&path).unwrap(), stripes());
    }

    #[test]
    fn labels_and_alpha_are_understood() {
        let folder = folder();
        let mask = stripes();
        let labels: Vec<u8> = mask.data.iter().map(|&m| u8::from(m)).collect();
        let path = folder.path().join("labels.png");
        std::fs::write(
            &path,
            encode_png(&labels, 13, 7, ExtendedColorType::L8).unwrap(),
        )
        .unwrap();
        assert_eq!(read_mask(&path).unwrap(), mask);

        let cutout: Vec<u8> = mask
            .data
            .iter()
            .flat_map(|&m| [10, 20, 30, if m { 255 } else { 0 }])
            .collect();
        let path = folder.path().join("cutout.png");
        std::fs::write(
            &path,
            encode_png(&cutout, 13, 7, ExtendedColorType::Rgba8).unwrap(),
        )
        .unwrap();
        assert_eq!(read_mask(&path).unwrap(), mask);
    }

    #[test]
    fn a_missing_mask_is_named() {
        let error = read_mask(Path::new("nowhere/m.png")).unwrap_err();
        assert!(error.to_string().starts_with("nowhere/m.png: "), "{error}");
    }
}
