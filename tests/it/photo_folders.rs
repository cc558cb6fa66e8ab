//! Folders as photographers have them: turned photos, odd names, folders that cannot be written,
//! masks under any of their usual names, and masks that the program proposes.

use crate::common;

use common::{
    arg, done, json_of, noise_photos, reconstruct_until, reconstructed_until, rilievo, run,
    with_exif, write_noise_photo,
};
use rilievo_io::{read_mask, write_mask, write_photo_jpeg};
use rilievo_scene::{LinearImage, Mask};
use rilievo_synthetic::testing::overlap;
use std::path::Path;

fn object() -> Mask {
    Mask::from_fn(160, 120, |x, y| {
        (40..120).contains(&x) && (30..90).contains(&y)
    })
}

#[test]
fn all_orientations_keep_the_sensors_frame() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    let jpeg = std::fs::read(photos.join("p0.jpg")).unwrap();
    std::fs::remove_file(photos.join("p0.jpg")).unwrap();
    let masks = dir.path().join("masks");
    std::fs::create_dir(&masks).unwrap();
    for orientation in 1..=8 {
        let name = format!("turned{orientation}");
        let bytes = with_exif(&jpeg, orientation, 50);
        std::fs::write(photos.join(format!("{name}.jpg")), bytes).unwrap();
        write_mask(&masks.join(format!("{name}.png")), &object()).unwrap();
    }
    let run_dir = dir.path().join("run");
    let more = ["--masks", arg(&masks)];
    let stderr = reconstructed_until("1_photos", &photos, &run_dir, &more);
    assert!(stderr.contains("used as stored"), "{stderr}");
    let linear = |n: u16| {
        std::fs::read(run_dir.join(format!("1_photos/linear/turned{n}.exr"))).expect("a result")
    };
    for orientation in 2..=8 {
        assert!(
            linear(orientation) == linear(1),
            "orientation {orientation}"
        );
    }
}

#[test]
fn a_focal_length_that_cannot_be_is_a_guess_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let jpeg = std::fs::read(photos.join("p0.jpg")).unwrap();
    std::fs::write(photos.join("p0.jpg"), with_exif(&jpeg, 1, 60_000)).unwrap();
    let (code, _, stderr) = run(&["check", arg(&photos)]);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stderr.contains("60000") && stderr.contains("not plausible"),
        "{stderr}"
    );
    assert!(stderr.contains("focal length unknown"), "{stderr}");
}

#[test]
fn copies_and_missing_masks_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    std::fs::copy(photos.join("p0.jpg"), photos.join("p7.jpg")).unwrap();
    let run_dir = dir.path().join("run");
    for (code, _, stderr) in [
        run(&["check", arg(&photos)]),
        reconstruct_until("1_photos", &photos, &run_dir, &[]),
    ] {
        assert_eq!(code, 0, "{stderr}");
        for part in [
            "p7.jpg has the same content as p0.jpg",
            "the whole frame is taken for the object",
        ] {
            assert!(stderr.contains(part), "{part} is not told in: {stderr}");
        }
        assert!(!stderr.contains("p1.jpg has"), "{stderr}");
    }
}

#[test]
fn spaces_and_any_script_are_names_like_others() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("Büste à la fenêtre 石膏像");
    let masks = folder.join("маски и прочее");
    std::fs::create_dir_all(&masks).unwrap();
    for (index, name) in ["vue de face", "横から見た", "it's \"it\""]
        .iter()
        .enumerate()
    {
        write_noise_photo(&folder.join(format!("{name}.jpg")), index as u64 + 1);
        write_mask(&masks.join(format!("{name}.png")), &object()).unwrap();
    }
    let run_dir = dir.path().join("résultat 1");
    let more = ["--masks", arg(&masks)];
    let stderr = reconstructed_until("1_photos", &folder, &run_dir, &more);
    assert!(run_dir.join("1_photos/linear/横から見た.exr").exists());
    assert!(stderr.contains("3/3"), "{stderr}");
}

