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

use super::limits::{refuse_wide_lens, rows_of};
use crate::cameras::{CameraEntry, CameraFile, DistinctCameras, rigid_from_world_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::words::spaced;
use crate::xml;
use nalgebra::Matrix3;
use rilievo_scene::{Distortion, Intrinsics, Unit};
use roxmltree::{Document, Node};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}

/// All elements of a name below one, at any depth, in order.
fn below<'a, 'input>(node: Node<'a, 'input>, name: &str) -> impl Iterator<Item = Node<'a, 'input>> {
    node.descendants()
        .skip(1)
        .filter(move |node| node.has_tag_name(name))
}

fn numbers<const N: usize>(node: Node<'_, '_>) -> Result<[f64; N], String> {
    // Comments cut a text into pieces.
    let pieces = node.children().filter(|child| child.is_text());
    let text: String = pieces.filter_map(|piece| piece.text()).collect();
    let values: Option<Vec<f64>> = text
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
        .collect();
    values
        .and_then(|values| <[f64; N]>::try_from(values).ok())
        .ok_or_else(|| {
            let name = node.tag_name().name();
            format!("<{name}> is \"{}\", not {N} numbers", text.trim())
        })
}

pub(super) fn read(path: &Path) -> Result<CameraFile, IoError> {
    parse(&read_regular_text(path)?).map_err(|reason| IoError::input(path, reason))
}

fn parse(text: &str) -> Result<CameraFile, String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    xml::check(text)?;
    let document = Document::parse(text).map_err(|error| format!("broken XML: {error}"))?;
    let root = document.root_element();
    let name = root.tag_name().name();
    if name != "document" {
        return Err(format!("<{name}> is not Metashape's <document>"));
    }
    let chunks: Vec<Node<'_, '_>> = below(root, "chunk").collect();
    let chunk = match chunks[..] {
        [chunk] => chunk,
        [] => return Err("has no <chunk>".to_owned()),
        _ => return Err("has several chunks; export one".to_owned()),
    };
    let mut sensors = HashMap::new();
    for sensor in below(chunk, "sensor") {
        let id = sensor.attribute("id").unwrap_or_default();
        let camera = intrinsics(sensor).map_err(|reason| format!("sensor {id}: {reason}"));
        sensors.entry(id).or_insert(camera);
    }
    let scale = child(chunk, "transform").and_then(|transform| child(transform, "scale"));
    let scale = scale.map(numbers::<1>).transpose()?.map(|[scale]| scale);
    if let Some(scale) = scale.filter(|&scale| scale <= 0.0) {
        return Err(format!("the chunk's scale is {scale}"));
    }
    let mut file = CameraFile {
        unit: match scale {
            Some(_) => Unit::Metre,
            None => Unit::Arbitrary,
        },
        ..CameraFile::default()
    };
    for camera in below(chunk, "camera") {
        let label = camera.attribute("label").unwrap_or_default().to_owned();
        let Some(transform) = child(camera, "transform") else {
            file.unregistered
                .push((label, "not aligned in Metashape".to_owned()));
            continue;
        };
        let m: [f64; 16] =
            numbers(transform).map_err(|reason| format!("camera {label}: {reason}"))?;
        let rotation = Matrix3::from_fn(|i, j| m[4 * i + j]);
        let center = [m[3], m[7], m[11]].map(|value| value * scale.unwrap_or(1.0));
        let pose = rigid_from_world_pose(&rotation, center)
            .map_err(|reason| format!("the transform of camera {label} {reason}"))?;
        let sensor_id = camera.attribute("sensor_id").unwrap_or_default();
        let sensor = sensors
            .get(sensor_id)
            .ok_or_else(|| format!("camera {label} names no sensor \"{sensor_id}\""))?;
        file.cameras
            .push(CameraEntry::posed(label, sensor.clone()?, pose));
    }
    Ok(file)
}

