//! The whole program on a small synthetic set: accuracy, same bytes from any number of threads and
//! after any number of kills.

use crate::browser;
use crate::common;
use rilievo_synthetic::testing::not_tested;

use common::{
    arg, differences, done, fresh_folder, reconstruct_arguments, rilievo, run, small_arguments,
    synthetic_set,
};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, OnceLock};
use std::time::{Duration, Instant};

/// One test at a time: each uses all cores, and some measure time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    match ALONE.lock() {
        Ok(guard) => guard,
        // Another test failed; that says nothing about this one.
        Err(poisoned) => poisoned.into_inner(),
    }
}

/// An undisturbed run whose accuracy, report and verdict are judged.
fn reference() -> &'static Path {
    static REFERENCE: OnceLock<PathBuf> = OnceLock::new();
    REFERENCE.get_or_init(|| {
        let run_dir = fresh_folder("reference-run");
        reconstruct(&synthetic_set(), &run_dir, &[]);
        run_dir
    })
}

/// An undisturbed run of the small set, whose bytes other runs are compared with.
fn small_reference() -> &'static Path {
    static REFERENCE: OnceLock<PathBuf> = OnceLock::new();
    REFERENCE.get_or_init(|| {
        let run_dir = fresh_folder("small-run");
        reconstruct_small(&run_dir, &[]);
        run_dir
    })
}

/// A copy of a run.
fn copy_of(run_dir: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-a").args([run_dir, to]).status();
    assert!(copied.is_ok_and(|status| status.success()));
}

fn reconstruct(set: &Path, run_dir: &Path, more: &[&str]) -> String {
    completed(&reconstruct_arguments(set, run_dir), more)
}

/// Reconstructs the small set; what the program reports.
fn reconstruct_small(run_dir: &Path, more: &[&str]) -> String {
    completed(&small_arguments(run_dir), more)
}

/// Runs the program to a good end; what it reports.
fn completed(arguments: &[String], more: &[&str]) -> String {
    let output = rilievo().args(arguments).args(more).output();
    let output = output.expect("the program starts");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    stderr
}

/// Correlations by wavelength, shortest first.
fn correlations(relief: &serde_json::Value) -> Vec<f64> {
    let bands = relief.as_array().map(Vec::as_slice).unwrap_or_default();
    let correlation = |band: &serde_json::Value| band["correlation"].as_f64().unwrap_or(f64::NAN);
    bands.iter().map(correlation).collect()
}

/// The halves share no photo: what they agree on is in the truth too, but for errors that both make.
#[test]
fn two_halves_agree_about_as_far_as_the_result_agrees_with_the_truth() {
    let _alone = alone();
    let run_dir = reference();
    let json = |arguments: &[&str]| -> serde_json::Value {
        serde_json::from_str(&done(arguments)).expect("JSON")
    };
    let truth = synthetic_set().join("truth");
    let of_truth = json(&["evaluate", arg(run_dir), "--truth", arg(&truth), "--json"]);
    let of_halves = json(&["evaluate", arg(run_dir), "--halves", "--json"]);
    let (true_ones, halves) = (
        correlations(&of_truth["all"]["relief"]),
        correlations(&of_halves["relief"]),
    );
    assert!(halves.len() >= 4, "{of_halves}");
    for (of_truth, of_halves) in true_ones.iter().zip(&halves) {
        assert!(
            (of_truth - of_halves).abs() < 0.1,
            "{true_ones:?} {halves:?}"
        );
    }
    assert!(of_halves["resolved"]["wavelength_px"].is_f64());
    assert_eq!(of_halves["halves"][1][0], "IMG_0002");
    assert_eq!(of_halves["unit"], "metre");
    // The evaluation against the truth stays beside that of the halves.
    let page = std::fs::read_to_string(run_dir.join("report.html")).expect("a report");
    assert!(page.contains("id=\"accuracy\"") && page.contains("id=\"halves\""));
}