#[test]
fn a_line_break_in_a_name_costs_that_photo_alone() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    std::fs::rename(photos.join("p1.jpg"), photos.join("line\nbreak.jpg")).unwrap();
    let run_dir = dir.path().join("run");
    let stderr = reconstructed_until("1_photos", &photos, &run_dir, &[]);
    assert!(
        stderr.contains("break.jpg is left out") && stderr.contains("rename the photo"),
        "{stderr}"
    );
    assert!(run_dir.join("1_photos/linear/p0.exr").exists());
}

#[test]
fn a_folder_that_cannot_be_written_is_read_and_left_as_it_was() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let look = || {
        let mut files: Vec<_> = std::fs::read_dir(&photos)
            .expect("a folder")
            .flatten()
            .map(|entry| {
                let data = entry.metadata().expect("a file");
                (entry.file_name(), data.len(), data.modified().ok())
            })
            .collect();
        files.sort();
        files
    };
    let before = look();
    let set = |path: &Path, mode: u32| {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).expect("allowed");
    };
    set(&photos.join("p0.jpg"), 0o444);
    set(&photos, 0o555);
    let (code, _, stderr) = reconstruct_until("1_photos", &photos, &dir.path().join("run"), &[]);
    set(&photos, 0o755);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(look(), before);
}

#[test]
fn masks_are_found_under_all_usual_names() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 1);
    for name in [
        "p0.png",
        "p0.jpg.png",
        "p0_mask.png",
        "p0-mask.PNG",
        "mask_p0.png",
        "photos/p0.png",
        "object/p0_mask.png",
    ] {
        let masks = tempfile::tempdir_in(dir.path()).unwrap();
        let path = masks.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_mask(&path, &object()).unwrap();
        let (code, _, stderr) = run(&["check", arg(&photos), "--masks", arg(masks.path())]);
        assert_eq!(code, 0, "{name}: {stderr}");
        assert!(stderr.contains("masks: 1/1 matched"), "{name}: {stderr}");
    }
}

/// Photos of equal names in folders as cameras number them, one of their masks beside them.
fn card(dir: &Path) -> std::path::PathBuf {
    let card = dir.join("DCIM");
    let folders = [("100CANON", [1, 2]), ("101CANON", [1, 3])];
    for (k, (folder, numbers)) in folders.into_iter().enumerate() {
        std::fs::create_dir_all(card.join(folder)).expect("a folder");
        for number in numbers {
            let photo = card.join(format!("{folder}/IMG_{number}.JPG"));
            write_noise_photo(&photo, 10 * k as u64 + number);
        }
    }
    write_mask(&card.join("100CANON/IMG_1_mask.png"), &object()).expect("a mask");
    card
}

#[test]
fn photos_in_subfolders_are_told_or_read() {
    let dir = tempfile::tempdir().unwrap();
    let card = card(dir.path());
    let (code, _, stderr) = run(&["check", arg(&card)]);
    assert_eq!(code, 3, "{stderr}");
    let told = "4 photos in 2 subfolders not read (100CANON, 101CANON): --recursive reads them";
    assert!(stderr.contains(told), "{stderr}");
    write_noise_photo(&card.join("IMG_0.jfif"), 30);
    let (code, _, stderr) = run(&["check", arg(&card)]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains(told), "{stderr}");
    assert!(stderr.contains("all 1 photos"), "{stderr}");

    // Masks by the same path; results are called by folder and name. What a run left among the photos is none.
    let masks = card.join("masks");
    for name in [
        "100CANON/IMG_1.png",
        "100CANON/IMG_2.png",
        "101CANON/IMG_1.png",
        "101CANON_IMG_3.png",
        "IMG_0.png",
    ] {
        let path = masks.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_mask(&path, &object()).unwrap();
    }
    let run_dir = card.join("run");
    let more = ["--masks", arg(&masks), "--recursive"];
    let stderr = reconstructed_until("1_photos", &card, &run_dir, &more);
    assert!(stderr.contains("5/5 matched"), "{stderr}");
    assert!(stderr.contains("101CANON/IMG_1.JPG"), "{stderr}");
    for name in [
        "100CANON_IMG_1",
        "100CANON_IMG_2",
        "101CANON_IMG_1",
        "101CANON_IMG_3",
        "IMG_0",
    ] {
        assert!(
            run_dir.join(format!("1_photos/linear/{name}.exr")).exists(),
            "{name}"
        );
    }
    let again = reconstructed_until("1_photos", &card, &run_dir, &more);
    assert!(again.contains("nothing to do"), "{again}");

    // A mask that two photos would have is nobody's.
    std::fs::remove_dir_all(masks.join("101CANON")).unwrap();
    let (code, _, stderr) = run(&["check", arg(&card), "--masks", arg(&masks), "--recursive"]);
    assert_eq!(code, 3, "{stderr}");
    assert!(
        stderr.contains("101CANON/IMG_1.JPG") || stderr.contains("IMG_1"),
        "{stderr}"
    );
    std::fs::rename(masks.join("100CANON/IMG_1.png"), masks.join("IMG_1.png")).unwrap();
    let (code, _, stderr) = run(&["check", arg(&card), "--masks", arg(&masks), "--recursive"]);
    assert_eq!(code, 3, "{stderr}");
    assert!(
        stderr.contains("the mask of both 100CANON/IMG_1.JPG and 101CANON/IMG_1.JPG"),
        "{stderr}"
    );
}

