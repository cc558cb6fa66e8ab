//! What is redone, what is kept, and what is told: cache behaviour of the run directory.

#![allow(clippy::expect_used, reason = "helpers of tests fail as tests do")]

mod common;

use common::{arg, noise_photos, reconstruct_until, run, write_noise_photo};
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 3);
    let run_dir = dir.path().join("run");
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
fn threads_and_memory_redo_nothing_options_do() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
    two_stages(&photos, &run_dir, &[]);
    let other_work = ["--threads", "1", "--memory", "1G"];
    assert_eq!(two_stages(&photos, &run_dir, &other_work), both(true, true));

    // An option of a later stage touches no earlier one.
    let config = dir.path().join("options.toml");
    std::fs::write(&config, "[shading]\nnoise = 0.02\n").unwrap();
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 3);
    let run_dir = dir.path().join("run");
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
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
fn an_evaluation_goes_with_the_results_that_it_judged() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
    two_stages(&photos, &run_dir, &[]);
    let cloud = run_dir.join("evaluation/deviation.ply");
    let evaluated = || {
        std::fs::create_dir_all(cloud.parent().unwrap()).unwrap();
        std::fs::write(&cloud, "ply").unwrap();
        let page = run_dir.join("report.html");
        let text = std::fs::read_to_string(&page).unwrap();
        let text = text.replace("<!-- evaluation -->", "<!-- evaluation -->judged");
        std::fs::write(&page, text).unwrap();
    };
    let stands = || {
        let page = std::fs::read_to_string(run_dir.join("report.html")).unwrap();
        (cloud.exists(), page.contains("-->judged"))
    };
    evaluated();
    two_stages(&photos, &run_dir, &[]);
    assert_eq!(stands(), (true, true), "nothing was redone");
    let (code, _, stderr) = run(&["run", "2_features", arg(&run_dir)]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(stands(), (false, false));
    evaluated();
    let (code, _, stderr) = run(&["clean", arg(&run_dir), "2_features"]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(stands(), (false, false));
}

#[test]
fn from_redoes_valid_stages_and_run_needs_what_it_reads() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
    two_stages(&photos, &run_dir, &[]);
    assert_eq!(
        two_stages(&photos, &run_dir, &["--from", "features"]),
        both(true, false)
    );
    let (code, _, stderr) = run(&["run", "2_features", arg(&run_dir)]);
    assert_eq!(code, 0, "{stderr}");
    let (code, _, stderr) = run(&["run", "4_lighting", arg(&run_dir)]);
    assert_eq!(code, 5, "{stderr}");
    assert!(stderr.contains("3_poses"), "{stderr}");
}

#[test]
fn json_lines_are_events_that_end_with_the_outcome() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
    let report = || -> serde_json::Value {
        let text = std::fs::read(run_dir.join("report.json")).unwrap();
        serde_json::from_slice(&text).unwrap()
    };
    let (code, _, _) = run(&["reconstruct", arg(&photos), "-o", arg(&run_dir)]);
    assert_eq!(code, 4, "noise has no poses");
    assert_eq!(report()["outcome"]["exit_code"], 4);
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));
    assert_eq!(report()["outcome"]["exit_code"], 0);
}

#[test]
fn a_request_that_cannot_be_used_leaves_the_run_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
    two_stages(&photos, &run_dir, &[]);
    std::fs::write(run_dir.join("run.json"), "{\"program\": \"ril").unwrap();
    let (code, _, stderr) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 5, "{stderr}");
    let told = stderr.contains("run.json") && stderr.contains("rilievo reconstruct");
    assert!(told, "{stderr}");
    assert_eq!(two_stages(&photos, &run_dir, &[]), both(true, true));
    let (code, _, stderr) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 0, "{stderr}");
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
    let dir = tempfile::tempdir().unwrap();
    let photos = noise_photos(dir.path(), 2);
    let run_dir = dir.path().join("run");
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
