//! Every format is written, read back and compared by projected points; and, because two equal
//! mistakes would cancel, its file is read by hand with the format's own formula.

use super::*;
use crate::cameras::CameraEntry;
use crate::cameras::tests::largest_projection_difference;
use crate::mask::encode_png;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use rilievo_scene::{Distortion, Intrinsics, RigidTransform, Unit};
use std::io::{Read as _, Write as _};

/// Largest difference of projections that counts as the same, pixels.
const SAME_PX: f64 = 1e-6;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

fn camera(i: usize, intrinsics: Intrinsics) -> CameraEntry {
    CameraEntry {
        image: Some(format!("IMG_{i:04}.png")),
        intrinsics,
        cam_from_world: Some(RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.3 * i as f64, -0.7, 2.1),
            translation: Vector3::new(0.1, -0.2 * i as f64, 1.5),
        }),
    }
}

/// A folder with the images that size-less formats ask for.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    let grey = vec![9; WIDTH * HEIGHT];
    let png = encode_png(&grey, WIDTH, HEIGHT, image::ExtendedColorType::L8).unwrap();
    for i in 0..3 {
        std::fs::write(folder.path().join(format!("IMG_{i:04}.png")), &png).unwrap();
        std::fs::write(folder.path().join(format!("images/{i:08}.png")), &png).unwrap();
    }
    folder
}

fn plain() -> Intrinsics {
    Intrinsics {
        fy: 71.5,
        ..Intrinsics::pinhole(WIDTH, HEIGHT, 70.25, 30.75, 24.5)
    }
}

fn centered() -> Intrinsics {
    Intrinsics::pinhole(WIDTH, HEIGHT, 70.25, 31.5, 23.5)
}

fn cameras(intrinsics: Intrinsics) -> CameraFile {
    CameraFile {
        unit: Unit::Arbitrary,
        cameras: (0..3).map(|i| camera(i, intrinsics)).collect(),
        ..CameraFile::default()
    }
}

fn path_of(folder: &tempfile::TempDir, format: CameraFormat) -> PathBuf {
    folder.path().join(match format {
        CameraFormat::CamerasJson => "cameras.json",
        CameraFormat::Colmap => "text",
        CameraFormat::ColmapBinary => "binary",
        CameraFormat::Transforms => "transforms.json",
        CameraFormat::Middlebury => "stone_par.txt",
        CameraFormat::Metashape => "cameras.xml",
        CameraFormat::SfmData => "cameras.sfm",
        CameraFormat::OpenMvs => "scene.mvs",
        CameraFormat::Npz => "cameras_sphere.npz",
    })
}

fn round_trip(format: CameraFormat, original: &CameraFile) -> CameraFile {
    let folder = folder();
    let path = path_of(&folder, format);
    export_cameras(&path, format, original).unwrap();
    assert_eq!(CameraFormat::detect(&path), Some(format), "{format:?}");
    import_cameras(&path, format, None).unwrap()
}

#[test]
fn every_format_gives_back_its_cameras() {
    for format in CameraFormat::ALL {
        let original = cameras(plain());
        let back = round_trip(format, &original);
        let worst = largest_projection_difference(&original, &back);
        assert!(worst < SAME_PX, "{format:?}: {worst}");
        if format != CameraFormat::Npz {
            assert_eq!(
                back.cameras[2].image, original.cameras[2].image,
                "{format:?}"
            );
        }
        let of_name = |other: &CameraFormat| other.name() == format.name();
        assert_eq!(CameraFormat::ALL.into_iter().filter(of_name).count(), 1);
    }
}

#[test]
fn lens_distortion_is_kept_or_refused() {
    let bent = Intrinsics {
        distortion: Distortion {
            k1: -0.1,
            k2: 0.02,
            p1: 1e-3,
            p2: -2e-3,
            k3: 0.01,
            ..Distortion::default()
        },
        ..plain()
    };
    let original = cameras(bent);
    for format in CameraFormat::ALL {
        let folder = folder();
        let path = path_of(&folder, format);
        match export_cameras(&path, format, &original) {
            Ok(()) => {
                let back = import_cameras(&path, format, None).unwrap();
                let worst = largest_projection_difference(&original, &back);
                assert!(worst < SAME_PX, "{format:?}: {worst}");
            }
            Err(error) => assert!(
                matches!(
                    format,
                    CameraFormat::Middlebury | CameraFormat::OpenMvs | CameraFormat::Npz
                ),
                "{error}"
            ),
        }
    }
}

