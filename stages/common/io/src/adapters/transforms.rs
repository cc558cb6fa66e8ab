//! `transforms.json` of nerfstudio and instant-ngp.
//!
//! ```text
//! {"fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2", "k3",
//!  "frames": [{"file_path": "images/x.jpg", "transform_matrix": 4 x 4 world from camera}]}
//! ```
//! Camera axes x right, y up, z backward; the first pixel's centre at 0.5. Every key of the camera
//! may stand at the top or in a frame, `camera_angle_x` instead of a focal length. Source:
//! nerfstudio documentation, "Data conventions".

use super::limits::{flip, refuse_wide_lens, rows_of};
use super::photos::{Photos, folder_of, size_of};
use crate::cameras::lens::LensModel;
use crate::cameras::{CameraEntry, CameraFile, last_part, rigid_from_world_pose, unit};
use crate::error::IoError;
use crate::files::OutputFile;
use crate::json::{self, Node};
use crate::names::Names;
use nalgebra::Matrix3;
use rilievo_scene::Intrinsics;
use serde_json::json;
use std::path::Path;

/// Keys of a model's coefficients, and of those that we cannot hold, and must therefore be zero.
fn coefficients_of(lens: LensModel) -> (&'static [&'static str], &'static [&'static str]) {
    match lens {
        LensModel::Fisheye => (&["k1", "k2", "k3", "k4"], &["p1", "p2", "k5", "k6"]),
        _ => (&["k1", "k2", "p1", "p2", "k3"], &["k4", "k5", "k6"]),
    }
}

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let photos = Photos::new(photos, folder_of(path), &[""]);
    let value = json::read(path)?;
    let root = Node::root(path, &value);
    let mut file = CameraFile {
        unit: unit(&root)?,
        ..CameraFile::default()
    };
    for frame in root.get("frames")?.array()? {
        let name = frame.get("file_path")?.text()?.trim_start_matches("./");
        let intrinsics = intrinsics(&root, &frame, &photos, name)?;
        let node = frame.get("transform_matrix")?;
        let rows = node.array()?;
        if !(3..=4).contains(&rows.len()) {
            return Err(node.refuse("is not a matrix of 4 rows"));
        }
        let row = |i: usize| rows[i].numbers::<4>();
        let m = [row(0)?, row(1)?, row(2)?];
        let rotation = Matrix3::from_fn(|i, j| m[i][j]);
        let center = m.map(|[.., last]| last);
        let pose = rigid_from_world_pose(&(rotation * flip()), center)
            .map_err(|reason| node.refuse(reason))?;
        file.cameras
            .push(CameraEntry::posed(name.to_owned(), intrinsics, pose));
    }
    CameraEntry::without_folders(&mut file.cameras);
    Ok(file)
}

/// A key in the frame, else at the top.
fn key<'a>(root: &Node<'a>, frame: &Node<'a>, name: &str) -> Result<Option<Node<'a>>, IoError> {
    match frame.opt(name)? {
        Some(node) => Ok(Some(node)),
        None => root.opt(name),
    }
}

fn intrinsics(
    root: &Node<'_>,
    frame: &Node<'_>,
    photos: &Photos,
    name: &str,
) -> Result<Intrinsics, IoError> {
    let mut lens = LensModel::OpenCv;
    if let Some(model) = key(root, frame, "camera_model")? {
        match model.text()? {
            "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL"
            | "FULL_OPENCV" => {}
            "OPENCV_FISHEYE" => lens = LensModel::Fisheye,
            _ => return Err(model.refuse("is a camera model that is not supported")),
        }
    }
    let number = |name: &str| -> Result<Option<f64>, IoError> {
        key(root, frame, name)?
            .map(|node| node.number())
            .transpose()
    };
    let (width, height) = match (key(root, frame, "w")?, key(root, frame, "h")?) {
        (Some(w), Some(h)) => (w.count()?, h.count()?),
        _ => size_of(&photos.named(frame.file, &[name, last_part(name)])?)?,
    };
    let fx = match (number("fl_x")?, number("camera_angle_x")?) {
        (Some(fx), _) => fx,
        (None, Some(angle)) => 0.5 * width as f64 / (0.5 * angle).tan(),
        (None, None) => return Err(frame.refuse("has neither \"fl_x\" nor \"camera_angle_x\"")),
    };
    let fy = number("fl_y")?.unwrap_or(fx);
    if !(fx.is_finite() && fx > 0.0 && fy > 0.0) {
        return Err(frame.refuse(format!("has the focal lengths {fx}, {fy}")));
    }
    let (known, foreign) = coefficients_of(lens);
    for name in foreign {
        if number(name)?.is_some_and(|value| value != 0.0) {
            return Err(frame.refuse(format!("has the lens coefficient {name}")));
        }
    }
    let coefficient = |name: &str| number(name).map(|value| value.unwrap_or(0.0));
    let cx = number("cx")?.unwrap_or(0.5 * width as f64) - 0.5;
    let cy = number("cy")?.unwrap_or(0.5 * height as f64) - 0.5;
    let coefficients = known.iter().map(|name| coefficient(name));
    let camera = Intrinsics {
        distortion: lens.distortion(&coefficients.collect::<Result<Vec<_>, _>>()?),
        ..Intrinsics::undistorted((width, height), [fx, fy, cx, cy])
    };
    match camera.check_lens() {
        Ok(()) => Ok(camera),
        Err(reason) => Err(frame.refuse(format!("has a lens that cannot be used: {reason}"))),
    }
}

pub(super) fn file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    for entry in &cameras.cameras {
        Names::Path.check(path, "transforms.json", entry.name())?;
        let d = &entry.intrinsics.distortion;
        if LensModel::of(d).0 != LensModel::Fisheye {
            refuse_wide_lens(path, entry, "transforms.json")?;
        }
    }
    let frames = cameras.posed().map(|(entry, pose)| {
        let rotation = pose.inverse().rotation_matrix() * flip();
        let [first, second, third] = rows_of(&rotation, &pose.center_in_source());
        let (i, d) = (&entry.intrinsics, &entry.intrinsics.distortion);
        let (lens, coefficients) = LensModel::of(d);
        let mut frame = json!({
            "file_path": entry.name(),
            "w": i.width, "h": i.height,
            "fl_x": i.fx, "fl_y": i.fy, "cx": i.cx + 0.5, "cy": i.cy + 0.5,
            "transform_matrix": [first, second, third, [0.0, 0.0, 0.0, 1.0]],
        });
        if lens == LensModel::Fisheye {
            frame["camera_model"] = json!("OPENCV_FISHEYE");
        }
        for (name, value) in coefficients_of(lens).0.iter().zip(coefficients) {
            frame[*name] = json!(value);
        }
        frame
    });
    let frames: Vec<serde_json::Value> = frames.collect();
    let unit = cameras.unit.name();
    json::file(
        path,
        &json!({"camera_model": "OPENCV", "unit": unit, "frames": frames}),
    )
}
