//! Cameras of other programs, in and out, as scripts call it: what is in the way, what is missing, what
//! comes back.

use crate::common;

use common::{
    arg, done, noise_photos, reconstruct_arguments, reconstructed_until, run, synthetic_set,
};
use nalgebra::Point2;
use rilievo_io::{
    CameraEntry, CameraFile, decode_photo, read_cameras, read_mask, write_cameras, write_mask,
    write_photo_jpeg,
};
use rilievo_scene::{
    Distortion, Intrinsics, LinearImage, Mask, RigidTransform, Samples, Unit, srgb,
};
use std::path::{Path, PathBuf};

/// Cameras of the noise photos.
fn write_plain_cameras(path: &Path, names: &[&str]) {
    let entry = |name: &&str| CameraEntry {
        image: Some((*name).to_owned()),
        intrinsics: Intrinsics::pinhole(160, 120, 200.0, 79.5, 59.5),
        cam_from_world: Some(RigidTransform::identity()),
    };
    let cameras = CameraFile {
        unit: Unit::Metre,
        cameras: names.iter().map(entry).collect(),
        ..CameraFile::default()
    };
    write_cameras(path, &cameras).expect("a file");
}

fn export(source: &Path, format: &str, output: &Path, more: &[&str]) -> (i32, String, String) {
    let command = ["export", arg(source), "--format", format, "-o", arg(output)];
    run(&[&command[..], more].concat())
}

/// Every file below a folder, with its content.
fn files_in(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            files.extend(files_in(&path));
        } else {
            let content = std::fs::read(&path).expect("a file");
            files.push((path, content));
        }
    }
    files.sort();
    files
}

#[test]
fn what_is_there_is_replaced_only_when_asked_and_whole() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("cameras.json");
    write_plain_cameras(&source, &["p0.jpg", "p1.jpg"]);
    let out = dir.path().join("out");
    for (format, name, beside) in [
        ("npz", "cameras.npz", "cameras.names.txt"),
        ("colmap", "sparse", "sparse/points3D.txt"),
    ] {
        std::fs::create_dir_all(&out).unwrap();
        let output = out.join(name);
        let beside = out.join(beside);
        std::fs::create_dir_all(beside.parent().unwrap()).unwrap();
        std::fs::write(&beside, "a letter").unwrap();
        let before = files_in(&out);
        let (code, _, stderr) = export(&source, format, &output, &[]);
        assert_eq!(code, 2, "{format}: {stderr}");
        assert!(
            stderr.contains(arg(&beside)) && stderr.contains("--overwrite"),
            "{format}: {stderr}"
        );
        assert_eq!(files_in(&out), before, "{format}");
        let (code, _, stderr) = export(&source, format, &output, &["--overwrite"]);
        assert_eq!(code, 0, "{format}: {stderr}");
        assert_ne!(std::fs::read(&beside).unwrap(), b"a letter", "{format}");
        let written = files_in(&out);
        // A script that is run once more.
        let (code, _, stderr) = export(&source, format, &output, &[]);
        assert_eq!(code, 0, "{format}: {stderr}");
        assert_eq!(files_in(&out), written, "{format}");
        std::fs::remove_dir_all(&out).unwrap();
    }
    let target = dir.path().join("imported.json");
    std::fs::write(&target, "{}").unwrap();
    let import = ["import", arg(&source), "-o", arg(&target)];
    let (code, _, stderr) = run(&import);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("imported.json"), "{stderr}");
    done(&[&import[..], &["--overwrite"]].concat());
    assert_eq!(read_cameras(&target).unwrap().cameras.len(), 2);
}

#[test]
fn sizes_come_from_photos_in_a_folder_of_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let source = dir.path().join("cameras.json");
    write_plain_cameras(&source, &["p0.jpg", "p1.jpg"]);
    for (format, name) in [("middlebury", "x_par.txt"), ("npz", "cameras.npz")] {
        let out = dir.path().join(format);
        let output = out.join(name);
        let (code, _, stderr) = export(&source, format, &output, &[]);
        assert_eq!(code, 0, "{format}: {stderr}");
        let back = out.join("back.json");
        let import = ["import", arg(&output), "--format", format, "-o", arg(&back)];
        let (code, _, stderr) = run(&import);
        assert_eq!(code, 3, "{format}: {stderr}");
        assert!(
            stderr.contains("its size in pixels is needed") && stderr.contains("--photos DIR"),
            "{format}: {stderr}"
        );
        let (code, _, stderr) = run(&[&import[..], &["--photos", arg(&photos)]].concat());
        assert_eq!(code, 0, "{format}: {stderr}");
        let back = read_cameras(&back).unwrap();
        let names: Vec<_> = back.cameras.iter().map(|c| c.image.as_deref()).collect();
        assert_eq!(names, [Some("p0.jpg"), Some("p1.jpg")], "{format}");
        let size = (
            back.cameras[1].intrinsics.width,
            back.cameras[1].intrinsics.height,
        );
        assert_eq!(size, (160, 120), "{format}");
    }
}

