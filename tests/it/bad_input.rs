//! Every bad input gets its message and its exit code, names the file, and loses nothing.

use crate::common;

use common::{
    arg, done, noise_photos, noise_run, reconstruct_until, run, synthetic_set, write_noise_photo,
};
use rilievo_io::{write_depth, write_linear, write_mask, write_photo_jpeg};
use rilievo_scene::{DepthMap, LinearImage, Mask};
use std::path::Path;

/// Reads photos only: enough for everything that is wrong with files.
fn first_stage(photos: &Path, run_dir: &Path, more: &[&str]) -> (i32, String, String) {
    reconstruct_until("1_photos", photos, run_dir, more)
}

#[test]
fn an_empty_folder_is_input_that_cannot_be_used() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("nothing here");
    std::fs::create_dir(&photos).unwrap();
    let (code, _, stderr) = first_stage(&photos, &dir.path().join("run"), &[]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("nothing here"), "{stderr}");
    let report = std::fs::read_to_string(dir.path().join("run/report.json")).unwrap();
    assert!(report.contains("nothing here"), "{report}");
}

#[test]
fn one_photo_is_told_the_command_for_single_views() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    let (code, _, stderr) = reconstruct_until("3_poses", &photos, &dir.path().join("run"), &[]);
    assert_eq!(code, 4, "{stderr}");
    for part in ["rilievo shade --image", "--camera", "--lighting", "--init"] {
        assert!(stderr.contains(part), "{part} is not told in: {stderr}");
    }
}

#[test]
fn bad_files_among_good_photos_are_named_and_the_good_ones_go_on() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 3);
    std::fs::write(photos.join("zero.jpg"), b"").unwrap();
    std::fs::write(photos.join("letter.jpg"), b"Dear reader,").unwrap();
    std::fs::write(photos.join("notes.txt"), b"shutter 1/50").unwrap();
    let whole = std::fs::read(photos.join("p0.jpg")).unwrap();
    std::fs::write(photos.join("cut.jpg"), &whole[..whole.len() / 2]).unwrap();
    // A sector that a memory card lost.
    let mut damaged = whole.clone();
    let middle = whole.len() / 2;
    damaged[middle..middle + 512].fill(0);
    std::fs::write(photos.join("sector.jpg"), &damaged).unwrap();
    std::fs::write(photos.join("shot.NEF"), b"MM\0*").unwrap();
    // Four components where three were: CMYK.
    let mut cmyk = whole.clone();
    let frame = whole
        .windows(2)
        .position(|pair| pair == [0xFF, 0xC0])
        .unwrap();
    cmyk[frame + 9] = 4;
    std::fs::write(photos.join("press.jpg"), &cmyk).unwrap();
    write_linear(&photos.join("dot.exr"), &LinearImage::filled(1, 1, 3, 0.5)).unwrap();
    // A header that claims more pixels than any camera has.
    std::fs::write(photos.join("huge.png"), png_header(65_500, 65_500)).unwrap();

    let run_dir = dir.path().join("run");
    let (code, _, stderr) = first_stage(&photos, &run_dir, &[]);
    assert_eq!(code, 0, "{stderr}");
    for (name, reason) in [
        ("zero.jpg", "0 bytes"),
        ("letter.jpg", "not a JPEG"),
        ("cut.jpg", "cut off"),
        ("sector.jpg", "damaged"),
        ("shot.NEF", "linear 16-bit TIFF"),
        ("press.jpg", "CMYK"),
        ("dot.exr", "1 x 1"),
        ("huge.png", "65500"),
        ("notes.txt", "no photo"),
    ] {
        let told = stderr
            .lines()
            .any(|line| line.contains(name) && line.contains(reason));
        assert!(told, "{name}: {reason} is not told in: {stderr}");
    }
    for name in ["p0", "p1", "p2"] {
        assert!(run_dir.join(format!("1_photos/linear/{name}.exr")).exists());
    }
    let report = std::fs::read_to_string(run_dir.join("report.json")).unwrap();
    assert!(
        report.contains("cut.jpg"),
        "the report lists rejected photos"
    );
}

/// The first bytes of a PNG of 8-bit colours.
fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    bytes.extend(width.to_be_bytes());
    bytes.extend(height.to_be_bytes());
    bytes.extend([8, 2, 0, 0, 0]);
    // CRC-32 of the chunk (ISO 3309, as PNG asks).
    let mut crc = u32::MAX;
    for &byte in &bytes[12..] {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 {
                0xEDB8_8320 ^ (crc >> 1)
            } else {
                crc >> 1
            };
        }
    }
    bytes.extend((!crc).to_be_bytes());
    bytes.extend(b"\0\0\0\x10IDAT0123456789abcdef\0\0\0\0");
    bytes
}

