//! AliceVision's `sfmData` (Meshroom's `cameras.sfm`), as JSON.
//!
//! Numbers are written as texts. A pose is `transform.rotation`, camera from world column by
//! column, and `transform.center`. Pixel centres lie at integers, the principal point is an offset
//! from half the image's size. Focal lengths changed with the version: pixels before 1.2.2, then
//! millimetres with the sensor's width, `fx = f w / sensorWidth`; `pixelRatio` is `fx / fy` before
//! 1.2.5 and `fy / fx` since. Lens models: `radial1` and `radial3` are k1 and k1 k2 k3, `brown` is
//! k1 k2 k3 p1 p2; others are refused.
//!
//! Source: AliceVision, `src/aliceVision/sfmDataIO/jsonIO.cpp`.

use super::limits::refuse_wide_lens;
use super::photos::{Photos, folder_of};
use crate::cameras::{CameraEntry, CameraFile, DistinctCameras, rigid_from_world_pose};
use crate::error::IoError;
use crate::files::OutputFile;
use crate::json::{self, Node};
use crate::names::Names;
use nalgebra::Matrix3;
use rilievo_scene::{Distortion, Intrinsics};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The version that is written.
const VERSION: [u32; 3] = [1, 2, 6];

/// Sensor's width that stands for one that is not known, millimetres: AliceVision's own default.
const SENSOR_WIDTH_MM: f64 = 36.0;

/// A number, or a text that is one.
fn number(node: &Node<'_>) -> Result<f64, IoError> {
    match node.value.as_str() {
        Some(text) => match text.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(node.refuse("is not a finite number")),
        },
        None => node.number(),
    }
}

/// Whether a list is empty, which is written as an empty text.
fn is_empty(node: &Node<'_>) -> bool {
    node.value.as_str() == Some("")
}

fn numbers(node: &Node<'_>) -> Result<Vec<f64>, IoError> {
    if is_empty(node) {
        return Ok(Vec::new());
    }
    node.array()?.iter().map(number).collect()
}

fn size(node: &Node<'_>) -> Result<usize, IoError> {
    node.whole(number(node)?)
}

/// An identifier, which is written as a text or a number.
fn id(node: &Node<'_>) -> String {
    node.value
        .as_str()
        .map_or_else(|| node.value.to_string(), str::to_owned)
}

pub(super) fn read(path: &Path) -> Result<CameraFile, IoError> {
    let value = json::read(path)?;
    let root = Node::root(path, &value);
    let version = root.opt_as("version", numbers)?;
    let version = version.unwrap_or_else(|| VERSION.map(f64::from).to_vec());
    let before = |minor: f64, patch: f64| version.as_slice() < [1.0, minor, patch].as_slice();
    let list = |name: &str| match root.opt(name)? {
        Some(node) if !is_empty(&node) => node.array(),
        _ => Ok(Vec::new()),
    };

    let mut intrinsics = BTreeMap::new();
    for node in list("intrinsics")? {
        intrinsics.insert(id(&node.get("intrinsicId")?), read_camera(&node, &before)?);
    }
    let mut poses = BTreeMap::new();
    for node in list("poses")? {
        let transform = node.get("pose")?.get("transform")?;
        let rotation = numbers(&transform.get("rotation")?)?;
        let center = numbers(&transform.get("center")?)?;
        let (9, [x, y, z]) = (rotation.len(), center.as_slice()) else {
            return Err(transform.refuse("is not a rotation of nine and a centre of three"));
        };
        // Column by column of camera from world is row by row of world from camera.
        let world_from_camera = Matrix3::from_row_slice(&rotation);
        let pose = rigid_from_world_pose(&world_from_camera, [*x, *y, *z])
            .map_err(|reason| transform.refuse(reason))?;
        poses.insert(id(&node.get("poseId")?), pose);
    }
    let mut file = CameraFile::default();
    for node in list("views")? {
        let image = node.get("path")?.text()?;
        let key = id(&node.get("intrinsicId")?);
        let Some(camera) = intrinsics.get(&key) else {
            return Err(node.refuse(format!(
                "refers to the intrinsics {key}, which are not there"
            )));
        };
        let pose = node.opt("poseId")?;
        let pose = pose.and_then(|pose| poses.get(&id(&pose)).copied());
        file.cameras.push(CameraEntry {
            image: Some(image.replace('\\', "/")),
            intrinsics: *camera,
            cam_from_world: pose,
        });
    }
    if file.cameras.is_empty() {
        return Err(IoError::input(path, "holds no views"));
    }
    CameraEntry::without_folders(&mut file.cameras);
    file.cameras.sort_by(|a, b| a.image.cmp(&b.image));
    Ok(file)
}