#[test]
fn the_result_is_accurate() {
    let _alone = alone();
    let run_dir = reference();
    let truth = synthetic_set().join("truth");
    let evaluate = |truth: &Path, align: &str| -> (serde_json::Value, String) {
        let stdout = done(&[
            "evaluate",
            arg(run_dir),
            "--truth",
            arg(truth),
            "--align",
            align,
            "--json",
        ]);
        (serde_json::from_str(&stdout).expect("JSON"), stdout)
    };
    // Normals alone, as photometric data sets tell them: no frame to align, no depth.
    let normals = tempfile::tempdir().expect("a folder");
    for view in 1..=4 {
        let name = format!("IMG_{view:04}_normal.exr");
        std::fs::copy(truth.join(&name), normals.path().join(&name)).expect("a true normal map");
    }
    let (of_normals, _) = evaluate(normals.path(), "none");
    assert!(of_normals["all"]["depth_median_rel"].is_null());
    assert!(of_normals["all"]["reasons"]["depth_median_rel"].is_string());

    // Poses alone, and a surface alone in the run's own frame.
    for (file, known, unknown) in [
        ("cameras.json", "poses", "cloud"),
        ("mesh.ply", "cloud", "poses"),
    ] {
        let part = tempfile::tempdir().expect("a folder");
        std::fs::copy(truth.join(file), part.path().join(file)).expect("a file of the truth");
        let (found, stdout) = evaluate(part.path(), "auto");
        assert!(
            found[known].is_object() && found[unknown].is_null(),
            "{stdout}"
        );
        assert!(found["all"].is_null(), "{stdout}");
    }

    let (found, stdout) = evaluate(&truth, "sim3");
    let difference = found["all"]["normal_mae_deg"].as_f64().unwrap_or(f64::NAN)
        - of_normals["all"]["normal_mae_deg"]
            .as_f64()
            .unwrap_or(f64::NAN);
    assert!(difference.abs() < 0.5, "{difference}\n{of_normals}");
    let number = |path: &str| found.pointer(path).and_then(|v| v.as_f64());
    let check = |path: &str, low: f64, high: f64| {
        let value = number(path).unwrap_or(f64::NAN);
        assert!(
            (low..=high).contains(&value),
            "{path} = {value}, expected {low} to {high}\n{stdout}"
        );
    };
    assert_eq!(number("/poses/num_cameras"), Some(4.0), "{stdout}");
    // The sphere gives the scale; a pixel covers 0.9 mm of the object.
    check("/scale", 0.99, 1.01);
    check("/poses/center_error_mean", 0.0, 1.0e-3);
    check("/poses/rotation_error_mean_deg", 0.0, 0.2);
    check("/all/complete", 0.9, 1.0);
    check("/all/normal_mae_deg", 0.0, 13.0);
    check("/all/depth_median_rel", 0.0, 0.002);
    check("/cloud/accuracy_median", 0.0, 0.6e-3);
    check("/cloud/completeness", 0.6, 1.0);
    for file in [
        "3_poses/cameras.json",
        "3_poses/sparse/points3D.txt",
        "4_lighting/lighting.json",
        "5_shading/depth/IMG_0001.exr",
        "5_shading/depth/IMG_0001.png",
        "5_shading/normal/IMG_0001.exr",
        "6_fusion/cloud.ply",
        "6_fusion/mesh.ply",
        "6_fusion/asset.glb",
        "6_fusion/asset/asset.obj",
        "6_fusion/asset/normal.png",
        "evaluation/deviation.ply",
        "report.json",
        "report.html",
    ] {
        assert!(run_dir.join(file).exists(), "{file} is missing");
    }
}

/// The verdict in a run directory's report, its level and reasons, and the codes of its findings.
fn verdict(run_dir: &Path) -> (serde_json::Value, Vec<String>) {
    let text = std::fs::read(run_dir.join("report.json")).expect("a report");
    let report: serde_json::Value = serde_json::from_slice(&text).expect("JSON");
    let findings = report["findings"].as_array().expect("findings");
    let codes = findings.iter().map(|finding| finding["code"].as_str());
    let codes = codes.map(|code| code.expect("a code").to_owned());
    (report["verdict"].clone(), codes.collect())
}

#[test]
fn the_verdict_is_good_of_a_good_set_and_not_of_one_without_masks() {
    let _alone = alone();
    let good = reference();
    let nothing = serde_json::json!({ "level": "good", "notes": [], "reasons": [] });
    assert_eq!(verdict(good), (nothing, Vec::new()));
    let said = reconstruct(&synthetic_set(), good, &[]);
    assert!(said.ends_with("verdict: good\n"), "{said}");

    let set = synthetic_set();
    let dir = tempfile::tempdir().expect("a folder");
    let run_dir = dir.path().join("run");
    let (photos, cameras) = (set.join("photos"), set.join("intrinsics.json"));
    let arguments = ["reconstruct", arg(&photos), "-o", arg(&run_dir), "--json"];
    let more = ["--cameras", arg(&cameras), "--until", "poses", "--strict"];
    let stdout = done(&[&arguments[..], &more[..]].concat());
    let (usable, codes) = verdict(&run_dir);
    assert_eq!(usable["level"], "usable", "{usable}");
    assert!(codes.iter().any(|code| code == "masks_none"), "{codes:?}");
    assert_eq!(
        usable["reasons"].as_array().map(Vec::len),
        Some(codes.len())
    );
    let last = stdout.lines().last().expect("events");
    let last: serde_json::Value = serde_json::from_str(last).expect("JSON");
    assert_eq!(last["event"], "finished");
    assert_eq!(last["verdict"], usable, "{last}");
}

