//! Valid files of people and other programs with single bytes changed: read or refused, never a
//! panic.

// Helpers of the tests may fail as the tests do.
use rilievo_io as io;
use std::path::Path;

/// Changes a byte here and there, a different one each time.
fn mutate(text: &str, mut read: impl FnMut(&Path)) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.json");
    for at in (0..text.len()).step_by(3) {
        let mut bytes = text.as_bytes().to_vec();
        let replacements = b"0-9.eE\"[]{},:x\n\xff";
        bytes[at] = replacements[at % replacements.len()];
        std::fs::write(&path, &bytes).unwrap();
        read(&path);
    }
}

#[test]
fn changed_bytes_never_panic() {
    mutate(
        r#"{"unit": "metre", "cameras": [{"image": "a.jpg", "width": 4, "height": 3,
            "K": [[5,0,1],[0,5,1],[0,0,1]], "distortion": {"model": "opencv",
            "coefficients": [0.1,0,0,0,0]}, "camera_center": [1,2,3],
            "world_from_camera_rotation": [[1,0,0],[0,1,0],[0,0,1]]}]}"#,
        |path| drop(io::read_cameras(path)),
    );
    mutate(
        r#"{"radius": 0.04, "views": {"b": {"ellipse": [1, 2, 5, 4, 90]},
            "c": {"circle": [3, 4, 6]}, "p": {"points": [[0,0],[1,0],[2,1],[1,2],[0,1]]}},
            "center": [0.1, 0.2, 0.3]}"#,
        |path| drop(io::read_sphere_file(path)),
    );
    mutate(
        r#"{"L1": [[1,2,3,4,5,6,7,8,9]], "L2": [[0,0,-1,0,0,0,0,0,1e3]]}"#,
        |path| {
            drop(io::read_lighting(path, Some("L1")));
        },
    );
    mutate(
        r#"{"views": [{"name": "a", "image": "i.exr", "camera": "c.json", "init": "plane",
            "lighting": "l.json:L1"}], "matches": []}"#,
        |path| drop(io::read_scene(path)),
    );
    mutate("x1,y1,x2,y2\n1,2,3.5,-4\n5,6,7,8\n", |path| {
        drop(io::read_matches_csv(path))
    });
}
