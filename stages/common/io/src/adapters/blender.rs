//! A Python script that makes the cameras in Blender, each with its photo behind it.
//!
//! Blender's camera axes are x right, y up, z backward. With the sensor fitted to the image's
//! width, of 36 mm here, a focal length of `f_x` pixels is a lens of `36 f_x / w` mm; the shifts
//! are the image centre's distance from the principal point, in image widths, to the right and
//! upwards; pixels are `f_x / f_y` times as high as wide. Source: Blender manual, "Cameras", and
//! its Python API, `bpy.types.Camera`.

use super::limits::{flip, refuse_distortion, rows_of};
use crate::cameras::CameraFile;
use crate::error::IoError;
use crate::files::OutputFile;
use nalgebra::Vector3;
use serde_json::json;
use std::path::Path;

/// Width of the sensor to which focal lengths refer, millimetres.
const SENSOR_MM: f64 = 36.0;

const SCRIPT: &str = r#"
import os

import bpy
from mathutils import Matrix

scene = bpy.context.scene
collection = bpy.data.collections.new("photos")
scene.collection.children.link(collection)
for number, given in enumerate(CAMERAS, start=1):
    data = bpy.data.cameras.new(given["name"])
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = SENSOR_MM
    data.lens = given["lens"]
    data.shift_x, data.shift_y = given["shift"]
    data.display_size = SIZE
    data.clip_start, data.clip_end = 0.01 * SIZE, 1e4 * SIZE
    data["resolution"] = given["resolution"]
    camera = bpy.data.objects.new(given["name"], data)
    camera.matrix_world = Matrix(given["world_from_camera"])
    collection.objects.link(camera)
    photo = os.path.join(PHOTOS, given["photo"])
    if PHOTOS and os.path.isfile(photo):
        behind = data.background_images.new()
        behind.image = bpy.data.images.load(photo)
        data.show_background_images = True
    # Each camera is the scene's in a frame of its own.
    marker = scene.timeline_markers.new(given["name"], frame=number)
    marker.camera = camera
    if number == 1:
        scene.camera = camera
        # Size and pixels' shape are the scene's in Blender: where photos differ, each camera has its "resolution".
        scene.render.resolution_x, scene.render.resolution_y = given["resolution"]
        scene.render.resolution_percentage = 100
        aspect = given["pixel_aspect"]
        scene.render.pixel_aspect_x = max(1.0, 1.0 / aspect)
        scene.render.pixel_aspect_y = max(1.0, aspect)
scene.frame_start, scene.frame_end = 1, len(CAMERAS)
scene.frame_set(1)
"#;

/// The script for cameras with a pose, in the unit and the local frame of the meshes: Blender has single precision.
///
/// # Errors
/// When a camera has lens distortion, which Blender does not.
pub fn blender_file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let mut cameras = cameras.clone();
    cameras.to_metres();
    let world = cameras.localize([0.0; 3]);
    let mut list = Vec::new();
    let mut centers = Vec::new();
    for (entry, pose) in cameras.posed() {
        refuse_distortion(path, entry, "Blender")?;
        let k = &entry.intrinsics;
        let [width, height] = [k.width as f64, k.height as f64];
        let aspect = k.fx / k.fy;
        let rotation = pose.inverse().rotation_matrix() * flip();
        let center = pose.center_in_source();
        centers.push(center);
        let [first, second, third] = rows_of(&rotation, &center);
        let name = Path::new(entry.name()).file_stem().unwrap_or_default();
        list.push(json!({
            "name": name.to_string_lossy(),
            "photo": entry.name(),
            "resolution": [k.width, k.height],
            "lens": SENSOR_MM * k.fx / width,
            "shift": [
                (0.5 * (width - 1.0) - k.cx) / width,
                (k.cy - 0.5 * (height - 1.0)) * aspect / width,
            ],
            "pixel_aspect": aspect,
            "world_from_camera": [first, second, third, [0.0, 0.0, 0.0, 1.0]],
        }));
    }
    if list.is_empty() {
        let reason = "there is no camera with a pose to write";
        return Err(IoError::input(path, reason));
    }
    let num = centers.len() as f64;
    let middle: Vector3<f64> = centers.iter().map(|c| c.coords / num).sum();
    let around = centers.iter().map(|c| (c.coords - middle).norm() / num);
    let size = 0.2 * around.sum::<f64>();
    // A list in JSON without true, false and null is one in Python.
    let entries: Vec<String> = list.iter().map(|entry| format!("    {entry},\n")).collect();
    let text = format!(
        "# Cameras for Blender: run this in the Text Editor, or with blender --python.\n\
         # {}: that of mesh.ply, and of mesh.glb where it is level.\n\n\
         # Folder of the photos, to see each behind its camera.\n\
         PHOTOS = \"\"\n\
         SENSOR_MM = {SENSOR_MM:?}\n\
         # Length of the cameras' drawing.\n\
         SIZE = {}\n\
         CAMERAS = [\n{}]\n{SCRIPT}",
        world.comments().join("; "),
        if size > 0.0 { size } else { 1.0 },
        entries.concat(),
    );
    Ok(OutputFile::new(path, text))
}