#[test]
fn the_report_works_in_a_browser() {
    let _alone = alone();
    let run_dir = reference();
    let Some(seen) = browser::open(&run_dir.join("report.html")) else {
        not_tested("Chromium, to open the report in");
        return;
    };
    assert_eq!(seen.errors, Vec::<String>::new(), "console");
    let number = |key: &str| seen.facts[key].as_u64().unwrap_or(u64::MAX);
    assert!((8..1000).contains(&number("images")), "{}", seen.facts);
    assert_eq!(seen.facts["failed"], serde_json::json!([]));
    assert_eq!(number("withoutAlt"), 0, "{}", seen.facts);
    // Shaded surface has many tones; an empty canvas has one.
    assert!((50..1 << 24).contains(&number("colors")), "{}", seen.facts);
    assert_eq!(seen.facts["wide"], false, "scrolls sideways");
    let size = std::fs::metadata(run_dir.join("report.html")).map_or(u64::MAX, |m| m.len());
    assert!(size < 25_000_000 / 2, "{size} bytes for four views");
}

#[test]
fn a_second_run_does_nothing_within_two_seconds() {
    let _alone = alone();
    let run_dir = reference();
    let began = Instant::now();
    let said = reconstruct(&synthetic_set(), run_dir, &[]);
    assert!(
        began.elapsed() < Duration::from_secs(2),
        "{:?}",
        began.elapsed()
    );
    assert!(said.contains("nothing to do"), "{said}");
}

#[test]
fn too_little_memory_is_told_with_what_would_do() {
    let _alone = alone();
    let expected = small_reference();
    let dir = tempfile::tempdir().unwrap();
    let run_dir = dir.path().join("run");
    copy_of(expected, &run_dir);
    let redo = |memory: &str| run(&["run", "5_shading", arg(&run_dir), "--memory", memory]);
    let (code, _, told) = redo("2M");
    assert_eq!(code, 3, "{told}");
    let (_, number) = told.split_once("give it --memory ").expect(&told);
    let number = number.split('M').next().unwrap();
    assert!(number.parse::<u64>().unwrap() > 2, "{told}");
    // What was there stays.
    assert_eq!(differences(expected, &run_dir), Vec::<String>::new());
    let (code, _, told) = redo(&format!("{number}M"));
    assert_eq!(code, 0, "{told}");
    assert_eq!(differences(expected, &run_dir), Vec::<String>::new());
}

#[test]
fn one_thread_gives_the_same_bytes() {
    let _alone = alone();
    let dir = tempfile::tempdir().unwrap();
    let run_dir = dir.path().join("run");
    reconstruct_small(&run_dir, &["--threads", "1"]);
    assert_eq!(
        differences(small_reference(), &run_dir),
        Vec::<String>::new()
    );
}

/// Starts the program, and returns when it has reported an event of this kind in a stage so many times; `false` when it
/// ended before.
fn started_until(arguments: &[String], (kind, stage, times): (&str, &str, usize)) -> (Child, bool) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_rilievo"))
        .args(arguments)
        .arg("--json")
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    let lines = BufReader::new(child.stdout.take().expect("its output")).lines();
    let is_such = |line: std::io::Result<String>| {
        let event: serde_json::Value = serde_json::from_str(&line.ok()?).ok()?;
        let of_this_run = event["reused"] != true;
        Some(of_this_run && event["event"] == kind && event["stage"] == stage)
    };
    let reached = lines
        .filter_map(is_such)
        .filter(|such| *such)
        .nth(times - 1);
    (child, reached.is_some())
}

#[test]
fn killed_at_many_points_the_run_ends_with_the_same_bytes() {
    let _alone = alone();
    let expected = small_reference();
    let dir = tempfile::tempdir().unwrap();
    let run_dir = dir.path().join("run");
    let arguments = small_arguments(&run_dir);
    let stages = [
        "1_photos",
        "2_features",
        "3_poses",
        "4_lighting",
        "5_shading",
        "6_fusion",
    ];
    let mut points = Vec::new();
    for stage in stages {
        points.extend([("stage_started", stage, 1), ("progress", stage, 2)]);
        if stage == "5_shading" {
            points.extend([10, 5, 20, 40].map(|times| ("progress", stage, times)));
        }
        points.push(("stage_finished", stage, 1));
    }
    let mut num_kills = 0;
    for point in points {
        let (mut child, reached) = started_until(&arguments, point);
        // SIGKILL: nothing of the program runs any more.
        child.kill().expect("a child can be killed");
        let status = child.wait().expect("a child can be waited for");
        num_kills += usize::from(reached && status.code().is_none());
    }
    // A short step may be over before it has made progress twice.
    assert!(num_kills >= 14, "{num_kills}");
    reconstruct_small(&run_dir, &[]);
    assert_eq!(differences(expected, &run_dir), Vec::<String>::new());
    assert!(!run_dir.join(".work").exists(), "no leftovers");
}

