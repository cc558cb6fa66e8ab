//! Small files of other programs: one smooth picture, plain, turned, and with ten bits.

use super::*;
use crate::photo::{decode_photo_bytes, is_photo_name, photo_size};

/// Its colours are told by the coded picture alone, as phones do.
const PLAIN: &[u8] = include_bytes!("../samples/plain.heic");
/// Turned by container and EXIF alike.
const TURNED: &[u8] = include_bytes!("../samples/turned.heic");
const TEN_BITS: &[u8] = include_bytes!("../samples/ten.heic");

fn read(name: &str, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    decode_photo_bytes(Path::new(name), bytes)
}

/// Mean difference of a photo from the picture that was coded, levels of 255.
fn apart(photo: &DecodedPhoto) -> f64 {
    let levels: Vec<f64> = match &photo.samples {
        Samples::U8(v) => v.iter().map(|&v| f64::from(v)).collect(),
        Samples::U16(v) => v.iter().map(|&v| f64::from(v) / 257.0).collect(),
        Samples::F32(_) => panic!("HEIF has integers"),
    };
    let coded = (0..100).flat_map(|y| {
        (0..144).flat_map(move |x| {
            let (x, y) = (f64::from(x), f64::from(y));
            [20.0 + 1.5 * x, 30.0 + 1.2 * y + 0.5 * x, 200.0 - x]
        })
    });
    let sum: f64 = coded.zip(&levels).map(|(a, b)| (a - b).abs()).sum();
    sum / levels.len() as f64
}

#[test]
fn pictures_are_those_that_were_coded_whatever_the_name_says() {
    for (name, bytes, bits) in [
        ("a.heic", PLAIN, 8),
        ("A.JPG", PLAIN, 8),
        ("a.hif", TEN_BITS, 16),
        ("a.heic", TURNED, 8),
    ] {
        let photo = read(name, bytes).unwrap();
        assert_eq!((photo.width, photo.height, photo.channels), (144, 100, 3));
        assert_eq!(photo.samples.bits(), bits, "{name}");
        assert!(!photo.linear_by_metadata && photo.saturates_at_white);
        // Wrong range or matrix of the colours is 6 levels and more.
        let apart = apart(&photo);
        assert!(apart < 1.0, "{name}: {apart}");
        assert!(is_photo_name(Path::new(name)));
    }
}

#[test]
fn the_containers_turn_is_noted_whatever_exif_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.heic");
    let turned = read("a.heic", TURNED).unwrap();
    assert_eq!(turned.exif.orientation, Some(6));
    assert_eq!(turned.exif.make.as_deref(), Some("Phone"));
    std::fs::write(&path, TURNED).unwrap();
    assert_eq!(photo_size(&path), Some((144, 100)));

    // EXIF says nothing of the turn: tag, kind, number of values, value.
    let tag = [0x01, 0x12, 0, 3, 0, 0, 0, 1, 0, 6];
    let at = TURNED.windows(10).position(|w| w == tag).unwrap();
    let mut bytes = TURNED.to_vec();
    bytes[at + 9] = 1;
    let same = read("a.heic", &bytes).unwrap();
    assert_eq!(same.exif.orientation, Some(6));
    assert_eq!((same.width, same.height), (144, 100));

    // Turned by half: `irot` and the quarter turns against the clock.
    let at = bytes.windows(4).position(|w| w == b"irot").unwrap();
    assert_eq!(bytes[at + 4], 3);
    bytes[at + 4] = 2;
    assert_eq!(read("a.heic", &bytes).unwrap().exif.orientation, Some(3));
    assert_eq!(read("a.heic", PLAIN).unwrap().exif.orientation, Some(1));
}

#[test]
fn turns_and_mirrors_of_containers_are_orientations() {
    use Transform::{MirrorHorizontal, MirrorVertical, Rotate90Ccw};
    for (transforms, number) in [
        (vec![], 1),
        (vec![MirrorHorizontal], 2),
        (vec![Rotate90Ccw(2)], 3),
        (vec![MirrorVertical], 4),
        // EXIF's 6 is turned with the clock for display, 8 against it.
        (vec![Rotate90Ccw(3)], 6),
        (vec![Rotate90Ccw(1)], 8),
        (vec![Rotate90Ccw(1), MirrorVertical], 5),
        (vec![Rotate90Ccw(1), MirrorHorizontal], 7),
    ] {
        assert_eq!(
            turn(&transforms).map(Orientation::number),
            Some(number),
            "{transforms:?}"
        );
    }
}

#[test]
fn damage_is_named_and_never_a_panic() {
    let cut = read("a.heic", &PLAIN[..PLAIN.len() / 2]).unwrap_err();
    let message = cut.to_string();
    assert!(
        message.contains("a.heic") && (message.contains("cut off") || message.contains("damaged")),
        "{message}"
    );
    assert!(read("a.heic", &PLAIN[..40]).is_err());
    for whole in [PLAIN, TURNED, TEN_BITS] {
        for at in (0..700).chain((700..whole.len()).step_by(331)) {
            let mut bytes = whole.to_vec();
            bytes[at] ^= 0x5A;
            let _ = read("a.heic", &bytes);
        }
    }
}
