//! Data of the interactive view: a coarse mesh and the cameras, packed for the page's script.
//!
//! A vertex is 12 bytes, little endian: position as 3 × u16 over the bounding box, normal as
//! 3 × i8 over ±127, colour as 3 × u8. Behind the vertices stand the triangles, 3 × u16 each.

use super::picture::base64;
use crate::store::RunDir;
use maud::{Markup, PreEscaped, html};
use rilievo_io::{CoarseMesh, read_coarse_mesh_ply};
use rilievo_scene::{Mesh, PosedViews, StageId, Unit};

/// Vertices of the view: 1.1 MB in the page, fluent on a phone, and 16 bits tell them apart.
const MAX_NUM_VERTICES: usize = 30_000;

/// The section; empty when there is no mesh.
///
/// # Errors
/// When the mesh cannot be read.
pub fn section(run: &RunDir, posed: &PosedViews) -> anyhow::Result<Markup> {
    let path = run.stage_dir(StageId::Fusion).join("mesh.ply");
    if !path.exists() {
        return Ok(Markup::default());
    }
    let CoarseMesh {
        mesh,
        num_triangles,
        bounds: [low, high],
    } = read_coarse_mesh_ply(&path, MAX_NUM_VERTICES)?;
    if mesh.triangles.is_empty() {
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
        "low": low, "high": high, "vertices": mesh.vertices.len(), "cameras": cameras,
        "metric": posed.scale.unit == Unit::Metre,
    });
    let packed = base64(&pack(&mesh, low, high));
    Ok(html! {
        section.on-screen {
            h2 { "The result in 3D" }
            div.viewer {
                div.stage {
                    canvas id="viewer" tabindex="0" role="img" aria-label=(CANVAS) {}
                    div id="viewer-scale" { span {} }
                }
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
                    label { input id="viewer-measure" type="checkbox"; " measure: choose two points" }
                }
                p.hint {
                    "Drag or arrow keys turn; two fingers, the right button or shift and drag move; wheel (after a \
                     click), pinch, + and - come nearer; 0 goes back. A coarse surface of "
                    (mesh.triangles.len()) " triangles stands for the " (num_triangles) " of "
                    a href="6_fusion/mesh.ply" { "mesh.ply" } "."
                }
            }
            script type="application/json" id="viewer-data" {
                (PreEscaped(escape_script(&data.to_string())))
            }
            script type="text/plain" id="viewer-mesh" { (PreEscaped(packed)) }
        }
    })
}

/// What the canvas is to those who cannot see it.
const CANVAS: &str = "Surface that can be turned with the mouse or the arrow keys, and relit";

/// JSON inside a script element must not close it.
fn escape_script(json: &str) -> String {
    json.replace('<', "\\u003c")
}

fn pack(mesh: &Mesh, low: [f32; 3], high: [f32; 3]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(mesh.vertices.len() * 12 + mesh.triangles.len() * 6);
    for (index, vertex) in mesh.vertices.iter().enumerate() {
        for axis in 0..3 {
            let extent = (high[axis] - low[axis]).max(f32::MIN_POSITIVE);
            let share = (vertex[axis] - low[axis]) / extent;
            bytes.extend(((share * 65535.0).round() as u16).to_le_bytes());
        }
        let normal = mesh.normals.get(index).copied().unwrap_or_default();
        bytes.extend(normal.map(|n| (n * 127.0).round() as i8 as u8));
        bytes.extend(mesh.colors.get(index).copied().unwrap_or([128; 3]));
    }
    let corners = mesh.triangles.iter().flatten();
    bytes.extend(corners.flat_map(|&corner| (corner as u16).to_le_bytes()));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_is_packed_over_its_bounds() {
        let mesh = Mesh {
            vertices: vec![[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
            normals: vec![[0.0, -1.0, 0.0]; 3],
            colors: vec![[1, 2, 3]; 3],
            triangles: vec![[0, 2, 1]],
        };
        let bytes = pack(&mesh, [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]);
        assert_eq!(bytes.len(), 3 * 12 + 6);
        assert_eq!(bytes[..2], [0, 0]);
        assert_eq!(bytes[12..14], [255, 255]);
        assert_eq!(bytes[6..12], [0, 129, 0, 1, 2, 3]);
        assert_eq!(bytes[36..], [0, 0, 2, 0, 1, 0]);
        assert_eq!(escape_script("a</script>"), "a\\u003c/script>");
    }
}
