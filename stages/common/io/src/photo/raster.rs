//! Photos that the image library decodes: JPEG, PNG, TIFF and Radiance HDR.

use super::icc::{self, MAX_PROFILE_BYTES, ToneCurve, profile_too_large};
use super::names::file_name;
use super::parts::{alpha_mask, of_floats};
use super::png_chunks::{self, PngColor};
use super::{exif_facts, further_tiff, jpeg};
use crate::claims;
use crate::error::IoError;
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits,
};
use rilievo_scene::{DecodedPhoto, Samples};
use std::io::Cursor;
use std::path::Path;

const CMYK_HINT: &str = "convert the photo to RGB";

/// Decodes a JPEG that is whole; the caller catches the library's panics, here and below.
pub(super) fn jpeg(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    jpeg::check(bytes).map_err(|defect| {
        let hint = match defect {
            jpeg::Defect::Cmyk => CMYK_HINT,
            _ => "copy the photo from the camera again",
        };
        IoError::input(path, defect.to_string()).with_hint(hint)
    })?;
    let mut decoder = open(path, bytes, ImageFormat::Jpeg)?;
    let profile = decoder.icc_profile().ok().flatten();
    decode(path, bytes, decoder, profile, None)
}

pub(super) fn png(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    png_chunks::check_profile(bytes).map_err(|reason| IoError::input(path, reason))?;
    let mut decoder = open(path, bytes, ImageFormat::Png)?;
    let profile = decoder.icc_profile().ok().flatten();
    decode(path, bytes, decoder, profile, png_chunks::color(bytes))
}

pub(super) fn tiff(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let profile = tiff_profile(bytes).map_err(|reason| IoError::input(path, reason))?;
    let refusal = if further_tiff::has_wide_integers(bytes) {
        let reason = "holds integers of 32 bits of a kind that cannot be read";
        IoError::input(path, reason).with_hint("save it with 16 bits a sample")
    } else {
        let decoder = open(path, bytes, ImageFormat::Tiff);
        match decoder.and_then(|decoder| decode(path, bytes, decoder, profile.clone(), None)) {
            Err(refusal) => refusal,
            decoded => return decoded,
        }
    };
    let Some((size, samples)) = further_tiff::read(bytes) else {
        return Err(refusal);
    };
    let (linear_by_metadata, encoding_reason, profile_curve) =
        encoding(&samples, profile.as_deref(), None);
    Ok(DecodedPhoto {
        exif: exif_facts::read(bytes),
        linear_by_metadata,
        encoding_reason,
        profile_curve,
        samples,
        ..of_floats(path, size, Vec::new(), "")
    })
}

pub(super) fn hdr(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let decoder = open(path, bytes, ImageFormat::Hdr)?;
    decode(path, bytes, decoder, None, None)
}

fn open<'a>(
    path: &Path,
    bytes: &'a [u8],
    format: ImageFormat,
) -> Result<impl ImageDecoder + 'a, IoError> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.no_limits();
    reader.into_decoder().map_err(|error| refused(path, error))
}

/// Decodes what was opened, with its encoding by its metadata.
fn decode(
    path: &Path,
    bytes: &[u8],
    mut decoder: impl ImageDecoder,
    profile: Option<Vec<u8>>,
    png: Option<PngColor>,
) -> Result<DecodedPhoto, IoError> {
    let (width, height) = decoder.dimensions();
    let size = (u64::from(width), u64::from(height));
    let bytes_per_px = u64::from(decoder.color_type().bytes_per_pixel());
    // The samples, and those of colour and alpha apart.
    claims::check(size, bytes_per_px, 2, bytes.len(), claims::MAX_EXPANSION)
        .map_err(|reason| IoError::input(path, reason))?;
    if matches!(
        decoder.original_color_type(),
        ExtendedColorType::Cmyk8 | ExtendedColorType::Cmyk16
    ) {
        let reason = jpeg::Defect::Cmyk.to_string();
        return Err(IoError::input(path, reason).with_hint(CMYK_HINT));
    }
    // Bounds what a damaged header can ask for beyond the pixels themselves.
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2) + (64 << 20));
    let damaged = |error| refused(path, error);
    decoder.set_limits(limits).map_err(damaged)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(damaged)?;

    let (width, height) = (width as usize, height as usize);
    let (samples, channels, alpha) = split(decoded);
    let (linear_by_metadata, encoding_reason, profile_curve) =
        encoding(&samples, profile.as_deref(), png);
    Ok(DecodedPhoto {
        file_name: file_name(path),
        width,
        height,
        channels,
        saturates_at_white: !matches!(samples, Samples::F32(_)),
        samples,
        linear_by_metadata,
        encoding_reason,
        profile_curve,
        alpha: alpha.and_then(|alpha| alpha_mask(width, height, alpha.into_iter())),
        exif: exif_facts::read(bytes),
    })
}

