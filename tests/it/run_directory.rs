//! What is redone, what is kept, and what is told: cache behaviour of the run directory.

use crate::common;

use common::{
    arg, done, json_of, noise_photos, noise_run, reconstruct_until, reconstructed_until, run,
    write_noise_photo,
};
use std::path::Path;

/// Brings the first two stages up to date; `(stage, reused)` in order.
fn two_stages(photos: &Path, run_dir: &Path, more: &[&str]) -> Vec<(String, bool)> {
    let mut arguments = vec!["--json"];
    arguments.extend(more);
    let (code, stdout, stderr) = reconstruct_until("2_features", photos, run_dir, &arguments);
    assert_eq!(code, 0, "{stderr}");
    stages(&stdout)
}

/// Stages that ended, and whether their result was kept, from JSON lines.
fn stages(stdout: &str) -> Vec<(String, bool)> {
    stdout
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("a line is JSON"))
        .filter(|event| event["event"] == "stage_finished")
        .map(|event| {
            let stage = event["stage"].as_str().expect("a stage").to_owned();
            (stage, event["reused"] == true)
        })
        .collect()
}

fn both(photos: bool, features: bool) -> Vec<(String, bool)> {
    vec![
        ("1_photos".to_owned(), photos),
        ("2_features".to_owned(), features),
    ]
}

/// A file's identity on disk: it stays when a result is linked instead of made again.
fn identity(path: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata(path).expect("the file is there").ino()
}

#[test]
fn a_second_run_does_nothing_and_dates_do_not_count() {
    let (_dir, photos, run_dir) = noise_run(3);
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(false, false));
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));

    let later = std::time::SystemTime::now() + std::time::Duration::from_secs(3600);
    for entry in std::fs::read_dir(&photos).unwrap().flatten() {
        let file = std::fs::File::options()
            .write(true)
            .open(entry.path())
            .unwrap();
        file.set_modified(later).unwrap();
    }
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));
}

#[test]
fn what_a_stopped_run_left_goes_when_its_stage_is_kept() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    for folder in ["1_photos/linear", "2_features.previous"] {
        let folder = run_dir.join(".work").join(folder);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("half.exr"), "half").unwrap();
    }
    std::fs::create_dir_all(run_dir.join(".old")).unwrap();
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));
    for folder in [".work", ".old"] {
        assert!(!run_dir.join(folder).exists(), "{folder} is still there");
    }
}

#[test]
fn threads_and_memory_redo_nothing_options_do() {
    let (dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let other_work = ["--threads", "1", "--memory", "1G"];
    assert_eq!(two_stages(&photos, &run_dir, &other_work), both(true, true));

    // An option of a later stage touches no earlier one.
    let config = dir.path().join("options.toml");
    std::fs::write(&config, "[shading.paper]\nnoise = 0.02\n").unwrap();
    let with_config = ["--config", arg(&config)];
    assert_eq!(
        two_stages(&photos, &run_dir, &with_config),
        both(true, true)
    );

    std::fs::write(&config, "[features]\nmax_ratio = 0.7\n").unwrap();
    let (code, _, _) = run(&[
        "reconstruct",
        arg(&photos),
        "-o",
        arg(&run_dir),
        "--until",
        "1_photos",
        "--config",
        arg(&config),
    ]);
    assert_eq!(code, 0);
    let (code, why, _) = run(&["why", arg(&run_dir), "2_features"]);
    assert_eq!(code, 0);
    assert!(why.contains("max_ratio") && why.contains("0.7"), "{why}");
    let (_, status, _) = run(&["status", arg(&run_dir)]);
    assert!(
        status.contains("stale") && status.contains("missing") && status.contains("valid"),
        "{status}"
    );
    assert_eq!(
        two_stages(&photos, &run_dir, &with_config),
        both(true, false)
    );
}

#[test]
fn a_replaced_photo_redoes_its_own_and_a_new_one_adds_its_own() {
    let (_dir, photos, run_dir) = noise_run(3);
    two_stages(&photos, &run_dir, &[]);
    let keypoints = |name: &str| run_dir.join(format!("2_features/keypoints/{name}.bin"));
    let before = ["p0", "p1", "p2"].map(|name| identity(&keypoints(name)));

    write_noise_photo(&photos.join("p1.jpg"), 77);
    write_noise_photo(&photos.join("p9.jpg"), 78);
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(false, false));
    let after = ["p0", "p1", "p2"].map(|name| identity(&keypoints(name)));
    assert_eq!((after[0], after[2]), (before[0], before[2]), "kept");
    assert_ne!(after[1], before[1], "the replaced photo's own are new");
    assert!(keypoints("p9").exists());

    std::fs::remove_file(photos.join("p9.jpg")).unwrap();
    two_stages(&photos, &run_dir, &[]);
    assert!(!keypoints("p9").exists(), "a removed photo leaves nothing");
    assert_eq!(identity(&keypoints("p0")), before[0]);
}

