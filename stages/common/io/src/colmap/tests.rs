use super::*;
use crate::cameras::{CameraFile, read_cameras};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rilievo_scene::{
    Distortion, Intrinsics, PhotoIdx, PosedView, PosedViews, RigidTransform, SparsePoint,
    TrackElement, ViewIdx,
};

fn write_binary(folder: &Path, model: &ColmapModel) {
    for file in binary_files(folder, model).unwrap() {
        file.write().unwrap();
    }
}

fn views() -> PosedViews {
    let plain = Intrinsics::pinhole(1280, 960, 1_777.777_777_8, 639.5, 479.5);
    let bent = Intrinsics {
        fy: 1780.1,
        distortion: Distortion {
            k1: -0.05,
            k2: 0.01,
            p1: 1e-4,
            p2: -3e-4,
            k3: 0.0,
            ..Distortion::default()
        },
        ..plain
    };
    let mut views = PosedViews::default();
    let mut with_k3 = bent;
    with_k3.distortion.k3 = 2e-3;
    for (i, intrinsics) in [plain, bent, plain, with_k3].into_iter().enumerate() {
        views.views.push(PosedView {
            photo: PhotoIdx(i),
            name: format!("photo {i}"),
            file_name: format!("photo {i}.jpg"),
            intrinsics,
            cam_from_world: RigidTransform {
                rotation: UnitQuaternion::from_euler_angles(0.1 * i as f64, 0.5, -1.3),
                translation: Vector3::new(0.3, -0.1 * i as f64, 1.0 / 3.0),
            },
        });
    }
    for p in 0..20 {
        let in_camera = Point3::new(0.1 * (p % 4) as f64 - 0.15, 0.05 * (p % 5) as f64, 1.1);
        let world = views.views[0].cam_from_world.inverse().apply(&in_camera);
        let track = views
            .views
            .iter()
            .enumerate()
            .filter_map(|(v, view)| {
                let pixel = view
                    .intrinsics
                    .project(&view.cam_from_world.apply(&world))?;
                Some(TrackElement {
                    view: ViewIdx(v),
                    keypoint_idx: 7,
                    pixel: [pixel.x, pixel.y],
                })
            })
            .collect();
        views.points.push(SparsePoint {
            position: [world.x, world.y, world.z],
            color: [1, 2, p],
            error_px: 0.25,
            track,
        });
    }
    views
}

/// Largest distance between a model's observations and its own projections, pixels: half pixels,
/// axes and tracks all enter.
fn largest_reprojection_error(model: &ColmapModel) -> f64 {
    let mut worst = 0.0f64;
    let mut num = 0;
    for point in &model.points {
        for &(image_id, index) in &point.track {
            let image = model.images.iter().find(|i| i.id == image_id).unwrap();
            let camera = model
                .cameras
                .iter()
                .find(|c| c.id == image.camera_id)
                .unwrap();
            let world = Point3::from(point.position);
            let pixel = camera
                .intrinsics()
                .unwrap()
                .project(&image.cam_from_world.apply(&world))
                .unwrap();
            let ([x, y], seen) = image.points2d[index as usize];
            assert_eq!(seen, Some(point.id));
            worst = worst.max((pixel.x + 0.5 - x).hypot(pixel.y + 0.5 - y));
            num += 1;
        }
    }
    assert!(num > 20, "{num}");
    worst
}

#[test]
fn models_survive_both_formats_and_project_alike() {
    let model = ColmapModel::from_posed_views(&views());
    assert_eq!(model.cameras.len(), 3);
    let folder = tempfile::tempdir().unwrap();
    write_colmap_text(folder.path(), &views()).unwrap();
    let text = read_model(folder.path()).unwrap();
    assert_eq!(text, model);
    write_binary(folder.path(), &model);
    let binary = read_model(folder.path()).unwrap();
    assert_eq!(binary, model);
    let error = largest_reprojection_error(&binary);
    assert!(error < 1e-9, "{error}");
}

#[test]
fn a_folder_is_a_camera_file() {
    let folder = tempfile::tempdir().unwrap();
    write_colmap_text(folder.path(), &views()).unwrap();
    let cameras: CameraFile = read_cameras(folder.path()).unwrap();
    for view in &views().views {
        let entry = cameras.find(&view.file_name).unwrap();
        let difference = (entry.intrinsics.cx - view.intrinsics.cx).abs();
        assert!(difference < 1e-12, "{difference}");
        assert_eq!(entry.cam_from_world, Some(view.cam_from_world));
    }
}

