//! The readers on the files in the shared folder beside the repository, where it is there.

// Helpers of the tests may fail as the tests do.
use nalgebra::{Point3, Vector3};
use rilievo_io as io;
use rilievo_scene::{SphereMark, Unit};
use rilievo_synthetic::testing::shared_data as data;
use std::path::Path;

#[test]
fn a_studio_set_is_consistent() {
    let Some(folder) = data("studio_stone") else {
        return;
    };
    let truth = io::read_cameras(&folder.join("truth/cameras.json")).unwrap();
    assert_eq!(truth.unit, Unit::Metre);
    assert_eq!(truth.cameras.len(), 8);
    assert!(
        truth.extra.contains_key("sphere"),
        "{:?}",
        truth.extra.keys()
    );
    let known = io::read_cameras(&folder.join("intrinsics.json")).unwrap();
    assert!(
        known
            .cameras
            .iter()
            .all(|camera| camera.cam_from_world.is_none())
    );

    let sphere = io::read_sphere_file(&folder.join("sphere_calibrated.json")).unwrap();
    let beside = &sphere.spheres[0];
    assert_eq!((beside.radius, beside.views.len()), (0.04, 8));
    assert_eq!(sphere.calibration[0].same_camera_as, "IMG_0004.jpg");
    // The true centre projects into the middle of the mask.
    let center = truth.extra["sphere"]["center"].as_array().unwrap();
    let center: Vec<f64> = center.iter().map(|v| v.as_f64().unwrap()).collect();
    let world = Point3::new(center[0], center[1], center[2]);
    for (name, mark) in &beside.views {
        let SphereMark::Mask(mask) = mark else {
            panic!("{mark:?}")
        };
        let camera = truth.find(name).unwrap();
        let in_camera = camera.cam_from_world.unwrap().apply(&world);
        let pixel = camera.intrinsics.project(&in_camera).unwrap();
        let inside = mask.contains(pixel.x.round() as isize, pixel.y.round() as isize);
        assert!(inside, "{name}: {pixel}");
    }

    let depth = io::read_depth(&folder.join("truth/IMG_0004_depth.exr")).unwrap();
    let normal = io::read_normal(&folder.join("truth/IMG_0004_normal.exr")).unwrap();
    let mask = io::read_mask(&folder.join("masks/IMG_0004.png")).unwrap();
    let camera = truth.find("IMG_0004").unwrap();
    assert!(depth.same_size(&normal) && depth.same_size(&mask));
    let mut worst = -1.0f64;
    for y in (0..depth.height).step_by(7) {
        for x in (0..depth.width).step_by(7) {
            assert_eq!(*depth.at(x, y) > 0.0, normal.normal(x, y).is_some());
            if let Some(n) = normal.normal(x, y) {
                let ray: Vector3<f64> = camera
                    .intrinsics
                    .ray(&nalgebra::Point2::new(x as f64, y as f64))
                    .normalize();
                worst = worst.max(n.dot(&ray));
            }
        }
    }
    assert!(worst < 0.05, "{worst}");

    let mesh = io::read_mesh_ply(&folder.join("truth/mesh.ply")).unwrap();
    assert!(mesh.triangles.len() > 1000, "{}", mesh.triangles.len());
}

#[test]
fn the_table_scene_is_complete() {
    let Some(folder) = data("shading_table") else {
        return;
    };
    let scene = io::read_scene(&folder.join("scene_L3.json")).unwrap();
    assert_eq!(scene.views.len(), 2);
    let matches = io::read_matches_csv(&scene.matches[0].file).unwrap();
    assert_eq!(matches.len(), 173);
    let mut cameras = Vec::new();
    let mut depths = Vec::new();
    for view in &scene.views {
        let image = io::decode_photo(&view.image).unwrap();
        assert!(image.linear_by_metadata && image.channels == 3);
        let (file, name) = view.lighting.as_ref().unwrap();
        let lighting = io::read_lighting(file, name.as_deref()).unwrap();
        assert_eq!(lighting.for_view(&view.name).unwrap().channels.len(), 3);
        let depth = io::read_depth(Path::new(view.init.as_ref().unwrap())).unwrap();
        assert_eq!((depth.width, depth.height), (image.width, image.height));
        let camera = io::read_cameras(&view.camera).unwrap();
        cameras.push(camera.cameras[0].clone());
        depths.push(io::read_depth(&view.image.with_file_name("depth_true.exr")).unwrap());
    }
    // Matches, cameras and depth agree: a point of view 1 projects to its match in view 2.
    let mut worst = 0.0f64;
    for [x1, y1, x2, y2] in matches {
        let depth = f64::from(*depths[0].at(x1 as usize, y1 as usize));
        let pixel = nalgebra::Point2::new(x1, y1);
        let in_first = cameras[0].intrinsics.unproject(&pixel, depth);
        let second_from_first = cameras[1]
            .cam_from_world
            .unwrap()
            .compose(&cameras[0].cam_from_world.unwrap().inverse());
        let found = cameras[1]
            .intrinsics
            .project(&second_from_first.apply(&in_first))
            .unwrap();
        worst = worst.max((found.x - x2).hypot(found.y - y2));
    }
    assert!(worst < 0.01, "{worst}");
    let message = io::read_lighting(&folder.join("lighting.json"), None).unwrap_err();
    assert!(message.to_string().contains("L1, L2, L3"), "{message}");
}

#[test]
fn real_photos_and_a_single_camera() {
    if let Some(folder) = data("sceaux") {
        let photo = io::decode_photo(&folder.join("100_7100.JPG")).unwrap();
        assert_eq!((photo.width, photo.height), (2832, 2128));
        assert_eq!(photo.exif.focal_35mm, Some(35.0));
        assert_eq!(photo.exif.focal_mm, Some(5.85));
        assert_eq!(photo.exif.make.as_deref(), Some("EASTMAN KODAK COMPANY"));
        assert!(!photo.linear_by_metadata, "{}", photo.encoding_reason);
        let bytes = std::fs::read(folder.join("100_7100.JPG")).unwrap();
        for share in [0.1, 0.5, 0.9, 0.999] {
            let end = (bytes.len() as f64 * share) as usize;
            let cut = io::decode_photo_bytes(Path::new("cut.jpg"), &bytes[..end]);
            assert!(cut.is_err(), "{share}");
        }
    }
    if let Some(folder) = data("rgbd_vase") {
        let cameras = io::read_cameras(&folder.join("camera.json")).unwrap();
        let depth = io::read_depth(&folder.join("depth.exr")).unwrap();
        let found = cameras.find("image.png").unwrap().intrinsics;
        assert_eq!((found.width, found.height), (depth.width, depth.height));
    }
}
