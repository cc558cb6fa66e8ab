//! Photos that the image library decodes: JPEG, PNG, TIFF and Radiance HDR.

use super::alpha::alpha_mask;
use super::icc::{self, MAX_PROFILE_BYTES, ToneCurve, profile_too_large};
use super::names::file_name;
use super::{exif_facts, float_tiff, jpeg, png_chunks};
use crate::claims;
use crate::error::IoError;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use rilievo_scene::{DecodedPhoto, Samples};
use std::io::Cursor;
use std::path::Path;

/// Decodes a JPEG, PNG, TIFF or Radiance HDR; the caller catches the library's panics.
pub(super) fn decode(
    path: &Path,
    bytes: &[u8],
    format: ImageFormat,
) -> Result<DecodedPhoto, IoError> {
    let damaged = |error: image::ImageError| {
        let refusal = IoError::input(path, describe(&error));
        match error {
            image::ImageError::Unsupported(_) => {
                refusal.with_hint("convert to OpenEXR, or to PNG or TIFF with 8 or 16 bits")
            }
            _ => refusal,
        }
    };
    if format == ImageFormat::Jpeg {
        jpeg::check(bytes).map_err(|reason| match reason {
            jpeg::Defect::Cmyk => {
                IoError::input(path, reason.to_string()).with_hint("convert the photo to RGB")
            }
            _ => IoError::input(path, reason.to_string())
                .with_hint("copy the photo from the camera again"),
        })?;
    }
    if format == ImageFormat::Png {
        png_chunks::check_profile(bytes).map_err(|reason| IoError::input(path, reason))?;
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.no_limits();
    let mut decoder = match reader.into_decoder() {
        Ok(decoder) => decoder,
        Err(error) => {
            let float = (format == ImageFormat::Tiff)
                .then(|| float_tiff::read(bytes))
                .flatten();
            return match float {
                Some((width, height, channels, data)) => Ok(DecodedPhoto {
                    file_name: file_name(path),
                    width,
                    height,
                    channels,
                    samples: Samples::F32(data),
                    linear_by_metadata: true,
                    saturates_at_white: false,
                    encoding_reason: "floating point".to_owned(),
                    profile_curve: None,
                    alpha: None,
                    exif: exif_facts::read(bytes),
                }),
                None => Err(damaged(error)),
            };
        }
    };
    let (width, height) = decoder.dimensions();
    let size = (u64::from(width), u64::from(height));
    let bytes_per_px = u64::from(decoder.color_type().bytes_per_pixel());
    // The samples, and those of colour and alpha apart.
    claims::check(size, bytes_per_px, 2, bytes.len(), claims::MAX_EXPANSION)
        .map_err(|reason| IoError::input(path, reason))?;
    if matches!(
        decoder.original_color_type(),
        image::ExtendedColorType::Cmyk8 | image::ExtendedColorType::Cmyk16
    ) {
        return Err(IoError::input(path, jpeg::Defect::Cmyk.to_string())
            .with_hint("convert the photo to RGB"));
    }
    // Bounds what a damaged header can ask for beyond the pixels themselves.
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2) + (64 << 20));
    decoder.set_limits(limits).map_err(damaged)?;
    let profile = match format {
        ImageFormat::Tiff => tiff_profile(bytes).map_err(|reason| IoError::input(path, reason))?,
        _ => decoder.icc_profile().ok().flatten(),
    };
    let decoded = DynamicImage::from_decoder(decoder).map_err(damaged)?;

    let exif = exif_facts::read(bytes);
    let (samples, channels, alpha) = split(decoded);
    let saturates_at_white = !matches!(samples, Samples::F32(_));
    let alpha =
        alpha.and_then(|alpha| alpha_mask(width as usize, height as usize, alpha.into_iter()));
    let (linear_by_metadata, encoding_reason, profile_curve) =
        encoding(bytes, format, &samples, profile.as_deref());
    Ok(DecodedPhoto {
        file_name: file_name(path),
        width: width as usize,
        height: height as usize,
        channels,
        samples,
        linear_by_metadata,
        saturates_at_white,
        encoding_reason,
        profile_curve,
        alpha,
        exif,
    })
}

/// The colour profile of a TIFF, which the image library looks for without bounds or within those of
/// the pixels.
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

