use super::*;

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn ramp() -> Raster<f32> {
    Raster::from_fn(17, 9, |x, y| 1.0 + 0.37 * x as f32 - 1e-7 * (y * y) as f32)
}

#[test]
fn maps_survive_the_disk_bit_for_bit() {
    let folder = folder();
    let path = folder.path().join("map.exr");
    write_depth(&path, &ramp()).unwrap();
    assert_eq!(read_depth(&path).unwrap(), ramp());
    write_channel(&path, "C", &ramp()).unwrap();
    assert_eq!(read_channel(&path, "C").unwrap(), ramp());
    let normals = Raster::from_fn(8, 5, |x, y| [x as f32 * 0.1, -0.2, -(y as f32)]);
    write_normal(&path, &normals).unwrap();
    assert_eq!(read_normal(&path).unwrap(), normals);
    for channels in [1, 3] {
        // More than one block of the compression, noise and all.
        let mut image = LinearImage::filled(67, 45, channels, 0.0);
        for (i, value) in image.data.iter_mut().enumerate() {
            *value = (i as f32 * 12.9898).sin() * 3.0;
        }
        write_linear(&path, &image).unwrap();
        assert_eq!(read_linear(&path).unwrap(), image);
        write_linear_half(&path, &image).unwrap();
        let half = read_linear(&path).unwrap();
        for (a, b) in half.data.iter().zip(&image.data) {
            assert!((a - b).abs() <= 5e-4 * b.abs(), "{a} {b}");
        }
    }
}

#[test]
fn the_same_map_gives_the_same_bytes() {
    let folder = folder();
    let (a, b) = (folder.path().join("a.exr"), folder.path().join("b.exr"));
    write_depth(&a, &ramp()).unwrap();
    write_depth(&b, &ramp()).unwrap();
    assert_eq!(std::fs::read(a).unwrap(), std::fs::read(b).unwrap());
}

#[test]
fn a_missing_channel_is_named_with_those_present() {
    let folder = folder();
    let path = folder.path().join("map.exr");
    write_depth(&path, &ramp()).unwrap();
    let error = read_normal(&path).unwrap_err().to_string();
    assert!(
        error.contains("N.X") && error.contains("channels are: Z"),
        "{error}"
    );
    let error = read_linear(&path).unwrap_err().to_string();
    assert!(error.contains("R G B or Y"), "{error}");
}

#[test]
fn a_layered_name_is_found_when_it_is_the_only_one() {
    let folder = folder();
    let path = folder.path().join("map.exr");
    write_channel(&path, "ViewLayer.Depth.Z", &ramp()).unwrap();
    assert_eq!(read_depth(&path).unwrap(), ramp());
}

#[test]
fn a_data_window_is_placed_in_its_frame() {
    use exr::prelude::*;
    let folder = folder();
    let path = folder.path().join("map.exr");
    let channel = AnyChannel::new("Z", FlatSamples::F32(vec![1.0, 2.0, 3.0, 4.0]));
    let layer = Layer::new(
        (2, 2),
        LayerAttributes {
            layer_position: Vec2(3, 1),
            ..LayerAttributes::default()
        },
        Encoding::FAST_LOSSLESS,
        AnyChannels::sort(std::iter::once(channel).collect()),
    );
    let attributes = ImageAttributes::new(IntegerBounds::from_dimensions((6, 4)));
    Image::empty(attributes)
        .with_layer(layer)
        .write()
        .to_file(&path)
        .unwrap();
    let map = read_depth(&path).unwrap();
    assert_eq!((map.width, map.height), (6, 4));
    let expected = Raster::from_fn(6, 4, |x, y| match (x, y) {
        (3, 1) => 1.0,
        (4, 1) => 2.0,
        (3, 2) => 3.0,
        (4, 2) => 4.0,
        _ => 0.0,
    });
    assert_eq!(map, expected);
}

#[test]
fn no_part_of_a_file_and_no_flipped_byte_panics() {
    let folder = folder();
    let path = folder.path().join("map.exr");
    write_depth(&path, &ramp()).unwrap();
    let whole = std::fs::read(&path).unwrap();
    for end in 0..whole.len() {
        assert!(
            Channels::decode(&path, &whole[..end]).is_err(),
            "{end} bytes"
        );
    }
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x55;
        let _ = Channels::decode(&path, &bytes);
    }
}

#[test]
fn impossible_paths_and_maps_are_refused() {
    let error = write_depth(Path::new("/nonexistent/map.exr"), &ramp()).unwrap_err();
    assert_eq!(error.kind, crate::IoErrorKind::Write);
    let empty = Raster::from_fn(0, 0, |_, _| 0.0);
    let folder = folder();
    assert!(write_depth(&folder.path().join("map.exr"), &empty).is_err());
    let error = read_depth(Path::new("nowhere.exr")).unwrap_err();
    assert_eq!(error.kind, crate::IoErrorKind::Input);
}