#[test]
fn ctrl_c_ends_soon_and_leaves_a_resumable_run() {
    let _alone = alone();
    let dir = tempfile::tempdir().unwrap();
    let run_dir = dir.path().join("run");
    let point = ("progress", "5_shading", 3);
    let arguments = reconstruct_arguments(&synthetic_set(), &run_dir);
    let (mut child, reached) = started_until(&arguments, point);
    assert!(reached, "the run ended before it could be interrupted");
    // The shell's own `kill` is everywhere; the program of that name is not.
    let interrupt = format!("kill -INT {}", child.id());
    let sent = Command::new("sh").args(["-c", &interrupt]).status();
    assert!(sent.is_ok_and(|status| status.success()));
    let asked = Instant::now();
    let status = child.wait().expect("a child can be waited for");
    assert_eq!(status.code(), Some(130));
    assert!(
        asked.elapsed() < Duration::from_secs(10),
        "{:?}",
        asked.elapsed()
    );
    let (code, status, _) = run(&["status", arg(&run_dir)]);
    assert_eq!(code, 0);
    assert!(status.contains("1_photos     valid"), "{status}");
}

/// Whether two texts mean the same: white space, and the digits of a number beyond its precision, mean nothing.
fn is_same_json(one: &[u8], other: &[u8]) -> bool {
    let parse = |text| serde_json::from_slice::<serde_json::Value>(text).ok();
    parse(one).is_some_and(|value| Some(value) == parse(other))
}

#[test]
fn a_flipped_bit_anywhere_is_found_and_never_told_as_a_result() {
    let _alone = alone();
    let expected = small_reference();
    let dir = tempfile::tempdir().unwrap();
    let run_dir = dir.path().join("run");
    copy_of(expected, &run_dir);
    reconstruct_small(&run_dir, &[]);
    let mut files = Vec::new();
    let mut folders = vec![run_dir.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            if entry.path().is_dir() {
                folders.push(entry.path());
            } else if entry.metadata().unwrap().len() > 0 {
                files.push(entry.path());
            }
        }
    }
    files.sort();
    files.retain(|file| !file.starts_with(run_dir.join("evaluation")));
    let mut num_flips = 0;
    for (index, file) in files.iter().enumerate() {
        let whole = std::fs::read(file).unwrap();
        // First, last, and places in between that differ from file to file.
        for place in [0.0, 0.31, 0.57, 0.83, 1.0] {
            let last = (whole.len() - 1) as f64;
            let shift = (97 * index) as f64 * place * (1.0 - place);
            let at = (place * last + shift).min(last) as usize;
            let mut bytes = whole.clone();
            bytes[at] ^= 1 << (index % 8);
            std::fs::write(file, &bytes).unwrap();
            num_flips += 1;
            let what = format!("bit {} of byte {at} of {}", index % 8, file.display());
            if file.parent() == Some(&run_dir) {
                let said = reconstruct_small(&run_dir, &[]);
                assert!(std::fs::read(file).unwrap() == whole, "{what}: {said}");
            } else {
                let (code, stdout, _) = run(&["status", arg(&run_dir), "--verify"]);
                let is_manifest = file.file_name().is_some_and(|name| name == "manifest.json");
                assert!(
                    code == 5 && stdout.contains("damaged")
                        || is_manifest && is_same_json(&bytes, &whole),
                    "{what}: {stdout}"
                );
                std::fs::write(file, &whole).unwrap();
            }
        }
    }
    assert!(num_flips >= 200, "{num_flips}");
    // What is damaged is made again, and what follows from it stays.
    for (file, stage) in [
        ("1_photos/linear/IMG_0002.exr", "1_photos"),
        ("2_features/pairs.bin", "2_features"),
        ("3_poses/posed_views.json", "3_poses"),
        ("4_lighting/calibration.json", "4_lighting"),
        ("6_fusion/cloud.ply", "6_fusion"),
    ] {
        let path = run_dir.join(file);
        let mut bytes = std::fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 4;
        std::fs::write(&path, bytes).unwrap();
        let said = reconstruct_small(&run_dir, &[]);
        assert!(
            said.contains(&format!("{stage}: redoing, because it is damaged")),
            "{said}"
        );
        assert_eq!(
            differences(expected, &run_dir),
            Vec::<String>::new(),
            "{file}"
        );
    }
}
