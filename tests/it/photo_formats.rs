//! One scene in every format of photos: the same light, and the same shape read from it.

use crate::common;

use common::{arg, done, json_of, noise_photos, reconstructed_until, run};
use rilievo_io::{
    read_linear, read_mask, read_normal, write_linear, write_photo_deep, write_photo_dng,
    write_photo_jpeg,
};
use rilievo_scene::{ExifFacts, LinearImage, Mask, NormalMap};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A rendered view and its truth.
struct View {
    dir: tempfile::TempDir,
    image: LinearImage,
    mask: Mask,
}

impl View {
    fn new() -> Self {
        let dir = tempfile::tempdir().expect("a folder");
        let set = dir.path().join("set");
        let synth = ["synth", arg(&set), "--views", "2", "--size", "320x240"];
        done(&[&synth[..], &["--format", "exr"]].concat());
        let mut camera = json_of(&set.join("truth/cameras.json"))["cameras"][0].clone();
        camera.as_object_mut().expect("a camera").remove("image");
        std::fs::write(dir.path().join("camera.json"), camera.to_string()).expect("a file");
        let mut image = read_linear(&set.join("photos/IMG_0001.exr")).expect("a photo");
        // No file of integers holds what is brighter than white.
        image
            .data
            .iter_mut()
            .for_each(|value| *value = value.clamp(0.0, 1.0));
        let mask = read_mask(&set.join("masks/IMG_0001.png")).expect("a mask");
        Self { dir, image, mask }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.dir.path().join(file)
    }

    /// The photo in every format: file name, and the bounds that the format's steps set to the RMS error of
    /// the object's linear values and to the mean change of normals, degrees.
    fn in_all_formats(&self) -> Vec<(&'static str, f64, f64)> {
        let image = &self.image;
        let deep = |name: &str| write_photo_deep(&self.path(name), image);
        write_linear(&self.path("exr.exr"), image).expect("a file");
        deep("tiff.tif").expect("a file");
        deep("png.png").expect("a file");
        write_photo_jpeg(&self.path("jpeg.jpg"), image, 95).expect("a file");
        // A step of q leaves q / √12; JPEG halves the resolution of colours, besides rounding them.
        let step = 1.0 / 65_535.0 / 12.0_f64.sqrt();
        let formats = vec![
            ("exr.exr", 0.0, 0.0),
            ("tiff.tif", 1.05 * step, 0.02),
            ("png.png", 1.05 * step, 0.02),
            ("jpeg.jpg", 0.012, 1.6),
        ];
        if !cfg!(feature = "raw") {
            return formats;
        }
        // Two of three colours are interpolated from pixels beside, which hold noise and the mat's print.
        let exif = ExifFacts::default();
        write_photo_dng(&self.path("raw.dng"), image, [1.0; 3], &exif).expect("a file");
        [formats, vec![("raw.dng", 0.02, 1.6)]].concat()
    }

    /// Normals from the photo's shading alone.
    fn normals(&self, photo: &str) -> NormalMap {
        let output = self.path(&format!("{photo}-shaded"));
        let set = self.path("set");
        let lighting = format!("{}:IMG_0001", arg(&set.join("truth/lighting.json")));
        let (image, camera) = (self.path(photo), self.path("camera.json"));
        let mask = set.join("masks/IMG_0001.png");
        let init = set.join("truth/IMG_0001_depth.exr");
        done(&[
            "shade",
            "--image",
            arg(&image),
            "--mask",
            arg(&mask),
            "--camera",
            arg(&camera),
            "--lighting",
            &lighting,
            "--init",
            arg(&init),
            "-o",
            arg(&output),
        ]);
        let name = photo.split('.').next().unwrap_or_default();
        read_normal(&output.join(format!("normal/{name}.exr"))).expect("normals")
    }
}

/// Mean angle, degrees, between normals that both maps have.
fn mean_angle(a: &NormalMap, b: &NormalMap) -> f64 {
    let angles: Vec<f64> = a
        .data
        .iter()
        .zip(&b.data)
        .filter(|(a, b)| a[2] != 0.0 && b[2] != 0.0)
        .map(|(a, b)| {
            let dot = |a: &[f32; 3], b: &[f32; 3]| -> f64 {
                a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum()
            };
            (dot(a, b) / (dot(a, a) * dot(b, b)).sqrt())
                .clamp(-1.0, 1.0)
                .acos()
                .to_degrees()
        })
        .collect();
    assert!(angles.len() > 5_000, "{} normals", angles.len());
    angles.iter().sum::<f64>() / angles.len() as f64
}