#[test]
fn names_that_a_format_cannot_hold_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("cameras.json");
    write_plain_cameras(&source, &["p0.jpg", "line\nbreak.jpg"]);
    for format in ["colmap", "middlebury", "npz"] {
        let output = dir.path().join("out").join(format);
        let (code, _, stderr) = export(&source, format, &output, &[]);
        assert_eq!(code, 3, "{format}: {stderr}");
        assert!(stderr.contains("line\\nbreak.jpg"), "{format}: {stderr}");
        assert!(!dir.path().join("out").exists(), "{format}");
    }
    for format in [
        "colmap-binary",
        "metashape",
        "transforms",
        "sfmdata",
        "openmvs",
    ] {
        let output = dir.path().join(format);
        let (code, _, stderr) = export(&source, format, &output, &[]);
        assert_eq!(code, 0, "{format}: {stderr}");
    }
}

#[test]
fn a_run_gives_its_points_and_keeps_its_own_files() {
    let dir = tempfile::tempdir().unwrap();
    let run_dir = dir.path().join("run");
    let mut arguments = reconstruct_arguments(&synthetic_set(), &run_dir);
    arguments.extend(["--until".to_owned(), "3_poses".to_owned()]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    done(&arguments);
    let (text, binary) = (dir.path().join("text"), dir.path().join("binary"));
    for (format, output) in [("colmap", &text), ("colmap-binary", &binary)] {
        let (code, stdout, stderr) = export(&run_dir, format, output, &[]);
        assert_eq!(code, 0, "{stderr}");
        assert!(stdout.contains("points"), "{stdout}");
    }
    let sparse = run_dir.join("3_poses/sparse");
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        let of = |folder: &Path| std::fs::read(folder.join(name)).expect("a file");
        assert!(of(&text) == of(&sparse), "{name}");
    }
    let model = rilievo_io::colmap::read_model(&binary).unwrap();
    assert_eq!(model, rilievo_io::colmap::read_model(&text).unwrap());
    assert!(model.points.len() > 50 && model.points.iter().all(|p| p.track.len() > 1));

    let before = files_in(&run_dir);
    for (format, name) in [
        ("cameras", "run.json"),
        ("cameras", "3_poses/cameras.json"),
        ("colmap", "3_poses/sparse"),
    ] {
        let (code, _, stderr) = export(&run_dir, format, &run_dir.join(name), &["--overwrite"]);
        assert!(
            code == 2 || (format, code) == ("lp", 6),
            "{format}: {stderr}"
        );
    }
    assert!(files_in(&run_dir) == before);
}

/// Without a reader's care, whoever opens one waits until somebody writes to it.
#[cfg(unix)]
#[test]
fn pipes_and_devices_are_refused_and_never_waited_for() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    let good = dir.path().join("good.json");
    write_plain_cameras(&good, &["p0.jpg"]);
    let pipe = |name: &str| {
        let path = dir.path().join(name);
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.is_ok_and(|status| status.success()));
        path
    };
    let image = photos.join("p0.jpg");
    let out = dir.path().join("out");
    let mut cases: Vec<(PathBuf, Vec<String>)> = Vec::new();
    let mut add = |file: PathBuf, arguments: &[&str]| {
        cases.push((file, arguments.iter().map(|&a| a.to_owned()).collect()));
    };
    for (name, format) in [
        ("c.json", "cameras"),
        ("t.json", "transforms"),
        ("c.sfm", "sfmdata"),
        ("c.mvs", "openmvs"),
        ("c.npz", "npz"),
        ("c.xml", "metashape"),
        ("c_par.txt", "middlebury"),
    ] {
        let file = pipe(name);
        add(
            file.clone(),
            &["import", arg(&file), "--format", format, "-o", arg(&out)],
        );
    }
    let scene = pipe("scene.json");
    add(scene.clone(), &["shade", arg(&scene), "-o", arg(&out)]);
    let picture = pipe("picture.jpg");
    let shade = [
        "shade",
        "--image",
        arg(&picture),
        "--camera",
        arg(&good),
        "-o",
        arg(&out),
    ];
    add(picture.clone(), &shade);
    let mask = pipe("mask.png");
    let shade = [
        "shade",
        "--image",
        arg(&image),
        "--camera",
        arg(&good),
        "--mask",
        arg(&mask),
    ];
    add(
        mask.clone(),
        &[&shade[..], &["--init", "plane", "-o", arg(&out)]].concat(),
    );
    let zero = dir.path().join("zero.json");
    std::os::unix::fs::symlink("/dev/zero", &zero).unwrap();
    add(
        zero.clone(),
        &["check", arg(&photos), "--cameras", arg(&zero)],
    );
    for (file, arguments) in cases {
        // Its own exit code, 124, tells that it did not end.
        let output = std::process::Command::new("timeout")
            .args(["20", env!("CARGO_BIN_EXE_rilievo")])
            .args(&arguments)
            .output()
            .expect("it ends");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {stderr}");
        let told = stderr.contains(arg(&file)) && stderr.contains("not");
        assert!(
            told && stderr.contains(" a file"),
            "{arguments:?}: {stderr}"
        );
    }
}

