//! HEIF with HEVC pictures (HEIC, HIF), as phones and some cameras store photos.
//!
//! The container states in a field of its own how to turn the picture for display, and EXIF is not
//! asked (ISO/IEC 23008-12, section 6.5.10). The picture is left as coded, and its turn noted as
//! EXIF's orientation of other photos is; where the container crops too, its word is followed and
//! the picture counts as upright.

use super::exif_facts;
use super::guard::guarded;
use super::icc;
use super::names::file_name;
use super::parts::alpha_mask;
use super::raster::by_profile;
use crate::claims;
use crate::error::IoError;
use heic_decoder::isobmff::Transform;
use heic_decoder::{ColorInfo, DecodeOptions, HeifError, RgbOptions};
use rilievo_scene::{DecodedPhoto, Orientation, Raster, Samples};
use std::path::Path;

/// Bytes in memory per pixel: three planes of integers, of tiles and of the whole, and colours.
const BYTES_PER_PX: u64 = 18;

/// Colours of files without a statement of them: sRGB, the whole range, BT.601's matrix (ISO/IEC
/// 23000-22, section 7.3.6.4).
const UNLABELLED: ColorInfo = ColorInfo {
    color_primaries: 1,
    transfer_characteristics: 13,
    matrix_coefficients: 6,
    full_range: true,
};

/// Transfer characteristics (ITU-T H.273, table 3).
const LINEAR: u16 = 8;
const PERCEPTUAL_QUANTIZER: u16 = 16;
const HYBRID_LOG_GAMMA: u16 = 18;

/// Columns and rows of the picture that [`decode`] returns.
pub(super) fn size(bytes: &[u8]) -> Option<(usize, usize)> {
    let info = heic_decoder::probe(bytes).ok()?;
    let turn = turn(&heic_decoder::isobmff::parse(bytes).ok()?.transforms);
    Some(match turn {
        Some(_) => (info.coded_width, info.coded_height),
        None => (info.width, info.height),
    })
}

/// How a container turns its picture; `None` where it crops.
fn turn(transforms: &[Transform]) -> Option<Orientation> {
    // A picture that looks different under every turn.
    let stored = Raster::from_fn(3, 2, |x, y| 3 * y + x);
    let mut upright = stored.clone();
    for transform in transforms {
        let (width, height) = (upright.width, upright.height);
        upright = match *transform {
            Transform::CleanAperture(_) => return None,
            Transform::Rotate90Ccw(turns) => (0..turns % 4).fold(upright, |before, _| {
                let (width, height) = (before.height, before.width);
                Raster::from_fn(width, height, |x, y| *before.at(height - 1 - y, x))
            }),
            Transform::MirrorVertical => {
                Raster::from_fn(width, height, |x, y| *upright.at(x, height - 1 - y))
            }
            Transform::MirrorHorizontal => {
                Raster::from_fn(width, height, |x, y| *upright.at(width - 1 - x, y))
            }
        };
    }
    (1..=8)
        .filter_map(Orientation::of_exif)
        .find(|turn| turn.raster_to_stored(&upright) == stored)
}

/// Does work in a thread of its own, on one thread: the decoder would wait for the threads that
/// decode other photos, and take up another photo meanwhile.
fn alone<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T, String> {
    std::thread::scope(|scope| {
        let worker = std::thread::Builder::new().spawn_scoped(scope, || {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
            pool.map(|pool| pool.install(work))
                .map_err(|error| error.to_string())
        });
        let worker = worker.map_err(|error| format!("no thread can be had: {error}"))?;
        worker.join().map_err(|_| "its decoder failed".to_owned())?
    })
}

/// Decodes the file's main picture.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let decoded = alone(|| guarded(path, || decode_here(path, bytes)));
    decoded.unwrap_or_else(|reason| Err(IoError::input(path, reason)))
}

fn decode_here(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
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
    let info = heic_decoder::probe(bytes).map_err(refused)?;
    let parsed = heic_decoder::isobmff::parse(bytes).map_err(refused)?;
    let turn = turn(&parsed.transforms);
    claims::check(
        (info.coded_width as u64, info.coded_height as u64),
        BYTES_PER_PX,
        1,
        bytes.len(),
        claims::MAX_WAVELET_EXPANSION,
    )
    .map_err(|reason| IoError::input(path, reason))?;
    exif.orientation = turn.map(Orientation::number);
    let options = DecodeOptions {
        apply_transforms: turn.is_none(),
    };
    let image = heic_decoder::decode_with(bytes, &options).map_err(refused)?;
    let colors = RgbOptions {
        color: Some(image.color_info.unwrap_or(UNLABELLED)),
        ..RgbOptions::default()
    };
    let size = (image.width, image.height);
    let is_grey = image.chroma_format_idc == 0;
    let channels = if is_grey { 1 } else { 3 };
    // Grey pictures come with three equal channels.
    let step = if is_grey { 3 } else { 1 };
    let samples = if image.bit_depth_luma == 8 {
        let rgb = image.to_rgb8_with_options(&colors).map_err(refused)?.data;
        Samples::U8(rgb.into_iter().step_by(step).collect())
    } else {
        let rgb = image.to_rgb16_with_options(&colors).map_err(refused)?.data;
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
