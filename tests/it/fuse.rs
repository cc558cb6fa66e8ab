//! `rilievo fuse` on the true maps of a synthetic set, as several programs would write them, and on
//! maps that cannot be fused.

use crate::common;

use common::{arg, done, json_of, run, synthetic_set};
use rilievo_io::{
    CameraFile, CameraFormat, export_cameras, read_cameras, read_depth, read_normal, write_cameras,
    write_depth, write_normal,
};
use rilievo_scene::{NormalMap, Unit};
use std::path::{Path, PathBuf};

/// Names and cameras of the set's truth.
fn truth() -> (PathBuf, CameraFile) {
    let truth = synthetic_set().join("truth");
    let cameras = read_cameras(&truth.join("cameras.json")).expect("cameras");
    (truth, cameras)
}

fn names(cameras: &CameraFile) -> Vec<String> {
    let images = cameras.cameras.iter().filter_map(|c| c.image.clone());
    images
        .map(|image| image.split('.').next().unwrap_or_default().to_owned())
        .collect()
}

/// A folder with the truth's maps in OpenEXR, without cameras.
fn exr_maps(folder: &Path) -> CameraFile {
    let (truth, cameras) = truth();
    for name in names(&cameras) {
        for what in ["depth", "normal"] {
            let file = format!("{name}_{what}.exr");
            std::fs::copy(truth.join(&file), folder.join(&file)).expect("a copy");
        }
    }
    cameras
}

fn array(width: usize, height: usize, planes: &[Vec<f32>]) -> Vec<u8> {
    let mut bytes = format!("{width}&{height}&{}&", planes.len()).into_bytes();
    for value in planes.iter().flatten() {
        bytes.extend(value.to_le_bytes());
    }
    bytes
}

/// The truth as COLMAP's dense workspace, a pixel of each map being no number.
fn colmap_workspace(folder: &Path) {
    let (truth, cameras) = truth();
    export_cameras(&folder.join("sparse"), CameraFormat::ColmapBinary, &cameras).expect("a model");
    let stereo = folder.join("stereo");
    for what in ["depth_maps", "normal_maps"] {
        std::fs::create_dir_all(stereo.join(what)).expect("a folder");
    }
    for camera in &cameras.cameras {
        let image = camera.image.clone().expect("a name");
        let name = image.split('.').next().unwrap_or_default();
        let mut depth = read_depth(&truth.join(format!("{name}_depth.exr"))).expect("depth");
        let normal = read_normal(&truth.join(format!("{name}_normal.exr"))).expect("normals");
        depth.data[0] = f32::NAN;
        let plane = |k: usize| normal.data.iter().map(|n| n[k]).collect::<Vec<f32>>();
        let file = format!("{image}.geometric.bin");
        let (width, height) = (depth.width, depth.height);
        std::fs::write(
            stereo.join("depth_maps").join(&file),
            array(width, height, &[depth.data]),
        )
        .expect("a file");
        std::fs::write(
            stereo.join("normal_maps").join(&file),
            array(width, height, &[plane(0), plane(1), plane(2)]),
        )
        .expect("a file");
    }
}

fn num_points(out: &Path) -> u64 {
    let report = json_of(&out.join("report.json"));
    report["report"]["num_points"].as_u64().expect("a number")
}

#[test]
fn maps_of_two_programs_give_one_surface() {
    let dir = tempfile::tempdir().unwrap();
    let (truth, _) = truth();
    let exr = dir.path().join("exr");
    let photos = synthetic_set().join("photos");
    done(&[
        "fuse",
        arg(&truth),
        "--photos",
        arg(&photos),
        "-o",
        arg(&exr),
    ]);
    assert!(!exr.join("mesh.obj").exists() && !exr.join("mesh.glb").exists());
    for file in ["cloud.ply", "mesh.ply", "asset.glb", "asset/asset.obj"] {
        assert!(exr.join(file).exists(), "{file}");
    }
    let workspace = dir.path().join("dense");
    colmap_workspace(&workspace);
    let colmap = dir.path().join("colmap");
    let arguments = ["fuse", arg(&workspace), "-o", arg(&colmap)];
    done(&[&arguments[..], &["--scale", "1"]].concat());
    assert_eq!(num_points(&exr), num_points(&colmap));

    // Without a scale the unit is unknown, and said to be; wider spacing leaves fewer points, and a format that is not
    // asked for leaves none of the earlier surface.
    let more = ["--spacing", "0.004", "--formats", "glb"];
    let (code, _, stderr) = run(&[&arguments[..], &more].concat());
    assert!(colmap.join("mesh.glb").exists() && !colmap.join("mesh.obj").exists());
    assert!(!colmap.join("asset.glb").exists() && !colmap.join("asset/normal.png").exists());
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("--scale"), "{stderr}");
    assert!(num_points(&colmap) * 4 < num_points(&exr));
    assert!(!stderr.contains("a spacing of"), "{stderr}");
    let ply = std::fs::read(colmap.join("cloud.ply")).unwrap();
    let header = String::from_utf8_lossy(&ply[..200]).into_owned();
    assert!(header.contains("comment unit arbitrary"), "{header}");
}

