//! Writes a linear image as a camera RAW file: an uncompressed mosaic as Digital Negative.
//!
//! Each pixel keeps the one colour of its filter, red and green in even rows, green and blue in odd
//! ones, as `s = b + (w - b) L` between the black level `b` and the white level `w` of a camera of
//! 14 bits, and saturates at `w`. So made, a rendered photo goes the whole way of one from a
//! camera.
//!
//! Source: Adobe, Digital Negative Specification 1.4, chapter 4.

use crate::error::IoError;
use crate::files::OutputFile;
use exif::experimental::Writer;
use exif::{Context, Field, In, Rational, SRational, Tag, Value};
use rilievo_scene::{ExifFacts, LinearImage};
use std::io::Cursor;
use std::path::Path;

/// Black level of the written sensor.
const BLACK: u16 = 512;

/// White level: the largest number of 14 bits.
const WHITE: u16 = 16_383;

/// Colours (0 red, 1 green, 2 blue) of the filters over 2 x 2 pixels.
const FILTERS: [u8; 4] = [0, 1, 1, 2];

/// Denominator of written fractions: exact to a part in a hundred thousand at 1/8000 s, and up to
/// four seconds; longer exposures and all else take [`COARSE_FRACTION`].
const FRACTION: u32 = 1_000_000_000;

/// Denominator of fractions that the finer one cannot hold.
const COARSE_FRACTION: u32 = 10_000;

/// Writes a photo of three channels as DNG, with camera and exposure by `exif`; the camera's
/// balance makes `neutral` grey (its response to something white, relative to green).
///
/// # Errors
/// When the image has one channel, or the file cannot be written.
pub fn write_photo_dng(
    path: &Path,
    photo: &LinearImage,
    neutral: [f64; 3],
    exif: &ExifFacts,
) -> Result<(), IoError> {
    if photo.channels != 3 {
        return Err(IoError::write(path, "a mosaic needs a photo in colour"));
    }
    let samples = mosaic(photo);
    let fields = fields(photo, neutral, exif);
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let strips = [samples.as_slice()];
    writer.set_strips(&strips, In::PRIMARY);
    let mut bytes = Cursor::new(Vec::new());
    writer
        .write(&mut bytes, true)
        .map_err(|error| IoError::write(path, error))?;
    OutputFile::new(path, bytes.into_inner()).write()
}

/// Samples of the sensor, 16 bits each, little endian.
fn mosaic(photo: &LinearImage) -> Vec<u8> {
    let range = f32::from(WHITE - BLACK);
    let pixels = photo.data.chunks_exact(3).enumerate();
    pixels
        .flat_map(|(i, pixel)| {
            let (x, y) = (i % photo.width, i / photo.width);
            let color = FILTERS[y % 2 * 2 + x % 2];
            let level = f32::from(BLACK) + range * pixel[usize::from(color)];
            // Casting keeps noise below black down to zero, and saturates.
            (level.round() as u16).min(WHITE).to_le_bytes()
        })
        .collect()
}

fn fields(photo: &LinearImage, neutral: [f64; 3], exif: &ExifFacts) -> Vec<Field> {
    let tiff = |number: u16, value: Value| Field {
        tag: Tag(Context::Tiff, number),
        ifd_num: In::PRIMARY,
        value,
    };
    let short = |values: &[u16]| Value::Short(values.to_vec());
    let long = |value: usize| Value::Long(vec![value as u32]);
    let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
    let fraction = |value: f64| {
        let fits = value * f64::from(FRACTION) < f64::from(u32::MAX);
        let denom = if fits { FRACTION } else { COARSE_FRACTION };
        Rational {
            num: (value * f64::from(denom)).round() as u32,
            denom,
        }
    };
    let make = exif.make.as_deref().unwrap_or("rilievo");
    let model = exif.model.as_deref().unwrap_or("synthetic sensor");
    let one = |i: usize| i32::from(i.is_multiple_of(4));
    let identity = (0..9).map(|i| SRational {
        num: one(i),
        denom: 1,
    });
    let mut fields = vec![
        tiff(0x00FE, long(0)),            // NewSubfileType: full resolution
        tiff(0x0100, long(photo.width)),  // ImageWidth
        tiff(0x0101, long(photo.height)), // ImageLength
        tiff(0x0102, short(&[16])),       // BitsPerSample
        tiff(0x0103, short(&[1])),        // Compression: none
        tiff(0x0106, short(&[32_803])),   // PhotometricInterpretation: CFA
        tiff(0x010F, text(make)),         // Make
        tiff(0x0110, text(model)),        // Model
        tiff(0x0112, short(&[u16::from(exif.orientation.unwrap_or(1))])), // Orientation
        tiff(0x0115, short(&[1])),        // SamplesPerPixel
        tiff(0x0116, long(photo.height)), // RowsPerStrip
        tiff(0x011C, short(&[1])),        // PlanarConfiguration
        tiff(0x828D, short(&[2, 2])),     // CFARepeatPatternDim
        tiff(0x828E, Value::Byte(FILTERS.to_vec())), // CFAPattern
        tiff(0xC612, Value::Byte(vec![1, 4, 0, 0])), // DNGVersion
        tiff(0xC614, text(&format!("{make} {model}"))), // UniqueCameraModel
        tiff(0xC61A, short(&[BLACK])),    // BlackLevel
        tiff(0xC61D, short(&[WHITE])),    // WhiteLevel
        tiff(0xC621, Value::SRational(identity.collect())), // ColorMatrix1
        tiff(0xC628, Value::Rational(neutral.map(fraction).to_vec())), // AsShotNeutral
        tiff(0xC65A, short(&[21])),       // CalibrationIlluminant1: D65
    ];
    let mut add = |tag: Tag, value: Option<Value>| {
        let ifd_num = In::PRIMARY;
        fields.extend(value.map(|value| Field {
            tag,
            ifd_num,
            value,
        }));
    };
    let number = |value: Option<f64>| value.map(|value| Value::Rational(vec![fraction(value)]));
    let whole = |value: Option<f64>| value.map(|value| Value::Short(vec![value.round() as u16]));
    add(Tag::FocalLength, number(exif.focal_mm));
    add(Tag::FocalLengthIn35mmFilm, whole(exif.focal_35mm));
    add(Tag::ExposureTime, number(exif.exposure_time_s));
    add(Tag::FNumber, number(exif.f_number));
    add(Tag::PhotographicSensitivity, whole(exif.iso));
    add(Tag::LensModel, exif.lens.as_deref().map(text));
    add(Tag::BodySerialNumber, exif.serial.as_deref().map(text));
    add(Tag::DateTimeOriginal, exif.date.as_deref().map(text));
    fields
}