#[test]
fn photos_of_two_folders_keep_their_own_cameras() {
    let folder = folder();
    let frame = |path: &str, x: f64| {
        format!(
            r#"{{"file_path": "{path}", "w": 4, "h": 3, "fl_x": 5,
            "transform_matrix": [[1,0,0,{x}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#
        )
    };
    let path = folder.path().join("transforms.json");
    let read = |frames: &[String]| {
        let text = format!(r#"{{"frames": [{}]}}"#, frames.join(","));
        std::fs::write(&path, text).unwrap();
        import_cameras(&path, CameraFormat::Transforms, None).unwrap()
    };
    let both = read(&[
        frame("images/100/x.jpg", 1.0),
        frame("./images/101/x.jpg", 2.0),
    ]);
    let place = |photo: &str| {
        let pose = both.find(photo)?.cam_from_world?;
        Some(pose.center_in_source().x)
    };
    assert_eq!(place("100/x.jpg"), Some(1.0));
    assert_eq!(place("101/x.jpg"), Some(2.0));
    assert_eq!(place("101/x"), Some(2.0));
    // Neither of another folder nor of both.
    assert_eq!(place("102/x.jpg"), None);
    assert_eq!(place("x.jpg"), None);
    let one = read(&[frame("images/100/x.jpg", 1.0)]);
    assert_eq!(one.cameras[0].image.as_deref(), Some("x.jpg"));
}

#[test]
fn wide_lenses_are_kept_or_refused() {
    let rational = Distortion {
        k1: 0.1,
        p1: 1e-3,
        denominator: [0.2, 0.01, 0.0],
        ..Distortion::default()
    };
    let fisheye = Distortion {
        k1: 0.05,
        k4: -7e-4,
        fisheye: true,
        ..Distortion::default()
    };
    let prism = Distortion {
        prism: [2e-3, -1e-3],
        ..fisheye
    };
    let [json, colmap, binary, nerfstudio] = [
        CameraFormat::CamerasJson,
        CameraFormat::Colmap,
        CameraFormat::ColmapBinary,
        CameraFormat::Transforms,
    ];
    for (distortion, kept) in [
        (rational, &[json, colmap, binary][..]),
        (fisheye, &[json, colmap, binary, nerfstudio]),
        (prism, &[json, colmap, binary]),
    ] {
        let original = cameras(Intrinsics {
            distortion,
            ..plain()
        });
        for format in CameraFormat::ALL {
            let folder = folder();
            let path = path_of(&folder, format);
            let written = export_cameras(&path, format, &original);
            assert_eq!(
                written.is_ok(),
                kept.contains(&format),
                "{format:?}: {written:?}"
            );
            if written.is_ok() {
                let back = import_cameras(&path, format, None).unwrap();
                let worst = largest_projection_difference(&original, &back);
                assert!(worst < SAME_PX, "{format:?}: {worst}");
            }
        }
    }
}

/// A point before all three cameras' first, and where our camera sees it.
fn point_and_pixel(entry: &CameraEntry) -> (Point3<f64>, nalgebra::Point2<f64>) {
    let pose = entry.cam_from_world.unwrap();
    let in_camera = Point3::new(0.2, -0.15, 1.3);
    let world = pose.inverse().apply(&in_camera);
    (world, entry.intrinsics.project(&in_camera).unwrap())
}

fn written(format: CameraFormat, intrinsics: Intrinsics, name: &str) -> (String, CameraEntry) {
    let folder = folder();
    let original = cameras(intrinsics);
    export_cameras(&path_of(&folder, format), format, &original).unwrap();
    let text = std::fs::read_to_string(folder.path().join(name)).unwrap();
    (text, original.cameras[1].clone())
}

#[test]
fn transforms_by_nerfstudios_own_formula() {
    let (text, entry) = written(CameraFormat::Transforms, plain(), "transforms.json");
    let (world, pixel) = point_and_pixel(&entry);
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let frame = &value["frames"][1];
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let m = |i: usize, j: usize| number(&frame["transform_matrix"][i][j]);
    let rotation = Matrix3::from_fn(m);
    let center = Vector3::new(m(0, 3), m(1, 3), m(2, 3));
    // nerfstudio: a pixel's ray is ((u + 0.5 - cx) / fl_x, -(v + 0.5 - cy) / fl_y, -1).
    let p = rotation.transpose() * (world.coords - center);
    let u = number(&frame["fl_x"]) * p.x / -p.z + number(&frame["cx"]) - 0.5;
    let v = -number(&frame["fl_y"]) * p.y / -p.z + number(&frame["cy"]) - 0.5;
    assert!(
        (u - pixel.x).hypot(v - pixel.y) < SAME_PX,
        "{u} {v} {pixel}"
    );
}

#[test]
fn metashape_by_its_manuals_formula() {
    let bent = Intrinsics {
        distortion: Distortion {
            k1: -0.1,
            k2: 0.02,
            p1: 1e-2,
            p2: -2e-2,
            k3: 0.01,
            ..Distortion::default()
        },
        ..plain()
    };
    let (text, entry) = written(CameraFormat::Metashape, bent, "cameras.xml");
    let (world, pixel) = point_and_pixel(&entry);
    let document = roxmltree::Document::parse(&text).unwrap();
    let named = |name: &'static str| document.descendants().filter(move |n| n.has_tag_name(name));
    let value = |name: &'static str| -> f64 {
        let node = named(name).next().unwrap();
        node.text().unwrap().parse().unwrap()
    };
    let m: Vec<f64> = named("transform")
        .nth(1)
        .unwrap()
        .text()
        .unwrap()
        .split_whitespace()
        .map(|word| word.parse().unwrap())
        .collect();
    let rotation = Matrix3::from_fn(|i, j| m[4 * i + j]);
    let p = rotation.transpose() * (world.coords - Vector3::new(m[3], m[7], m[11]));
    let (x, y) = (p.x / p.z, p.y / p.z);
    let r2 = x * x + y * y;
    let radial = 1.0 + value("k1") * r2 + value("k2") * r2 * r2 + value("k3") * r2.powi(3);
    let (p1, p2) = (value("p1"), value("p2"));
    let xd = x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y;
    let yd = y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y;
    let u = 0.5 * WIDTH as f64 + value("cx") + xd * value("f") + xd * value("b1") - 0.5;
    let v = 0.5 * HEIGHT as f64 + value("cy") + yd * value("f") - 0.5;
    assert!(
        (u - pixel.x).hypot(v - pixel.y) < SAME_PX,
        "{u} {v} {pixel}"
    );
}

#[test]
fn middlebury_by_its_projection_matrix() {
    let (text, entry) = written(CameraFormat::Middlebury, plain(), "stone_par.txt");
    let (world, pixel) = point_and_pixel(&entry);
    let line = text.lines().nth(2).unwrap();
    let v: Vec<f64> = line
        .split(' ')
        .skip(1)
        .map(|w| w.parse().unwrap())
        .collect();
    let (k, r) = (
        Matrix3::from_row_slice(&v[..9]),
        Matrix3::from_row_slice(&v[9..18]),
    );
    let p = k * (r * world.coords + Vector3::from_row_slice(&v[18..]));
    assert!(
        (p.x / p.z - pixel.x).hypot(p.y / p.z - pixel.y) < SAME_PX,
        "{p} {pixel}"
    );
}

#[test]
fn blender_style_transforms_take_the_size_from_the_image() {
    let folder = folder();
    let path = folder.path().join("transforms.json");
    std::fs::write(
        &path,
        r#"{"camera_angle_x": 0.6911112070083618, "frames": [{"file_path": "./IMG_0000",
            "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#,
    )
    .unwrap();
    let file = import_cameras(&path, CameraFormat::Transforms, None).unwrap();
    let found = file.find("IMG_0000.png").unwrap();
    let k = found.intrinsics;
    assert_eq!((k.width, k.height, k.cx), (WIDTH, HEIGHT, 31.5));
    assert!(
        (k.fx - 32.0 / 0.345_555_603_504_180_9f64.tan()).abs() < 1e-9,
        "{}",
        k.fx
    );
    // At z = 4, looking along -z: the origin lies before it.
    let in_camera = found.cam_from_world.unwrap().apply(&Point3::origin());
    assert!(
        (in_camera - Point3::new(0.0, 0.0, 4.0)).norm() < 1e-12,
        "{in_camera}"
    );
}

#[test]
fn refusals_name_file_and_place() {
    let folder = folder();
    for (name, format, text, expected) in [
        (
            "transforms.json",
            CameraFormat::Transforms,
            "{}",
            "\"frames\" is missing",
        ),
        (
            "transforms.json",
            CameraFormat::Transforms,
            r#"{"frames": [{"file_path": "a.png", "w": 4, "h": 3, "fl_x": 5,
                "camera_model": "EQUIRECTANGULAR"}]}"#,
            "EQUIRECTANGULAR",
        ),
        (
            "transforms.json",
            CameraFormat::Transforms,
            r#"{"frames": [{"file_path": "a.png", "fl_x": 5}]}"#,
            "the photo a.png is not there",
        ),
        (
            "x_par.txt",
            CameraFormat::Middlebury,
            "2\nIMG_0000.png 1 2\n",
            "line 2",
        ),
        (
            "x_par.txt",
            CameraFormat::Middlebury,
            "2\n",
            "announces 2 images and has 0",
        ),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let message = import_cameras(&path, format, None).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn no_part_of_a_file_panics() {
    for format in [
        CameraFormat::Transforms,
        CameraFormat::Middlebury,
        CameraFormat::Metashape,
    ] {
        let folder = folder();
        let path = path_of(&folder, format);
        export_cameras(&path, format, &cameras(centered())).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for end in (0..whole.len()).step_by(11) {
            std::fs::write(&path, &whole[..end]).unwrap();
            let _ = import_cameras(&path, format, None);
        }
    }
}

#[test]
fn sfm_data_of_all_versions_means_one_camera() {
    let folder = folder();
    let file = |name: &str, version: &str, camera: &str| {
        let path = folder.path().join(name);
        let text = format!(
            r#"{{"version": {version}, "featuresFolders": "", "views": [{{"viewId": "7", "poseId": "9",
            "intrinsicId": "5", "path": "/far/away/IMG_0000.png", "width": "64", "height": "48"}}],
            "intrinsics": [{{"intrinsicId": "5", "width": "64", "height": "48", {camera}}}],
            "poses": [{{"poseId": "9", "pose": {{"transform": {{"rotation":
            ["0", "1", "0", "-1", "0", "0", "0", "0", "1"], "center": ["1", "2", "3"]}}}}}}]}}"#
        );
        std::fs::write(&path, text).unwrap();
        import_cameras(&path, CameraFormat::SfmData, None).unwrap()
    };
    let versions = [
        file(
            "a.sfm",
            r#"["1", "2", "0"]"#,
            r#""type": "pinhole",
            "pxFocalLength": ["80", "90"], "principalPoint": ["30", "25"]"#,
        ),
        file(
            "b.sfm",
            r#"["1", "2", "4"]"#,
            r#""type": "radial3", "sensorWidth": "32",
            "focalLength": "40", "pixelRatio": "0.88888888888888888",
            "principalPoint": ["-2", "1"], "distortionParams": ["0", "0", "0"]"#,
        ),
        file(
            "c.sfm",
            r#"["1", "2", "8"]"#,
            r#""type": "pinhole", "distortionType": "none",
            "sensorWidth": "32", "focalLength": "40", "pixelRatio": "1.125",
            "principalPoint": ["-2", "1"], "distortionParams": """#,
        ),
    ];
    for found in &versions {
        let entry = &found.cameras[0];
        let i = &entry.intrinsics;
        let worst = [i.fx - 80.0, i.fy - 90.0, i.cx - 30.0, i.cy - 25.0].map(f64::abs);
        assert!(worst.iter().all(|d| *d < 1e-9), "{i:?}");
        assert_eq!(entry.image.as_deref(), Some("IMG_0000.png"));
        // The columns of camera from world: x of the world is y of the camera.
        let pose = entry.cam_from_world.unwrap();
        let point = pose.apply(&Point3::new(2.0, 2.0, 3.0));
        assert!(
            (point - Point3::new(0.0, 1.0, 0.0)).norm() < 1e-12,
            "{point}"
        );
    }
}

#[test]
fn a_projection_matrix_of_any_sign_and_scale_is_parted() {
    let folder = folder();
    let path = folder.path().join("cameras_sphere.npz");
    std::fs::create_dir(folder.path().join("image")).unwrap();
    for i in 0..3 {
        let name = format!("IMG_{i:04}.png");
        std::fs::copy(
            folder.path().join(&name),
            folder.path().join("image").join(&name),
        )
        .unwrap();
    }
    let original = cameras(plain());
    export_cameras(&path, CameraFormat::Npz, &original).unwrap();
    // The first array's numbers, turned to the other sign: the same camera. Compressed, as
    // `numpy.savez_compressed` writes it.
    let mut plain = zip::ZipArchive::new(std::fs::File::open(&path).unwrap()).unwrap();
    let mut turned = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for index in 0..plain.len() {
        let mut entry = plain.by_index(index).unwrap();
        let name = entry.name().unwrap().into_owned();
        let mut array = Vec::new();
        entry.read_to_end(&mut array).unwrap();
        for i in (0..12).filter(|_| name == "world_mat_0.npy") {
            array[128 + 8 * i + 7] ^= 0x80;
        }
        let options = zip::write::SimpleFileOptions::default();
        let options = options.compression_method(zip::CompressionMethod::Deflated);
        turned.start_file(name, options).unwrap();
        turned.write_all(&array).unwrap();
    }
    let bytes = turned.finish().unwrap().into_inner();
    std::fs::write(&path, &bytes).unwrap();
    let back = import_cameras(&path, CameraFormat::Npz, None).unwrap();
    let worst = largest_projection_difference(&original, &back);
    assert!(worst < SAME_PX, "{worst}");
    for end in (0..bytes.len()).step_by(7) {
        std::fs::write(&path, &bytes[..end]).unwrap();
        assert!(
            import_cameras(&path, CameraFormat::Npz, None).is_err(),
            "{end} bytes"
        );
    }
}

#[test]
fn damaged_scenes_never_panic() {
    let folder = folder();
    for format in [
        CameraFormat::OpenMvs,
        CameraFormat::Npz,
        CameraFormat::SfmData,
    ] {
        let path = path_of(&folder, format);
        export_cameras(&path, format, &cameras(plain())).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x5A;
            std::fs::write(&path, &bytes).unwrap();
            drop(import_cameras(&path, format, None));
        }
    }
}

/// A folder with nothing but photos of the names that cameras have.
fn photos() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let grey = vec![9; WIDTH * HEIGHT];
    let png = encode_png(&grey, WIDTH, HEIGHT, image::ExtendedColorType::L8).unwrap();
    for i in 0..3 {
        std::fs::write(folder.path().join(format!("IMG_{i:04}.png")), &png).unwrap();
    }
    folder
}

#[test]
fn photos_that_tell_sizes_may_be_in_a_folder_of_their_own() {
    let photos = photos();
    for format in [CameraFormat::Middlebury, CameraFormat::Npz] {
        let folder = tempfile::tempdir().unwrap();
        let path = path_of(&folder, format);
        let original = cameras(centered());
        export_cameras(&path, format, &original).unwrap();
        let message = import_cameras(&path, format, None).unwrap_err().to_string();
        assert!(
            message.contains("is not there; its size in pixels is needed")
                && message.contains("--photos DIR"),
            "{format:?}: {message}"
        );
        let back = import_cameras(&path, format, Some(photos.path())).unwrap();
        let worst = largest_projection_difference(&original, &back);
        assert!(worst < SAME_PX, "{format:?}: {worst}");
        for (a, b) in original.cameras.iter().zip(&back.cameras) {
            assert_eq!(a.image, b.image, "{format:?}");
        }
    }
}

#[test]
fn names_come_back_or_are_refused() {
    let names = [
        "a b.png",
        " a.png",
        "a.png ",
        "a\nb.png",
        "a\tb.png",
        "a\rb.png",
        "a\u{1}.png",
        "#a.png",
        "\"a\".png",
        "<a&amp;>.png",
        "ä石.png",
        "a\\b.png",
        "a,b.png",
        "-a.png",
        "a\u{a0}b.png",
    ];
    for name in names {
        let photos = photos();
        std::fs::copy(photos.path().join("IMG_0000.png"), photos.path().join(name)).unwrap();
        let mut original = cameras(centered());
        original.cameras[1].image = Some(name.to_owned());
        let mut num_kept = 0;
        for format in CameraFormat::ALL {
            let folder = tempfile::tempdir().unwrap();
            let path = path_of(&folder, format);
            match export_cameras(&path, format, &original) {
                Ok(()) => {
                    let back = import_cameras(&path, format, Some(photos.path()));
                    let back = back.unwrap_or_else(|error| panic!("{format:?} {name:?}: {error}"));
                    let known = |entry: &CameraEntry| entry.image.as_deref() == Some(name);
                    assert!(back.cameras.iter().any(known), "{format:?} {name:?}");
                    assert_eq!(back.cameras.len(), 3, "{format:?} {name:?}");
                    num_kept += 1;
                }
                Err(error) => {
                    assert_eq!(error.kind, crate::IoErrorKind::Input, "{error}");
                    let message = error.to_string();
                    assert!(message.contains(&format!("{name:?}")), "{message}");
                    assert!(!path.is_file(), "{format:?} {name:?}");
                }
            }
        }
        assert!(num_kept >= 2, "{name:?}");
    }
}

#[test]
fn more_cameras_than_a_numpy_file_counts_are_refused() {
    let entry = camera(0, plain());
    let many = |num: usize| CameraFile {
        cameras: vec![entry.clone(); num],
        ..CameraFile::default()
    };
    let path = Path::new("cameras.npz");
    assert!(camera_files(path, CameraFormat::Npz, &many(32_767)).is_ok());
    let error = camera_files(path, CameraFormat::Npz, &many(32_768)).unwrap_err();
    assert!(error.to_string().contains("32767 cameras"), "{error}");
}

#[test]
fn blenders_script_holds_lens_shift_and_place() {
    let original = cameras(plain());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.py");
    blender_file(&path, &original).unwrap().write().unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let listed = text.lines().filter(|line| line.starts_with("    {"));
    let mut back = original.clone();
    let mut count = 0;
    for (line, entry) in listed.zip(&mut back.cameras) {
        let given: serde_json::Value = serde_json::from_str(line.trim_end_matches(',')).unwrap();
        let number = |v: &serde_json::Value| v.as_f64().unwrap();
        let [w, h] = [0, 1].map(|k| number(&given["resolution"][k]));
        let [right, up] = [0, 1].map(|k| number(&given["shift"][k]));
        let fx = number(&given["lens"]) / 36.0 * w;
        let aspect = number(&given["pixel_aspect"]);
        // The window moves to the right and upwards: the principal point to the left and down.
        let (cx, cy) = (
            0.5 * (w - 1.0) - right * w,
            0.5 * (h - 1.0) + up * w / aspect,
        );
        let intrinsics = &mut entry.intrinsics;
        (intrinsics.fx, intrinsics.fy) = (fx, fx / aspect);
        (intrinsics.cx, intrinsics.cy) = (cx, cy);
        let m = |i: usize, j: usize| number(&given["world_from_camera"][i][j]);
        // Blender's axes: y up, z backward.
        let rotation = Matrix3::from_fn(|i, j| if j == 0 { m(i, j) } else { -m(i, j) });
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(rotation);
        let center = Point3::new(m(0, 3), m(1, 3), m(2, 3));
        entry.cam_from_world = Some(RigidTransform::from_world_pose(rotation, center));
        count += 1;
    }
    assert_eq!(count, 3);
    let worst = largest_projection_difference(&original, &back);
    assert!(worst < SAME_PX, "{worst}");

    // Words of a foreign file shall not become lines of the script.
    let mut foreign = original.clone();
    let words = "x\nimport os";
    foreign.extra.insert("frame".into(), words.into());
    foreign.cameras[0].image = Some("a\"\n'b.png".into());
    blender_file(&path, &foreign).unwrap().write().unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(text.matches("import os").count(), 1, "{text}");
    assert_eq!(
        text.lines()
            .filter(|line| line.starts_with("    {"))
            .count(),
        3
    );

    let mut bent = cameras(plain());
    bent.cameras[1].intrinsics.distortion.k1 = -0.1;
    let error = blender_file(Path::new("cameras.py"), &bent).unwrap_err();
    assert!(error.to_string().contains("IMG_0001"), "{error}");
}
