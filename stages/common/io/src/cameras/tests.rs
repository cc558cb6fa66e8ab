use super::*;
use crate::IoErrorKind;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rilievo_scene::{Distortion, Intrinsics, RigidTransform, Unit};
use std::path::{Path, PathBuf};

fn file() -> CameraFile {
    let entry = |i: usize, posed: bool| CameraEntry {
        image: Some(format!("IMG {i}ä.jpg")),
        intrinsics: Intrinsics {
            fy: 1101.25,
            distortion: Distortion {
                k1: -0.1,
                k2: 0.03,
                p1: 1e-4,
                p2: -2e-4,
                k3: if i == 2 { 1e-3 } else { 0.0 },
                ..Distortion::default()
            },
            ..Intrinsics::pinhole(1280, 960, 1_100.123_456_789_012, 639.4, 480.7)
        },
        cam_from_world: posed.then(|| RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.3 * i as f64, -0.7, 2.1),
            translation: Vector3::new(0.1, -0.2, 1.5 + i as f64),
        }),
    };
    CameraFile {
        unit: Unit::Metre,
        cameras: vec![entry(0, true), entry(1, false), entry(2, true)],
        unregistered: vec![("IMG 9.jpg".to_owned(), "no matches".to_owned())],
        extra: serde_json::Map::new(),
    }
}

/// Largest distance of projected points, pixels.
pub(crate) fn largest_projection_difference(a: &CameraFile, b: &CameraFile) -> f64 {
    assert_eq!(a.cameras.len(), b.cameras.len());
    let mut worst = 0.0f64;
    for (a, b) in a.cameras.iter().zip(&b.cameras) {
        let pose = |entry: &CameraEntry| {
            entry
                .cam_from_world
                .unwrap_or_else(RigidTransform::identity)
        };
        let from_first = pose(a).inverse();
        for &(x, y, z) in &[(0.0, 0.0, 1.0), (0.4, -0.3, 1.2), (-0.5, 0.35, 2.0)] {
            let world = from_first.apply(&Point3::new(x, y, z));
            let p = a.intrinsics.project(&pose(a).apply(&world)).unwrap();
            let q = b.intrinsics.project(&pose(b).apply(&world)).unwrap();
            worst = worst.max((p - q).norm());
        }
    }
    worst
}

fn read_text(text: &str) -> Result<CameraFile, crate::IoError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    std::fs::write(&path, text).unwrap();
    read_cameras(&path)
}

#[test]
fn cameras_survive_the_disk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    let original = file();
    write_cameras(&path, &original).unwrap();
    let back = read_cameras(&path).unwrap();
    for (a, b) in original.cameras.iter().zip(&back.cameras) {
        // Intrinsics to the bit: fixed ones must leave as they came.
        assert_eq!(a.intrinsics, b.intrinsics);
        assert_eq!(a.image, b.image);
    }
    assert_eq!(back.unit, Unit::Metre);
    assert_eq!(back.unregistered, original.unregistered);
    let difference = largest_projection_difference(&original, &back);
    assert!(difference < 1e-9, "{difference}");
}

#[test]
fn photos_are_found_with_and_without_ending_or_folder() {
    let mut cameras = file();
    cameras.cameras[0].image = Some("a/x.jpg".to_owned());
    cameras.cameras[1].image = Some("x.png".to_owned());
    cameras.cameras[2].image = Some("y.1".to_owned());
    let at = |name: &str| cameras.find(name).and_then(|entry| entry.image.as_deref());
    assert_eq!(at("x.jpg"), Some("a/x.jpg"));
    assert_eq!(at("x.png"), Some("x.png"));
    assert_eq!(at("y.1.tif"), Some("y.1"));
    assert_eq!(at("z.jpg"), None);
}