#[test]
fn clean_and_damage_are_repaired() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let (code, _, _) = run(&["clean", arg(&run_dir), "2_features"]);
    assert_eq!(code, 0);
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, false));

    std::fs::remove_file(run_dir.join("2_features/keypoints/p0.bin")).unwrap();
    let (_, status, _) = run(&["status", arg(&run_dir)]);
    assert!(status.contains("p0.bin is gone"), "{status}");
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, false));

    // Half of a file is no result, and not to be taken over when the stage is made again.
    let half = run_dir.join("2_features/keypoints/p0.bin");
    let whole = std::fs::read(&half).unwrap();
    std::fs::write(&half, &whole[..whole.len() / 2]).unwrap();
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, false));
    assert!(
        std::fs::read(&half).unwrap() == whole,
        "the file is whole again"
    );

    let (code, stdout, _) = run(&["status", arg(&run_dir), "--json"]);
    assert_eq!(code, 0);
    let status: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(status["stages"]["1_photos"]["state"], "valid");
    assert_eq!(status["stages"]["6_fusion"]["state"], "missing");
}

#[test]
fn a_stage_without_its_input_is_told_and_a_damaged_one_hides_no_other() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let (code, stdout, _) = run(&["clean", arg(&run_dir), "1_photos"]);
    assert_eq!(code, 0);
    assert!(stdout.contains("rilievo reconstruct"), "{stdout}");
    let (code, stdout, _) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 0);
    let told =
        "2_features   valid, but 1_photos that it was made from is gone: `rilievo reconstruct`";
    assert!(stdout.contains(told), "{stdout}");
    let (_, stdout, _) = run(&["status", arg(&run_dir), "--json"]);
    let status: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let expected = serde_json::json!({"state": "valid", "lacks": ["1_photos"]});
    assert_eq!(status["stages"]["2_features"], expected);
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(false, true));

    std::fs::write(run_dir.join("1_photos/manifest.json"), "{").unwrap();
    let (code, stdout, stderr) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 5, "{stderr}");
    assert!(stdout.contains("2_features   valid"), "{stdout}");
    assert!(stdout.contains("6_fusion     missing"), "{stdout}");
    assert!(stdout.contains("manifest.json is damaged"), "{stdout}");
}

#[test]
fn halves_need_what_stage_5_reads_and_an_evaluation_needs_a_measure() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let (code, stdout, stderr) = run(&["evaluate", arg(&run_dir), "--halves"]);
    assert_eq!(code, 5, "{stderr}");
    assert!(
        stdout.is_empty() && stderr.contains("3_poses, which is missing"),
        "{stderr}"
    );
    let (code, _, stderr) = run(&["evaluate", arg(&run_dir)]);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("--truth"), "{stderr}");
    let both = ["evaluate", arg(&run_dir), "--halves", "--truth", "truth"];
    assert_eq!(run(&both).0, 2);
}

#[test]
fn an_evaluation_goes_with_the_results_that_it_judged() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let cloud = run_dir.join("evaluation/deviation.ply");
    let evaluated = || {
        std::fs::create_dir_all(cloud.parent().unwrap()).unwrap();
        std::fs::write(&cloud, "ply").unwrap();
        let page = run_dir.join("report.html");
        let text = std::fs::read_to_string(&page).unwrap();
        let text = text.replace("<!-- evaluation -->", "<!-- evaluation -->judged");
        // A page ends with the hash of what stands before it.
        let (content, seal) = text.rsplit_once(": ").unwrap();
        let content = content
            .strip_suffix("<!-- blake3 of the page before this line")
            .unwrap();
        let hash = blake3::hash(content.as_bytes()).to_hex();
        let text = text.replace(seal, &format!("{hash} -->\n"));
        std::fs::write(&page, text).unwrap();
    };
    let stands = || {
        let page = std::fs::read_to_string(run_dir.join("report.html")).unwrap();
        (cloud.exists(), page.contains("-->judged"))
    };
    evaluated();
    two_stages(&photos, &run_dir, &[]);
    assert_eq!(stands(), (true, true), "nothing was redone");
    done(&["run", "2_features", arg(&run_dir)]);
    assert_eq!(stands(), (false, false));
    evaluated();
    done(&["clean", arg(&run_dir), "2_features"]);
    assert_eq!(stands(), (false, false));
}