#[test]
fn only_bad_files_is_input_that_cannot_be_used() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("zero.jpg"), b"").unwrap();
    let (code, _, stderr) = first_stage(dir.path(), &dir.path().join("run"), &[]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("zero.jpg"), "{stderr}");
}

#[test]
fn masks_that_do_not_fit_are_refused_never_ignored() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let good = Mask::from_fn(160, 120, |x, y| {
        (40..120).contains(&x) && (30..90).contains(&y)
    });
    let cases: [(&str, Option<Mask>); 5] = [
        ("missing", None),
        ("other-size", Some(Mask::filled(80, 60, true))),
        ("black", Some(Mask::filled(160, 120, false))),
        ("white", Some(Mask::filled(160, 120, true))),
        (
            "inverted",
            Some(Mask::from_fn(160, 120, |x, y| {
                !good.contains(x as isize, y as isize)
            })),
        ),
    ];
    for (name, mask) in cases {
        let masks = dir.path().join(name);
        std::fs::create_dir(&masks).unwrap();
        write_mask(&masks.join("p0.png"), &good).unwrap();
        if let Some(mask) = &mask {
            write_mask(&masks.join("p1.png"), mask).unwrap();
        }
        let run_dir = dir.path().join(format!("run-{name}"));
        let (code, _, stderr) = first_stage(&photos, &run_dir, &["--masks", arg(&masks)]);
        assert_eq!(code, 3, "{name}: {stderr}");
        assert!(stderr.contains("p1"), "{name}: {stderr}");
        assert!(!run_dir.join("1_photos").exists(), "{name} left a result");
    }
}

#[test]
fn photos_and_noise_given_as_masks_are_refused_and_masks_of_other_photos_told() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    // The folder of photos itself, by mistake.
    let (run_dir, masks) = (dir.path().join("run"), arg(&photos));
    let (code, _, stderr) = first_stage(&photos, &run_dir, &["--masks", masks]);
    assert_eq!(code, 3, "{stderr}");
    for part in ["p0.jpg", "p1.jpg", "is no mask", "white on the object"] {
        assert!(stderr.contains(part), "{part} is not told in: {stderr}");
    }

    let masks = dir.path().join("masks");
    std::fs::create_dir(&masks).unwrap();
    let object = |left: usize| {
        Mask::from_fn(160, 120, |x, y| {
            (left..left + 60).contains(&x) && (30..90).contains(&y)
        })
    };
    write_mask(&masks.join("p0.png"), &object(20)).unwrap();
    let mut state = 1u32;
    let noise = Mask::from_fn(160, 120, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 31 == 1
    });
    write_mask(&masks.join("p1.png"), &noise).unwrap();
    let (code, _, stderr) = first_stage(&photos, &run_dir, &["--masks", arg(&masks)]);
    assert_eq!(code, 3, "{stderr}");
    assert!(
        stderr.contains("p1.png") && stderr.contains("noise"),
        "{stderr}"
    );
    assert!(!stderr.contains("p0.png"), "{stderr}");
    assert!(!run_dir.join("1_photos").exists(), "left a result");

    // A bright object before a darker wall, and the mask of where it stood in another photo.
    let mut image = LinearImage::filled(160, 120, 3, 0.2);
    for y in 0..120 {
        for x in 0..160 {
            let wall = 0.02 * ((x * 7 + y * 13) % 11) as f32 / 11.0;
            let bright = object(20).contains(x as isize, y as isize);
            let level = if bright { 0.6 } else { 0.2 } + wall;
            image.pixel_mut(x, y).fill(level);
        }
    }
    for name in ["p0", "p1"] {
        write_photo_jpeg(&photos.join(format!("{name}.jpg")), &image, 90).unwrap();
    }
    write_mask(&masks.join("p1.png"), &object(70)).unwrap();
    let (code, _, stderr) = first_stage(&photos, &run_dir, &["--masks", arg(&masks)]);
    assert_eq!(code, 0, "{stderr}");
    let told: Vec<&str> = stderr
        .lines()
        .filter(|line| line.contains("lies on no edge"))
        .collect();
    assert_eq!(told.len(), 1, "{stderr}");
    assert!(
        told[0].contains("p1.jpg") && !told[0].contains("p0.jpg"),
        "{stderr}"
    );
}

#[test]
fn broken_json_names_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let broken = dir.path().join("broken.json");
    std::fs::write(&broken, "{\"unit\": \"metre\", \"cameras\": [").unwrap();
    for option in ["--cameras", "--sphere"] {
        let (code, _, stderr) =
            first_stage(&photos, &dir.path().join("run"), &[option, arg(&broken)]);
        assert_eq!(code, 3, "{option}: {stderr}");
        assert!(stderr.contains("broken.json"), "{option}: {stderr}");
    }
}