#[test]
fn nothing_of_the_environment_is_needed() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let output = rilievo()
        .env_clear()
        .env("LC_ALL", "de_DE.UTF-8")
        .args(["check", arg(&photos), "--json"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0));
    let text = String::from_utf8(output.stdout).unwrap();
    let last: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    let photo = &last["report"]["photos"][0];
    for key in [
        "black_level",
        "corner_falloff",
        "noise_sigma",
        "sharpness",
        "clipped_share",
    ] {
        assert!(photo[key].is_number(), "{key}: {photo}");
    }
}

/// A shaded ball before an even backdrop.
fn write_ball(path: &Path, backdrop: f32) -> Mask {
    let mask = Mask::from_fn(160, 120, |x, y| {
        (x as f32 - 84.0).hypot(y as f32 - 60.0) < 35.0
    });
    let mut image = LinearImage::filled(160, 120, 3, backdrop);
    for y in 0..120 {
        for x in 0..160 {
            if *mask.at(x, y) {
                let shade = 0.2 + 0.3 * (x as f32 - 49.0) / 70.0;
                image.pixel_mut(x, y).fill(shade);
            }
        }
    }
    write_photo_jpeg(path, &image, 95).expect("a photo");
    mask
}

#[test]
fn what_was_cut_out_to_black_or_white_is_the_mask() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    let truth = write_ball(&photos.join("black.jpg"), 0.0);
    write_ball(&photos.join("white.jpg"), 1.0);
    let run_dir = dir.path().join("run");
    let stderr = reconstructed_until("1_photos", &photos, &run_dir, &[]);
    assert!(
        stderr.contains("black.jpg, white.jpg: the surroundings are exactly black or white"),
        "{stderr}"
    );
    assert!(stderr.contains("masks: 2/2 matched"), "{stderr}");
    for name in ["black", "white"] {
        let found = read_mask(&run_dir.join(format!("1_photos/masks/{name}.png"))).unwrap();
        let overlap = overlap(&found, &truth);
        assert!(overlap > 0.98, "{name}: {overlap}");
    }
    let whole = reconstructed_until("1_photos", &photos, &run_dir, &["--masks", "none"]);
    assert!(!whole.contains("surroundings are exactly"), "{whole}");
    assert!(!run_dir.join("1_photos/masks").exists());
}

