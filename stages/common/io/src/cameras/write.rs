//! Writing `cameras.json`.

use super::entry::CameraFile;
use crate::error::IoError;
use crate::files::OutputFile;
use crate::json;
use rilievo_scene::Unit;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Writes `cameras.json`.
///
/// # Errors
/// When the file cannot be written.
pub fn write_cameras(path: &Path, cameras: &CameraFile) -> Result<(), IoError> {
    cameras_file(path, cameras)?.write()
}

/// `cameras.json`, to be written.
///
/// # Errors
/// When the cameras cannot be put into words.
pub fn cameras_file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let mut root = Map::new();
    let unit = match cameras.unit {
        Unit::Metre => "metre",
        Unit::Arbitrary => "arbitrary",
    };
    root.insert("unit".to_owned(), json!(unit));
    root.insert(
        "conventions".to_owned(),
        json!("pixel centres at integers; camera x right, y down, z forward"),
    );
    for (key, value) in &cameras.extra {
        root.insert(key.clone(), value.clone());
    }
    let entries: Vec<Value> = cameras
        .cameras
        .iter()
        .map(|entry| {
            let i = &entry.intrinsics;
            let mut object = Map::new();
            if let Some(image) = &entry.image {
                object.insert("image".to_owned(), json!(image));
            }
            object.insert("width".to_owned(), json!(i.width));
            object.insert("height".to_owned(), json!(i.height));
            object.insert(
                "K".to_owned(),
                json!([[i.fx, 0.0, i.cx], [0.0, i.fy, i.cy], [0.0, 0.0, 1.0]]),
            );
            if !i.distortion.is_none() {
                let d = &i.distortion;
                object.insert(
                    "distortion".to_owned(),
                    json!({"model": "opencv", "coefficients": [d.k1, d.k2, d.p1, d.p2, d.k3]}),
                );
            }
            if let Some(pose) = &entry.cam_from_world {
                let r = pose.inverse().rotation_matrix();
                let rows: Vec<[f64; 3]> = (0..3)
                    .map(|row| [r[(row, 0)], r[(row, 1)], r[(row, 2)]])
                    .collect();
                let center = pose.center_in_source();
                object.insert("world_from_camera_rotation".to_owned(), json!(rows));
                object.insert(
                    "camera_center".to_owned(),
                    json!([center.x, center.y, center.z]),
                );
            }
            Value::Object(object)
        })
        .collect();
    root.insert("cameras".to_owned(), Value::Array(entries));
    let unregistered: Vec<Value> = cameras
        .unregistered
        .iter()
        .map(|(image, reason)| json!({"image": image, "reason": reason}))
        .collect();
    root.insert("unregistered".to_owned(), Value::Array(unregistered));
    json::file(path, &Value::Object(root))
}
