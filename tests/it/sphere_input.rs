//! What is wrong with a reference sphere is told with file, reason and remedy, and what is right goes on.

use crate::common;

use common::{
    arg, done, json_of, noise_photos, reconstruct_until, reconstructed_until, run, synthetic_set,
};
use rilievo_io::{decode_photo, read_mask, write_mask, write_photo_jpeg};
use rilievo_scene::{LinearImage, Mask};
use serde_json::{Value, json};
use std::path::PathBuf;

/// A copy of the synthetic set whose photos, masks, cameras and sphere file may be spoilt.
struct Set {
    folder: tempfile::TempDir,
}

impl Set {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let source = synthetic_set();
        for kind in ["photos", "masks", "sphere_masks"] {
            let target = folder.path().join(kind);
            std::fs::create_dir(&target).unwrap();
            for entry in std::fs::read_dir(source.join(kind)).unwrap().flatten() {
                std::fs::copy(entry.path(), target.join(entry.file_name())).unwrap();
            }
        }
        for file in ["intrinsics.json", "sphere.json", "truth/cameras.json"] {
            let target = folder.path().join(file);
            std::fs::create_dir_all(target.parent().unwrap()).unwrap();
            std::fs::copy(source.join(file), target).unwrap();
        }
        Self { folder }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// The light of the set under a sphere file; exit code and what stderr says.
    fn light(&self, cameras: &str, sphere: &Value) -> (i32, String) {
        let file = self.path("marks.json");
        std::fs::write(&file, sphere.to_string()).unwrap();
        let (code, _, stderr) = reconstruct_until(
            "4_lighting",
            &self.path("photos"),
            &self.path("run"),
            &[
                "--masks",
                arg(&self.path("masks")),
                "--cameras",
                arg(&self.path(cameras)),
                "--sphere",
                arg(&file),
            ],
        );
        (code, stderr)
    }

    /// What stage 4 says of a view.
    fn view(&self, name: &str) -> Value {
        let report = json_of(&self.path("run/report.json"));
        let views = report["stages"]["4_lighting"]["report"]["views"].clone();
        let found = views.as_array().unwrap().iter().find(|v| v["name"] == name);
        found.unwrap().clone()
    }

    fn sphere_mask(&self, view: usize) -> Mask {
        read_mask(&self.path(&format!("sphere_masks/IMG_000{view}.png"))).unwrap()
    }

    /// Changes a photo.
    fn repaint(&self, view: usize, change: impl FnOnce(LinearImage) -> LinearImage) {
        let file = self.path(&format!("photos/IMG_000{view}.jpg"));
        let encoding = rilievo_photos::PhotosOptions::default().encoding;
        let decoded = decode_photo(&file).unwrap();
        let (image, _) = rilievo_photos::linearize(&decoded, encoding);
        write_photo_jpeg(&file, &change(image), 95).unwrap();
    }

    /// Circles of the sphere's masks, as marks of a sphere file.
    fn circles(&self) -> Value {
        let mut views = serde_json::Map::new();
        for view in 1..=4 {
            let mask = self.sphere_mask(view);
            let (mut x, mut y, mut count) = (0.0, 0.0, 0.0_f64);
            for v in 0..mask.height {
                for u in (0..mask.width).filter(|&u| *mask.at(u, v)) {
                    (x, y, count) = (x + u as f64, y + v as f64, count + 1.0);
                }
            }
            let radius = (count / std::f64::consts::PI).sqrt();
            let circle = json!({"circle": [x / count, y / count, radius]});
            views.insert(format!("IMG_000{view}.jpg"), circle);
        }
        json!({"radius": 0.03, "unit": "metre", "light": "world", "views": views})
    }
}

fn told(stderr: &str, parts: &[&str]) {
    let line = stderr
        .lines()
        .find(|line| parts.iter().all(|part| line.contains(part)));
    assert!(line.is_some(), "no line has all of {parts:?} in: {stderr}");
}

/// A circle where there is no sphere.
fn elsewhere() -> Value {
    json!({"circle": [100, 60, 30]})
}