#[test]
fn masks_are_proposed_shown_and_never_written_over() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    let truth = write_ball(&photos.join("dark.jpg"), 0.01);
    write_ball(&photos.join("bright.jpg"), 0.9);
    let masks = dir.path().join("masks");
    let (code, _, stderr) = run(&["mask", arg(&photos), "-o", arg(&masks)]);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stderr.contains("dark backdrop") && stderr.contains("bright backdrop"),
        "{stderr}"
    );
    assert!(stderr.contains("certainty"), "{stderr}");
    for name in ["dark", "bright"] {
        let found = read_mask(&masks.join(format!("{name}.png"))).unwrap();
        let wrong = found
            .data
            .iter()
            .zip(&truth.data)
            .filter(|(a, b)| a != b)
            .count();
        assert!(
            wrong < truth.count() / 50,
            "{name}: {wrong} of {}",
            truth.count()
        );
        let overlay = dir.path().join(format!("masks-overlays/{name}.png"));
        assert!(overlay.exists(), "{}", overlay.display());
    }
    // What it proposes is what the other commands accept.
    done(&["check", arg(&photos), "--masks", arg(&masks)]);

    // Corrected by hand, and another photo that allows no mask.
    write_mask(&masks.join("dark.png"), &object()).unwrap();
    write_noise_photo(&photos.join("noise.jpg"), 5);
    let (code, _, stderr) = run(&["mask", arg(&photos), "-o", arg(&masks)]);
    assert_eq!(code, 4, "{stderr}");
    assert!(
        stderr.contains("noise.jpg") && stderr.contains("not plain"),
        "{stderr}"
    );
    assert_eq!(read_mask(&masks.join("dark.png")).unwrap(), object());

    // Where no photo allows one, nothing is left.
    let none = dir.path().join("none");
    let (code, _, stderr) = run(&["mask", arg(&photos.join("noise.jpg")), "-o", arg(&none)]);
    assert_eq!(code, 4, "{stderr}");
    assert!(stderr.contains("mask: proposing masks 1/1"), "{stderr}");
    assert!(!none.exists() && !dir.path().join("none-overlays").exists());
}

#[test]
fn masks_are_proposed_by_the_photos_poses_where_a_mat_is_in_the_picture() {
    let dir = tempfile::tempdir().unwrap();
    let set = dir.path().join("set");
    done(&[
        "synth",
        arg(&set),
        "--views",
        "5",
        "--size",
        "640x480",
        "--seed",
        "5",
    ]);
    let (photos, masks) = (set.join("photos"), dir.path().join("masks"));
    let cameras = set.join("intrinsics.json");
    let found = [
        "mask",
        arg(&photos),
        "-o",
        arg(&masks),
        "--cameras",
        arg(&cameras),
        "--json",
    ];
    let (code, stdout, stderr) = run(&found);
    assert_eq!(code, 0, "{stderr}");
    let last: serde_json::Value = serde_json::from_str(stdout.lines().last().unwrap()).unwrap();
    for told in last["masks"].as_array().unwrap() {
        assert_eq!(told["method"], "poses");
        assert!(told["consistency"].as_f64().unwrap() > 0.8, "{told}");
    }
    for k in 1..=5 {
        let name = format!("IMG_{k:04}.png");
        let found = read_mask(&masks.join(&name)).unwrap();
        let truth = read_mask(&set.join("masks").join(&name)).unwrap();
        let overlap = overlap(&found, &truth);
        assert!(overlap > 0.93, "{name}: {overlap}");
    }
    // The same from the run that it made, and nothing from one of other photos.
    let again = dir.path().join("again");
    let made = dir.path().join("masks-run");
    done(&["mask", arg(&photos), "-o", arg(&again), "--run", arg(&made)]);
    let bytes = |folder: &Path| std::fs::read(folder.join("IMG_0003.png")).unwrap();
    assert_eq!(bytes(&masks), bytes(&again));
    std::fs::rename(photos.join("IMG_0002.jpg"), photos.join("other.jpg")).unwrap();
    let only = photos.join("other.jpg");
    let some = photos.join("IMG_0001.jpg");
    let other = dir.path().join("other");
    let both = [
        "mask",
        arg(&only),
        arg(&some),
        "-o",
        arg(&other),
        "--run",
        arg(&made),
    ];
    let (code, _, stderr) = run(&both);
    assert_eq!(code, 4, "{stderr}");
    assert!(
        stderr.contains("other.jpg has no pose in the run"),
        "{stderr}"
    );
    assert!(other.join("IMG_0001.png").exists());
    // One photo is enough where its pose is known, but not another one of its name.
    let place = |name: &str| dir.path().join(name);
    let (single, swapped) = (place("single"), place("swapped"));
    done(&["mask", arg(&some), "-o", arg(&single), "--run", arg(&made)]);
    std::fs::copy(photos.join("IMG_0003.jpg"), &some).unwrap();
    let (code, _, stderr) = run(&["mask", arg(&some), "-o", arg(&swapped), "--run", arg(&made)]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("not the photo of that name"), "{stderr}");
    assert!(!swapped.exists());
    // A run that was not made for masks is not replaced.
    std::fs::rename(masks.join("IMG_0002.png"), masks.join("other.png")).unwrap();
    let (whole, its_run) = (place("whole"), place("whole-run"));
    let asked = [
        "reconstruct",
        arg(&photos),
        "--masks",
        arg(&masks),
        "--until",
        "1_photos",
    ];
    done(&[&asked[..], &["-o", arg(&its_run)]].concat());
    let (code, _, stderr) = run(&["mask", arg(&photos), "-o", arg(&whole)]);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("--run"), "{stderr}");
}

