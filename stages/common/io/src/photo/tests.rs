use super::*;
use exif::experimental::Writer;
use exif::{Rational, Value};
use image::{DynamicImage, ImageFormat};
use image::{ImageBuffer, Luma, Rgb, Rgba};
use rilievo_scene::{ExifFacts, Samples};
use std::io::Cursor;
use std::path::PathBuf;

pub(super) fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn wave(i: usize) -> f32 {
    0.5 + 0.45 * (i as f32 * 0.37).sin()
}

pub(super) fn encoded(image: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.into().write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn rgb8(width: u32, height: u32) -> ImageBuffer<Rgb<u8>, Vec<u8>> {
    let len = (width * height * 3) as usize;
    let data = (0..len).map(|i| (wave(i) * 255.0) as u8).collect();
    ImageBuffer::from_raw(width, height, data).unwrap()
}

pub(super) fn rgb16(width: u32, height: u32) -> ImageBuffer<Rgb<u16>, Vec<u16>> {
    let len = (width * height * 3) as usize;
    let data = (0..len).map(|i| (wave(i) * 65535.0) as u16).collect();
    ImageBuffer::from_raw(width, height, data).unwrap()
}

pub(super) fn decode(name: &str, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    decode_photo_bytes(Path::new(name), bytes)
}

/// A JPEG with an EXIF segment right after its start.
fn with_exif(jpeg: &[u8], fields: &[Field]) -> Vec<u8> {
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut tiff = Cursor::new(Vec::new());
    writer.write(&mut tiff, false).unwrap();
    let tiff = tiff.into_inner();
    let mut bytes = jpeg[..2].to_vec();
    bytes.extend([0xFF, 0xE1]);
    bytes.extend(((tiff.len() + 8) as u16).to_be_bytes());
    bytes.extend(b"Exif\0\0");
    bytes.extend(&tiff);
    bytes.extend(&jpeg[2..]);
    bytes
}

use exif::{Field, In, Tag};

fn field(tag: Tag, value: Value) -> Field {
    Field {
        tag,
        ifd_num: In::PRIMARY,
        value,
    }
}

#[test]
fn integer_formats_keep_every_sample() {
    for format in [ImageFormat::Png, ImageFormat::Tiff] {
        let image = rgb8(12, 7);
        let photo = decode("a", &encoded(image.clone(), format)).unwrap();
        assert_eq!((photo.width, photo.height, photo.channels), (12, 7, 3));
        assert_eq!(photo.samples, Samples::U8(image.into_raw()));
        assert!(!photo.linear_by_metadata, "{}", photo.encoding_reason);
        let image = rgb16(5, 9);
        let photo = decode("a", &encoded(image.clone(), format)).unwrap();
        assert_eq!(photo.samples, Samples::U16(image.into_raw()));
        assert!(photo.linear_by_metadata, "{}", photo.encoding_reason);
        let grey: ImageBuffer<Luma<u16>, _> =
            ImageBuffer::from_raw(3, 2, vec![0u16, 1, 2, 300, 40_000, 65_535]).unwrap();
        let photo = decode("a", &encoded(grey.clone(), format)).unwrap();
        assert_eq!(
            (photo.channels, photo.samples),
            (1, Samples::U16(grey.into_raw()))
        );
        assert_eq!(photo.alpha, None);
    }
}

#[test]
fn float_formats_are_linear() {
    let data: Vec<f32> = (0..60).map(|i| wave(i) * 3.0 - 0.2).collect();
    let image: ImageBuffer<Rgb<f32>, _> = ImageBuffer::from_raw(5, 4, data.clone()).unwrap();
    for format in [ImageFormat::Tiff, ImageFormat::OpenExr] {
        let photo = decode("a", &encoded(image.clone(), format)).unwrap();
        assert_eq!(photo.samples, Samples::F32(data.clone()), "{format:?}");
        assert!(photo.linear_by_metadata);
    }
}

#[test]
fn alpha_becomes_a_mask_and_leaves_the_colours() {
    let pixels: Vec<u8> = (0..8u8)
        .flat_map(|i| [10 * i, 20, 30, if i < 3 { 255 } else { 0 }])
        .collect();
    let image: ImageBuffer<Rgba<u8>, _> = ImageBuffer::from_raw(4, 2, pixels).unwrap();
    let photo = decode("a.png", &encoded(image, ImageFormat::Png)).unwrap();
    assert_eq!(photo.channels, 3);
    let alpha = photo.alpha.unwrap();
    assert_eq!(alpha.count(), 3);
    assert!(matches!(photo.samples, Samples::U8(v) if v.len() == 24 && v[3] == 10));
    let opaque: ImageBuffer<Rgba<u8>, _> = ImageBuffer::from_pixel(4, 2, Rgba([1u8, 2, 3, 255]));
    let photo = decode("a.png", &encoded(opaque, ImageFormat::Png)).unwrap();
    assert_eq!(photo.alpha, None);
}

#[test]
fn a_cut_off_photo_is_refused_at_every_length() {
    let jpeg = encoded(rgb8(40, 30), ImageFormat::Jpeg);
    assert!(decode("a.jpg", &jpeg).is_ok());
    for end in 0..jpeg.len() {
        let error = decode("a.jpg", &jpeg[..end]).unwrap_err();
        assert_eq!(error.path, PathBuf::from("a.jpg"), "{end} bytes");
    }
    let whole = jpeg.len();
    let error = decode("a.jpg", &jpeg[..whole - 3]).unwrap_err().to_string();
    assert!(error.contains("cut off"), "{error}");
    for format in [ImageFormat::Png, ImageFormat::Tiff] {
        let bytes = encoded(rgb16(20, 10), format);
        // The last chunk of a PNG (12 bytes) only says that the file ends.
        for end in 0..bytes.len() - 12 {
            assert!(decode("a", &bytes[..end]).is_err(), "{format:?} {end}");
        }
    }
}

/// A JPEG of the real coding kinds: sequential at two samplings, grey, with restart markers, and
/// progressive; made by another program.
const FOREIGN_JPEGS: [(&str, &[u8]); 5] = [
    ("4:4:4", include_bytes!("samples/plain.jpg")),
    ("4:2:0", include_bytes!("samples/halved.jpg")),
    ("grey", include_bytes!("samples/grey.jpg")),
    ("restart", include_bytes!("samples/restart.jpg")),
    ("progressive", include_bytes!("samples/progressive.jpg")),
];

#[test]
fn jpegs_of_all_kinds_pass_and_damage_in_their_middle_is_named() {
    for (kind, whole) in FOREIGN_JPEGS {
        let good = decode("a.jpg", whole);
        assert!(good.is_ok(), "{kind}: {good:?}");
        // What disks and memory cards lose: a sector, read back as zeros or as something else.
        for filler in [0x00, 0xA5, 0x31] {
            for share in [0.35, 0.5, 0.65, 0.8] {
                let at = (whole.len() as f64 * share) as usize;
                let mut bytes = whole.to_vec();
                bytes[at..at + 64].fill(filler);
                let found = decode("a.jpg", &bytes);
                let told = found
                    .as_ref()
                    .map_or_else(ToString::to_string, |_| String::new());
                assert!(
                    told.contains("damaged"),
                    "{kind} {filler:x} {share}: {told:?}"
                );
            }
        }
        // A part that is missing, as from a broken transfer.
        let at = whole.len() / 2;
        let bytes = [&whole[..at], &whole[at + 100..]].concat();
        assert!(decode("a.jpg", &bytes).is_err(), "{kind}");
    }
}

#[test]
fn single_wrong_bytes_of_a_jpeg_are_told_where_the_codes_fall_out_of_step() {
    let whole = FOREIGN_JPEGS[1].1;
    let scan = whole
        .windows(2)
        .position(|pair| pair == [0xFF, 0xDA])
        .unwrap()
        + 20;
    let (mut num, mut num_told) = (0usize, 0usize);
    for at in (scan..whole.len() - 200).step_by(23) {
        let mut bytes = whole.to_vec();
        bytes[at] ^= 0x6D;
        num += 1;
        num_told += usize::from(decode("a.jpg", &bytes).is_err());
    }
    // The others change values alone, which no check of the file's structure can see.
    let share = num_told as f64 / num as f64;
    assert!(share > 0.25, "{num_told} of {num}");
}

#[test]
fn floating_point_tiffs_of_all_kinds_are_read() {
    use tiff::encoder::{TiffEncoder, colortype};
    let values: Vec<f32> = (0..20).map(|i| i as f32 * 0.25 - 1.0).collect();
    let doubles: Vec<f64> = values.iter().map(|&v| f64::from(v)).collect();
    let mut grey = Cursor::new(Vec::new());
    TiffEncoder::new(&mut grey)
        .unwrap()
        .write_image::<colortype::Gray32Float>(5, 4, &values)
        .unwrap();
    let mut double = Cursor::new(Vec::new());
    TiffEncoder::new(&mut double)
        .unwrap()
        .write_image::<colortype::Gray64Float>(5, 4, &doubles)
        .unwrap();
    for bytes in [grey.into_inner(), double.into_inner()] {
        let photo = decode("a.tif", &bytes).unwrap();
        assert_eq!((photo.width, photo.height, photo.channels), (5, 4, 1));
        assert_eq!(photo.samples, Samples::F32(values.clone()));
        assert!(photo.linear_by_metadata);
        for end in 0..bytes.len() {
            let _ = decode("a.tif", &bytes[..end]);
        }
        assert!(decode("a.tif", &bytes[..bytes.len() / 3]).is_err());
    }
}

#[test]
fn damaged_bytes_never_panic() {
    let made = [ImageFormat::Jpeg, ImageFormat::Png, ImageFormat::Tiff]
        .map(|format| encoded(rgb8(24, 16), format));
    let progressive = FOREIGN_JPEGS[4].1[..2000].to_vec();
    for whole in made.into_iter().chain([progressive]) {
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x5A;
            let _ = decode("a", &bytes);
        }
    }
}