#[test]
fn a_radius_that_no_sphere_has_is_refused_before_anything_is_computed() {
    let folder = tempfile::tempdir().unwrap();
    let photos = noise_photos(folder.path(), 2);
    let file = folder.path().join("ball.json");
    let views = json!({"p0.jpg": {"circle": [80, 60, 20]}});
    for (radius, reason) in [
        (None, "\"radius\" is missing: measure the sphere"),
        (Some(json!(0)), "radius: 0 is not greater than zero"),
        (Some(json!(-0.03)), "radius: -0.03 is not greater than zero"),
        (
            Some(json!("3 cm")),
            "radius: \"3 cm\" is not a finite number",
        ),
    ] {
        let mut sphere = json!({"views": views});
        if let Some(radius) = radius {
            sphere["radius"] = radius;
        }
        std::fs::write(&file, sphere.to_string()).unwrap();
        let more = ["--sphere", arg(&file)];
        let (code, _, stderr) =
            reconstruct_until("1_photos", &photos, &folder.path().join("run"), &more);
        assert_eq!(code, 3, "{stderr}");
        told(&stderr, &["ball.json", reason]);
    }
    for (more, reason) in [
        (vec!["--sphere", "auto"], "needs --sphere-radius METRES"),
        (
            vec!["--sphere", "auto", "--sphere-radius", "0"],
            "--sphere-radius 0 must be a positive length in metres",
        ),
        (
            vec!["--sphere", "auto", "--sphere-radius", "-1"],
            "--sphere-radius -1 must be a positive length in metres",
        ),
    ] {
        let mut arguments = vec!["reconstruct", arg(&photos), "-o", arg(folder.path())];
        arguments.extend(more);
        let (code, _, stderr) = run(&arguments);
        assert_eq!(code, 2, "{stderr}");
        told(&stderr, &[reason]);
    }
}

#[test]
fn what_cannot_be_a_sphere_is_refused_with_its_place_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let photos = noise_photos(folder.path(), 2);
    let file = folder.path().join("ball.json");
    write_mask(
        &folder.path().join("none.png"),
        &Mask::filled(160, 120, false),
    )
    .unwrap();
    let line = [[20, 40], [30, 40], [40, 40], [50, 40], [60, 40]];
    let one_place = [[20, 40]; 5];
    let arc = [[110, 60], [109, 66], [107, 73], [104, 79], [100, 85]];
    let circle = json!({"circle": [80, 60, 20]});
    let marked = |points: Value| json!({"radius": 0.03, "views": {"p0.jpg": {"points": points}, "p1.jpg": circle}});
    let many = vec![json!({"views": {"p0.jpg": circle}}); 300];
    for (sphere, parts) in [
        (
            marked(json!(line)),
            [
                "the sphere in p0.jpg (views.p0.jpg.points)",
                "determine no ellipse",
                "all around",
            ],
        ),
        (
            marked(json!(one_place)),
            [
                "the sphere in p0.jpg",
                "1 different outline points",
                "all around",
            ],
        ),
        (
            marked(json!(arc)),
            ["the sphere in p0.jpg", "a short arc", "all around"],
        ),
        (
            json!({"radius": 0.03, "views": {"p0.jpg": {"mask": "none.png"}}}),
            [
                "no mark of the sphere is left",
                "none.png",
                "0 white pixels",
            ],
        ),
        (
            json!({"radius": 0.03, "views": {"p0.jpg": circle}, "center": [1e300, 0, 0]}),
            ["ball.json", "center", "no place beside the object"],
        ),
        (
            json!({"radius": 1e300, "views": {"p0.jpg": circle}}),
            ["ball.json", "radius", "no sphere's radius"],
        ),
        (
            json!({"radius": 0.03, "spheres": many}),
            ["ball.json", "300 spheres", "64 at most"],
        ),
    ] {
        std::fs::write(&file, sphere.to_string()).unwrap();
        let more = ["--sphere", arg(&file)];
        let run = folder.path().join("run");
        let (code, _, stderr) = reconstruct_until("1_photos", &photos, &run, &more);
        assert_eq!(code, 3, "{stderr}");
        told(&stderr, &parts);
    }
}

