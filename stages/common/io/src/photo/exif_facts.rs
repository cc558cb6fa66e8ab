//! EXIF: focal length, exposure, camera and orientation, each only where it is plausible.
//!
//! Source: CIPA DC-008 (Exif 2.32), tables 4 to 8.

use exif::{Field, In, Tag, Value};
use rilievo_scene::ExifFacts;
use std::io::Cursor;

/// Millimetres in an inch.
const MM_PER_INCH: f64 = 25.4;

/// Reads what there is; damaged or absent EXIF means absent facts, never an error: the pixels are
/// good without it.
pub(super) fn read(bytes: &[u8]) -> ExifFacts {
    let mut reader = exif::Reader::new();
    reader.continue_on_error(true);
    let parsed = reader
        .read_from_container(&mut Cursor::new(bytes))
        .or_else(|error| error.distill_partial_result(|_| {}));
    let Ok(exif) = parsed else {
        return ExifFacts::default();
    };
    let field = |tag: Tag| exif.get_field(tag, In::PRIMARY);
    let positive = |tag: Tag| field(tag).and_then(number).filter(|&v| v > 0.0);
    let integer = |tag: Tag| field(tag).and_then(|f| f.value.get_uint(0));

    let px_per_unit = positive(Tag::FocalPlaneXResolution);
    let focal_plane_px_per_mm = px_per_unit.and_then(|px| {
        // Units of FocalPlaneResolutionUnit: 2 inch (also the default), 3 centimetre; 4 and 5
        // (millimetre, micrometre) are in use beyond the standard.
        match integer(Tag::FocalPlaneResolutionUnit).unwrap_or(2) {
            2 => Some(px / MM_PER_INCH),
            3 => Some(px / 10.0),
            4 => Some(px),
            5 => Some(px * 1e3),
            _ => None,
        }
    });
    ExifFacts {
        focal_mm: positive(Tag::FocalLength),
        focal_35mm: positive(Tag::FocalLengthIn35mmFilm),
        focal_plane_px_per_mm,
        pixel_x_dimension: integer(Tag::PixelXDimension).filter(|&v| v > 0),
        pixel_y_dimension: integer(Tag::PixelYDimension).filter(|&v| v > 0),
        orientation: integer(Tag::Orientation)
            .filter(|v| (1..=8).contains(v))
            .map(|v| v as u8),
        make: field(Tag::Make).and_then(text),
        model: field(Tag::Model).and_then(text),
        serial: field(Tag::BodySerialNumber).and_then(text),
        lens: field(Tag::LensModel).and_then(text),
        exposure_time_s: positive(Tag::ExposureTime),
        f_number: positive(Tag::FNumber),
        iso: positive(Tag::PhotographicSensitivity),
        date: field(Tag::DateTimeOriginal).and_then(text),
    }
}

/// The first number of a field, where it is finite.
fn number(field: &Field) -> Option<f64> {
    let value = match &field.value {
        Value::Rational(v) => v.first()?.to_f64(),
        Value::SRational(v) => v.first()?.to_f64(),
        Value::Float(v) => f64::from(*v.first()?),
        Value::Double(v) => *v.first()?,
        other => f64::from(other.get_uint(0)?),
    };
    value.is_finite().then_some(value)
}

/// The text of a field without the padding that cameras leave in it.
fn text(field: &Field) -> Option<String> {
    let Value::Ascii(parts) = &field.value else {
        return None;
    };
    let text = String::from_utf8_lossy(parts.first()?)
        .trim_matches(|c: char| c.is_whitespace() || c == '\0')
        .to_owned();
    (!text.is_empty()).then_some(text)
}
