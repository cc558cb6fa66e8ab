//! Sphere files as users write them.

use super::*;
use crate::mask::write_mask;
use rilievo_scene::{InMemoryPixels, Intrinsics, Mask, Photo, Raster};
use std::sync::Arc;

fn disc() -> Mask {
    Raster::from_fn(40, 30, |x, y| {
        (x as f64 - 20.0).hypot(y as f64 - 15.0) < 8.0
    })
}

fn read(text: &str) -> Result<SphereFile, IoError> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("masks")).unwrap();
    write_mask(&folder.path().join("masks/a.png"), &disc()).unwrap();
    let path = folder.path().join("sphere.json");
    std::fs::write(&path, text).unwrap();
    read_sphere_file(&path)
}

fn photos(names: &[&str]) -> PhotoSet {
    let image = Arc::new(LinearImage::filled(40, 30, 1, 0.5));
    PhotoSet {
        photos: names
            .iter()
            .map(|name| Photo {
                file_name: format!("{name}.jpg"),
                name: (*name).to_owned(),
                pixels: Arc::new(InMemoryPixels(image.clone())),
                intrinsics: Intrinsics::pinhole(40, 30, 50.0, 19.5, 14.5),
                focal_source: rilievo_scene::FocalSource::Guess,
                camera_group: 0,
                orientation: 1,
                mask: None,
                clip_level: 1.0,
                given_cam_from_world: None,
            })
            .collect(),
    }
}

const ALL_FORMS: &str = r#"{"radius": 0.04, "unit": "metre", "light": "camera",
    "views": {"a.jpg": {"mask": "masks/a.png"}, "b": {"ellipse": [1, 2, 5, 4, 90]},
              "c.JPG": {"circle": [3, 4, 6]},
              "gone": {"points": [[0,0],[1,0],[2,1],[1,2],[0,1]]}},
    "center": [0.1, 0.2, 0.3],
    "calibration": [{"image": "CAL.jpg", "same_camera_as": "b.jpg", "radius": 0.09}]}"#;

#[test]
fn all_forms_are_read_and_found_in_the_set() {
    let file = read(ALL_FORMS).unwrap();
    let [sphere] = &file.spheres[..] else {
        panic!("{:?}", file.spheres);
    };
    assert_eq!((sphere.radius, file.light), (0.04, Some(LightKind::Camera)));
    assert_eq!(sphere.name, MarkedSphere::ONLY);
    assert_eq!(
        sphere.views[0],
        ("a.jpg".to_owned(), SphereMark::Mask(disc()))
    );
    assert!(file.files.iter().any(|f| f.ends_with("masks/a.png")));
    assert!(file.calibration[0].image.ends_with("CAL.jpg"));
    let image = LinearImage::filled(40, 30, 1, 0.2);
    let set = photos(&["a", "b", "c"]);
    let (request, absent) = file.to_request(&set, vec![image]).unwrap();
    assert_eq!(absent, ["gone"]);
    let sphere = &request.spheres[0];
    assert_eq!(sphere.marks.len(), 3);
    assert!(matches!(
        sphere.marks[1],
        (PhotoIdx(1), SphereMark::Ellipse { angle_rad, .. })
            if (angle_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-15
    ));
    assert_eq!(request.calibration[0].same_camera_as, PhotoIdx(1));
    assert_eq!(sphere.center_in_world, Some(Point3::new(0.1, 0.2, 0.3)));
}

const TWO: &str = r#"{"radius": 0.04, "spheres": [
    {"views": {"a": {"circle": [3, 4, 6]}, "gone": {"circle": [3, 4, 6]}}},
    {"name": "left", "radius": 0.03, "views": {"b": {"mask": "masks/a.png"}}}]}"#;

