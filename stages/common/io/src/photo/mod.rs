//! Photos: JPEG, PNG, TIFF, Radiance HDR, OpenEXR and camera RAW to samples as stored, with their metadata.
//!
//! Nothing is linearised, rotated or scaled here; what the file says of its encoding is noted
//! ([`DecodedPhoto::linear_by_metadata`], [`DecodedPhoto::profile_curve`]), and stage 1 decides.
//!
//! # What counts as linear by metadata
//! | file | linear when |
//! |---|---|
//! | OpenEXR, Radiance HDR, 32-bit float TIFF | always: their samples are scene-referred |
//! | camera RAW (with the feature `raw`) | always: the sensor counts light; black and white level are taken out, the missing colours interpolated |
//! | 8 bit | its colour profile, `gAMA` or `cICP` says so; else not |
//! | 16 bit | the same; and also when the file says nothing of its colours: programs that encode for a display write the profile or `sRGB`, those that store measurements write none |

mod exif_facts;
mod float_tiff;
pub(crate) mod guard;
mod icc;
mod jpeg;
mod png_chunks;
mod raster;
#[cfg(feature = "raw")]
mod raw;
mod raw_decoder;
mod size;

use crate::error::IoError;
use crate::exr_maps;
use crate::files::read_regular;
use guard::guarded;
use image::ImageFormat;
use rilievo_scene::{DecodedPhoto, ExifFacts, Mask, Samples};
use std::path::Path;

pub use guard::decoder_is_guarded;
pub use raw_decoder::{RawDecoder, decode_raw_here, set_raw_decoder};
pub use size::photo_size;

/// Endings of photos that can be decoded.
const PHOTO_ENDINGS: [&str; 8] = ["jpg", "jpeg", "jpe", "png", "tif", "tiff", "exr", "hdr"];

/// Endings of photos that people have and this program cannot decode.
const FOREIGN_ENDINGS: [(&str, &str); 6] = [
    ("heic", "HEIC"),
    ("heif", "HEIF"),
    ("avif", "AVIF"),
    ("webp", "WebP"),
    ("jxl", "JPEG XL"),
    ("gif", "GIF"),
];

/// Endings of camera RAW files.
const RAW_ENDINGS: [&str; 21] = [
    "dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "srf", "sr2", "raf", "rw2", "orf", "pef",
    "srw", "x3f", "3fr", "iiq", "mrw", "kdc", "dcr", "erf",
];

fn ending(path: &Path) -> String {
    path.extension()
        .map(|ending| ending.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default()
}

/// Whether a file name has the ending of camera RAW.
pub(crate) fn is_raw_name(path: &Path) -> bool {
    RAW_ENDINGS.contains(&ending(path).as_str())
}

/// Whether a file name has the ending of a photo, be it one that can be decoded or one of a format
/// that is refused with advice (camera RAW, HEIC).
pub fn is_photo_name(path: &Path) -> bool {
    let hidden = path
        .file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with('.'));
    let ending = ending(path);
    !hidden
        && (PHOTO_ENDINGS.contains(&ending.as_str())
            || RAW_ENDINGS.contains(&ending.as_str())
            || FOREIGN_ENDINGS.iter().any(|(name, _)| *name == ending))
}

/// Decodes a photo, sample by sample as stored: nothing is linearised, rotated or scaled.
///
/// # Errors
/// When the file cannot be read, is no image, is damaged or cut off, or is of a kind that is not
/// supported (CMYK, RAW of unknown cameras).
pub fn decode_photo(path: &Path) -> Result<DecodedPhoto, IoError> {
    let bytes = read_regular(path)?;
    decode_photo_bytes(path, &bytes)
}

/// The same for a file that is already in memory; `path` names it.
///
/// # Errors
/// As [`decode_photo`].
pub fn decode_photo_bytes(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    if bytes.is_empty() {
        return Err(IoError::input(path, "the file is empty (0 bytes)"));
    }
    let ending = ending(path);
    if is_raw_name(path) {
        return raw_decoder::decode(path, bytes);
    }
    if let Some((_, kind)) = FOREIGN_ENDINGS.iter().find(|(name, _)| *name == ending) {
        return Err(
            IoError::input(path, format!("{kind} files cannot be decoded"))
                .with_hint("convert to 16-bit TIFF, OpenEXR or JPEG with one fixed development"),
        );
    }
    let format = image::guess_format(bytes)
        .ok()
        .filter(|format| {
            matches!(
                format,
                ImageFormat::Jpeg
                    | ImageFormat::Png
                    | ImageFormat::Tiff
                    | ImageFormat::Hdr
                    | ImageFormat::OpenExr
            )
        })
        .ok_or_else(|| {
            IoError::input(path, "not a JPEG, PNG, TIFF, Radiance HDR or OpenEXR image")
        })?;
    guarded(path, || match format {
        ImageFormat::OpenExr => decode_exr(path, bytes),
        _ => raster::decode(path, bytes, format),
    })
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    )
}

fn decode_exr(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let (image, alpha) = exr_maps::linear_with_alpha(path, bytes)?;
    let alpha = alpha.and_then(|alpha| {
        alpha_mask(
            image.width,
            image.height,
            alpha.data.iter().map(|&a| a >= 0.5),
        )
    });
    Ok(DecodedPhoto {
        file_name: file_name(path),
        width: image.width,
        height: image.height,
        channels: image.channels,
        samples: Samples::F32(image.data),
        linear_by_metadata: true,
        saturates_at_white: false,
        encoding_reason: "OpenEXR".to_owned(),
        profile_curve: None,
        alpha,
        exif: ExifFacts::default(),
    })
}

/// The alpha channel as a mask; an alpha that is opaque everywhere says nothing.
fn alpha_mask(width: usize, height: usize, opaque: impl Iterator<Item = bool>) -> Option<Mask> {
    let data: Vec<bool> = opaque.collect();
    if data.iter().all(|&inside| inside) {
        return None;
    }
    Mask::from_vec(width, height, data)
}

#[cfg(test)]
mod claims_tests;
#[cfg(test)]
mod tests;