#[test]
fn one_scene_in_every_format_is_the_same_light_and_the_same_shape() {
    let view = View::new();
    let mut reference = None;
    for (photo, tolerance, allowed) in view.in_all_formats() {
        let decoded = rilievo_io::decode_photo(&view.path(photo)).expect("a photo");
        let options = rilievo_photos::Encoding::Auto;
        let (linear, _) = rilievo_photos::linearize(&decoded, options);
        let on_object = |i: usize| view.mask.data[i / 3];
        let pairs = linear.data.iter().zip(&view.image.data).enumerate();
        let square: f64 = pairs
            .filter(|(i, _)| on_object(*i))
            .map(|(_, (a, b))| f64::from(a - b).powi(2))
            .sum();
        let rms = (square / (3 * view.mask.count()) as f64).sqrt();
        let normals = view.normals(photo);
        let angle = reference
            .as_ref()
            .map_or(0.0, |exact| mean_angle(exact, &normals));
        eprintln!("{photo}: light differs by {rms:.2e} RMS, normals by {angle:.4} deg");
        assert!(rms <= tolerance, "{photo}: {rms} > {tolerance}");
        assert!(angle <= allowed, "{photo}: {angle} deg > {allowed}");
        reference.get_or_insert(normals);
    }
}

/// A picture of shading alone, which interpolation loses nothing of.
#[cfg(feature = "raw")]
fn smooth(width: usize, height: usize) -> LinearImage {
    let mut image = LinearImage::filled(width, height, 3, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        let (x, y) = ((i / 3 % width) as f32, (i / 3 / width) as f32);
        *value = [0.5, 1.0, 0.7][i % 3] * (0.5 + 0.3 * (x / 37.0).sin() * (y / 29.0).cos());
    }
    image
}

#[cfg(feature = "raw")]
#[test]
fn raw_photos_are_checked_and_become_linear_with_their_exif() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    let mut image = smooth(160, 120);
    for pixel in image.data[..30].iter_mut() {
        *pixel = 2.0;
    }
    let exif = ExifFacts {
        focal_mm: Some(50.0),
        focal_35mm: Some(50.0),
        orientation: Some(8),
        exposure_time_s: Some(0.01),
        f_number: Some(8.0),
        iso: Some(100.0),
        ..ExifFacts::default()
    };
    let neutral = [0.5, 1.0, 0.7];
    write_photo_dng(&photos.join("a.dng"), &image, neutral, &exif).unwrap();
    std::fs::write(photos.join("b.nef"), b"no RAW file of any camera, but text").unwrap();
    let (code, _, stderr) = run(&["check", arg(&photos)]);
    // One file of three cannot be used; the others are told of all the same.
    assert_eq!(code, 3, "{stderr}");
    for part in [
        "a.dng",
        "160 x 120",
        "EXIF 50 mm",
        "b.nef",
        "RAW file cannot be decoded",
    ] {
        assert!(stderr.contains(part), "{part}: {stderr}");
    }
    let run_dir = dir.path().join("run");
    reconstructed_until("1_photos", &photos, &run_dir, &[]);
    let linear = read_linear(&run_dir.join("1_photos/linear/a.exr")).unwrap();
    let worst = worst_inside(&linear, &image);
    assert!(worst < 1e-3, "{worst}");
    let facts = facts_of(&run_dir, "a");
    // 50 mm on 36 mm, in the sensor's own frame.
    let focal = facts["intrinsics"]["fx"].as_f64().unwrap();
    assert!((focal - 160.0 / 36.0 * 50.0).abs() < 1e-9, "{focal}");
    assert_eq!(
        (facts["width"].as_u64(), facts["orientation"].as_u64()),
        (Some(160), Some(8))
    );
    let clipped = facts["clipped_share"].as_f64().unwrap();
    // Ten saturated pixels, and at most two beyond them to each side.
    assert!(
        (10.0..60.0).contains(&(clipped * 160.0 * 120.0)),
        "{clipped}"
    );
}

