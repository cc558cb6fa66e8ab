//! Data of the interactive view: a thinned cloud and the cameras, packed for the page's script.
//!
//! A point is 12 bytes, little endian: position as 3 × u16 over the bounding box, normal as
//! 3 × i8 over ±127, colour as 3 × u8.

use super::picture::base64;
use crate::store::RunDir;
use maud::{Markup, PreEscaped, html};
use rilievo_io::read_thinned_cloud_ply;
use rilievo_scene::{CloudPoint, PosedViews, StageId};

/// Points beyond this many are thinned out: 2.4 MB in the page, fluent on a phone.
const MAX_NUM_POINTS: usize = 150_000;

/// The section; empty when there is no cloud.
///
/// # Errors
/// When the cloud cannot be read.
pub fn section(run: &RunDir, posed: &PosedViews) -> anyhow::Result<Markup> {
    let path = run.stage_dir(StageId::Fusion).join("cloud.ply");
    if !path.exists() {
        return Ok(Markup::default());
    }
    let cloud = read_thinned_cloud_ply(&path, MAX_NUM_POINTS)?;
    let (points, [low, high]) = (&cloud.points, cloud.bounds);
    if points.is_empty() {
        return Ok(Markup::default());
    }
    let cameras: Vec<_> = posed
        .views
        .iter()
        .map(|view| {
            let world_from_cam = view.cam_from_world.inverse();
            let center = world_from_cam.translation;
            let forward = world_from_cam.rotation * nalgebra::Vector3::z();
            let up = world_from_cam.rotation * -nalgebra::Vector3::y();
            serde_json::json!({
                "name": view.name, "center": center.as_slice(), "forward": forward.as_slice(),
                "up": up.as_slice(),
                "aspect": view.intrinsics.width as f64 / view.intrinsics.height as f64,
                "half": 0.5 * view.intrinsics.height as f64 / view.intrinsics.fy,
            })
        })
        .collect();
    let data = serde_json::json!({
        "low": low, "high": high, "count": points.len(), "cameras": cameras,
    });
    let packed = base64(&pack(points, low, high));
    Ok(html! {
        section {
            h2 { "The result in 3D" }
            div.viewer {
                canvas id="viewer" tabindex="0" role="img" aria-label=(CANVAS) {}
                p id="viewer-message" role="status" {}
                div.controls {
                    label {
                        "show "
                        select id="viewer-mode" {
                            option value="0" { "relit surface" }
                            option value="1" { "colours" }
                            option value="2" { "normals" }
                        }
                    }
                    label {
                        "light left/right "
                        input id="light-x" type="range" min="-90" max="90" value="-40";
                    }
                    label {
                        "light down/up "
                        input id="light-y" type="range" min="-90" max="90" value="35";
                    }
                    label { input id="viewer-cameras" type="checkbox"; " cameras" }
                }
                p.hint {
                    "Drag or arrow keys turn, wheel or + and - come nearer, 0 goes back. "
                    (points.len()) " of " (cloud.num_points) " points are shown."
                }
            }
            script type="application/json" id="viewer-data" {
                (PreEscaped(escape_script(&data.to_string())))
            }
            script type="text/plain" id="viewer-points" { (PreEscaped(packed)) }
        }
    })
}

/// What the canvas is to those who cannot see it.
const CANVAS: &str = "Point cloud that can be turned with the mouse or the arrow keys, and relit";

/// JSON inside a script element must not close it.
fn escape_script(json: &str) -> String {
    json.replace('<', "\\u003c")
}

fn pack(points: &[CloudPoint], low: [f32; 3], high: [f32; 3]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(points.len() * 12);
    for point in points {
        for axis in 0..3 {
            let extent = (high[axis] - low[axis]).max(f32::MIN_POSITIVE);
            let share = (point.position[axis] - low[axis]) / extent;
            bytes.extend(((share * 65535.0).round() as u16).to_le_bytes());
        }
        for axis in 0..3 {
            bytes.push((point.normal[axis] * 127.0).round() as i8 as u8);
        }
        bytes.extend(point.color);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_packed_over_their_bounds() {
        let point = |x: f32| CloudPoint {
            position: [x, 0.0, 1.0],
            normal: [0.0, -1.0, 0.0],
            color: [1, 2, 3],
            confidence: 1.0,
            num_views: 2,
        };
        let points = [point(-1.0), point(1.0)];
        let (low, high) = ([-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]);
        let bytes = pack(&points, low, high);
        assert_eq!(bytes.len(), 24);
        assert_eq!(bytes[..2], [0, 0]);
        assert_eq!(bytes[12..14], [255, 255]);
        assert_eq!(bytes[6..12], [0, 129, 0, 1, 2, 3]);
        assert_eq!(escape_script("a</script>"), "a\\u003c/script>");
    }
}
