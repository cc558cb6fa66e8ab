//! Published data sets become folders of photos, masks and truth.

use crate::common;

use common::{arg, done, run};
use rilievo_io::{read_cameras, read_linear, read_mask, read_normal, write_mask, write_photo_deep};
use rilievo_scene::{LinearImage, Mask};
use rilievo_synthetic::testing::mat_file;
use std::path::Path;

const SIZE: (usize, usize) = (40, 30);

/// A MATLAB file of arrays of doubles by columns.
fn write_mat(path: &Path, arrays: &[(&str, &[i32], Vec<f64>)]) {
    let arrays = arrays
        .iter()
        .map(|(name, dims, values)| mat_file::array(name, dims, values));
    let parts: Vec<Vec<u8>> = std::iter::once(mat_file::header()).chain(arrays).collect();
    std::fs::write(path, parts.concat()).expect("a file");
}

/// A flat view of 0.4 under each of two lamps of strength 2 and 1.
fn write_view(folder: &Path) {
    std::fs::create_dir_all(folder).expect("a folder");
    let (width, height) = SIZE;
    for (name, content) in [
        ("filenames.txt", "001.png\n002.png\n"),
        ("light_directions.txt", "0 0.6 0.8\n0 0 1\n"),
        ("light_intensities.txt", "2 2 2\n1 1 1\n"),
    ] {
        std::fs::write(folder.join(name), content).expect("a file");
    }
    let image = LinearImage::filled(width, height, 3, 0.4);
    for name in ["001.png", "002.png"] {
        write_photo_deep(&folder.join(name), &image).expect("a file");
    }
    let mask = Mask::from_fn(width, height, |x, y| x > 5 && y > 5);
    write_mask(&folder.join("mask.png"), &mask).expect("a file");
    let plane = |value: f64| vec![value; width * height];
    let normals = [plane(0.0), plane(0.6), plane(0.8)].concat();
    write_mat(
        &folder.join("Normal_gt.mat"),
        &[("Normal_gt", &[height as i32, width as i32, 3], normals)],
    );
}

#[test]
fn diligent_mv_becomes_photos_masks_cameras_and_normals() {
    let dir = tempfile::tempdir().unwrap();
    let object = dir.path().join("bearPNG");
    write_view(&object.join("view_01"));
    write_view(&object.join("view_02"));
    let k = vec![100.0, 0.0, 0.0, 0.0, 100.0, 0.0, 19.5, 14.5, 1.0];
    let rotation = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let mut arrays: Vec<(&str, &[i32], Vec<f64>)> = vec![("KK", &[3, 3], k)];
    for (r, t) in [("Rc_1", "Tc_1"), ("Rc_2", "Tc_2")] {
        arrays.push((r, &[3, 3], rotation.clone()));
        arrays.push((t, &[3, 1], vec![10.0, 0.0, 1500.0]));
    }
    write_mat(&object.join("Calib_Results.mat"), &arrays);
    let out = dir.path().join("set");
    let stdout = done(&["import", arg(&object), "-o", arg(&out)]);
    assert!(
        stdout.contains("2 views") && stdout.contains("\"camera\""),
        "{stdout}"
    );
    // The mean of 0.4 / 2 and 0.4 / 1.
    let photo = read_linear(&out.join("photos/view_02.exr")).unwrap();
    assert!(
        (photo.pixel(20, 20)[1] - 0.3).abs() < 1e-5,
        "{:?}",
        photo.pixel(20, 20)
    );
    let cameras = read_cameras(&out.join("truth/cameras.json")).unwrap();
    let center = cameras
        .find("view_01")
        .unwrap()
        .cam_from_world
        .unwrap()
        .inverse()
        .translation;
    assert!(
        (center.x + 0.01).abs() + (center.z + 1.5).abs() < 1e-12,
        "{center}"
    );
    let normal = read_normal(&out.join("truth/view_01_normal.exr")).unwrap();
    assert_eq!(
        (*normal.at(20, 20), *normal.at(2, 2)),
        ([0.0, -0.6, -0.8], [0.0; 3])
    );
    assert_eq!(
        read_mask(&out.join("masks/view_01.png")).unwrap().count(),
        34 * 24
    );
    let lamps = std::fs::read_to_string(out.join("lamps/view_01.lp")).unwrap();
    assert_eq!(lamps, "2\n001.png 0 0.6 0.8\n002.png 0 0 1\n");
    // What was written is what the other commands read.
    let (photos, masks) = (out.join("photos"), out.join("masks"));
    let truth = out.join("truth/cameras.json");
    let check = [
        "check",
        arg(&photos),
        "--masks",
        arg(&masks),
        "--cameras",
        arg(&truth),
    ];
    let (code, _, stderr) = run(&check);
    // Even pictures show nothing, and that is said of each.
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("view_01.exr"), "{stderr}");
}

#[test]
fn one_lamp_is_picked_and_one_view_is_told_to_be_one() {
    let dir = tempfile::tempdir().unwrap();
    let object = dir.path().join("catPNG");
    write_view(&object);
    let out = dir.path().join("set");
    let import = [
        "import",
        arg(&object),
        "--format",
        "diligent",
        "-o",
        arg(&out),
    ];
    let stdout = done(&[&import[..], &["--lamp", "1"]].concat());
    assert!(stdout.contains("one view without a camera"), "{stdout}");
    let photo = read_linear(&out.join("photos/catPNG.exr")).unwrap();
    assert!(
        (photo.pixel(3, 3)[0] - 0.2).abs() < 1e-5,
        "{:?}",
        photo.pixel(3, 3)
    );
    let (code, _, stderr) = run(&[&import[..], &["--lamp", "3"]].concat());
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("2 lamps"), "{stderr}");
    std::fs::remove_file(object.join("light_directions.txt")).unwrap();
    let (code, _, stderr) = run(&import);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("light_directions.txt"), "{stderr}");
}