#[test]
fn damage_of_the_same_size_is_found_and_mended() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let file = run_dir.join("2_features/pairs.bin");
    let whole = std::fs::read(&file).unwrap();
    let damage = || {
        let mut bytes = whole.clone();
        bytes[0] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
    };
    damage();
    let (code, _, _) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 0, "sizes are as they were");
    let (code, stdout, stderr) = run(&["status", arg(&run_dir), "--verify"]);
    assert_eq!(code, 5, "{stdout}");
    assert!(
        stdout.contains("2_features   damaged: pairs.bin"),
        "{stdout}"
    );
    assert!(stderr.contains("damaged: 2_features"), "{stderr}");
    let (code, _, stderr) = run(&["run", "3_poses", arg(&run_dir)]);
    assert_eq!(code, 5, "{stderr}");
    assert!(stderr.contains("pairs.bin"), "{stderr}");
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, false));
    assert!(std::fs::read(&file).unwrap() == whole);
    // A manifest tells of its own damage, and its stage is made again.
    let manifest = run_dir.join("1_photos/manifest.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, text.replacen("\"bits\": 8", "\"bits\": 9", 1)).unwrap();
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(false, true));
}

#[test]
fn a_run_that_is_moved_with_its_photos_is_still_valid() {
    let dir = tempfile::tempdir().unwrap();
    let project = dir.path().join("project");
    let photos = noise_photos(&project, 2);
    std::fs::create_dir(project.join("masks")).unwrap();
    let good = rilievo_scene::Mask::from_fn(160, 120, |x, y| {
        (40..120).contains(&x) && (30..90).contains(&y)
    });
    for index in 0..2 {
        let file = project.join(format!("masks/p{index}.png"));
        rilievo_io::write_mask(&file, &good).unwrap();
    }
    let masks = |project: &Path| project.join("masks");
    let with = masks(&project);
    two_stages(&photos, &project.join("run"), &["--masks", arg(&with)]);
    let moved = dir.path().join("elsewhere/moved");
    std::fs::create_dir_all(moved.parent().unwrap()).unwrap();
    std::fs::rename(&project, &moved).unwrap();
    let stdout = done(&["status", arg(&moved.join("run"))]);
    assert_eq!(stdout.matches(" valid").count(), 2, "{stdout}");
    let with = masks(&moved);
    assert_eq!(
        two_stages(
            &moved.join("photos"),
            &moved.join("run"),
            &["--masks", arg(&with)]
        ),
        both(true, true)
    );
    // What is added is named.
    let (_, why, _) = run(&["why", arg(&moved.join("run")), "1_photos"]);
    assert!(why.contains("would be kept"), "{why}");
    let (code, _, stderr) =
        reconstruct_until("2_features", &moved.join("photos"), &moved.join("run"), &[]);
    assert_eq!(code, 0);
    assert!(stderr.contains("mask of p0.jpg is gone"), "{stderr}");
}

#[test]
fn a_run_of_other_photos_is_not_replaced_unasked() {
    let (dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let others = dir.path().join("others");
    std::fs::create_dir(&others).unwrap();
    write_noise_photo(&others.join("p0.jpg"), 70);
    write_noise_photo(&others.join("p1.jpg"), 71);
    let before = common::results(&run_dir);
    let asked = std::fs::read(run_dir.join("run.json")).unwrap();
    let (code, _, stderr) = reconstruct_until("2_features", &others, &run_dir, &[]);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("--overwrite"), "{stderr}");
    assert!(common::results(&run_dir) == before);
    assert!(std::fs::read(run_dir.join("run.json")).unwrap() == asked);
    assert_eq!(
        two_stages(&others, &run_dir, &["--overwrite"]),
        both(false, false)
    );
}

