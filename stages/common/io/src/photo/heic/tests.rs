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
fn a_turn_that_exif_tells_too_is_noted_and_any_other_is_followed() {
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
    let upright = read("a.heic", &bytes).unwrap();
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(photo_size(&path), Some((100, 144)));
    assert_eq!((upright.width, upright.height), (100, 144));
    assert_eq!(upright.exif.orientation, None);
    let (Samples::U8(upright), Samples::U8(stored)) = (&upright.samples, &turned.samples) else {
        panic!("eight bits each");
    };
    let orientation = Orientation::of_exif(6).unwrap();
    let raster = rilievo_scene::Raster::from_vec(
        100,
        144,
        upright
            .chunks_exact(3)
            .map(|px| [px[0], px[1], px[2]])
            .collect(),
    )
    .unwrap();
    let back = orientation.raster_to_stored(&raster);
    assert_eq!(back.data.concat(), *stored);
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