/// What the metadata say of the encoding: linear or not, why, and the profile's own curve.
fn encoding(
    bytes: &[u8],
    format: ImageFormat,
    samples: &Samples,
    profile: Option<&[u8]>,
) -> (bool, String, Option<Vec<f32>>) {
    let bits = samples.bits();
    if matches!(samples, Samples::F32(_)) {
        return (true, "floating point".to_owned(), None);
    }
    if let Some(curve) = profile.and_then(icc::tone_curve) {
        return match curve {
            ToneCurve::Linear => (true, format!("{bits} bit, linear colour profile"), None),
            ToneCurve::Srgb => (
                false,
                format!("{bits} bit, sRGB curve in its profile"),
                None,
            ),
            ToneCurve::Other(table) => (
                false,
                format!("{bits} bit, curve of its colour profile"),
                Some(table),
            ),
        };
    }
    let png = (format == ImageFormat::Png)
        .then(|| png_chunks::color(bytes))
        .flatten();
    match png {
        Some(png_chunks::PngColor::Linear) => {
            return (true, format!("{bits} bit, linear by its gamma"), None);
        }
        Some(png_chunks::PngColor::Encoded) => {
            return (false, format!("{bits} bit, sRGB by its metadata"), None);
        }
        Some(png_chunks::PngColor::Gamma(gamma)) => {
            let table = icc::power_table(gamma);
            return (false, format!("{bits} bit, gamma {gamma:.2}"), Some(table));
        }
        None => {}
    }
    match (bits, profile) {
        (16, None) => (true, "16 bit without colour metadata".to_owned(), None),
        (_, Some(_)) => (
            false,
            format!("{bits} bit, colour profile without a plain curve, taken as sRGB"),
            None,
        ),
        _ => (false, format!("{bits} bit"), None),
    }
}

/// Colour samples, number of colour channels, and whether alpha is at least one half.
fn split(image: DynamicImage) -> (Samples, usize, Option<Vec<bool>>) {
    fn without_alpha<T: Copy>(
        data: Vec<T>,
        channels: usize,
        opaque: impl Fn(T) -> bool,
    ) -> (Vec<T>, Vec<bool>) {
        let alpha = data
            .chunks_exact(channels + 1)
            .map(|pixel| opaque(pixel[channels]))
            .collect();
        let color = data
            .chunks_exact(channels + 1)
            .flat_map(|pixel| pixel[..channels].iter().copied())
            .collect();
        (color, alpha)
    }
    match image {
        DynamicImage::ImageLuma8(i) => (Samples::U8(i.into_raw()), 1, None),
        DynamicImage::ImageLuma16(i) => (Samples::U16(i.into_raw()), 1, None),
        DynamicImage::ImageRgb8(i) => (Samples::U8(i.into_raw()), 3, None),
        DynamicImage::ImageRgb16(i) => (Samples::U16(i.into_raw()), 3, None),
        DynamicImage::ImageRgb32F(i) => (Samples::F32(i.into_raw()), 3, None),
        DynamicImage::ImageLumaA8(i) => {
            let (color, alpha) = without_alpha(i.into_raw(), 1, |a| a >= 128);
            (Samples::U8(color), 1, Some(alpha))
        }
        DynamicImage::ImageLumaA16(i) => {
            let (color, alpha) = without_alpha(i.into_raw(), 1, |a| a >= 32768);
            (Samples::U16(color), 1, Some(alpha))
        }
        DynamicImage::ImageRgba8(i) => {
            let (color, alpha) = without_alpha(i.into_raw(), 3, |a| a >= 128);
            (Samples::U8(color), 3, Some(alpha))
        }
        DynamicImage::ImageRgba16(i) => {
            let (color, alpha) = without_alpha(i.into_raw(), 3, |a| a >= 32768);
            (Samples::U16(color), 3, Some(alpha))
        }
        DynamicImage::ImageRgba32F(i) => {
            let (color, alpha) = without_alpha(i.into_raw(), 3, |a| a >= 0.5);
            (Samples::F32(color), 3, Some(alpha))
        }
        // Kinds that the library may add later: eight bits of red, green and blue lose least.
        other => (Samples::U8(other.into_rgb8().into_raw()), 3, None),
    }
}

/// The reason in a user's words.
fn describe(error: &image::ImageError) -> String {
    use image::ImageError;
    match error {
        ImageError::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            "the image is cut off: its file ends too early".to_owned()
        }
        ImageError::Unsupported(error) => format!("this kind of image is not supported: {error}"),
        error => format!("the image is damaged: {error}"),
    }
}