#[test]
fn cameras_at_one_place_and_lenses_that_cannot_be_are_named_as_such() {
    let set = Set::new();
    let sphere = set.circles();
    let spoilt = |file: &str, change: &dyn Fn(&mut Value)| {
        let mut cameras = json_of(&set.path(file));
        change(&mut cameras["cameras"]);
        std::fs::write(set.path("spoilt.json"), cameras.to_string()).unwrap();
        set.light("spoilt.json", &sphere)
    };
    let (code, stderr) = spoilt("truth/cameras.json", &|cameras| {
        let first = cameras[0]["camera_center"].clone();
        for camera in cameras.as_array_mut().unwrap() {
            camera["camera_center"] = first.clone();
        }
    });
    assert_eq!(code, 4, "{stderr}");
    told(
        &stderr,
        &["cameras all stand at one place", "determine no depth"],
    );
    assert!(!stderr.contains("sphere"), "{stderr}");
    for focal in [1e300, 1e-300] {
        let (code, stderr) = spoilt("intrinsics.json", &|cameras| {
            cameras[1]["K"][0][0] = json!(focal);
            cameras[1]["K"][1][1] = json!(focal);
        });
        assert_eq!(code, 3, "{stderr}");
        let value = format!("{focal:e} pixels");
        told(
            &stderr,
            &["spoilt.json", "IMG_0002.jpg", &value, "48 to 48000"],
        );
    }
}

#[test]
fn a_stated_centre_is_compared_with_the_marks_and_needs_a_frame_and_a_view() {
    let set = Set::new();
    let truth = json_of(&set.path("truth/cameras.json"))["sphere"]["center"].clone();
    let place: Vec<f64> = serde_json::from_value(truth.clone()).unwrap();
    let mut sphere = set.circles();
    sphere["center"] = truth;
    let (code, stderr) = set.light("truth/cameras.json", &sphere);
    assert_eq!(code, 0, "{stderr}");
    assert!(!stderr.contains("stated centre"), "{stderr}");
    sphere["center"] = json!([place[0] + 0.3, place[1], place[2]]);
    let (code, stderr) = set.light("truth/cameras.json", &sphere);
    assert_eq!(code, 0, "{stderr}");
    let figures = [
        "the stated centre of the sphere",
        "lies 0.30",
        "times its radius",
    ];
    told(&stderr, &figures);
    let (code, stderr) = set.light("intrinsics.json", &sphere);
    assert_eq!(code, 0, "{stderr}");
    told(
        &stderr,
        &[
            "the stated centre of the sphere is not used",
            "its marks are used",
        ],
    );
    for (cameras, center, reason) in [
        (
            "truth/cameras.json",
            json!([0, 0, 50]),
            "in the frame of none of the 4 cameras",
        ),
        (
            "intrinsics.json",
            json!(place),
            "stated in the frame of given cameras",
        ),
    ] {
        let (code, stderr) = set.light(cameras, &json!({"radius": 0.03, "center": center}));
        assert_eq!(code, 4, "{stderr}");
        told(&stderr, &["error: no reference sphere was located", reason]);
    }
}

#[test]
fn marks_that_follow_no_sphere_are_told_and_an_empty_mask_stops_nothing() {
    let set = Set::new();
    let good = set.circles();
    let (code, stderr) = set.light("intrinsics.json", &good);
    assert_eq!(code, 0, "{stderr}");
    assert!(!stderr.contains("outline no matte sphere"), "{stderr}");
    for factor in [0.7, 1.3, 1.6] {
        let mut scaled = good.clone();
        for mark in scaled["views"].as_object_mut().unwrap().values_mut() {
            mark["circle"][2] = json!(mark["circle"][2].as_f64().unwrap() * factor);
        }
        let (_, stderr) = set.light("intrinsics.json", &scaled);
        let parts = [
            "marks of the sphere outline no matte sphere",
            "edge along",
            "unexplained",
        ];
        told(&stderr, &parts);
    }
    let mut masks = good;
    let none = Mask::filled(480, 360, false);
    write_mask(&set.path("none.png"), &none).unwrap();
    masks["views"]["IMG_0002.jpg"] = json!({"mask": "none.png"});
    let (code, stderr) = set.light("intrinsics.json", &masks);
    assert_eq!(code, 0, "{stderr}");
    told(
        &stderr,
        &["none.png", "0 white pixels", "the other marks go on"],
    );
}

