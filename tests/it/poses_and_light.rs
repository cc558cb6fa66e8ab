//! What stages 3 and 4 leave in the run directory for people and other programs, with a sphere,
//! without one, and with a distance that was measured.

use crate::common;

use common::{arg, done, json_of, reconstruct_arguments, run, synthetic_set};
use serde_json::Value;
use std::path::Path;

fn until_lighting(run_dir: &Path, sphere: bool, more: &[&str]) -> (i32, String) {
    let set = synthetic_set();
    let mut arguments = reconstruct_arguments(&set, run_dir);
    if !sphere {
        let at = arguments.iter().position(|a| a == "--sphere").unwrap();
        arguments.drain(at..at + 2);
    }
    arguments.extend(more.iter().map(|&a| a.to_owned()));
    arguments.extend(["--until".to_owned(), "4_lighting".to_owned()]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (code, _, stderr) = run(&arguments);
    (code, stderr)
}

#[test]
fn anchors_and_sphere_pictures_are_written_and_shown() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stderr) = until_lighting(folder.path(), true, &[]);
    assert_eq!(code, 0, "{stderr}");
    let table = json_of(&folder.path().join("3_poses/anchors.json"));
    let anchors = table["anchors"].as_array().unwrap();
    assert!(anchors.len() > 50, "{} anchors", anchors.len());
    assert_eq!(table["unit"], "metre");
    assert_eq!(table["views"].as_array().unwrap().len(), 4);
    let cloud = std::fs::read(folder.path().join("3_poses/anchors.ply")).unwrap();
    let header = String::from_utf8_lossy(&cloud[..400.min(cloud.len())]).into_owned();
    assert!(
        header.contains(&format!("element vertex {}\n", anchors.len())),
        "{header}"
    );
    let overlays = std::fs::read_dir(folder.path().join("4_lighting/overlay")).unwrap();
    assert_eq!(overlays.count(), 4);
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    for part in [
        "anchors.json",
        "depth anchors",
        "Reference sphere",
        "upwards in the world",
    ] {
        assert!(page.contains(part), "the page lacks {part}");
    }
    assert!(!page.contains("Uncalibrated"));
}

#[test]
fn without_a_sphere_the_light_is_marked_and_a_distance_gives_the_size() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stderr) = until_lighting(
        folder.path(),
        false,
        &["--known-distance", "IMG_0001.jpg,IMG_0004,0.5"],
    );
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("uncalibrated"), "{stderr}");
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(page.contains("Uncalibrated"));
    let report = json_of(&folder.path().join("report.json"));
    let scale = &report["stages"]["3_poses"]["report"]["scale"];
    assert_eq!(scale["source"], "known_distance", "{scale}");
    assert!(scale["relative_sigma"].as_f64().unwrap() < 0.01, "{scale}");
    let cameras = json_of(&folder.path().join("3_poses/cameras.json"));
    let center = |k: usize| -> Vec<f64> {
        let values = cameras["cameras"][k]["camera_center"].as_array().unwrap();
        values.iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let (first, last) = (center(0), center(3));
    let squares: f64 = first.iter().zip(&last).map(|(a, b)| (a - b).powi(2)).sum();
    let distance = squares.sqrt();
    assert!((distance - 0.5).abs() < 1e-9, "{distance}");
}

#[test]
fn a_known_distance_that_names_no_photo_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stderr) = until_lighting(
        folder.path(),
        false,
        &["--known-distance", "IMG_0001.jpg,IMG_0099.jpg,0.5"],
    );
    assert_eq!(code, 4, "{stderr}");
    assert!(stderr.contains("IMG_0099.jpg"), "{stderr}");
    let (code, _, stderr) = run(&[
        "reconstruct",
        arg(&synthetic_set().join("photos")),
        "-o",
        arg(folder.path()),
        "--known-distance",
        "IMG_0001.jpg,0.5",
    ]);
    assert_eq!(code, 2, "{stderr}");
}

/// Mean error of all normals, degrees.
fn normal_error(run_dir: &Path, truth: &Path) -> f64 {
    let stdout = done(&["evaluate", arg(run_dir), "--truth", arg(truth), "--json"]);
    let found: Value = serde_json::from_str(&stdout).unwrap();
    found["all"]["normal_mae_deg"].as_f64().unwrap()
}

/// A lighting file as seen in a mirror that swaps left with right and up with down.
fn mirrored(lighting: &Path, to: &Path) {
    let mut file = json_of(lighting);
    for rows in file["views"].as_object_mut().unwrap().values_mut() {
        for row in rows.as_array_mut().unwrap() {
            for odd in [0, 1, 5, 6] {
                let value = row[odd].as_f64().unwrap();
                row[odd] = (-value).into();
            }
        }
    }
    std::fs::write(to, file.to_string()).unwrap();
}

#[test]
fn a_given_light_lights_the_surface_and_one_that_the_photos_contradict_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run_dir = folder.path().join("run");
    let shaded = |set: &Path, light: [&str; 2], more: &[&str]| {
        let [photos, masks] = ["photos", "masks"].map(|name| set.join(name));
        let cameras = set.join("truth/cameras.json");
        let mut arguments = vec!["reconstruct", arg(&photos), "-o", arg(&run_dir)];
        arguments.extend(["--masks", arg(&masks), "--cameras", arg(&cameras)]);
        arguments.extend(["--until", "5_shading", "--overwrite"]);
        arguments.extend(light);
        arguments.extend(more);
        let (code, _, stderr) = run(&arguments);
        (code, stderr)
    };
    // One small scene tells both apart only to a percent.
    let (mut by_sphere, mut by_file) = (0.0, 0.0);
    let sets = ["2", "1"].map(|seed| {
        let set = folder.path().join(seed);
        done(&[
            "synth",
            arg(&set),
            "--views",
            "3",
            "--size",
            "240x180",
            "--seed",
            seed,
        ]);
        let truth = set.join("truth");
        for (light, error) in [
            (["--sphere", arg(&set.join("sphere.json"))], &mut by_sphere),
            (
                ["--lighting", arg(&truth.join("lighting.json"))],
                &mut by_file,
            ),
        ] {
            let (code, stderr) = shaded(&set, light, &[]);
            assert_eq!(code, 0, "{stderr}");
            *error += 0.5 * normal_error(&run_dir, &truth);
        }
        set
    });
    println!("normals {by_sphere:.2} deg by the sphere, {by_file:.2} deg by the true light");
    assert!(
        by_file < 1.01 * by_sphere,
        "{by_file}, by the sphere {by_sphere}"
    );

    let set = &sets[1];
    let truth = set.join("truth");
    let by_file = normal_error(&run_dir, &truth);
    let wrong = folder.path().join("mirrored.json");
    mirrored(&truth.join("lighting.json"), &wrong);
    let (code, stderr) = shaded(set, ["--lighting", arg(&wrong)], &[]);
    assert_eq!(code, 4, "{stderr}");
    for part in ["IMG_0001 (", "3 of 3 views", "--trust-lighting"] {
        assert!(stderr.contains(part), "{stderr} lacks {part}");
    }
    let (code, stderr) = shaded(set, ["--lighting", arg(&wrong)], &["--trust-lighting"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("contradicts the photos"), "{stderr}");
    let trusted = normal_error(&run_dir, &truth);
    assert!(
        trusted > 1.1 * by_file,
        "{trusted}, by the true light {by_file}"
    );
}
