use super::*;
use nalgebra::Vector3;

fn colmap(width: usize, height: usize, channels: usize, values: &[f32]) -> Vec<u8> {
    let mut bytes = format!("{width}&{height}&{channels}&").into_bytes();
    values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    bytes
}

#[test]
fn colmap_stores_channels_one_after_the_other() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.bin");
    std::fs::write(&path, colmap(2, 1, 1, &[1.5, f32::NAN])).unwrap();
    let depth = read_colmap_depth(&path).unwrap();
    assert_eq!((depth.width, depth.height, depth.data[0]), (2, 1, 1.5));
    assert!(depth.data[1].is_nan());
    std::fs::write(&path, colmap(2, 1, 3, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])).unwrap();
    let normal = read_colmap_normal(&path).unwrap();
    assert_eq!(normal.data, [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]);
    let error = read_colmap_depth(&path).unwrap_err().to_string();
    assert!(error.contains("3 channel(s)"), "{error}");
}

#[test]
fn damaged_arrays_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.bin");
    for (bytes, reason) in [
        (&b""[..], "width&height"),
        (b"12", "width&height"),
        (b"a&b&c&", "width&height"),
        (b"0&4&1&", "0 x 4"),
        (b"4294967296&4294967296&1&", "pixels"),
        (b"99999999&99999999&1&", "pixels"),
        (b"2&2&1&abcd", "need 16 bytes"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let error = read_colmap_depth(&path).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
}

/// A file of a 2 × 1 map of a 4 × 2 image.
fn dmap() -> Vec<u8> {
    let mut bytes = b"DR\x03\x00".to_vec();
    for n in [4_u32, 2, 2, 1] {
        bytes.extend(n.to_le_bytes());
    }
    for z in [0.5_f32, 2.0] {
        bytes.extend(z.to_le_bytes());
    }
    bytes.extend(7_u16.to_le_bytes());
    bytes.extend(b"d/a.jpg");
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend([0; 8]);
    let numbers = [
        [10.0, 0.0, 1.5, 0.0, 10.0, 0.5, 0.0, 0.0, 1.0],
        // World x is the camera's z.
        [0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0],
    ];
    for v in numbers.iter().flatten().chain(&[1.0, 2.0, 3.0_f64]) {
        bytes.extend(v.to_le_bytes());
    }
    for v in [1.0_f32, 0.0, 0.0, 0.0, -1.0, 0.0, 0.6, -0.8] {
        bytes.extend(v.to_le_bytes());
    }
    bytes
}

#[test]
fn a_dmap_brings_its_camera_at_the_maps_size() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("depth0000.dmap");
    std::fs::write(&path, dmap()).unwrap();
    let file = read_dmap(&path).unwrap();
    assert_eq!(
        (file.image.as_str(), &file.depth.data[..]),
        ("a.jpg", &[1.0, 0.0][..])
    );
    let camera = file.intrinsics;
    // The middle of the image stays the middle of the map.
    assert_eq!((camera.fx, camera.cx, camera.cy), (5.0, 0.5, 0.0));
    assert_eq!(file.normal.unwrap().data[1], [0.0, 0.6, -0.8]);
    let ahead = file
        .cam_from_world
        .apply(&nalgebra::Point3::new(2.0, 2.0, 3.0));
    assert!((ahead.coords - Vector3::z()).norm() < 1e-12, "{ahead}");
}

#[test]
fn damaged_dmaps_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.dmap");
    let whole = dmap();
    for end in 0..whole.len() {
        std::fs::write(&path, &whole[..end]).unwrap();
        assert!(read_dmap(&path).is_err(), "cut after {end} bytes");
    }
    let mut newer = whole.clone();
    newer[1] = b'2';
    std::fs::write(&path, newer).unwrap();
    let error = read_dmap(&path).unwrap_err().to_string();
    assert!(error.contains("quantised"), "{error}");
}