#[test]
fn wrong_marks_are_left_out_by_name_and_the_others_go_on() {
    let set = Set::new();
    let square = Mask::from_fn(480, 360, |x, y| {
        (50..250).contains(&x) && (100..160).contains(&y)
    });
    write_mask(&set.path("square.png"), &square).unwrap();
    let good = set.circles();
    let spoilt = |photo: &str, mark: Value| {
        let mut sphere = good.clone();
        sphere["views"][photo] = mark;
        sphere
    };
    for (sphere, parts) in [
        (
            spoilt("IMG_0001.jpg", json!({"mask": "square.png"})),
            vec![
                "IMG_0001.jpg: the mark of the sphere is left out",
                "not the outline of a sphere",
            ],
        ),
        (
            spoilt("IMG_0002.jpg", elsewhere()),
            vec![
                "IMG_0002.jpg: the mark of the sphere is left out",
                "px from the sphere that the other photos agree on",
            ],
        ),
        (
            spoilt("DSC_0009.jpg", elsewhere()),
            vec!["marked in photos that are not used", "DSC_0009.jpg"],
        ),
        (
            {
                let mut sphere = good.clone();
                sphere["light"] = json!("camera");
                sphere
            },
            vec![
                "stated as fixed to the camera",
                "it is fixed in the world (\"world\")",
            ],
        ),
    ] {
        let (code, stderr) = set.light("intrinsics.json", &sphere);
        assert_eq!(code, 0, "{stderr}");
        told(&stderr, &parts);
        let poses = json_of(&set.path("run/report.json"))["stages"]["3_poses"]["report"].clone();
        assert_eq!(poses["scale"]["source"], "sphere", "{poses}");
        for view in 1..=4 {
            let facts = set.view(&format!("IMG_000{view}"));
            assert!(facts["left_out"].is_null(), "{facts}");
        }
    }
}

#[test]
fn marks_that_fix_nothing_end_with_the_reason_and_a_remedy() {
    let set = Set::new();
    let good = set.circles();
    let only = |views: Value| json!({"radius": 0.03, "views": views});
    let square: Vec<[usize; 2]> = (0..40)
        .map(|k| [100 + 5 * (k % 20), 80 + 90 * (k / 20)])
        .collect();
    for (sphere, parts) in [
        (
            only(json!({"IMG_0001.jpg": {"points": square}, "IMG_0003.jpg": {"points": square}})),
            vec![
                "not the outline of a sphere",
                "marked in IMG_0001.jpg, IMG_0003.jpg",
            ],
        ),
        (
            only(
                json!({"IMG_0001.jpg": good["views"]["IMG_0001.jpg"], "IMG_0002.jpg": elsewhere()}),
            ),
            vec!["contradict each other", "the worst is IMG_000"],
        ),
        (
            only(json!({"IMG_0001.jpg": good["views"]["IMG_0001.jpg"]})),
            vec!["in one posed photo only", "mark it in a second photo"],
        ),
        (
            only(json!({"DSC_0001.jpg": elsewhere(), "DSC_0002.jpg": elsewhere()})),
            vec!["photos that are not used: DSC_0001.jpg, DSC_0002.jpg"],
        ),
    ] {
        let (code, stderr) = set.light("intrinsics.json", &sphere);
        assert_eq!(code, 4, "{stderr}");
        let warning = [&["3_poses: warning:"], &parts[..]].concat();
        told(&stderr, &warning);
        // What the run ends with names the cause too.
        let end = ["error: no reference sphere was located", "--sphere none"];
        told(&stderr, &[&end, &parts[..]].concat());
        let report = json_of(&set.path("run/report.json"));
        let verdict = report["outcome"]["error"].as_str().unwrap();
        assert!(parts.iter().all(|part| verdict.contains(part)), "{verdict}");
    }
}