fn intrinsics(sensor: Node<'_, '_>) -> Result<Intrinsics, String> {
    let calibrations: Vec<Node<'_, '_>> = below(sensor, "calibration").collect();
    // The adjusted one, where both are there.
    let calibration = *calibrations
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
    let resolution = child(calibration, "resolution").or(child(sensor, "resolution"));
    let size = |name: &str| -> Result<usize, String> {
        resolution
            .and_then(|node| node.attribute(name))
            .and_then(|text| text.parse().ok())
            .filter(|&value| value > 0)
            .ok_or_else(|| format!("has no {name} in <resolution>"))
    };
    let (width, height) = (size("width")?, size("height")?);
    let value = |name: &str| match child(calibration, name) {
        Some(node) => numbers::<1>(node).map(|[value]| value),
        None => Ok(0.0),
    };
    for name in ["k4", "b2", "p3", "p4"] {
        if value(name)? != 0.0 {
            return Err(format!("<{name}> is not zero, which is not supported"));
        }
    }
    let f = match child(calibration, "f") {
        Some(_) => value("f")?,
        None => value("fy")?,
    };
    let fx = f + value("b1")?;
    if f <= 0.0 || fx <= 0.0 {
        return Err(format!("the focal length is {f}"));
    }
    let cx = 0.5 * width as f64 + value("cx")? - 0.5;
    let cy = 0.5 * height as f64 + value("cy")? - 0.5;
    Ok(Intrinsics {
        distortion: Distortion::plain([
            value("k1")?,
            value("k2")?,
            value("p2")?,
            value("p1")?,
            value("k3")?,
        ]),
        ..Intrinsics::undistorted((width, height), [fx, f, cx, cy])
    })
}

/// Text that may stand in an attribute. White space but the plain one is written as its number,
/// since readers make a space of it otherwise.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '<' | '>' | '"' | '\'' | '&' | '\t' | '\n' | '\r' => {
                escaped += &format!("&#{};", u32::from(c));
            }
            _ => escaped.push(c),
        }
    }
    escaped
}

pub(super) fn file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let mut sensors = DistinctCameras::default();
    let mut entries = String::new();
    // Writing into a String cannot fail, hence the ignored results.
    for (i, entry) in cameras.cameras.iter().enumerate() {
        let sensor = sensors.place(&entry.intrinsics);
        Names::Xml.check(path, "Metashape's XML", entry.name())?;
        refuse_wide_lens(path, entry, "Metashape's XML")?;
        let label = escaped(entry.name());
        let _ = write!(
            entries,
            "      <camera id=\"{i}\" sensor_id=\"{sensor}\" label=\"{label}\">"
        );
        if let Some(pose) = entry.cam_from_world {
            let rotation = pose.inverse().rotation_matrix();
            let rows = rows_of(&rotation, &pose.center_in_source());
            let rows = spaced(rows.as_flattened());
            entries += &format!("<transform>{rows} 0 0 0 1</transform>");
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
    if let Some(metres) = cameras.unit.metres() {
        text += &format!("    <transform><scale>{metres}</scale></transform>\n");
    }
    text.push_str("  </chunk>\n</document>\n");
    Ok(OutputFile::new(path, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_escaped_as_readers_take_them_back() {
        assert_eq!(escaped("a\nb"), "a&#10;b");
        for text in ["<\"&'ä>&lt;", "a\nb\tc\r", "&", "&#65", "a & b; c"] {
            let document = format!("<a x=\"{}\"/>", escaped(text));
            let document = Document::parse(&document).unwrap();
            assert_eq!(document.root_element().attribute("x"), Some(text));
        }
    }

    #[test]
    fn broken_documents_are_refused_and_never_panic() {
        let whole = "<?xml version=\"1.0\"?>\n<!-- <no> -->\n<a x='1' y = \"b &lt; c\">\n\
            <b/><c><b z=\"ä\">1 2\n3</b></c> t&amp;lt; </a>";
        for end in (0..=whole.len()).filter(|&end| whole.is_char_boundary(end)) {
            assert!(parse(&whole[..end]).is_err(), "{end}");
        }
        for text in [
            "",
            "text",
            "<a></b>",
            "<a b></a>",
            "<a/><b/>",
            "</a>",
            "<a x=1/>",
            "< >",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
        assert!(parse(&"<a>".repeat(100_000)).is_err());
    }
}