#[test]
fn nothing_in_a_run_directory_leads_elsewhere() {
    use std::os::unix::fs::symlink;
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let foreign = dir.path().join("foreign");
    std::fs::create_dir(&foreign).unwrap();
    let letter = foreign.join("letter.txt");
    for place in [
        ".lock",
        ".work",
        ".old",
        "evaluation",
        "1_photos",
        "run.json",
    ] {
        std::fs::write(&letter, "Dear reader,").unwrap();
        let run_dir = dir.path().join(format!("run{place}"));
        two_stages(&photos, &run_dir, &[]);
        let link = run_dir.join(place);
        let _ = std::fs::remove_file(&link);
        let _ = std::fs::remove_dir_all(&link);
        symlink(if place == ".lock" { &letter } else { &foreign }, &link).unwrap();
        let more = ["--from", "1_photos"];
        let (code, _, stderr) = reconstruct_until("1_photos", &photos, &run_dir, &more);
        if place == "run.json" {
            // Its copy is enough, and the link makes way for the file.
            assert_eq!(code, 0, "{stderr}");
        } else {
            assert_eq!(code, 5, "{place}: {stderr}");
            assert!(stderr.contains("is a link"), "{place}: {stderr}");
        }
        let left: Vec<_> = std::fs::read_dir(&foreign).unwrap().collect();
        assert_eq!(left.len(), 1, "{place}");
        assert_eq!(std::fs::read(&letter).unwrap(), b"Dear reader,", "{place}");
    }
}

#[test]
fn names_that_are_no_utf8_stay_distinct() {
    use std::os::unix::ffi::OsStrExt;
    let dir = tempfile::tempdir().unwrap();
    let odd = dir
        .path()
        .join(std::ffi::OsStr::from_bytes(b"odd\xffplace"));
    let photos = odd.join("photos");
    std::fs::create_dir_all(&photos).unwrap();
    for (seed, name) in [&b"a\xff.jpg"[..], b"a\xfe.jpg"].into_iter().enumerate() {
        write_noise_photo(
            &photos.join(std::ffi::OsStr::from_bytes(name)),
            seed as u64 + 1,
        );
    }
    let run_dir = odd.join("run");
    let reconstruct = || {
        common::rilievo()
            .args(["reconstruct", "--until", "2_features", "--json", "-o"])
            .args([&run_dir, &photos])
            .output()
            .unwrap()
    };
    for reused in [false, true] {
        let output = reconstruct();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{stderr}");
        let stdout = String::from_utf8_lossy(&output.stdout);
        assert_eq!(stages(&stdout), both(reused, reused));
    }
    for name in ["a%FF", "a%FE"] {
        assert!(run_dir.join(format!("1_photos/linear/{name}.exr")).exists());
    }
    let status = common::rilievo()
        .arg("status")
        .arg(&run_dir)
        .output()
        .unwrap();
    assert_eq!(status.status.code(), Some(0));
}

#[test]
fn names_that_no_result_can_have_are_left_out_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    write_noise_photo(&photos.join(format!("{}.jpg", "x".repeat(251))), 5);
    write_noise_photo(&photos.join("two\nlines.jpg"), 6);
    let stderr = reconstructed_until("1_photos", &photos, &dir.path().join("run"), &[]);
    assert!(stderr.contains("its name has 251 bytes"), "{stderr}");
    assert!(stderr.contains("control character"), "{stderr}");
}

#[test]
fn what_is_no_file_is_left_out_and_does_not_hang() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let pipe = photos.join("pipe.jpg");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.is_ok_and(|status| status.success()));
    std::os::unix::fs::symlink("/dev/zero", photos.join("zero.jpg")).unwrap();
    let _socket = std::os::unix::net::UnixListener::bind(photos.join("socket.jpg")).unwrap();
    let run_dir = dir.path().join("run");
    let stderr = reconstructed_until("1_photos", &photos, &run_dir, &[]);
    for name in ["pipe.jpg", "zero.jpg", "socket.jpg"] {
        let told = stderr.lines().any(|line| {
            line.contains(name) && (line.contains("not a file") || line.contains("not to a file"))
        });
        assert!(told, "{name}: {stderr}");
    }
    for option in ["--cameras", "--sphere", "--lighting", "--config", "--masks"] {
        let (code, _, stderr) =
            reconstruct_until("1_photos", &photos, &run_dir, &[option, arg(&pipe)]);
        assert_eq!(code, 3, "{option}: {stderr}");
    }
}

#[test]
fn from_redoes_valid_stages_and_run_needs_what_it_reads() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    assert_eq!(
        two_stages(&photos, &run_dir, &["--from", "features"]),
        both(true, false)
    );
    done(&["run", "2_features", arg(&run_dir)]);
    let (code, _, stderr) = run(&["run", "4_lighting", arg(&run_dir)]);
    assert_eq!(code, 5, "{stderr}");
    assert!(stderr.contains("3_poses"), "{stderr}");
}