/// The colour profile of a TIFF; the image library has no bounds for it, or those of the pixels.
fn tiff_profile(bytes: &[u8]) -> Result<Option<Vec<u8>>, String> {
    use tiff::decoder::{Decoder, Limits, ifd::Value};
    let Ok(decoder) = Decoder::new(Cursor::new(bytes)) else {
        return Ok(None);
    };
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_PROFILE_BYTES.min(bytes.len()) * size_of::<Value>();
    match decoder
        .with_limits(limits)
        .find_tag(tiff::tags::Tag::IccProfile)
    {
        Err(tiff::TiffError::LimitsExceeded) => Err(profile_too_large()),
        found => Ok(found.ok().flatten().and_then(|tag| tag.into_u8_vec().ok())),
    }
}

/// The encoding by the metadata: linear or not, why, and the profile's own curve.
fn encoding(
    samples: &Samples,
    profile: Option<&[u8]>,
    png: Option<PngColor>,
) -> (bool, String, Option<Vec<f32>>) {
    let bits = samples.bits();
    if matches!(samples, Samples::F32(_)) {
        return (true, "floating point".to_owned(), None);
    }
    if let Some(curve) = profile.and_then(icc::tone_curve) {
        return by_profile(bits, curve);
    }
    let (is_linear, what, curve) = match (png, bits, profile) {
        (Some(PngColor::Linear), ..) => (true, ", linear by its gamma".to_owned(), None),
        (Some(PngColor::Encoded), ..) => (false, ", sRGB by its metadata".to_owned(), None),
        (Some(PngColor::Gamma(gamma)), ..) => {
            let table = icc::power_table(gamma);
            (false, format!(", gamma {gamma:.2}"), Some(table))
        }
        (None, 16, None) => (true, " without colour metadata".to_owned(), None),
        (None, _, Some(_)) => {
            let what = ", colour profile without a plain curve, taken as sRGB";
            (false, what.to_owned(), None)
        }
        (None, _, None) => (false, String::new(), None),
    };
    (is_linear, format!("{bits} bit{what}"), curve)
}

/// The same of a photo whose colour profile has a curve.
pub(super) fn by_profile(bits: u32, curve: ToneCurve) -> (bool, String, Option<Vec<f32>>) {
    let (is_linear, what, table) = match curve {
        ToneCurve::Linear => (true, "linear colour profile", None),
        ToneCurve::Srgb => (false, "sRGB curve in its profile", None),
        ToneCurve::Other(table) => (false, "curve of its colour profile", Some(table)),
    };
    (is_linear, format!("{bits} bit, {what}"), table)
}

/// Colour samples, number of colour channels, and whether alpha is at least one half.
fn split(image: DynamicImage) -> (Samples, usize, Option<Vec<bool>>) {
    fn parted<T: Copy>(
        data: Vec<T>,
        channels: usize,
        opaque: impl Fn(T) -> bool,
        samples: fn(Vec<T>) -> Samples,
    ) -> (Samples, usize, Option<Vec<bool>>) {
        let pixels = data.chunks_exact(channels + 1);
        let alpha = pixels.clone().map(|pixel| opaque(pixel[channels]));
        let alpha = alpha.collect();
        let color = pixels.flat_map(|pixel| pixel[..channels].iter().copied());
        (samples(color.collect()), channels, Some(alpha))
    }
    let half8 = |a: u8| a >= 128;
    let half16 = |a: u16| a >= 32768;
    match image {
        DynamicImage::ImageLuma8(i) => (Samples::U8(i.into_raw()), 1, None),
        DynamicImage::ImageLuma16(i) => (Samples::U16(i.into_raw()), 1, None),
        DynamicImage::ImageRgb8(i) => (Samples::U8(i.into_raw()), 3, None),
        DynamicImage::ImageRgb16(i) => (Samples::U16(i.into_raw()), 3, None),
        DynamicImage::ImageRgb32F(i) => (Samples::F32(i.into_raw()), 3, None),
        DynamicImage::ImageLumaA8(i) => parted(i.into_raw(), 1, half8, Samples::U8),
        DynamicImage::ImageLumaA16(i) => parted(i.into_raw(), 1, half16, Samples::U16),
        DynamicImage::ImageRgba8(i) => parted(i.into_raw(), 3, half8, Samples::U8),
        DynamicImage::ImageRgba16(i) => parted(i.into_raw(), 3, half16, Samples::U16),
        DynamicImage::ImageRgba32F(i) => parted(i.into_raw(), 3, |a| a >= 0.5, Samples::F32),
        // Kinds that the library may add later: eight bits of red, green and blue lose least.
        other => (Samples::U8(other.into_rgb8().into_raw()), 3, None),
    }
}

/// The refusal in a user's words.
fn refused(path: &Path, error: ImageError) -> IoError {
    let reason = match &error {
        ImageError::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            "the image is cut off: its file ends too early".to_owned()
        }
        ImageError::Unsupported(error) => format!("this kind of image is not supported: {error}"),
        error => format!("the image is damaged: {error}"),
    };
    let refusal = IoError::input(path, reason);
    match error {
        ImageError::Unsupported(_) => {
            refusal.with_hint("convert to OpenEXR, or to PNG or TIFF with 8 or 16 bits")
        }
        _ => refusal,
    }
}
