//! JPEG, HEIC, PNG, TIFF, Radiance HDR, OpenEXR and camera RAW to samples as stored, with metadata.
//!
//! Nothing is linearised, rotated or scaled here; the encoding by the metadata is noted
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
mod format;
mod further_tiff;
pub(crate) mod guard;
mod heic;
mod icc;
mod jpeg;
mod names;
mod parts;
mod png_chunks;
mod raster;
#[cfg(feature = "raw")]
mod raw;
mod raw_decoder;
mod size;

use crate::error::IoError;
use crate::exr_maps;
use crate::files::read_regular;
use format::Format;
use guard::guarded;
use parts::{alpha_mask, of_floats};
use rilievo_scene::DecodedPhoto;
use std::path::Path;

pub use guard::decoder_is_guarded;
pub use names::is_photo_name;
pub(crate) use names::{file_name, is_raw_name};
pub use raw_decoder::{RawDecoder, decode_raw_here, set_raw_decoder};
pub use size::photo_size;

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
pub fn decode_photo_bytes(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    match Format::of(path, bytes) {
        None => Err(format::unknown(path, bytes)),
        Some(Format::Raw) => raw_decoder::decode(path, bytes),
        Some(Format::Heif) => heic::decode(path, bytes),
        Some(Format::OpenExr) => guarded(path, || decode_exr(path, bytes)),
        Some(Format::Jpeg) => guarded(path, || raster::jpeg(path, bytes)),
        Some(Format::Png) => guarded(path, || raster::png(path, bytes)),
        Some(Format::Tiff) => guarded(path, || raster::tiff(path, bytes)),
        Some(Format::Hdr) => guarded(path, || raster::hdr(path, bytes)),
    }
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
    let size = (image.width, image.height, image.channels);
    Ok(DecodedPhoto {
        alpha,
        ..of_floats(path, size, image.data, "OpenEXR")
    })
}

#[cfg(test)]
mod claims_tests;
#[cfg(test)]
mod tests;