#[test]
fn every_convertible_model_is_understood_and_others_are_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("images.txt"),
        "# c\n1 1 0 0 0 0 0 0 1 my photo.jpg\n\n",
    )
    .unwrap();
    let with = |line: &str| {
        std::fs::write(folder.path().join("cameras.txt"), format!("# c\n{line}\n")).unwrap();
        read_cameras(folder.path())
    };
    for (line, k1, fy) in [
        ("1 SIMPLE_PINHOLE 100 80 90 50 40", 0.0, 90.0),
        ("1 PINHOLE 100 80 90 91 50 40", 0.0, 91.0),
        ("1 SIMPLE_RADIAL 100 80 90 50 40 0.1", 0.1, 90.0),
        ("1 RADIAL 100 80 90 50 40 0.1 0.01", 0.1, 90.0),
        ("1 OPENCV 100 80 90 91 50 40 0.1 0 0 0", 0.1, 91.0),
        (
            "1 FULL_OPENCV 100 80 90 91 50 40 0.1 0 0 0 0.2 0.2 0 0",
            0.1,
            91.0,
        ),
        ("1 SIMPLE_FISHEYE 100 80 90 50 40", 0.0, 90.0),
        ("1 FISHEYE 100 80 90 91 50 40", 0.0, 91.0),
        ("1 SIMPLE_RADIAL_FISHEYE 100 80 90 50 40 0.1", 0.1, 90.0),
        ("1 RADIAL_FISHEYE 100 80 90 50 40 0.1 0.01", 0.1, 90.0),
        ("1 OPENCV_FISHEYE 100 80 90 91 50 40 0.1 0 0 0", 0.1, 91.0),
        (
            "1 THIN_PRISM_FISHEYE 100 80 90 91 50 40 0.1 0 0 0 0 0 1e-3 0",
            0.1,
            91.0,
        ),
    ] {
        let cameras = with(line).unwrap();
        let entry = cameras.find("my photo").unwrap();
        let found = entry.intrinsics;
        assert_eq!((found.cx, found.cy, found.fy), (49.5, 39.5, fy), "{line}");
        assert_eq!(found.distortion.k1, k1, "{line}");
        assert_eq!(found.distortion.fisheye, line.contains("FISHEYE"), "{line}");
        // What is written is the same lens again.
        let again = ColmapCamera::from_intrinsics(1, &found);
        assert_eq!(again.intrinsics().as_ref(), Ok(&found), "{line}");
    }
    for (line, expected) in [
        ("1 FOV 100 80 90 91 50 40 0.9", "FOV is not supported"),
        (
            "1 OPENCV_FISHEYE 100 80 30 31 50 40 0 0 0 0",
            "camera 1 (OPENCV_FISHEYE): the lens sees 2",
        ),
        ("1 PINHOLE 100 80 90 91 50", "3 parameters"),
        ("1 PINHOLE 100 80 90 nan 50 40", "line 2"),
        ("1 PINHOLE 100 80 -90 91 50 40", "focal"),
        ("1 PINHOLE x 80 90 91 50 40", "WIDTH is \"x\""),
        ("2 PINHOLE 100 80 90 91 50 40", "refers to camera 1"),
    ] {
        let message = with(line).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let empty = tempfile::tempdir().unwrap();
    let message = read_cameras(empty.path()).unwrap_err().to_string();
    assert!(message.contains("cameras.txt"), "{message}");
}

#[test]
fn no_part_of_a_binary_file_panics() {
    let folder = tempfile::tempdir().unwrap();
    let model = ColmapModel::from_posed_views(&views());
    write_binary(folder.path(), &model);
    type Parse = fn(&Path, &[u8], &mut ColmapModel) -> Result<(), IoError>;
    let files: [(&str, Parse); 3] = [
        ("cameras.bin", binary::parse_cameras),
        ("images.bin", binary::parse_images),
        ("points3D.bin", binary::parse_points),
    ];
    for (name, parse) in files {
        let path = folder.path().join(name);
        let whole = std::fs::read(&path).unwrap();
        for end in 0..whole.len() {
            let mut model = ColmapModel::default();
            assert!(
                parse(&path, &whole[..end], &mut model).is_err(),
                "{name} {end}"
            );
            let mut flipped = whole.clone();
            flipped[end] ^= 0xFF;
            let _ = parse(&path, &flipped, &mut ColmapModel::default());
        }
    }
}

#[test]
fn models_with_rigs_and_frames_carry_their_poses_in_the_images() {
    let folder = tempfile::tempdir().unwrap();
    let views = views();
    write_colmap_text(folder.path(), &views).unwrap();
    let plain = read_model(folder.path()).unwrap();
    // As COLMAP 3.12 writes them beside the model: a rig per camera, a frame per image.
    let rigs = "# RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[]\n1 1 CAMERA 1\n";
    std::fs::write(folder.path().join("rigs.txt"), rigs).unwrap();
    let frames = "# FRAME_ID, RIG_ID, RIG_FROM_WORLD[], NUM_DATA_IDS, DATA_IDS[]\n\
                  1 1 1 0 0 0 0 0 0 1 CAMERA 1 1\n";
    std::fs::write(folder.path().join("frames.txt"), frames).unwrap();
    assert_eq!(read_model(folder.path()).unwrap(), plain);
}