#[test]
fn an_unknown_key_in_a_config_file_is_wrong_usage_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let config = dir.path().join("options.toml");
    std::fs::write(&config, "[shading]\nnoize = 0.01\n").unwrap();
    let (code, _, stderr) = first_stage(
        &photos,
        &dir.path().join("run"),
        &["--config", arg(&config)],
    );
    assert_eq!(code, 2, "{stderr}");
    assert!(
        stderr.contains("options.toml") && stderr.contains("noize"),
        "{stderr}"
    );
}

#[test]
fn photos_that_share_nothing_allow_no_result_and_keep_what_was_done() {
    let (_dir, photos, run_dir) = noise_run(2);
    let (code, _, stderr) = run(&["reconstruct", arg(&photos), "-o", arg(&run_dir)]);
    assert_eq!(code, 4, "{stderr}");
    assert!(stderr.contains("match"), "{stderr}");
    assert!(run_dir.join("2_features/manifest.json").exists());
    let report = std::fs::read_to_string(run_dir.join("report.json")).unwrap();
    assert!(report.contains("\"exit_code\": 4"), "{report}");
}

#[test]
fn foreign_and_newer_folders_are_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let foreign = dir.path().join("letters");
    std::fs::create_dir(&foreign).unwrap();
    std::fs::write(foreign.join("letter.txt"), "x").unwrap();
    let (code, _, stderr) = first_stage(&photos, &foreign, &[]);
    assert_eq!(code, 5, "{stderr}");
    assert_eq!(std::fs::read_dir(&foreign).unwrap().count(), 1);

    let newer = dir.path().join("newer");
    std::fs::create_dir(&newer).unwrap();
    std::fs::write(
        newer.join("run.json"),
        r#"{"program": "rilievo", "format_version": 99, "request": {}}"#,
    )
    .unwrap();
    for arguments in [
        vec!["reconstruct", arg(&photos), "-o", arg(&newer)],
        vec!["status", arg(&newer)],
    ] {
        let (code, _, stderr) = run(&arguments);
        assert_eq!(code, 5, "{stderr}");
        assert!(stderr.contains("99"), "{stderr}");
    }
    let (code, _, _) = run(&["status", arg(&dir.path().join("never"))]);
    assert_eq!(code, 5);
}

#[test]
fn a_run_in_use_is_refused_with_its_owner() {
    let (_dir, photos, run_dir) = noise_run(2);
    std::fs::create_dir(&run_dir).unwrap();
    let held = std::fs::File::create(run_dir.join(".lock")).unwrap();
    held.lock().unwrap();
    std::fs::write(run_dir.join(".lock"), "4242\n").unwrap();
    let (code, _, stderr) = first_stage(&photos, &run_dir, &[]);
    assert_eq!(code, 5, "{stderr}");
    assert!(stderr.contains("4242"), "{stderr}");
    drop(held);
    let (code, _, stderr) = first_stage(&photos, &run_dir, &[]);
    assert_eq!(code, 0, "{stderr}");
}

#[test]
fn an_output_that_cannot_be_written_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    // A file where a folder must be made: refused for every user, root included.
    let file = dir.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let (code, _, stderr) = first_stage(&photos, &file.join("run"), &[]);
    assert_eq!(code, 6, "{stderr}");
    assert!(stderr.contains("file"), "{stderr}");
}

#[test]
fn wrong_usage_is_told_apart_from_wrong_input() {
    for arguments in [
        vec!["reconstruct"],
        vec!["reconstruct", "photos", "-o", "run", "--model", "magic"],
        vec!["run", "9_magic", "run"],
        vec!["shade", "-o", "out"],
        vec!["conjure"],
    ] {
        let (code, _, stderr) = run(&arguments);
        assert_eq!(code, 2, "{arguments:?}: {stderr}");
    }
    let (_, _, stderr) = run(&["shade", "-o", "out"]);
    assert!(stderr.contains("--image PHOTO with --camera"), "{stderr}");
    let (code, _, stderr) = run(&["check", "no-such-folder"]);
    assert_eq!(code, 3);
    assert!(stderr.contains("no such file or folder"), "{stderr}");
    let (code, _, _) = run(&["reconstruct", "no-such-folder", "-o", "never-made"]);
    assert_eq!(code, 3);
    assert!(!Path::new("never-made").exists());
}

#[test]
fn two_photos_of_one_name_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    for folder in ["left", "right"] {
        std::fs::create_dir(dir.path().join(folder)).unwrap();
        write_noise_photo(&dir.path().join(folder).join("a.jpg"), 1);
    }
    let (left, right) = (
        dir.path().join("left/a.jpg"),
        dir.path().join("right/a.jpg"),
    );
    let run_dir = dir.path().join("run");
    // The folder above them is not searched, and says so.
    let (code, _, stderr) = first_stage(dir.path(), &run_dir, &[]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("left, right"), "{stderr}");
    let (code, _, stderr) = run(&["reconstruct", arg(&left), arg(&right), "-o", arg(&run_dir)]);
    assert_eq!(code, 3, "{stderr}");
    assert!(
        stderr.contains("left") && stderr.contains("right"),
        "{stderr}"
    );
}