#[test]
fn what_is_no_photo_is_refused_by_name() {
    let folder = folder();
    for (name, content, expected) in [
        ("empty.jpg", &b""[..], "0 bytes"),
        ("text.jpg", b"Dear Sir or Madam", "not a JPEG"),
        ("raw.NEF", b"MM\0*", "linear 16-bit TIFF"),
        ("raw.dng", b"II*\0", "dcraw_emu"),
        ("phone.heic", b"....ftypheic", "damaged"),
        ("web.webp", b"RIFF", "WebP files cannot be decoded"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        let error = decode_photo(&path).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(expected), "{error}");
        assert!(is_photo_name(&path));
    }
    assert!(!is_photo_name(Path::new("notes.txt")));
    assert!(!is_photo_name(Path::new("._IMG_1.jpg")));
}

#[test]
fn four_component_jpegs_are_refused_as_cmyk() {
    let mut jpeg = encoded(rgb8(16, 16), ImageFormat::Jpeg);
    let frame = jpeg
        .windows(2)
        .position(|pair| pair == [0xFF, 0xC0])
        .unwrap();
    jpeg[frame + 9] = 4;
    let error = decode("a.jpg", &jpeg).unwrap_err().to_string();
    assert!(error.contains("CMYK"), "{error}");
}

#[test]
fn exif_is_read_and_orientation_is_not_applied() {
    let jpeg = encoded(rgb8(16, 8), ImageFormat::Jpeg);
    let plain = decode("a.jpg", &jpeg).unwrap();
    for orientation in 1..=8u16 {
        let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
        let bytes = with_exif(
            &jpeg,
            &[
                field(Tag::Orientation, Value::Short(vec![orientation])),
                field(Tag::FocalLength, rational(585, 100)),
                field(Tag::FocalLengthIn35mmFilm, Value::Short(vec![35])),
                field(Tag::FocalPlaneXResolution, rational(254_000, 10)),
                field(Tag::FocalPlaneResolutionUnit, Value::Short(vec![2])),
                field(Tag::PixelXDimension, Value::Long(vec![2832])),
                field(Tag::ExposureTime, rational(1, 400)),
                field(Tag::FNumber, rational(28, 10)),
                field(Tag::PhotographicSensitivity, Value::Short(vec![80])),
                field(Tag::Make, Value::Ascii(vec![b"KODAK  \0".to_vec()])),
            ],
        );
        let photo = decode("a.jpg", &bytes).unwrap();
        assert_eq!(photo.samples, plain.samples);
        let exif = photo.exif;
        assert_eq!(exif.orientation, Some(orientation as u8));
        assert_eq!(exif.focal_mm, Some(5.85));
        assert_eq!(exif.focal_35mm, Some(35.0));
        assert!(
            exif.focal_plane_px_per_mm
                .is_some_and(|v| (v - 1000.0).abs() < 1e-9)
        );
        assert_eq!(exif.pixel_x_dimension, Some(2832));
        assert_eq!(exif.make.as_deref(), Some("KODAK"));
        let exposure = exif.relative_exposure().unwrap();
        assert!((exposure - 80.0 / 400.0 / 7.84).abs() < 1e-12, "{exposure}");
    }
}