/// Bends a photo of a pinhole and its mask as another lens shows them.
fn bend(photo: &Path, mask: &Path, from: &Intrinsics, to: &Intrinsics) -> (LinearImage, Mask) {
    let decoded = decode_photo(photo).unwrap();
    let Samples::U8(bytes) = decoded.samples else {
        panic!("not of 8 bits");
    };
    let linear = bytes
        .iter()
        .map(|&byte| srgb::decode(f64::from(byte) / 255.0) as f32);
    let straight = LinearImage {
        width: decoded.width,
        height: decoded.height,
        channels: 3,
        data: linear.collect(),
    };
    let mask = read_mask(mask).unwrap();
    let mut bent = LinearImage::filled(to.width, to.height, 3, 0.2);
    let mut bent_mask = Mask::filled(to.width, to.height, false);
    for (y, x) in (0..to.height).flat_map(|y| (0..to.width).map(move |x| (y, x))) {
        let ray = to.normalized(&Point2::new(x as f64, y as f64));
        let (u, v) = (from.fx * ray.x + from.cx, from.fy * ray.y + from.cy);
        *bent_mask.at_mut(x, y) = mask.contains(u.round() as isize, v.round() as isize);
        for c in 0..3 {
            if let Some(value) = straight.sample(u, v, c) {
                bent.pixel_mut(x, y)[c] = value;
            }
        }
    }
    (bent, bent_mask)
}

#[test]
fn photos_of_a_fisheye_are_posed_by_its_colmap_camera() {
    let set = synthetic_set();
    let dir = tempfile::tempdir().unwrap();
    let [photos, masks] = ["photos", "masks"].map(|name| dir.path().join(name));
    std::fs::create_dir(&photos).unwrap();
    std::fs::create_dir(&masks).unwrap();
    let mut cameras = read_cameras(&set.join("truth/cameras.json")).unwrap();
    for entry in &mut cameras.cameras {
        let straight = entry.intrinsics;
        entry.intrinsics.fx *= 0.9;
        entry.intrinsics.fy *= 0.9;
        entry.intrinsics.distortion = Distortion {
            k1: -0.5,
            k2: 0.1,
            fisheye: true,
            ..Distortion::default()
        };
        let name = entry.image.clone().unwrap();
        let mask = format!("masks/{}.png", name.trim_end_matches(".jpg"));
        let photo = set.join("photos").join(&name);
        let (bent, bent_mask) = bend(&photo, &set.join(&mask), &straight, &entry.intrinsics);
        write_photo_jpeg(&photos.join(&name), &bent, 97).unwrap();
        write_mask(&dir.path().join(&mask), &bent_mask).unwrap();
    }
    // By COLMAP's file and back: its intrinsics alone.
    let posed = dir.path().join("posed.json");
    write_cameras(&posed, &cameras).unwrap();
    let model = dir.path().join("sparse");
    let (code, _, stderr) = export(&posed, "colmap", &model, &[]);
    assert_eq!(code, 0, "{stderr}");
    let text = std::fs::read_to_string(model.join("cameras.txt")).unwrap();
    assert!(text.contains(" OPENCV_FISHEYE 480 360 "), "{text}");
    let mut known = read_cameras(&model).unwrap();
    known
        .cameras
        .iter_mut()
        .for_each(|entry| entry.cam_from_world = None);
    let intrinsics = dir.path().join("intrinsics.json");
    write_cameras(&intrinsics, &known).unwrap();
    let run_dir = dir.path().join("run");
    let more = ["--masks", arg(&masks), "--cameras", arg(&intrinsics)];
    reconstructed_until("3_poses", &photos, &run_dir, &more);
    let truth = set.join("truth");
    let evaluated = done(&["evaluate", arg(&run_dir), "--truth", arg(&truth), "--json"]);
    let found: serde_json::Value = serde_json::from_str(evaluated.trim()).unwrap();
    // As photos of the pinhole: at 640 x 480 7e-5 and .05 degrees; without the lens 1.9e-3 and .5.
    let poses = &found["poses"];
    assert_eq!(poses["num_missing"], 0, "{poses}");
    let center = poses["center_error_max"].as_f64().unwrap();
    assert!(center < 4e-4, "{poses}");
    // What is written is the lens as given.
    let written = read_cameras(&run_dir.join("3_poses/sparse")).unwrap();
    for (written, given) in written.cameras.iter().zip(&known.cameras) {
        assert_eq!(written.intrinsics, given.intrinsics);
    }
}
