//! Sphere files as users write them.

use super::*;
use crate::error::IoError;
use crate::mask::write_mask;
use nalgebra::Point3;
use rilievo_scene::{InMemoryPixels, Intrinsics, Mask, Orientation, Photo, Raster};
use rilievo_scene::{LightKind, LinearImage, MarkedSphere, PhotoIdx, PhotoSet, SphereMark};
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
    for (name, inside) in [("empty", false), ("full", true)] {
        let file = folder.path().join(format!("masks/{name}.png"));
        write_mask(&file, &Mask::filled(40, 30, inside)).unwrap();
    }
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
                orientation: Orientation::UPRIGHT,
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
    let SpheresInSet {
        request, absent, ..
    } = file.to_request(&set, vec![image]).unwrap();
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
    let SpheresInSet {
        request, absent, ..
    } = file.to_request(&photos(&["a", "b"]), Vec::new()).unwrap();
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
            r#"{"radius": 1e300, "center": [0,0,0]}"#,
            "radius: 1e+300 is no sphere's radius",
        ),
        (
            r#"{"radius": 1, "spheres": [{"radius": 1e-300, "center": [0,0,0]}]}"#,
            "spheres[0].radius: 1e-300 is no sphere's radius",
        ),
        (
            r#"{"radius": 1, "views": {"a": {"circle": [20,15,8]}}, "center": [1e300,0,0]}"#,
            "center: [1e+300,0,0] is no place",
        ),
        (
            r#"{"radius": 1, "views": {"a": {"circle": [20,15,1e-300]}}}"#,
            "less than a pixel",
        ),
        (
            r#"{"radius": 1, "views": {"a": {"mask": "masks/empty.png"}, "b": {"mask": "masks/full.png"}}}"#,
            "empty.png: the sphere's mask has 0 white pixels; ",
        ),
        (
            r#"{"calibration": [{"image": "x", "same_camera_as": "a", "radius": 1, "mask": "masks/empty.png"}]}"#,
            "empty.png: the sphere's mask has 0 white pixels",
        ),
        (
            r#"{"calibration": [{"image": "x"}]}"#,
            "\"same_camera_as\" is missing",
        ),
    ] {
        let message = read(text).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn a_mask_that_marks_nothing_is_left_out_by_name_and_the_others_stay() {
    let file = read(
        r#"{"radius": 1, "views": {"a": {"mask": "masks/a.png"}, "b": {"mask": "masks/empty.png"},
            "c": {"mask": "masks/full.png"}}}"#,
    )
    .unwrap();
    let views: Vec<&str> = file.spheres[0].views.iter().map(|v| v.0.as_str()).collect();
    assert_eq!(views, ["a"]);
    let told = |k: usize, name: &str, reason: &str| {
        let (file, why) = &file.left_out[k];
        assert!(
            file.ends_with(name) && why.contains(reason),
            "{file:?}: {why}"
        );
    };
    told(0, "masks/empty.png", "0 white pixels");
    told(1, "masks/full.png", "white everywhere");
    // A mask that is mended must be read again.
    assert_eq!(file.files.len(), 3, "{:?}", file.files);
}

#[test]
fn a_list_of_spheres_that_nobody_places_is_refused_and_a_long_one_is_not() {
    let list = |num: usize| {
        let sphere = r#"{"center": [0,0,0]}"#;
        format!(
            r#"{{"radius": 1, "spheres": [{}]}}"#,
            vec![sphere; num].join(",")
        )
    };
    assert_eq!(read(&list(MAX_NUM_SPHERES)).unwrap().spheres.len(), 64);
    let message = read(&list(MAX_NUM_SPHERES + 1)).unwrap_err().to_string();
    assert!(
        message.contains("names 65 spheres") && message.contains("64 at most"),
        "{message}"
    );
}

#[test]
fn a_mark_outside_the_photo_is_refused() {
    for mark in [
        r#"{"circle": [1e300, 15, 8]}"#,
        r#"{"ellipse": [20, -9, 8, 7, 0]}"#,
        r#"{"points": [[50,10],[60,10],[65,15],[60,20],[50,20]]}"#,
    ] {
        let file = read(&format!(r#"{{"radius": 1, "views": {{"a": {mark}}}}}"#)).unwrap();
        let told = file.to_request(&photos(&["a"]), Vec::new());
        let message = told.unwrap_err().to_string();
        assert!(
            message.contains("views.a: the mark lies outside"),
            "{message}"
        );
    }
}

#[test]
fn upright_marks_of_turned_photos_are_turned_back_all_or_none() {
    // Of 40 x 30 pixels as stored, 30 x 40 upright: the second circle lies below the stored frame.
    let text = r#"{"radius": 1, "views": {"a": {"circle": [12, 20, 6]}, "b": {"circle": [5, 36, 2]},
        "c": {"circle": [12, 20, 6]}}}"#;
    let file = read(text).unwrap();
    let mut set = photos(&["a", "b", "c"]);
    set.photos[0].orientation = Orientation::of_exif(6).unwrap();
    set.photos[1].orientation = Orientation::of_exif(8).unwrap();
    let in_set = file.to_request(&set, Vec::new()).unwrap();
    assert_eq!(in_set.upright, ["a.jpg", "b.jpg"]);
    assert!(!in_set.may_be_upright);
    let centers: Vec<[f64; 2]> = in_set.request.spheres[0]
        .marks
        .iter()
        .map(|(_, mark)| match mark {
            SphereMark::Circle { center_px, .. } => *center_px,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(centers, [[20.0, 17.0], [3.0, 5.0], [12.0, 20.0]]);

    // A mask of the stored size says that nothing was turned.
    let text = text.replace(
        r#""a": {"circle": [12, 20, 6]}"#,
        r#""a": {"mask": "masks/a.png"}"#,
    );
    let refused = read(&text).unwrap().to_request(&set, Vec::new());
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("views.b"), "{message}");

    // Marks that fit either way are taken as they are, and that is told.
    let text =
        r#"{"radius": 1, "views": {"a": {"circle": [12, 15, 6]}, "c": {"circle": [12, 20, 6]}}}"#;
    let in_set = read(text).unwrap().to_request(&set, Vec::new()).unwrap();
    assert!(in_set.upright.is_empty() && in_set.may_be_upright);

    // One slip among many marks turns none of them.
    let names: Vec<String> = (0..9).map(|k| format!("p{k}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut set = photos(&names);
    for photo in &mut set.photos {
        photo.orientation = Orientation::of_exif(6).unwrap();
    }
    let marks: Vec<String> = (0..9)
        .map(|k| {
            format!(
                r#""p{k}": {{"circle": [12, {}, 2]}}"#,
                if k == 4 { 36 } else { 20 }
            )
        })
        .collect();
    let text = format!(r#"{{"radius": 1, "views": {{{}}}}}"#, marks.join(", "));
    let refused = read(&text).unwrap().to_request(&set, Vec::new());
    assert!(refused.unwrap_err().to_string().contains("views.p4"));
}