#[test]
fn absurd_exif_is_absent_exif() {
    let jpeg = encoded(rgb8(16, 8), ImageFormat::Jpeg);
    let zero = Value::Rational(vec![Rational { num: 1, denom: 0 }]);
    let bytes = with_exif(
        &jpeg,
        &[
            field(Tag::FocalLength, zero),
            field(Tag::Orientation, Value::Short(vec![9])),
            field(Tag::FocalLengthIn35mmFilm, Value::Short(vec![0])),
        ],
    );
    assert_eq!(decode("a.jpg", &bytes).unwrap().exif, ExifFacts::default());
}

#[test]
fn png_color_chunks_are_judged() {
    let bytes = encoded(rgb16(4, 4), ImageFormat::Png);
    let with_chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut bytes_with = bytes[..33].to_vec();
        bytes_with.extend((data.len() as u32).to_be_bytes());
        bytes_with.extend(kind);
        bytes_with.extend(data);
        bytes_with.extend([0; 4]);
        bytes_with.extend(&bytes[33..]);
        png_chunks::color(&bytes_with)
    };
    use png_chunks::PngColor;
    assert_eq!(png_chunks::color(&bytes), None);
    assert_eq!(with_chunk(b"sRGB", &[0]), Some(PngColor::Encoded));
    let gamma = |value: u32| with_chunk(b"gAMA", &value.to_be_bytes());
    assert_eq!(gamma(100_000), Some(PngColor::Linear));
    assert_eq!(gamma(45_455), Some(PngColor::Encoded));
    assert_eq!(gamma(50_000), Some(PngColor::Gamma(2.0)));
    assert_eq!(gamma(0), None);
    assert_eq!(with_chunk(b"cICP", &[1, 8, 0, 1]), Some(PngColor::Linear));
    assert_eq!(with_chunk(b"cICP", &[1, 13, 0, 1]), Some(PngColor::Encoded));
}

