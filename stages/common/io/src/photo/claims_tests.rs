//! Files that say more of themselves than they hold.

use super::tests::{decode, encoded, folder, rgb16};
use super::*;
use crate::read_mask;
use flate2::{Compression, write::ZlibEncoder};
use image::ImageFormat;
use std::io::Cursor;
use std::io::Write;

/// The PNG with a chunk after its header; the check sum is CRC-32 (ISO 3309).
fn with_chunk(png: &[u8], kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [kind, data].concat();
    let mut crc = flate2::Crc::new();
    crc.update(&body);
    let mut bytes = png[..33].to_vec();
    bytes.extend((data.len() as u32).to_be_bytes());
    bytes.extend(body);
    bytes.extend(crc.sum().to_be_bytes());
    bytes.extend(&png[33..]);
    bytes
}

/// A colour profile as PNG stores it.
fn stored_profile(profile: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(b"name\0\0".to_vec(), Compression::best());
    encoder.write_all(profile).unwrap();
    encoder.finish().unwrap()
}

/// A linear profile that is filled up to so many bytes.
fn linear_profile(len: usize) -> Vec<u8> {
    let mut profile = vec![0; 128];
    profile.extend(1u32.to_be_bytes());
    profile.extend(b"gTRC");
    profile.extend(144u32.to_be_bytes());
    profile.extend(12u32.to_be_bytes());
    profile.extend(b"curv\0\0\0\0\0\0\0\0");
    profile.resize(len, 0);
    profile
}

#[test]
fn a_profile_that_inflates_without_end_is_refused_for_photos_and_masks() {
    let whole = encoded(rgb16(8, 6), ImageFormat::Png);
    let profile = stored_profile(&linear_profile(4 << 20));
    let photo = decode("a.png", &with_chunk(&whole, b"iCCP", &profile)).unwrap();
    assert!(
        photo.encoding_reason.contains("linear colour profile"),
        "{}",
        photo.encoding_reason
    );

    let bomb = with_chunk(&whole, b"iCCP", &stored_profile(&vec![0; 33 << 20]));
    assert!(bomb.len() < 100_000, "{} bytes", bomb.len());
    let error = decode("a.png", &bomb).unwrap_err().to_string();
    assert!(error.contains("colour profile holds more than"), "{error}");
    let folder = folder();
    let path = folder.path().join("mask.png");
    std::fs::write(&path, &bomb).unwrap();
    let error = read_mask(&path).unwrap_err().to_string();
    assert!(
        error.contains("mask.png") && error.contains("profile"),
        "{error}"
    );
    assert_eq!(photo_size(&path), Some((8, 6)));
}

#[test]
fn texts_of_a_png_stay_compressed() {
    let whole = encoded(rgb16(8, 6), ImageFormat::Png);
    let mut text = b"Comment\0\0".to_vec();
    text.extend(&stored_profile(&vec![b'x'; 33 << 20])[6..]);
    let photo = decode("a.png", &with_chunk(&whole, b"zTXt", &text)).unwrap();
    assert_eq!((photo.width, photo.height), (8, 6));
}

#[test]
fn a_large_profile_of_a_tiff_counts() {
    use tiff::{encoder::TiffEncoder, encoder::colortype, tags::Tag};
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = encoder.new_image::<colortype::RGB8>(4, 4).unwrap();
    let profile = linear_profile(3 << 20);
    image
        .encoder()
        .write_tag(Tag::IccProfile, &profile[..])
        .unwrap();
    image.write_data(&[7; 48]).unwrap();
    let photo = decode("a.tif", &bytes.into_inner()).unwrap();
    assert!(photo.linear_by_metadata, "{}", photo.encoding_reason);
}

#[test]
fn headers_that_claim_more_than_their_file_holds_are_refused() {
    let mut png = encoded(rgb16(8, 6), ImageFormat::Png);
    png[16..20].copy_from_slice(&30_000u32.to_be_bytes());
    png[20..24].copy_from_slice(&30_000u32.to_be_bytes());
    let mut crc = flate2::Crc::new();
    crc.update(&png[12..29]);
    let sum = crc.sum().to_be_bytes();
    png[29..33].copy_from_slice(&sum);
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 31000 +X 31000\n\x02\x02".to_vec();
    let mut jpeg = include_bytes!("samples/progressive.jpg").to_vec();
    let at = jpeg.windows(2).position(|two| two == [0xFF, 0xC2]).unwrap();
    jpeg[at + 5..at + 9].fill(0xFF);
    let folder = folder();
    let path = folder.path().join("map.exr");
    let depth = rilievo_scene::DepthMap::filled(9, 7, 0.5);
    crate::write_depth(&path, &depth).unwrap();
    let mut exr = std::fs::read(&path).unwrap();
    // Both windows, as four numbers: the first and last column and row.
    let window: Vec<u8> = [0i32, 0, 8, 6]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let large: Vec<u8> = [0i32, 0, 30_000, 30_000]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let places: Vec<usize> = (0..exr.len() - 16)
        .filter(|&at| exr[at..at + 16] == window[..])
        .collect();
    assert_eq!(places.len(), 2);
    let mut frame = exr.clone();
    frame[places[1]..places[1] + 16].copy_from_slice(&large);
    for at in places {
        exr[at..at + 16].copy_from_slice(&large);
    }
    for (name, bytes) in [
        ("a.png", png),
        ("a.hdr", hdr),
        ("a.exr", exr),
        ("frame.exr", frame),
        ("a.jpg", jpeg),
    ] {
        let error = decode(name, &bytes).unwrap_err().to_string();
        assert!(error.contains("claims"), "{name}: {error}");
    }
}