#[test]
fn what_cannot_be_fused_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let maps = dir.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    let out = dir.path().join("out");
    let refused = |more: &[&str], code: i32, reason: &str| {
        let arguments = [&["fuse", arg(&maps), "-o", arg(&out)][..], more].concat();
        let (found, _, stderr) = run(&arguments);
        assert_eq!(found, code, "{stderr}");
        assert!(stderr.contains(reason), "{stderr}");
        assert!(!out.join("cloud.ply").exists());
    };
    refused(&[], 3, "holds no maps");
    let cameras = exr_maps(&maps);
    refused(&[], 3, "no cameras");

    let file = dir.path().join("cameras.json");
    let with = |change: &dyn Fn(&mut CameraFile)| {
        let mut changed = cameras.clone();
        change(&mut changed);
        write_cameras(&file, &changed).expect("a file");
    };
    let given = ["--cameras", arg(&file)];
    with(&|_| ());
    refused(&[&given[..], &["--scale=-1"]].concat(), 2, "positive");
    with(&|c| c.cameras[1].intrinsics.width += 2);
    refused(&given, 3, "IMG_0002_depth.exr");
    with(&|c| c.cameras.iter_mut().for_each(|c| c.cam_from_world = None));
    refused(&given, 3, "none of its maps has a camera with a pose");
    // Cameras in millimetres, maps in metres.
    with(&|c| {
        for pose in c
            .cameras
            .iter_mut()
            .filter_map(|c| c.cam_from_world.as_mut())
        {
            pose.translation *= 1000.0;
        }
    });
    refused(&given, 4, "in one unit");

    // Normals in the world's frame.
    with(&|c| c.unit = Unit::Metre);
    for camera in &cameras.cameras {
        let name = camera.image.as_deref().unwrap_or_default();
        let path = maps.join(format!("{}_normal.exr", name.split('.').next().unwrap()));
        let normal = read_normal(&path).unwrap();
        let rotation = camera.cam_from_world.unwrap().rotation.inverse();
        let turned = NormalMap::from_fn(normal.width, normal.height, |x, y| {
            let n = nalgebra::Vector3::from(normal.at(x, y).map(f64::from));
            (rotation * n).map(|c| c as f32).into()
        });
        write_normal(&path, &turned).unwrap();
    }
    refused(&given, 3, "contradict");
    // Without normal maps the depths' slopes stand in; without depths there is nothing.
    for name in names(&cameras) {
        std::fs::remove_file(maps.join(format!("{name}_normal.exr"))).unwrap();
    }
    for name in names(&cameras) {
        let path = maps.join(format!("{name}_depth.exr"));
        let mut depth = read_depth(&path).unwrap();
        depth.data.fill(f32::NAN);
        write_depth(&path, &depth).unwrap();
    }
    refused(&given, 4, "none of the 4 views has a depth map with values");
}

#[test]
fn one_view_is_fused_with_a_warning_and_views_apart_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let maps = dir.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    let cameras = exr_maps(&maps);
    let file = dir.path().join("cameras.json");
    let fuse = |changed: &CameraFile, out: &str| {
        write_cameras(&file, changed).expect("a file");
        let out = dir.path().join(out);
        let (code, _, stderr) = run(&[
            "fuse",
            arg(&maps),
            "--cameras",
            arg(&file),
            "-o",
            arg(&out),
            "--spacing",
            "0.002",
        ]);
        (code, stderr, out)
    };
    let mut alone = cameras.clone();
    alone.cameras.truncate(1);
    let (code, stderr, out) = fuse(&alone, "alone");
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("only 1 view"), "{stderr}");
    assert!(num_points(&out) > 1000);

    // Every camera looks at a copy of the object a metre farther to the side.
    let mut apart = cameras.clone();
    for (i, camera) in apart.cameras.iter_mut().enumerate() {
        let pose = camera.cam_from_world.as_mut().expect("a pose");
        let aside = pose.rotation * nalgebra::Vector3::x() * (i + 1) as f64;
        pose.translation += aside;
    }
    let (code, stderr, out) = fuse(&apart, "apart");
    assert_eq!(code, 4, "{stderr}");
    assert!(stderr.contains("do not overlap"), "{stderr}");
    assert!(!out.join("cloud.ply").exists());
}

#[test]
fn a_damaged_dmap_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let maps = dir.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    let out = dir.path().join("out");
    // The magic of OpenMVS, and sizes that the file does not hold.
    let damaged = [b"DR".as_slice(), &[0xFF; 64]].concat();
    for bytes in [&b"Dear reader"[..], &damaged] {
        std::fs::write(maps.join("depth0000.dmap"), bytes).unwrap();
        let (code, _, stderr) = run(&["fuse", arg(&maps), "-o", arg(&out)]);
        assert_eq!(code, 3, "{stderr}");
        assert!(stderr.contains("depth0000.dmap"), "{stderr}");
        assert!(!out.join("cloud.ply").exists());
    }
}