#[test]
fn sizes_are_read_from_headers_alone() {
    let folder = folder();
    for (name, format) in [("a.png", ImageFormat::Png), ("a.jpg", ImageFormat::Jpeg)] {
        let path = folder.path().join(name);
        let bytes = encoded(rgb8(40, 30), format);
        std::fs::write(&path, &bytes[..bytes.len() - 40]).unwrap();
        assert_eq!(photo_size(&path), Some((40, 30)), "{name}");
    }
    std::fs::write(folder.path().join("b.jpg"), b"no photo").unwrap();
    assert_eq!(photo_size(&folder.path().join("b.jpg")), None);
    // Kinds that the image library has no place for; and a size that no photo has.
    use tiff::encoder::{TiffEncoder, colortype};
    let path = folder.path().join("double.tif");
    let mut file = std::fs::File::create(&path).unwrap();
    TiffEncoder::new(&mut file)
        .unwrap()
        .write_image::<colortype::Gray64Float>(5, 4, &[0.5; 20])
        .unwrap();
    assert_eq!(photo_size(&path), Some((5, 4)));
    let path = folder.path().join("grey.exr");
    crate::write_depth(&path, &rilievo_scene::DepthMap::filled(9, 7, 0.5)).unwrap();
    assert_eq!(photo_size(&path), Some((9, 7)));
    let mut bytes = encoded(rgb8(40, 30), ImageFormat::Png);
    bytes[16..24].fill(0xFF);
    let path = folder.path().join("endless.png");
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(photo_size(&path), None);
}

#[test]
fn a_single_pixel_decodes() {
    let photo = decode("a.png", &encoded(rgb8(1, 1), ImageFormat::Png)).unwrap();
    assert_eq!((photo.width, photo.height), (1, 1));
}

/// Made by tifffile and Pillow (libtiff): 64 x 48 pixels with red 3x, green 4y, blue 2(x + y).
#[test]
fn tiff_of_other_programs_is_read_whatever_its_kind() {
    let big = include_bytes!("samples/big.tif");
    let zstd = include_bytes!("samples/zstd.tif");
    let jpeg = include_bytes!("samples/ycbcr.tif");
    let u32 = include_bytes!("samples/u32.tif");
    let cases: [(&str, &[u8], u32, f32); 4] = [
        ("big", big, 8, 0.0),
        ("zstd", zstd, 8, 0.0),
        // JPEG with halved colours; libtiff reads it to 3.
        ("ycbcr", jpeg, 8, 6.0),
        ("u32", u32, 32, 1e-4),
    ];
    for (name, bytes, bits, tolerance) in cases {
        let photo = decode("a.tif", bytes).unwrap();
        assert_eq!(
            (photo.width, photo.height, photo.channels),
            (64, 48, 3),
            "{name}"
        );
        assert_eq!(photo.samples.bits(), bits, "{name}");
        let value = |index: usize| match &photo.samples {
            Samples::U8(v) => f32::from(v[index]),
            Samples::F32(v) => 255.0 * v[index],
            Samples::U16(_) => f32::NAN,
        };
        for (y, x) in (0..48).flat_map(|y| (0..64).map(move |x| (y, x))) {
            for (c, expected) in [3 * x, 4 * y, 2 * (x + y)].into_iter().enumerate() {
                let error = (value(3 * (64 * y + x) + c) - expected as f32).abs();
                assert!(error <= tolerance, "{name} ({x}, {y}, {c}): {error}");
            }
        }
        assert_eq!(photo_size_of(bytes), Some((64, 48)), "{name}");
    }
    let error = decode("a.tif", include_bytes!("samples/i16.tif")).unwrap_err();
    assert!(error.to_string().contains("not supported"), "{error}");
}

fn photo_size_of(bytes: &[u8]) -> Option<(usize, usize)> {
    let folder = folder();
    let path = folder.path().join("a.tif");
    std::fs::write(&path, bytes).unwrap();
    photo_size(&path)
}