#[test]
fn an_evaluation_of_nothing_is_a_failure_with_its_reason() {
    let (dir, photos, run_dir) = noise_run(2);
    let (code, _, stderr) = first_stage(&photos, &run_dir, &[]);
    assert_eq!(code, 0, "{stderr}");
    let page = std::fs::read(run_dir.join("report.html")).unwrap();
    let truth = dir.path().join("truth");
    std::fs::create_dir(&truth).unwrap();
    let evaluate = |more: &[&str]| {
        let arguments = ["evaluate", arg(&run_dir), "--truth", arg(&truth)];
        run(&[&arguments[..], more].concat())
    };
    // A truth without anything; programs get the nulls with their reasons.
    let (code, stdout, stderr) = evaluate(&["--json"]);
    assert_eq!(code, 3, "{stderr}");
    for part in ["cameras.json", "NAME_depth.exr", "mesh.ply", "p0"] {
        assert!(stderr.contains(part), "{part} is not told in: {stderr}");
    }
    let found: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    for key in ["poses", "all", "cloud"] {
        assert!(found[key].is_null(), "{key}: {found}");
        assert!(found["reasons"][key].is_string(), "{key}: {found}");
    }
    assert_eq!(found["alignment"], "none");
    // A truth of other photos is as good as none.
    let plane = DepthMap::filled(160, 120, 1.0);
    write_depth(&truth.join("IMG_0001_depth.exr"), &plane).unwrap();
    let (code, stdout, _) = evaluate(&[]);
    assert_eq!((code, stdout.as_str()), (3, ""));
    // A truth of these photos, of which the run has no result yet.
    write_depth(&truth.join("p1_depth.exr"), &plane).unwrap();
    let (code, stdout, stderr) = evaluate(&[]);
    assert_eq!((code, stdout.as_str()), (4, ""), "{stderr}");
    assert!(stderr.contains("5_shading"), "{stderr}");
    assert!(std::fs::read(run_dir.join("report.html")).unwrap() == page);

    let held = std::fs::File::open(run_dir.join(".lock")).unwrap();
    held.lock().unwrap();
    let (code, _, stderr) = evaluate(&[]);
    assert_eq!(code, 5, "{stderr}");
}

#[test]
fn synth_and_demo_leave_other_peoples_folders_alone() {
    let dir = tempfile::tempdir().unwrap();
    let foreign = dir.path().join("letters");
    std::fs::create_dir(&foreign).unwrap();
    std::fs::write(foreign.join("letter.txt"), "x").unwrap();
    let small = ["--views", "2", "--size", "64x48"];
    let synth = |folder: &Path| run(&[&["synth", arg(folder)][..], &small].concat());
    for (code, _, stderr) in [synth(&foreign), run(&["demo", "-o", arg(&foreign)])] {
        assert_eq!(code, 5, "{stderr}");
        assert!(stderr.contains("letters"), "{stderr}");
    }
    assert_eq!(std::fs::read_dir(&foreign).unwrap().count(), 1);
    // Its own set it makes again.
    for _ in 0..2 {
        let (code, _, stderr) = synth(&dir.path().join("set"));
        assert_eq!(code, 0, "{stderr}");
        // A set is no demo.
        let (code, _, stderr_of_demo) = run(&["demo", "-o", arg(&dir.path().join("set"))]);
        assert_eq!(code, 5, "{stderr_of_demo}");
        assert!(
            stderr.contains("synth: photographing the scene 2/2"),
            "{stderr}"
        );
    }
}

#[test]
fn cameras_are_exported_into_folders_that_are_made() {
    let dir = tempfile::tempdir().unwrap();
    let cameras = synthetic_set().join("truth/cameras.json");
    for (format, name) in [
        ("middlebury", "par.txt"),
        ("colmap", "model"),
        ("cameras", "c.json"),
    ] {
        let to = dir.path().join(format!("not/there/{format}/{name}"));
        done(&["export", arg(&cameras), "--format", format, "-o", arg(&to)]);
        assert!(to.exists());
    }
    for (command, format) in [("import", "diligent"), ("export", "lp")] {
        let (code, stdout, _) = run(&["help", command]);
        assert_eq!(code, 0);
        for name in ["npz", "transforms", format] {
            assert!(stdout.contains(name), "{name} is not told in: {stdout}");
        }
        let (code, _, stderr) = run(&[command, "x", "--format", "neus", "-o", "y"]);
        assert_eq!(code, 2, "{stderr}");
        assert!(stderr.contains("npz"), "{stderr}");
    }
}
