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
mod icc;
mod jpeg;
mod png_color;
#[cfg(feature = "raw")]
mod raw;

use crate::error::IoError;
use crate::exr_maps;
use icc::ToneCurve;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use rilievo_scene::{DecodedPhoto, ExifFacts, Mask, Samples};
use std::io::Cursor;
use std::path::Path;

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

/// How a RAW file becomes a photo whose samples are proportional to light. LibRaw's `-4` writes 16
/// bits without tone curve and automatic brightness, `-o 0` keeps the camera's colours, so that the
/// file says nothing of its colours and is taken as linear.
const RAW_HINT: &str = "develop all photos alike to linear 16-bit TIFF, as with LibRaw's \
     dcraw_emu -T -4 -o 0 -w FILE, or in RawTherapee or darktable with a linear output profile and \
     no tone curve";

/// More pixels than any camera has: a header that claims them is damaged.
const MAX_PIXELS: u64 = 1_000_000_000;

fn ending(path: &Path) -> String {
    path.extension()
        .map(|ending| ending.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default()
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
    let bytes = std::fs::read(path).map_err(|error| IoError::read(path, &error))?;
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
    if RAW_ENDINGS.contains(&ending.as_str()) {
        let decoded = guarded(path, || decode_raw(path, bytes));
        return decoded.map_err(|error| error.with_hint(RAW_HINT));
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
        _ => decode_raster(path, bytes, format),
    })
}

/// The decoders' own checks are good, but they read whatever people's disks hold: a defect in one of
/// them must cost one photo, not the run.
fn guarded(
    path: &Path,
    decode: impl FnOnce() -> Result<DecodedPhoto, IoError> + std::panic::UnwindSafe,
) -> Result<DecodedPhoto, IoError> {
    std::panic::catch_unwind(decode).unwrap_or_else(|_| {
        Err(IoError::input(
            path,
            "the image is damaged (its decoder failed)",
        ))
    })
}

#[cfg(feature = "raw")]
use raw::decode as decode_raw;

#[cfg(not(feature = "raw"))]
fn decode_raw(path: &Path, _: &[u8]) -> Result<DecodedPhoto, IoError> {
    let reason = "this program was built without the reader of camera RAW files (feature `raw`)";
    Err(IoError::input(path, reason))
}

/// Columns and rows of a photo by its header alone; `None` where it has none that can be read. Headers
/// of camera RAW files tell of their previews.
pub fn photo_size(path: &Path) -> Option<(usize, usize)> {
    if RAW_ENDINGS.contains(&ending(path).as_str()) {
        return None;
    }
    let reader = ImageReader::open(path).ok()?.with_guessed_format().ok()?;
    // As in decoding: a decoder that fails on damaged bytes costs this photo alone.
    let size = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| reader.into_dimensions()));
    let (width, height) = size.ok()?.ok()?;
    Some((width as usize, height as usize))
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

fn decode_raster(path: &Path, bytes: &[u8], format: ImageFormat) -> Result<DecodedPhoto, IoError> {
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
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(IoError::input(
            path,
            format!("claims {width} x {height} pixels, more than any photo has"),
        ));
    }
    if matches!(
        decoder.original_color_type(),
        image::ExtendedColorType::Cmyk8 | image::ExtendedColorType::Cmyk16
    ) {
        return Err(IoError::input(path, jpeg::Defect::Cmyk.to_string())
            .with_hint("convert the photo to RGB"));
    }
    let profile = decoder.icc_profile().ok().flatten();
    // Bounds what a damaged header can ask for beyond the pixels themselves.
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2) + (64 << 20));
    decoder.set_limits(limits).map_err(damaged)?;
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
        .then(|| png_color::read(bytes))
        .flatten();
    match png {
        Some(png_color::PngColor::Linear) => {
            return (true, format!("{bits} bit, linear by its gamma"), None);
        }
        Some(png_color::PngColor::Encoded) => {
            return (false, format!("{bits} bit, sRGB by its metadata"), None);
        }
        Some(png_color::PngColor::Gamma(gamma)) => {
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

/// The alpha channel as a mask; an alpha that is opaque everywhere says nothing.
fn alpha_mask(width: usize, height: usize, opaque: impl Iterator<Item = bool>) -> Option<Mask> {
    let data: Vec<bool> = opaque.collect();
    if data.iter().all(|&inside| inside) {
        return None;
    }
    Mask::from_vec(width, height, data)
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

#[cfg(test)]
mod tests;
