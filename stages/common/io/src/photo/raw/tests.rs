use crate::{decode_photo, write_photo_dng};
use rilievo_scene::{DecodedPhoto, ExifFacts, LinearImage, Samples};
use std::path::PathBuf;

const SIZE: (usize, usize) = (96, 72);

/// A smooth picture in tinted light, as shading is.
fn shading(tint: [f32; 3]) -> LinearImage {
    let (width, height) = SIZE;
    let mut image = LinearImage::filled(width, height, 3, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        let (x, y) = ((i / 3 % width) as f32, (i / 3 / width) as f32);
        let wave = 0.5 + 0.3 * (x / 19.0).sin() * (y / 14.0).cos();
        *value = tint[i % 3] * wave;
    }
    image
}

fn written(folder: &tempfile::TempDir, image: &LinearImage, neutral: [f64; 3]) -> PathBuf {
    let path = folder.path().join("a.dng");
    write_photo_dng(&path, image, neutral, &ExifFacts::default()).unwrap();
    path
}

fn samples(photo: &DecodedPhoto) -> &[f32] {
    match &photo.samples {
        Samples::F32(samples) => samples,
        other => panic!("{} bits", other.bits()),
    }
}

fn worst(photo: &DecodedPhoto, image: &LinearImage) -> f32 {
    let pairs = samples(photo).iter().zip(&image.data);
    pairs.fold(0.0, |worst, (a, b)| worst.max((a - b).abs()))
}

#[test]
fn a_mosaic_gives_back_the_light_in_the_cameras_colours() {
    let folder = tempfile::tempdir().unwrap();
    let tint = [0.5, 1.0, 0.7];
    let image = shading(tint);
    let balanced = decode_photo(&written(&folder, &image, tint.map(f64::from))).unwrap();
    assert_eq!(
        (balanced.width, balanced.height, balanced.channels),
        (96, 72, 3)
    );
    assert!(balanced.linear_by_metadata && balanced.saturates_at_white);
    // Interpolation over a wave of 19 px: its second difference is 0.3 / 19^2 = 8e-4 a pixel; steps
    // of 14 bits are 6e-5. At the border, the library takes means over one side.
    let error = worst(&balanced, &image);
    assert!(error < 1.6e-2, "{error}");
    let inner: f32 = inner_error(&balanced, &image);
    assert!(inner < 1.2e-3, "{inner}");
    // A balance that does not fit costs accuracy between the samples, never a factor.
    let unbalanced = decode_photo(&written(&folder, &image, [1.0; 3])).unwrap();
    let plain = inner_error(&unbalanced, &image);
    assert!(plain < 3e-3 && inner <= plain, "{plain} {inner}");
}

/// Largest error off the border of three pixels.
fn inner_error(photo: &DecodedPhoto, image: &LinearImage) -> f32 {
    let (width, height) = SIZE;
    let inside = |i: usize| {
        let (x, y) = (i / 3 % width, i / 3 / width);
        (3..width - 3).contains(&x) && (3..height - 3).contains(&y)
    };
    let pairs = samples(photo).iter().zip(&image.data).enumerate();
    pairs
        .filter(|(i, _)| inside(*i))
        .fold(0.0, |worst, (_, (a, b))| worst.max((a - b).abs()))
}

#[test]
fn even_light_is_exact_and_black_is_not_clamped() {
    let folder = tempfile::tempdir().unwrap();
    for level in [-0.02_f32, 0.0, 0.25, 0.9] {
        let image = LinearImage::filled(32, 24, 3, level);
        let photo = decode_photo(&written(&folder, &image, [1.0; 3])).unwrap();
        let error = worst(&photo, &image);
        assert!(error < 0.5 / 15_871.0 + 1e-6, "{level}: {error}");
    }
}

#[test]
fn what_rests_on_saturated_samples_is_saturated() {
    let folder = tempfile::tempdir().unwrap();
    let mut image = LinearImage::filled(40, 40, 3, 0.3);
    for y in 10..20 {
        for x in 10..20 {
            image.data[3 * (y * 40 + x)..][..3].fill(1.7);
        }
    }
    let photo = decode_photo(&written(&folder, &image, [1.0; 3])).unwrap();
    let pixels: Vec<&[f32]> = samples(&photo).chunks_exact(3).collect();
    for (i, pixel) in pixels.iter().enumerate() {
        let (x, y) = (i % 40, i / 40);
        let saturated = (10..20).contains(&x) && (10..20).contains(&y);
        let far = !(6..24).contains(&x) || !(6..24).contains(&y);
        if saturated {
            assert!(pixel.iter().all(|&v| v >= 1.0), "{x} {y}: {pixel:?}");
        } else if far {
            assert!(
                pixel.iter().all(|&v| (v - 0.3).abs() < 1e-3),
                "{x} {y}: {pixel:?}"
            );
        }
    }
}

#[test]
fn exif_of_a_raw_file_is_that_of_any_photo() {
    let folder = tempfile::tempdir().unwrap();
    let exif = ExifFacts {
        focal_mm: Some(35.0),
        focal_35mm: Some(52.0),
        orientation: Some(6),
        make: Some("Maker".to_owned()),
        model: Some("Model 7".to_owned()),
        serial: Some("123".to_owned()),
        lens: Some("35 mm".to_owned()),
        exposure_time_s: Some(0.02),
        f_number: Some(8.0),
        iso: Some(100.0),
        date: Some("2024:01:02 03:04:05".to_owned()),
        ..ExifFacts::default()
    };
    let path = folder.path().join("a.DNG");
    write_photo_dng(&path, &shading([1.0; 3]), [1.0; 3], &exif).unwrap();
    let photo = decode_photo(&path).unwrap();
    assert_eq!(photo.exif, exif);
    // The sensor's frame, whatever the orientation.
    assert_eq!((photo.width, photo.height), SIZE);
}

#[test]
fn what_the_library_cannot_read_is_refused_by_name_with_advice() {
    let folder = tempfile::tempdir().unwrap();
    let whole = std::fs::read(written(&folder, &shading([1.0; 3]), [1.0; 3])).unwrap();
    let text = b"not a photo, but some text that is long enough to hold a header".to_vec();
    for (name, bytes) in [
        ("text.nef", text.as_slice()),
        ("text.cr3", &text),
        ("cut.dng", &whole[..whole.len() / 2]),
        ("header.arw", &whole[..40]),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = decode_photo(&path).unwrap_err();
        assert!(error.path.ends_with(name), "{error}");
        assert!(error.to_string().contains("RAW"), "{error}");
        assert!(error.hint.is_some(), "{error}");
    }
}