#[test]
fn a_radius_that_contradicts_given_poses_is_told() {
    let set = Set::new();
    let mut sphere = set.circles();
    sphere["radius"] = json!(0.003);
    let (code, stderr) = set.light("truth/cameras.json", &sphere);
    assert_eq!(code, 4, "{stderr}");
    let cause = ["stated as 0.0030 m", "give 0.0300 m", "check the radius"];
    told(&stderr, &cause);
    told(&stderr, &[&["error:"], &cause[..]].concat());
    // One mark cannot tell its radius, but where the sphere would stand.
    sphere["views"] = json!({"IMG_0001.jpg": sphere["views"]["IMG_0001.jpg"]});
    let (code, stderr) = set.light("truth/cameras.json", &sphere);
    assert_eq!(code, 0, "{stderr}");
    told(
        &stderr,
        &["times the distance of the scene", "its radius (0.0030)"],
    );
}

#[test]
fn a_radius_that_is_likely_in_another_unit_and_one_that_is_not_used_are_told() {
    let set = Set::new();
    let file = set.path("marks.json");
    std::fs::write(&file, set.circles().to_string()).unwrap();
    let stderr = reconstructed_until(
        "3_poses",
        &set.path("photos"),
        &set.path("run"),
        &[
            "--masks",
            arg(&set.path("masks")),
            "--cameras",
            arg(&set.path("intrinsics.json")),
            "--sphere",
            arg(&file),
            "--sphere-radius",
            "30",
        ],
    );
    told(&stderr, &["the sphere is stated as 30 m", "in metres?"]);
    told(
        &stderr,
        &[
            "--sphere-radius 30 is used, not the radius 0.03",
            "marks.json",
        ],
    );
}

#[test]
fn a_sphere_that_is_clipped_hidden_or_cut_in_some_photos_serves_from_the_others() {
    let set = Set::new();
    // Clipped in the first photo.
    let ball = set.sphere_mask(1);
    set.repaint(1, |mut image| {
        for y in 0..image.height {
            for x in (0..image.width).filter(|&x| *ball.at(x, y)) {
                image.pixel_mut(x, y).fill(1.0);
            }
        }
        image
    });
    // Behind the object in the second.
    let ball = set.sphere_mask(2);
    set.repaint(2, |mut image| {
        for y in 0..image.height {
            for x in (0..image.width).filter(|&x| *ball.at(x, y)) {
                image.pixel_mut(x, y).fill(0.2);
            }
        }
        image
    });
    let file = set.path("masks/IMG_0002.png");
    let mut object = read_mask(&file).unwrap();
    for (inside, &hidden) in object.data.iter_mut().zip(&ball.data) {
        *inside |= hidden;
    }
    write_mask(&file, &object).unwrap();
    // Cut by the frame's right side in the third.
    let ball = set.sphere_mask(3);
    let columns: Vec<usize> = (0..ball.width)
        .filter(|&x| (0..ball.height).any(|y| *ball.at(x, y)))
        .collect();
    let width = columns[columns.len() * 3 / 5];
    set.repaint(3, |image| {
        let mut cut = LinearImage::filled(width, image.height, 3, 0.0);
        for y in 0..image.height {
            for x in 0..width {
                cut.pixel_mut(x, y).copy_from_slice(image.pixel(x, y));
            }
        }
        cut
    });
    let file = set.path("masks/IMG_0003.png");
    let whole = read_mask(&file).unwrap();
    let cut = Mask::from_fn(width, whole.height, |x, y| *whole.at(x, y));
    write_mask(&file, &cut).unwrap();
    let mut cameras = json_of(&set.path("intrinsics.json"));
    cameras["cameras"][2]["width"] = json!(width);
    std::fs::write(set.path("intrinsics.json"), cameras.to_string()).unwrap();

    let mut sphere = set.circles();
    let marks = sphere["views"].as_object_mut().unwrap();
    marks.remove("IMG_0002.jpg");
    let (code, stderr) = set.light("intrinsics.json", &sphere);
    assert_eq!(code, 0, "{stderr}");
    let clipped = set.view("IMG_0001");
    let reason = clipped["left_out"].as_str().unwrap_or_default();
    assert!(reason.contains("100 % clipped"), "{clipped}");
    let hidden = set.view("IMG_0002");
    assert!(hidden["left_out"].is_string(), "{hidden}");
    for name in ["IMG_0003", "IMG_0004"] {
        let facts = set.view(name);
        assert!(facts["left_out"].is_null(), "{facts}");
        let rms = facts["relative_rms"].as_f64().unwrap_or(f64::NAN);
        assert!(rms < 0.03, "{facts}");
    }
    let share = set.view("IMG_0003")["hidden_share"].as_f64().unwrap();
    assert!((0.2..0.6).contains(&share), "{share} outside the frame");
    let report = json_of(&set.path("run/report.json"));
    let scale = &report["stages"]["3_poses"]["report"]["scale"];
    assert_eq!(scale["source"], "sphere", "{scale}");
}

