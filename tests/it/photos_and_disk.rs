//! One photo in every format, exposures that EXIF tells, photos that change under the program, and
//! disks that are too small.

use crate::common;
use rilievo_synthetic::testing::not_tested;

use common::{
    SmallDisk, arg, differences, json_of, noise_photos, reconstruct_until, reconstructed_until,
    rilievo, run, synthetic_set, with_exposure, write_noise_photo,
};
use rilievo_io::{read_linear, write_linear, write_photo_deep, write_photo_jpeg};
use rilievo_scene::LinearImage;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

/// A smooth picture, as shading is.
fn picture(width: usize, height: usize) -> LinearImage {
    let mut image = LinearImage::filled(width, height, 3, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        let (x, y) = ((i / 3 % width) as f32, (i / 3 / width) as f32);
        let wave = (x / 23.0).sin() * (y / 17.0).cos();
        *value = 0.4 + 0.25 * wave + 0.05 * (i % 3) as f32;
    }
    image
}

fn linear(run_dir: &Path, name: &str) -> LinearImage {
    read_linear(&run_dir.join(format!("1_photos/linear/{name}.exr"))).expect("a result")
}

#[test]
fn one_photo_in_every_format_is_the_same_light() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    let image = picture(160, 120);
    write_photo_deep(&photos.join("tiff.tif"), &image).unwrap();
    write_photo_deep(&photos.join("png.png"), &image).unwrap();
    write_linear(&photos.join("exr.exr"), &image).unwrap();
    write_photo_jpeg(&photos.join("jpeg.jpg"), &image, 95).unwrap();
    let run_dir = dir.path().join("run");
    reconstructed_until("1_photos", &photos, &run_dir, &[]);
    // Half a step of 16 bits, of the half floats that results are kept in, and of sRGB in 8 bits with
    // JPEG's own rounding.
    for (name, tolerance) in [("tiff", 6e-4), ("png", 6e-4), ("exr", 6e-4), ("jpeg", 0.02)] {
        let found = linear(&run_dir, name);
        let pairs = found.data.iter().zip(&image.data);
        let worst = pairs.fold(0.0_f32, |worst, (a, b)| worst.max((a - b).abs()));
        assert!(worst < tolerance, "{name}: {worst}");
    }
}

#[test]
fn exposures_are_evened_out_by_exif() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    for (name, gain, time) in [
        ("a", 1.0, [1, 50]),
        ("b", 0.5, [1, 100]),
        ("c", 1.0, [1, 50]),
    ] {
        let mut image = picture(160, 120);
        image.data.iter_mut().for_each(|value| *value *= gain);
        let path = photos.join(format!("{name}.jpg"));
        write_photo_jpeg(&path, &image, 95).unwrap();
        let jpeg = std::fs::read(&path).unwrap();
        std::fs::write(&path, with_exposure(&jpeg, time)).unwrap();
    }
    let run_dir = dir.path().join("run");
    reconstructed_until("1_photos", &photos, &run_dir, &[]);
    let manifest = json_of(&run_dir.join("1_photos/manifest.json"));
    assert_eq!(
        manifest["report"]["exposure_gains"],
        serde_json::json!([1.0, 2.0, 1.0])
    );
    let (code, _, stderr) = run(&["check", arg(&photos)]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("evened out by EXIF"), "{stderr}");
}

#[test]
fn a_photo_replaced_while_the_program_runs_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    // Large photos come first and take their time.
    for index in 0..3 {
        let path = photos.join(format!("a{index}.jpg"));
        write_photo_jpeg(&path, &picture(2400, 1800), 90).unwrap();
    }
    let last = photos.join("z.jpg");
    write_noise_photo(&last, 7);
    let run_dir = dir.path().join("run");
    let arguments = ["reconstruct", arg(&photos), "-o", arg(&run_dir)];
    let work = [
        "--until",
        "1_photos",
        "--threads",
        "1",
        "--memory",
        "1M",
        "--json",
    ];
    let mut child = Command::new(env!("CARGO_BIN_EXE_rilievo"))
        .args(arguments)
        .args(work)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    let started = lines.find(|line| line.as_ref().is_ok_and(|l| l.contains("stage_started")));
    assert!(started.is_some());
    write_noise_photo(&last, 8);
    for line in lines {
        line.expect("text");
    }
    let output = child.wait_with_output().expect("the program ends");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{stderr}");
    assert!(
        stderr.contains("z.jpg") && stderr.contains("was replaced"),
        "{stderr}"
    );
    // The same command takes the photo as it is now.
    reconstructed_until("1_photos", &photos, &run_dir, &[]);
    assert!(run_dir.join("1_photos/linear/z.exr").exists());
}

#[test]
fn a_full_disk_ends_the_run_and_loses_nothing() {
    let Some(disk) = SmallDisk::new(512) else {
        not_tested("the right to mount a file system");
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 8);
    let run_dir = disk.path.join("run");
    let (code, _, stderr) = reconstruct_until("1_photos", &photos, &run_dir, &[]);
    assert_eq!(code, 6, "{stderr}");
    assert!(stderr.to_lowercase().contains("no space left"), "{stderr}");
    // With room the same command goes on to what an undisturbed run gives.
    disk.grow(64 << 10);
    reconstructed_until("1_photos", &photos, &run_dir, &[]);
    let undisturbed = dir.path().join("undisturbed");
    reconstructed_until("1_photos", &photos, &undisturbed, &[]);
    assert_eq!(differences(&run_dir, &undisturbed), Vec::<String>::new());
}

#[test]
fn a_full_disk_keeps_an_earlier_surface() {
    let Some(disk) = SmallDisk::new(64 << 10) else {
        not_tested("the right to mount a file system");
        return;
    };
    let truth = synthetic_set().join("truth");
    let out = disk.path.join("out");
    let fuse = |more: &[&str]| {
        let output = rilievo()
            .args(["fuse", arg(&truth), "-o", arg(&out)])
            .args(more)
            .output()
            .expect("the program starts");
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), stderr)
    };
    let (code, stderr) = fuse(&["--spacing", "0.004"]);
    assert_eq!(code, Some(0), "{stderr}");
    let files = [
        "cloud.ply",
        "mesh.ply",
        "asset.glb",
        "asset/asset.obj",
        "asset/asset.mtl",
        "asset/base_color.png",
        "asset/base_color.exr",
        "asset/normal.png",
        "asset/occlusion.png",
        "report.json",
    ];
    let read = || files.map(|file| std::fs::read(out.join(file)).expect("a file"));
    let before = read();
    // What is left is less than the next surface takes.
    std::fs::write(disk.path.join("others"), vec![1; 1 << 20]).unwrap();
    let used: usize = before.iter().map(Vec::len).sum();
    disk.grow((used / 1024 + 1024 + 200) as u32);
    let (code, stderr) = fuse(&[]);
    assert_eq!(code, Some(6), "{stderr}");
    assert!(stderr.to_lowercase().contains("no space left"), "{stderr}");
    assert!(read() == before, "the earlier files have changed");
}