/// A RAW file whose maker's name claims 2^32 numbers: its library asks for 32 GiB, which ends the process.
#[cfg(feature = "raw")]
fn write_endless_raw(path: &Path) {
    const MAKE: u16 = 271;
    const DOUBLE: u16 = 12;
    let exif = ExifFacts::default();
    write_photo_dng(path, &smooth(32, 24), [1.0; 3], &exif).expect("a file");
    let mut bytes = std::fs::read(path).expect("a file");
    let directory = u32::from_le_bytes(bytes[4..8].try_into().expect("four bytes")) as usize;
    // The second of its entries, of twelve bytes each: tag, type, count, value.
    let entry = directory + 2 + 12;
    bytes[entry..entry + 2].copy_from_slice(&MAKE.to_le_bytes());
    bytes[entry + 2..entry + 4].copy_from_slice(&DOUBLE.to_le_bytes());
    bytes[entry + 4..entry + 8].fill(0xFF);
    std::fs::write(path, bytes).expect("a file");
}

#[cfg(feature = "raw")]
#[test]
fn a_raw_file_that_ends_its_decoder_costs_one_photo() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    write_endless_raw(&photos.join("endless.dng"));
    let exif = ExifFacts::default();
    write_photo_dng(&photos.join("good.dng"), &smooth(64, 48), [1.0; 3], &exif).unwrap();
    let run_dir = dir.path().join("run");
    let stderr = reconstructed_until("1_photos", &photos, &run_dir, &[]);
    let told = |line: &str| line.contains("endless.dng") && line.contains("cannot be decoded");
    assert!(stderr.lines().any(told), "{stderr}");
    for foreign in ["allocation", "panicked", "backtrace"] {
        assert!(!stderr.contains(foreign), "{foreign}: {stderr}");
    }
    for name in ["p0", "good"] {
        assert!(run_dir.join(format!("1_photos/linear/{name}.exr")).exists());
    }
    let (code, _, stderr) = run(&["mask", arg(&photos), "-o", arg(&dir.path().join("masks"))]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("endless.dng"), "{stderr}");
}

/// Children of a process, from the system's table.
#[cfg(all(feature = "raw", target_os = "linux"))]
fn children_of(parent: u32) -> Vec<String> {
    let processes = std::fs::read_dir("/proc").expect("a process table");
    let ids = processes
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned());
    // `id (name) state parent ...`, and the name may hold anything.
    let has_parent = |id: &String| {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        let after_name = stat.rsplit(')').next().unwrap_or_default();
        after_name.split_whitespace().nth(1) == Some(&parent.to_string())
    };
    ids.filter(has_parent).collect()
}

#[cfg(all(feature = "raw", target_os = "linux"))]
#[test]
fn a_photo_whose_decoder_was_killed_is_tried_again() {
    use std::time::{Duration, Instant};
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    let exif = ExifFacts::default();
    let large = smooth(4000, 3000);
    write_photo_dng(&photos.join("large.dng"), &large, [1.0; 3], &exif).unwrap();
    let run_dir = dir.path().join("run");
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_rilievo"));
    command.args(["reconstruct", arg(&photos), "-o", arg(&run_dir)]);
    command.args(["--until", "1_photos"]);
    let program = command
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let child = loop {
        if let Some(child) = children_of(program.id()).pop() {
            break child;
        }
        assert!(began.elapsed() < Duration::from_secs(60), "no child came");
        std::thread::sleep(Duration::from_millis(2));
    };
    let killed = std::process::Command::new("kill")
        .args(["-KILL", &child])
        .status();
    assert!(killed.is_ok_and(|status| status.success()));
    let output = program.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(6), "{stderr}");
    assert!(
        stderr.contains("large.dng") && stderr.contains("SIGKILL"),
        "{stderr}"
    );
    reconstructed_until("1_photos", &photos, &run_dir, &[]);
    assert!(run_dir.join("1_photos/linear/large.exr").exists());
}

/// Largest difference off the rim, and off what is saturated.
#[cfg(feature = "raw")]
fn worst_inside(found: &LinearImage, truth: &LinearImage) -> f32 {
    assert_eq!((found.width, found.height), (truth.width, truth.height));
    let mut worst = 0.0_f32;
    for y in 5..truth.height - 5 {
        for x in 5..truth.width - 5 {
            for (a, b) in found.pixel(x, y).iter().zip(truth.pixel(x, y)) {
                worst = worst.max((a - b).abs());
            }
        }
    }
    worst
}

#[cfg(feature = "raw")]
fn facts_of(run_dir: &Path, name: &str) -> Value {
    let manifest = json_of(&run_dir.join("1_photos/manifest.json"));
    let photos = manifest["report"]["photos"].as_array().expect("photos");
    let found = photos.iter().find(|photo| photo["name"] == name);
    found.expect("the photo").clone()
}