#[test]
fn a_single_camera_needs_no_name() {
    let cameras =
        read_text(r#"{"width": 4, "height": 3, "K": [[5,0,1.5],[0,5,1],[0,0,1]]}"#).unwrap();
    assert_eq!(cameras.unit, Unit::Arbitrary);
    let found = cameras.find("anything.png").unwrap();
    assert_eq!(found.intrinsics, Intrinsics::pinhole(4, 3, 5.0, 1.5, 1.0));
}

#[test]
fn wrong_values_are_refused_with_file_key_and_value() {
    let with = |k: &str, rest: &str| {
        format!(
            r#"{{"cameras": [{{"image": "a.jpg", "width": 4, "height": 3, "K": {k} {rest}}}]}}"#
        )
    };
    let k = "[[5,0,1],[0,5,1],[0,0,1]]";
    let pose = |rotation: &str| {
        with(
            k,
            &format!(r#", "world_from_camera_rotation": {rotation}, "camera_center": [0,0,0]"#),
        )
    };
    for (text, expected) in [
        ("{".to_owned(), "broken JSON"),
        ("[]".to_owned(), "not an object"),
        ("{}".to_owned(), "\"cameras\" is missing"),
        (with("[[5,0],[0,5]]", ""), "cameras[0].K"),
        (
            with("[[5,0,1],[0,\"x\",1],[0,0,1]]", ""),
            "cameras[0].K[1][1]: \"x\"",
        ),
        (with("[[-5,0,1],[0,5,1],[0,0,1]]", ""), "focal length"),
        (with("[[5,0.5,1],[0,5,1],[0,0,1]]", ""), "skew"),
        (with("[[5,0,1],[0,5,1],[0,1,1]]", ""), "of the form"),
        (with(k, r#", "width": 0"#), "cameras[0].width: 0"),
        (
            with(k, r#", "camera_center": [0,0,0]"#),
            "world_from_camera_rotation",
        ),
        (pose("[[1,0,0],[0,1,0],[0,0,-1]]"), "mirrored axes"),
        (pose("[[2,0,0],[0,1,0],[0,0,1]]"), "not orthonormal"),
        (pose("[[1,0,0],[0,1,0]]"), "2 rows"),
        (
            with(
                k,
                r#", "distortion": {"model": "fisheye", "coefficients": []}"#,
            ),
            "fisheye",
        ),
        (
            with(
                k,
                r#", "distortion": {"coefficients": [0,0,0,0,0,0,0,0,0.1]}"#,
            ),
            "coefficients[8]: 0.1",
        ),
        (
            r#"{"unit": "yard", "cameras": []}"#.to_owned(),
            "unit: \"yard\"",
        ),
    ] {
        let error = read_text(&text).unwrap_err();
        assert_eq!(error.kind, IoErrorKind::Input);
        let message = error.to_string();
        assert!(
            message.contains("cameras.json: ") && message.contains(expected),
            "{message}"
        );
    }
    let missing = read_cameras(Path::new("nowhere.json")).unwrap_err();
    assert_eq!(missing.path, PathBuf::from("nowhere.json"));
}

#[test]
fn rounded_rotations_are_made_orthonormal() {
    let text = r#"{"width": 4, "height": 3, "K": [[5,0,1],[0,5,1],[0,0,1]],
        "world_from_camera_rotation": [[0.8,-0.6001,0],[0.6,0.7999,0],[0,0,1]],
        "camera_center": [1,2,3]}"#;
    let pose = read_text(text).unwrap().cameras[0].cam_from_world.unwrap();
    let r = pose.rotation_matrix();
    let defect = (r.transpose() * r - nalgebra::Matrix3::identity()).amax();
    assert!(defect < 1e-12, "{defect}");
    assert!((pose.center_in_source() - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
}

#[test]
fn no_part_of_a_file_panics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    write_cameras(&path, &file()).unwrap();
    let whole = std::fs::read(&path).unwrap();
    // Every few bytes: each try is a file of its own.
    for end in (0..whole.len() - 2).step_by(13) {
        std::fs::write(&path, &whole[..end]).unwrap();
        assert!(read_cameras(&path).is_err(), "{end} bytes");
    }
}

#[test]
fn the_time_for_many_cameras_grows_with_their_number() {
    let num = 60_000;
    let entries: Vec<String> = (0..num)
        .map(|i| {
            format!(
                r#"{{"image": "IMG_{i}.jpg", "width": 4, "height": 3, "K": [[{},0,1],[0,5,1],[0,0,1]]}}"#,
                5.0 + 1e-3 * f64::from(i)
            )
        })
        .collect();
    let began = std::time::Instant::now();
    let cameras = read_text(&format!(r#"{{"cameras": [{}]}}"#, entries.join(","))).unwrap();
    let index = cameras.index();
    for i in 0..num {
        let found = index.find(&format!("IMG_{i}.png")).unwrap();
        assert_eq!(found.intrinsics.fx, 5.0 + 1e-3 * f64::from(i));
    }
    let mut distinct = DistinctCameras::default();
    for entry in cameras.cameras.iter().chain(&cameras.cameras) {
        distinct.place(&entry.intrinsics);
    }
    assert_eq!(distinct.list.len(), cameras.cameras.len());
    // About one second; comparing each with each takes minutes.
    let seconds = began.elapsed().as_secs_f64();
    assert!(seconds < 15.0, "{seconds} s");
}
