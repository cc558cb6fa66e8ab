//! Metashape's `cameras.xml` (exported cameras, formats 1.x and 2.x; frame cameras).
//!
//! With `x = X/Z, y = Y/Z, r² = x² + y²` in a camera x right, y down, z forward:
//! ```text
//! x' = x (1 + K1 r² + K2 r⁴ + K3 r⁶ + K4 r⁸) + P1 (r² + 2x²) + 2 P2 x y
//! y' = y (1 + K1 r² + K2 r⁴ + K3 r⁶ + K4 r⁸) + P2 (r² + 2y²) + 2 P1 x y
//! u  = w/2 + cx + x' f + x' B1 + y' B2        v = h/2 + cy + y' f
//! ```
//! and the first pixel's centre at 0.5. So `fx = f + B1`, `fy = f`, and P1, P2 are OpenCV's p2, p1;
//! K4 and B2 must be zero. A camera's `transform` is world from camera in the chunk's own frame,
//! which is kept: the chunk's transform into the earth's frame would cost six digits. Only its
//! scale is applied, and makes lengths metres. Source: Metashape manual, appendix "Camera models".

use crate::cameras::{CameraEntry, CameraFile, DistinctCameras, rigid_from_world_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::xml::{self, Element};
use nalgebra::Matrix3;
use rilievo_scene::{Distortion, Intrinsics, Unit};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

pub(super) fn read(path: &Path) -> Result<CameraFile, IoError> {
    let refuse = |reason: String| IoError::input(path, reason);
    let document = xml::parse(&read_regular_text(path)?).map_err(refuse)?;
    let chunks = document.descendants("chunk");
    let chunk = match (document.name.as_str(), &chunks[..]) {
        ("document", [chunk]) => *chunk,
        ("document", []) => return Err(refuse("has no <chunk>".to_owned())),
        ("document", _) => return Err(refuse("has several chunks; export one".to_owned())),
        (name, _) => return Err(refuse(format!("<{name}> is not Metashape's <document>"))),
    };
    let mut sensors = HashMap::new();
    for sensor in chunk.descendants("sensor") {
        let id = sensor.attribute("id").unwrap_or_default();
        let camera = intrinsics(sensor).map_err(|reason| refuse(format!("sensor {id}: {reason}")));
        sensors.entry(id).or_insert(camera);
    }
    let scale = chunk
        .child("transform")
        .and_then(|transform| transform.child("scale"))
        .map(|node| numbers::<1>(node).map(|[scale]| scale))
        .transpose()
        .map_err(refuse)?;
    if let Some(scale) = scale.filter(|&scale| scale <= 0.0) {
        return Err(refuse(format!("the chunk's scale is {scale}")));
    }
    let mut file = CameraFile {
        unit: match scale {
            Some(_) => Unit::Metre,
            None => Unit::Arbitrary,
        },
        ..CameraFile::default()
    };
    for camera in chunk.descendants("camera") {
        let label = camera.attribute("label").unwrap_or_default().to_owned();
        let Some(transform) = camera.child("transform") else {
            file.unregistered
                .push((label, "not aligned in Metashape".to_owned()));
            continue;
        };
        let m: [f64; 16] =
            numbers(transform).map_err(|reason| refuse(format!("camera {label}: {reason}")))?;
        let rotation = Matrix3::from_fn(|i, j| m[4 * i + j]);
        let center = [m[3], m[7], m[11]].map(|value| value * scale.unwrap_or(1.0));
        let pose = rigid_from_world_pose(&rotation, center)
            .map_err(|reason| refuse(format!("the transform of camera {label} {reason}")))?;
        let sensor_id = camera.attribute("sensor_id").unwrap_or_default();
        let sensor = sensors
            .get(sensor_id)
            .ok_or_else(|| refuse(format!("camera {label} names no sensor \"{sensor_id}\"")))?;
        file.cameras.push(CameraEntry {
            image: Some(label),
            intrinsics: sensor.clone()?,
            cam_from_world: Some(pose),
        });
    }
    Ok(file)
}

fn numbers<const N: usize>(node: &Element) -> Result<[f64; N], String> {
    let values: Option<Vec<f64>> = node
        .text
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
        .collect();
    values
        .and_then(|values| <[f64; N]>::try_from(values).ok())
        .ok_or_else(|| format!("<{}> is \"{}\", not {N} numbers", node.name, node.text))
}

fn intrinsics(sensor: &Element) -> Result<Intrinsics, String> {
    let calibrations = sensor.descendants("calibration");
    // The adjusted one, where both are there.
    let calibration = calibrations
        .iter()
        .find(|node| node.attribute("class") != Some("initial"))
        .or(calibrations.first())
        .ok_or("has no <calibration>")?;
    let kind = calibration
        .attribute("type")
        .or(sensor.attribute("type"))
        .unwrap_or("frame");
    if kind != "frame" {
        return Err(format!("the camera type \"{kind}\" is not supported"));
    }
    let size = |name: &str| -> Result<usize, String> {
        calibration
            .child("resolution")
            .or(sensor.child("resolution"))
            .and_then(|node| node.attribute(name))
            .and_then(|text| text.parse().ok())
            .filter(|&value| value > 0)
            .ok_or_else(|| format!("has no {name} in <resolution>"))
    };
    let (width, height) = (size("width")?, size("height")?);
    let value = |name: &str| -> Result<f64, String> {
        match calibration.child(name) {
            Some(node) => numbers::<1>(node).map(|[value]| value),
            None => Ok(0.0),
        }
    };
    for name in ["k4", "b2", "p3", "p4"] {
        if value(name)? != 0.0 {
            return Err(format!("<{name}> is not zero, which is not supported"));
        }
    }
    let f = match calibration.child("f") {
        Some(_) => value("f")?,
        None => value("fy")?,
    };
    let fx = f + value("b1")?;
    if f <= 0.0 || fx <= 0.0 {
        return Err(format!("the focal length is {f}"));
    }
    Ok(Intrinsics {
        width,
        height,
        fx,
        fy: f,
        cx: 0.5 * width as f64 + value("cx")? - 0.5,
        cy: 0.5 * height as f64 + value("cy")? - 0.5,
        distortion: Distortion {
            k1: value("k1")?,
            k2: value("k2")?,
            p1: value("p2")?,
            p2: value("p1")?,
            k3: value("k3")?,
        },
    })
}

pub(super) fn file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let mut sensors = DistinctCameras::default();
    let mut entries = String::new();
    // Writing into a String cannot fail, hence the ignored results.
    for (i, entry) in cameras.cameras.iter().enumerate() {
        let sensor = sensors.place(&entry.intrinsics);
        Names::Xml.check(path, "Metashape's XML", entry.name())?;
        let label = xml::encode(entry.name());
        let _ = write!(
            entries,
            "      <camera id=\"{i}\" sensor_id=\"{sensor}\" label=\"{label}\">"
        );
        if let Some(pose) = entry.cam_from_world {
            let (r, c) = (pose.inverse().rotation_matrix(), pose.center_in_source());
            entries.push_str("<transform>");
            for row in 0..3 {
                let _ = write!(
                    entries,
                    "{} {} {} {} ",
                    r[(row, 0)],
                    r[(row, 1)],
                    r[(row, 2)],
                    c[row]
                );
            }
            entries.push_str("0 0 0 1</transform>");
        }
        entries.push_str("</camera>\n");
    }
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\">\n  \
         <chunk label=\"rilievo\" enabled=\"true\">\n    <sensors>\n",
    );
    for (i, k) in sensors.list.iter().enumerate() {
        let (w, h, d) = (k.width, k.height, &k.distortion);
        let (cx, cy) = (k.cx + 0.5 - 0.5 * w as f64, k.cy + 0.5 - 0.5 * h as f64);
        let _ = writeln!(
            text,
            "      <sensor id=\"{i}\" label=\"{i}\" type=\"frame\">\n        \
             <resolution width=\"{w}\" height=\"{h}\"/>\n        \
             <calibration type=\"frame\" class=\"adjusted\">\n          \
             <resolution width=\"{w}\" height=\"{h}\"/>\n          \
             <f>{}</f><cx>{cx}</cx><cy>{cy}</cy><b1>{}</b1>\n          \
             <k1>{}</k1><k2>{}</k2><k3>{}</k3><p1>{}</p1><p2>{}</p2>\n        \
             </calibration>\n      </sensor>",
            k.fy,
            k.fx - k.fy,
            d.k1,
            d.k2,
            d.k3,
            d.p2,
            d.p1
        );
    }
    text.push_str("    </sensors>\n    <cameras>\n");
    text.push_str(&entries);
    text.push_str("    </cameras>\n");
    if cameras.unit == Unit::Metre {
        text.push_str("    <transform><scale>1</scale></transform>\n");
    }
    text.push_str("  </chunk>\n</document>\n");
    Ok(OutputFile::new(path, text))
}