#[test]
fn json_lines_are_events_that_end_with_the_outcome() {
    let (_dir, photos, run_dir) = noise_run(2);
    let (code, stdout, _) = run(&["reconstruct", arg(&photos), "-o", arg(&run_dir), "--json"]);
    assert_eq!(code, 4, "noise has no poses");
    let events: Vec<serde_json::Value> = stdout
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line is JSON"))
        .collect();
    for event in &events {
        let kind = event["event"].as_str().unwrap_or_default();
        assert!(
            [
                "stage_started",
                "progress",
                "iteration",
                "warning",
                "stage_finished",
                "finished"
            ]
            .contains(&kind),
            "{event}"
        );
    }
    let last = events.last().expect("events");
    assert_eq!(
        (&last["event"], &last["exit_code"]),
        (&"finished".into(), &4.into())
    );
}

#[test]
fn options_of_matching_keep_the_keypoints() {
    let (dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let keypoints = run_dir.join("2_features/keypoints/p0.bin");
    let before = identity(&keypoints);
    let config = dir.path().join("options.toml");
    std::fs::write(&config, "[features]\nmax_ratio = 0.7\n").unwrap();
    let with_config = ["--config", arg(&config)];
    assert_eq!(
        two_stages(&photos, &run_dir, &with_config),
        both(true, false)
    );
    assert_eq!(identity(&keypoints), before);
}

#[test]
fn the_report_of_a_failed_run_does_not_outlive_it() {
    let (_dir, photos, run_dir) = noise_run(2);
    let report = || json_of(&run_dir.join("report.json"));
    let (code, _, _) = run(&["reconstruct", arg(&photos), "-o", arg(&run_dir)]);
    assert_eq!(code, 4, "noise has no poses");
    assert_eq!(report()["outcome"]["exit_code"], 4);
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));
    assert_eq!(report()["outcome"]["exit_code"], 0);
}

#[test]
fn a_request_that_cannot_be_used_leaves_the_run_as_it_was() {
    let (dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let asked = std::fs::read(run_dir.join("run.json")).unwrap();
    let lighting = dir.path().join("lighting.json");
    std::fs::write(&lighting, "{").unwrap();
    let (code, _, stderr) = run(&[
        "reconstruct",
        arg(&photos),
        "-o",
        arg(&run_dir),
        "--lighting",
        arg(&lighting),
    ]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("lighting.json"), "{stderr}");
    assert!(std::fs::read(run_dir.join("run.json")).unwrap() == asked);
}

#[test]
fn a_damaged_request_is_asked_anew_and_the_results_are_kept() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let [file, copy] = ["run.json", ".run.json"].map(|name| run_dir.join(name));
    let whole = std::fs::read_to_string(&file).unwrap();
    // One of the two is enough, and what was found is said.
    let digit = whole.replacen("0.8", "0.7", 1);
    for text in [Some(""), Some("{}"), Some(digit.as_str()), None] {
        match text {
            Some(text) => std::fs::write(&file, text).unwrap(),
            None => std::fs::remove_file(&file).unwrap(),
        }
        let (code, stdout, stderr) = run(&["status", arg(&run_dir)]);
        assert_eq!(code, 0, "{stderr}");
        assert!(stdout.contains("2_features   valid"), "{stdout}");
        assert!(stderr.contains("its copy"), "{stderr}");
    }
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), whole);

    for path in [&file, &copy] {
        std::fs::write(path, "{\"program\": \"ril").unwrap();
    }
    let (code, _, stderr) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 5, "{stderr}");
    let told = stderr.contains("run.json") && stderr.contains("rilievo reconstruct");
    assert!(told, "{stderr}");
    for path in [&file, &copy] {
        std::fs::remove_file(path).unwrap();
    }
    let (code, _, stderr) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 5, "{stderr}");
    assert!(stderr.contains("but results of one"), "{stderr}");
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));
    done(&["status", arg(&run_dir)]);
}

#[test]
fn a_photo_that_cannot_be_read_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    std::os::unix::fs::symlink(dir.path().join("nowhere.jpg"), photos.join("p5.jpg")).unwrap();
    let run_dir = dir.path().join("run");
    two_stages(&photos, &run_dir, &[]);
    let text = std::fs::read_to_string(run_dir.join("1_photos/manifest.json")).unwrap();
    assert_eq!(
        text.matches("p5.jpg is left out: cannot be read").count(),
        1,
        "{text}"
    );
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let (_dir, photos, run_dir) = noise_run(2);
    two_stages(&photos, &run_dir, &[]);
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_rilievo"))
        .args(["status", arg(&run_dir)])
        .stdout(writer)
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(0));
}
