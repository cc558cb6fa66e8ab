//! Writing `cameras.json`.

use super::entry::{CameraEntry, CameraFile};
use super::lens::LensModel;
use crate::error::IoError;
use crate::files::OutputFile;
use crate::json;
use serde_json::{Value, json};
use std::path::Path;

/// Writes `cameras.json`.
pub fn write_cameras(path: &Path, cameras: &CameraFile) -> Result<(), IoError> {
    cameras_file(path, cameras)?.write()
}

/// `cameras.json`, to be written.
///
/// # Errors
/// When the cameras cannot be put into words.
pub fn cameras_file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let unregistered = cameras.unregistered.iter();
    let unregistered: Vec<Value> = unregistered
        .map(|(image, reason)| json!({"image": image, "reason": reason}))
        .collect();
    let mut root = json!({
        "unit": cameras.unit.name(),
        "conventions": "pixel centres at integers; camera x right, y down, z forward",
    });
    for (key, value) in &cameras.extra {
        root[key] = value.clone();
    }
    root["cameras"] = cameras.cameras.iter().map(camera).collect();
    root["unregistered"] = Value::Array(unregistered);
    json::file(path, &root)
}

fn camera(entry: &CameraEntry) -> Value {
    let (i, d) = (&entry.intrinsics, &entry.intrinsics.distortion);
    let mut object = json!({
        "width": i.width,
        "height": i.height,
        "K": [[i.fx, 0.0, i.cx], [0.0, i.fy, i.cy], [0.0, 0.0, 1.0]],
    });
    if let Some(image) = &entry.image {
        object["image"] = json!(image);
    }
    if !d.is_none() {
        let (model, coefficients) = LensModel::of(d);
        object["distortion"] = json!({"model": model.name(), "coefficients": coefficients});
    }
    if let Some(pose) = &entry.cam_from_world {
        let r = pose.inverse().rotation_matrix();
        let row = |row: usize| [r[(row, 0)], r[(row, 1)], r[(row, 2)]];
        let center = pose.center_in_source();
        object["world_from_camera_rotation"] = json!([row(0), row(1), row(2)]);
        object["camera_center"] = json!([center.x, center.y, center.z]);
    }
    object
}