#[test]
fn a_run_without_masks_proposes_its_own_and_keeps_what_was_corrected() {
    let dir = tempfile::tempdir().unwrap();
    let (set, run_dir) = (dir.path().join("set"), dir.path().join("run"));
    let made = "synth --views 5 --size 640x480 --seed 5";
    let made: Vec<&str> = made.split(' ').chain([arg(&set)]).collect();
    done(&made);
    let photos = set.join("photos");
    let (cameras, sphere) = (set.join("intrinsics.json"), set.join("sphere.json"));
    let given = ["--cameras", arg(&cameras), "--sphere", arg(&sphere)];
    let reconstruct = |more: &[&str]| {
        let more = [&given[..], more].concat();
        reconstructed_until("4_lighting", &photos, &run_dir, &more)
    };
    let verdict = || {
        let report = json_of(&run_dir.join("report.json"));
        let findings = report["findings"].as_array().unwrap().clone();
        let found = |code: &str| findings.iter().any(|finding| finding["code"] == code);
        [found("masks_proposed"), found("masks_none")]
    };
    let first = reconstruct(&[]);
    assert!(
        first.contains("masks: proposed by the photos' poses for 5 photos"),
        "{first}"
    );
    assert_eq!(verdict(), [true, false]);
    let masks = run_dir.join("masks");
    for k in 1..=5 {
        let name = format!("IMG_{k:04}.png");
        let found = read_mask(&masks.join(&name)).unwrap();
        let truth = read_mask(&set.join("masks").join(&name)).unwrap();
        assert!(overlap(&found, &truth) > 0.93, "{name}");
        assert!(run_dir.join("masks-overlays").join(&name).exists());
    }
    assert!(reconstruct(&[]).contains("nothing to do"));
    // Who says that they are right has the same result, and no word against them.
    assert!(reconstruct(&["--masks", arg(&masks)]).contains("nothing to do"));
    assert_eq!(verdict(), [false, false]);
    // A corrected mask is taken up, and stays where masks are proposed again.
    let corrected = read_mask(&set.join("masks/IMG_0002.png")).unwrap();
    write_mask(&masks.join("IMG_0002.png"), &corrected).unwrap();
    assert!(!reconstruct(&[]).contains("nothing to do"));
    std::fs::remove_file(masks.join("IMG_0004.png")).unwrap();
    reconstruct(&[]);
    assert!(masks.join("IMG_0004.png").exists());
    assert_eq!(read_mask(&masks.join("IMG_0002.png")).unwrap(), corrected);
    // The whole frame for who asks for it, and no masks that this run did not make.
    reconstruct(&["--masks", "none"]);
    assert_eq!(verdict(), [false, true]);
    std::fs::remove_file(run_dir.join("masks.json")).unwrap();
    let more = [&given[..], &["--overwrite"]].concat();
    let (code, _, stderr) = reconstruct_until("4_lighting", &photos, &run_dir, &more);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("was not proposed by this run"), "{stderr}");
}

/// Long: some three gigabytes and half a minute.
#[test]
#[ignore = "needs three gigabytes"]
fn a_hundred_megapixels_are_one_photo_like_others() {
    let dir = tempfile::tempdir().unwrap();
    let mut image = LinearImage::filled(12_000, 8_400, 3, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        *value = 0.2 + 0.6 * ((i / 3) % 12_000) as f32 / 12_000.0;
    }
    write_photo_jpeg(&dir.path().join("large.jpg"), &image, 80).unwrap();
    drop(image);
    let (code, _, stderr) = run(&["check", arg(dir.path())]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("12000 x 8400"), "{stderr}");
}