#[test]
fn several_spheres_have_names_and_radii_of_their_own() {
    let mut file = read(TWO).unwrap();
    let (request, absent) = file.to_request(&photos(&["a", "b"]), Vec::new()).unwrap();
    let told: Vec<_> = request
        .spheres
        .iter()
        .map(|s| (s.name.as_str(), s.radius, s.marks.len()))
        .collect();
    assert_eq!(told, [("sphere 1", 0.04, 1), ("sphere \"left\"", 0.03, 1)]);
    assert_eq!(absent, ["gone"]);
    assert!(file.files.iter().any(|f| f.ends_with("masks/a.png")));
    let message = file.replace_radius(0.05).unwrap_err().to_string();
    assert!(message.contains("differ in radius"), "{message}");
    file.spheres[1].radius = 0.04;
    file.replace_radius(0.05).unwrap();
    assert!(file.spheres.iter().all(|sphere| sphere.radius == 0.05));
}

#[test]
fn what_does_not_fit_the_set_is_refused() {
    let file = read(ALL_FORMS).unwrap();
    let set = photos(&["a", "c"]);
    let image = LinearImage::filled(40, 30, 1, 0.2);
    let error = file.to_request(&set, vec![image]).unwrap_err().to_string();
    assert!(
        error.contains("calibration[0].same_camera_as: \"b.jpg\""),
        "{error}"
    );
    let mut set = photos(&["a", "b", "c"]);
    set.photos[0].intrinsics.width = 41;
    let image = LinearImage::filled(40, 30, 1, 0.2);
    let error = file.to_request(&set, vec![image]).unwrap_err().to_string();
    assert!(
        error.contains("views.a.jpg") && error.contains("40 x 30"),
        "{error}"
    );
}

#[test]
fn wrong_values_are_refused_with_their_key() {
    for (text, expected) in [
        ("{}", "nothing says where"),
        (r#"{"radius": -1, "center": [0,0,0]}"#, "radius: -1"),
        (r#"{"center": [0,0,0]}"#, "\"radius\" is missing"),
        (
            r#"{"radius": 1, "center": [0,0]}"#,
            "center: [0,0] has 2 numbers",
        ),
        (
            r#"{"radius": 1, "views": {"a": {}}}"#,
            "views.a: {} has none of",
        ),
        (
            r#"{"radius": 1, "views": {"a": {"circle": [1,2,0]}}}"#,
            "views.a.circle",
        ),
        (
            r#"{"radius": 1, "views": {"a": {"points": [[1,2]]}}}"#,
            "has 1 points",
        ),
        (
            r#"{"radius": 1, "views": {"a": {"circle": [1,2,3], "mask": "masks/a.png"}}}"#,
            "more than one way",
        ),
        (
            r#"{"radius": 1, "views": {"a": {"mask": "b.png"}}}"#,
            "b.png: there is no such",
        ),
        (
            r#"{"radius": 1, "light": "sun", "center": [0,0,0]}"#,
            "light: \"sun\"",
        ),
        (
            r#"{"radius": 1, "spheres": [{"center": [0,0,0]}, {"views": {"a": {"circle": [1,2]}}}]}"#,
            "spheres[1].views.a.circle: [1,2] has 2 numbers",
        ),
        (
            r#"{"spheres": [{"radius": 1, "center": [0,0,0]}, {"center": [1,0,0]}]}"#,
            "the key \"spheres[1].radius\" is missing",
        ),
        (
            r#"{"radius": 1, "spheres": [{"center": [0,0,0]}, {"radius": -2, "center": [1,0,0]}]}"#,
            "spheres[1].radius: -2 is not greater than zero",
        ),
        (
            r#"{"radius": 1, "spheres": [{"center": [0,0,0]}, {"radius": 2}]}"#,
            "spheres[1]: {\"radius\":2} has neither \"views\" nor \"center\"",
        ),
        (
            r#"{"radius": 1, "spheres": [{"name": "a", "center": [0,0,0]}, {"name": "a", "center": [1,0,0]}]}"#,
            "spheres[1].name: \"a\" names another sphere",
        ),
        (
            r#"{"radius": 1, "center": [0,0,0], "spheres": [{"center": [1,0,0]}]}"#,
            "move those into the list",
        ),
        (r#"{"radius": 1, "spheres": []}"#, "names no sphere"),
        (
            r#"{"calibration": [{"image": "x"}]}"#,
            "\"same_camera_as\" is missing",
        ),
    ] {
        let message = read(text).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}