#[test]
fn two_spheres_are_both_used_and_what_is_wrong_with_one_is_told() {
    let set = Set {
        folder: tempfile::tempdir().unwrap(),
    };
    let beside = tempfile::tempdir().unwrap();
    let config = beside.path().join("two.toml");
    let scene = "[scene]\nmore_spheres = [{at_m = [-0.2, -0.05], radius_m = 0.025}]\n";
    std::fs::write(&config, scene).unwrap();
    done(&[
        "synth",
        arg(set.folder.path()),
        "--views",
        "4",
        "--size",
        "560x420",
        "--config",
        arg(&config),
    ]);
    let good = json_of(&set.path("sphere.json"));
    let (code, stderr) = set.light("intrinsics.json", &good);
    assert_eq!(code, 0, "{stderr}");
    assert!(!stderr.contains("one of the two radii"), "{stderr}");
    let report = json_of(&set.path("run/report.json"));
    let stages = &report["stages"];
    let scale = &stages["3_poses"]["report"]["scale"];
    assert_eq!(scale["source"], "sphere", "{scale}");
    let spheres = stages["4_lighting"]["report"]["spheres"]
        .as_array()
        .unwrap();
    let views: Vec<usize> = spheres
        .iter()
        .map(|s| s["views"].as_array().unwrap().len())
        .collect();
    assert_eq!(views, [4, 4], "{spheres:?}");
    assert_eq!(spheres[1]["name"], "sphere 2");

    let mut wrong = good.clone();
    wrong["spheres"][1]["radius"] = json!(1.05 * 0.025);
    let (code, stderr) = set.light("intrinsics.json", &wrong);
    assert_eq!(code, 0, "{stderr}");
    told(
        &stderr,
        &["the scale that sphere", "one of the two radii is wrong"],
    );

    let mut bad = good.clone();
    bad["spheres"][1]["views"]["IMG_0002.jpg"] = json!({"circle": [1, 2]});
    let (code, stderr) = set.light("intrinsics.json", &bad);
    assert_eq!(code, 3, "{stderr}");
    told(
        &stderr,
        &[
            "marks.json",
            "spheres[1].views.IMG_0002.jpg.circle: [1,2] has 2 numbers",
        ],
    );

    let mut gone = good;
    gone["spheres"][1]["views"] = json!({"DSC_0001.jpg": {"circle": [100, 60, 30]}});
    let (code, stderr) = set.light("intrinsics.json", &gone);
    assert_eq!(code, 0, "{stderr}");
    told(&stderr, &["sphere 2 was not located, the others go on"]);
}
