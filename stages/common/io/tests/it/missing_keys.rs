//! Every JSON file with one of its keys or list entries left out, wherever it stands: read, or refused
//! with a message that names the file and the place.

// Helpers of the tests may fail as the tests do.
use rilievo_io::{self as io, CameraFormat, IoError};
use serde_json::Value;
use std::path::Path;

/// Paths of all members and entries of a value.
fn places(value: &Value, at: &str, found: &mut Vec<String>) {
    let children: Vec<(String, &Value)> = match value {
        Value::Object(object) => object.iter().map(|(k, v)| (k.clone(), v)).collect(),
        Value::Array(list) => (0..).map(|i: usize| i.to_string()).zip(list).collect(),
        _ => return,
    };
    for (key, child) in children {
        let place = format!("{at}/{}", key.replace('~', "~0").replace('/', "~1"));
        places(child, &place, found);
        found.push(place);
    }
}

fn without(whole: &Value, place: &str) -> Value {
    let mut value = whole.clone();
    let (parent, key) = place.rsplit_once('/').unwrap();
    match value.pointer_mut(parent).unwrap() {
        Value::Object(object) => drop(object.remove(&key.replace("~1", "/").replace("~0", "~"))),
        Value::Array(list) => drop(list.remove(key.parse().unwrap())),
        _ => unreachable!("only these have children"),
    }
    value
}

/// Leaves out each part of a file; how many of the files were refused.
fn leave_out(name: &str, text: &str, read: impl Fn(&Path) -> Result<(), IoError>) -> usize {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let whole: Value = serde_json::from_str(text).unwrap();
    std::fs::write(&path, text).unwrap();
    read(&path).unwrap();
    let mut found = Vec::new();
    places(&whole, "", &mut found);
    let mut num_refused = 0;
    let wrong = [Value::Null, "x".into(), (-1).into(), Value::Array(vec![])];
    for place in found {
        let replaced = wrong.iter().map(|wrong| {
            let mut value = whole.clone();
            *value.pointer_mut(&place).unwrap() = wrong.clone();
            value
        });
        for value in replaced.chain([without(&whole, &place)]) {
            std::fs::write(&path, value.to_string()).unwrap();
            if let Err(error) = read(&path) {
                let message = error.to_string();
                assert!(message.contains(name), "{place}: {message}");
                num_refused += 1;
            }
        }
    }
    num_refused
}

#[test]
fn what_is_missing_is_told_with_its_file() {
    let camera = r#""width": 4, "height": 3, "K": [[5,0,1],[0,5,1],[0,0,1]], "camera_center": [1,2,3],
        "distortion": {"model": "opencv", "coefficients": [0.1,0,0,0,0]},
        "world_from_camera_rotation": [[1,0,0],[0,1,0],[0,0,1]]"#;
    let cameras = format!(
        r#"{{"unit": "metre", "cameras": [{{"image": "a.jpg", {camera}}}, {{"image": "b.jpg", {camera}}}],
        "unregistered": [{{"image": "c.jpg", "reason": "none"}}]}}"#
    );
    let transforms = r#"{"camera_model": "OPENCV", "frames": [{"file_path": "a.png", "w": 4, "h": 3, "fl_x": 5,
        "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#;
    let sfm = r#"{"version": ["1", "2", "8"], "views": [{"viewId": "7", "poseId": "9", "intrinsicId": "5",
        "path": "a.png", "width": "64", "height": "48"}], "intrinsics": [{"intrinsicId": "5", "width": "64",
        "height": "48", "type": "pinhole", "sensorWidth": "32", "focalLength": "40", "pixelRatio": "1.125",
        "principalPoint": ["-2", "1"], "distortionParams": ""}], "poses": [{"poseId": "9", "pose":
        {"transform": {"rotation": ["0","1","0","-1","0","0","0","0","1"], "center": ["1","2","3"]}}}]}"#;
    let sphere = r#"{"unit": "metre", "light": "world", "spheres": [{"name": "s", "radius": 0.04, "views":
        {"b": {"ellipse": [1,2,5,4,90]}, "c": {"circle": [3,4,6]}, "p": {"points":
        [[0,0],[1,0],[2,1],[1,2],[0,1]]}}, "center": [0.1,0.2,0.3]}], "calibration": [{"image": "c.jpg",
        "same_camera_as": "b", "radius": 0.1, "circle": [3,4,6]}]}"#;
    let lighting = r#"{"basis": "n1 n2 n3 1 n1n2 n1n3 n2n3 n1^2-n2^2 3n3^2-1", "frame": "camera",
        "includes_albedo": true, "views": {"a": [[1,2,3,4,5,6,7,8,9]], "b": [[1,2,3,4,5,6,7,8,9]]}}"#;
    let scene = r#"{"views": [{"name": "a", "image": "i.exr", "mask": "m.png", "camera": "c.json",
        "lighting": "l.json:L1", "init": "plane", "prior": "p.exr"}, {"image": "b.exr", "camera": "d.json"}],
        "matches": [{"views": ["a", "b"], "file": "m.csv"}]}"#;
    let import =
        |format: CameraFormat| move |path: &Path| io::import_cameras(path, format, None).map(drop);
    for (name, num_refused) in [
        ("camera.json", {
            let text = format!("{{{camera}}}");
            leave_out("camera.json", &text, |p| io::read_cameras(p).map(drop))
        }),
        (
            "cameras.json",
            leave_out("cameras.json", &cameras, |p| io::read_cameras(p).map(drop)),
        ),
        (
            "transforms.json",
            leave_out(
                "transforms.json",
                transforms,
                import(CameraFormat::Transforms),
            ),
        ),
        (
            "cameras.sfm",
            leave_out("cameras.sfm", sfm, import(CameraFormat::SfmData)),
        ),
        (
            "sphere.json",
            leave_out("sphere.json", sphere, |p| io::read_sphere_file(p).map(drop)),
        ),
        (
            "lighting.json",
            leave_out("lighting.json", lighting, |p| {
                io::read_lighting(p, None).map(drop)
            }),
        ),
        (
            "scene.json",
            leave_out("scene.json", scene, |p| io::read_scene(p).map(drop)),
        ),
    ] {
        assert!(num_refused > 20, "{name}: {num_refused}");
    }
}
