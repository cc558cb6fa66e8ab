//! HEIF with HEVC pictures (HEIC, HIF), as phones and some cameras store photos.
//!
//! The container says in its own words how to turn the picture for display. Where EXIF says the same, the
//! picture is left as coded and EXIF's orientation is noted, as for every other photo; where they differ,
//! or the container crops, its word is followed and the picture counts as upright.

use super::alpha::alpha_mask;
use super::exif_facts;
use super::icc;
use super::names::file_name;
use super::raster::by_profile;
use crate::claims;
use crate::error::IoError;
use heic_decoder::{DecodeOptions, HeifError};
use rilievo_scene::{DecodedPhoto, Orientation, Samples};
use std::path::Path;

/// Brands of still pictures in HEIF (ISO/IEC 23008-12, annex B) whose codec is HEVC or is not told.
const BRANDS: [&[u8; 4]; 8] = [
    b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1",
];

/// Bytes in memory per pixel: three planes of integers, of the tiles and of the whole, and the colours.
const BYTES_PER_PX: u64 = 18;

/// Transfer characteristics (ITU-T H.273, table 3).
const LINEAR: u16 = 8;
const PERCEPTUAL_QUANTIZER: u16 = 16;
const HYBRID_LOG_GAMMA: u16 = 18;

/// Whether a file begins as HEIF does.
pub(super) fn is_heif(bytes: &[u8]) -> bool {
    bytes.get(4..8) == Some(b"ftyp")
        && bytes
            .get(8..12)
            .is_some_and(|brand| BRANDS.iter().any(|known| brand == *known))
}

/// Columns and rows of the picture that [`decode`] gives.
pub(super) fn size(bytes: &[u8]) -> Option<(usize, usize)> {
    let exif = exif_facts::read(bytes);
    frame(bytes, exif.orientation).ok().map(|frame| frame.size)
}

/// The frame in which a picture is given.
struct Frame {
    size: (usize, usize),
    /// Whether the container's own turns and crops are applied.
    is_displayed: bool,
}

fn frame(bytes: &[u8], exif_orientation: Option<u8>) -> Result<Frame, HeifError> {
    let info = heic_decoder::probe(bytes)?;
    let orientation = exif_orientation
        .and_then(Orientation::of_exif)
        .unwrap_or_default();
    let coded = (info.coded_width, info.coded_height);
    let displayed = (info.width, info.height);
    let is_displayed = orientation.upright_size(coded) != displayed;
    Ok(Frame {
        size: if is_displayed { displayed } else { coded },
        is_displayed,
    })
}

/// Decodes the file's main picture; the caller catches the library's panics.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let refused = |error: HeifError| match error {
        HeifError::Unsupported(what) => {
            IoError::input(path, format!("this kind of HEIF is not supported: {what}"))
                .with_hint("convert to JPEG or 16-bit TIFF with one fixed development")
        }
        HeifError::Truncated { .. } => {
            IoError::input(path, "the image is cut off: its file ends too early")
                .with_hint("copy the photo from the camera again")
        }
        other => IoError::input(path, format!("the image is damaged: {other}"))
            .with_hint("copy the photo from the camera again"),
    };
    let mut exif = exif_facts::read(bytes);
    let Frame { size, is_displayed } = frame(bytes, exif.orientation).map_err(refused)?;
    claims::check(
        (size.0 as u64, size.1 as u64),
        BYTES_PER_PX,
        1,
        bytes.len(),
        claims::MAX_WAVELET_EXPANSION,
    )
    .map_err(|reason| IoError::input(path, reason))?;
    if is_displayed {
        exif.orientation = None;
    }
    let options = DecodeOptions {
        apply_transforms: is_displayed,
    };
    let image = heic_decoder::decode_with(bytes, &options).map_err(refused)?;
    let size = (image.width, image.height);
    let is_grey = image.chroma_format_idc == 0;
    let channels = if is_grey { 1 } else { 3 };
    // Grey pictures come with three equal channels.
    let step = if is_grey { 3 } else { 1 };
    let samples = if image.bit_depth_luma == 8 {
        let rgb = image.to_rgb8().map_err(refused)?.data;
        Samples::U8(rgb.into_iter().step_by(step).collect())
    } else {
        let rgb = image.to_rgb16().map_err(refused)?.data;
        Samples::U16(rgb.into_iter().step_by(step).collect())
    };
    let alpha = image.alpha.as_ref().and_then(|alpha| {
        let half = 1 << alpha.bit_depth.saturating_sub(1).min(30);
        alpha_mask(size.0, size.1, alpha.samples.iter().map(|&a| a >= half))
    });

    let bits = image.bit_depth_luma;
    let transfer = image.color_info.map(|color| color.transfer_characteristics);
    let profile = image.metadata.icc_profile.as_deref();
    let (linear_by_metadata, encoding_reason, profile_curve) = match (
        profile.and_then(icc::tone_curve),
        transfer,
    ) {
        (Some(curve), _) => by_profile(bits, curve),
        (None, Some(LINEAR)) => (true, format!("{bits} bit, linear by its metadata"), None),
        (None, Some(PERCEPTUAL_QUANTIZER | HYBRID_LOG_GAMMA)) => {
            return Err(IoError::input(
                    path,
                    "is encoded for displays of high dynamic range (PQ or HLG)",
                )
                .with_hint(
                    "shoot RAW or with the HDR setting off, or convert to 16-bit TIFF with one fixed development",
                ));
        }
        (None, _) => (false, format!("{bits} bit, taken as sRGB"), None),
    };
    Ok(DecodedPhoto {
        file_name: file_name(path),
        width: size.0,
        height: size.1,
        channels,
        samples,
        linear_by_metadata,
        saturates_at_white: true,
        encoding_reason,
        profile_curve,
        alpha,
        exif,
    })
}

#[cfg(test)]
mod tests;