fn read_camera(node: &Node<'_>, before: &dyn Fn(f64, f64) -> bool) -> Result<Intrinsics, IoError> {
    let (width, height) = (size(&node.get("width")?)?, size(&node.get("height")?)?);
    let member = |name: &str| node.opt_as(name, number);
    let pair = |name: &str| -> Result<(f64, f64), IoError> {
        let inner = node.get(name)?;
        match numbers(&inner)?.as_slice() {
            [x, y] => Ok((*x, *y)),
            _ => Err(inner.refuse("is not a pair of numbers")),
        }
    };
    let (fx, fy) = if before(2.0, 0.0) {
        let focal = number(&node.get("pxFocalLength")?)?;
        (focal, focal)
    } else if before(2.0, 2.0) {
        pair("pxFocalLength")?
    } else {
        let focal_mm = number(&node.get("focalLength")?)?;
        let fx = focal_mm / member("sensorWidth")?.unwrap_or(SENSOR_WIDTH_MM) * width as f64;
        let ratio = member("pixelRatio")?.unwrap_or(1.0);
        let is_inverse = before(2.0, 5.0);
        (fx, if is_inverse { fx / ratio } else { fx * ratio })
    };
    if !(fx.is_finite() && fy.is_finite() && fx > 0.0 && fy > 0.0) {
        return Err(node.refuse(format!("has the focal lengths {fx}, {fy}")));
    }
    let (mut cx, mut cy) = pair("principalPoint")?;
    if !before(2.0, 1.0) {
        cx += 0.5 * width as f64;
        cy += 0.5 * height as f64;
    }
    let params = node.opt_as("distortionParams", numbers)?;
    let params = params.unwrap_or_default();
    let kind = match node.opt("distortionType")? {
        Some(kind) => kind.text()?,
        None => node.get("type")?.text()?,
    };
    let [k1, k2, k3, p1, p2] = match (kind, params.as_slice()) {
        (_, params) if params.iter().all(|&k| k == 0.0) => [0.0; 5],
        ("radial1" | "radialk1", &[k1]) => [k1, 0.0, 0.0, 0.0, 0.0],
        ("radial3" | "radialk3", &[k1, k2, k3]) => [k1, k2, k3, 0.0, 0.0],
        ("brown", &[k1, k2, k3, p1, p2]) => [k1, k2, k3, p1, p2],
        (kind, _) => {
            let reason = format!("has the lens model {kind}, which is not supported");
            return Err(node.refuse(reason));
        }
    };
    Ok(Intrinsics {
        distortion: Distortion::plain([k1, k2, p1, p2, k3]),
        ..Intrinsics::undistorted((width, height), [fx, fy, cx, cy])
    })
}

/// Finds a photo's path: beside the file or in its `images`; else the bare name.
fn image_path(file: &Path, name: &str) -> String {
    Photos::new(None, folder_of(file), &["", "images", "photos"])
        .find(name)
        .and_then(|path| std::path::absolute(path).ok())
        .map_or_else(|| name.to_owned(), |path| path.display().to_string())
}

pub(super) fn file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let text = |value: f64| Value::String(value.to_string());
    let (mut views, mut intrinsics, mut poses) = (Vec::new(), Vec::new(), Vec::new());
    let mut known = DistinctCameras::default();
    for (index, entry) in cameras.cameras.iter().enumerate() {
        let i = &entry.intrinsics;
        let camera = known.place(i);
        if camera == intrinsics.len() {
            intrinsics.push(write_camera(camera + 1, i));
        }
        let id = (index + 1).to_string();
        let name = entry.name();
        Names::Path.check(path, "AliceVision", name)?;
        refuse_wide_lens(path, entry, "AliceVision's file")?;
        views.push(json!({
            "viewId": id, "poseId": id, "frameId": id, "intrinsicId": (camera + 1).to_string(),
            "path": image_path(path, name),
            "width": i.width.to_string(), "height": i.height.to_string(), "metadata": {},
        }));
        if let Some(pose) = &entry.cam_from_world {
            let center = pose.center_in_source();
            let rotation: Vec<Value> = pose.rotation_matrix().iter().copied().map(text).collect();
            let center: Vec<Value> = [center.x, center.y, center.z].map(text).to_vec();
            poses.push(json!({
                "poseId": id,
                "pose": {"transform": {"rotation": rotation, "center": center}, "locked": "0"},
            }));
        }
    }
    json::file(
        path,
        &json!({
            "version": VERSION.map(|part| part.to_string()),
            "views": views, "intrinsics": intrinsics, "poses": poses,
        }),
    )
}

fn write_camera(id: usize, camera: &Intrinsics) -> Value {
    let text = |value: f64| Value::String(value.to_string());
    let (w, h) = (camera.width as f64, camera.height as f64);
    let d = &camera.distortion;
    let (kind, params) = if d.is_none() {
        ("pinhole", Vec::new())
    } else if d.p1 == 0.0 && d.p2 == 0.0 {
        ("radial3", vec![d.k1, d.k2, d.k3])
    } else {
        ("brown", vec![d.k1, d.k2, d.k3, d.p1, d.p2])
    };
    let params: Vec<Value> = params.into_iter().map(text).collect();
    json!({
        "intrinsicId": id.to_string(),
        "width": camera.width.to_string(), "height": camera.height.to_string(),
        "sensorWidth": text(SENSOR_WIDTH_MM), "sensorHeight": text(SENSOR_WIDTH_MM * h / w),
        "serialNumber": "", "type": kind, "initializationMode": "calibrated",
        "focalLength": text(camera.fx * SENSOR_WIDTH_MM / w), "pixelRatio": text(camera.fy / camera.fx),
        "principalPoint": [text(camera.cx - 0.5 * w), text(camera.cy - 0.5 * h)],
        "distortionParams": params, "locked": "false",
    })
}
