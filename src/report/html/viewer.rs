//! Data of the interactive view: the asset or a coarse mesh, and the cameras, packed for the page's script.
//!
//! A vertex is 18 bytes, little endian: position as 3 × u16 over the bounding box, place on the texture as 2 × u16 over
//! it, normal as 3 × i8 over ±127, tangent and sign of the bitangent as 4 × i8, one to spare. Of a mesh without textures
//! the place is zero, and its colour as 3 × u8 stands for the tangent. Behind the vertices stand the triangles, 3 × u16
//! each.

use super::picture::base64;
use crate::store::RunDir;
use maud::{Markup, PreEscaped, html};
use rilievo_io::{
    AssetMesh, CoarseMesh, ViewerFrame, picture_as_jpeg, read_asset_mesh, read_coarse_mesh_ply,
};
use rilievo_scene::cloud::renumber;
use rilievo_scene::{PosedViews, StageId, Unit};
use std::path::Path;

/// Vertices of the view without textures: 1.1 MB in the page, fluent on a phone, and 16 bits tell them apart.
const MAX_NUM_VERTICES: usize = 30_000;
/// Triangles of the asset in the view, half as many vertices and those on the seams: 1 MB in the page.
const MAX_NUM_FACES: usize = 40_000;
/// Side of its textures, pixels, and bytes of each of the two.
const TEXTURE_SIDE: usize = 1024;
const TEXTURE_BYTES: usize = 450_000;

/// What is shown.
struct Shown {
    surface: AssetMesh,
    bounds: [[f32; 3]; 2],
    /// Colours and normals as JPEG; none of a coarse mesh.
    textures: Option<[Vec<u8>; 2]>,
    /// The file that it stands for, and its triangles.
    of: (&'static str, usize),
}

/// The section; empty when there is no mesh.
///
/// # Errors
/// When the mesh cannot be read.
pub fn section(run: &RunDir, posed: &PosedViews) -> anyhow::Result<Markup> {
    let folder = run.stage_dir(StageId::Fusion);
    let Some(shown) = shown(&folder, posed)? else {
        return Ok(Markup::default());
    };
    let [low, high] = shown.bounds;
    let (file, num_triangles) = shown.of;
    let mesh = &shown.surface.mesh;
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
        "textures": shown.textures.as_ref().map(|textures| {
            let url = |jpeg: &Vec<u8>| format!("data:image/jpeg;base64,{}", base64(jpeg));
            textures.each_ref().map(url)
        }),
    });
    let packed = base64(&pack(&shown));
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
                            option value="1" {
                                @if shown.textures.is_some() { "colours without light" } @else { "colours" }
                            }
                            option value="2" { "normals" }
                        }
                    }
                    label {
                        "light left/right "
                        input id="light-x" type="range" min="-90" max="90" step="any" value="-40";
                    }
                    label {
                        "light down/up "
                        input id="light-y" type="range" min="-90" max="90" step="any" value="35";
                    }
                    label { input id="viewer-light" type="checkbox"; " dragging moves the light" }
                    label { input id="viewer-cameras" type="checkbox"; " cameras" }
                    label { input id="viewer-measure" type="checkbox"; " measure: choose two points" }
                }
                p.hint {
                    "Drag or arrow keys turn; two fingers, the right button or shift and drag move; wheel (after a \
                     click), pinch, + and - come nearer; 0 goes back. "
                    (mesh.triangles.len()) " triangles "
                    @if shown.textures.is_some() { "with small textures " }
                    "stand for the " (num_triangles) " of "
                    a href={ "6_fusion/" (file) } { (file) } "."
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

/// The asset where there is one, else a coarse mesh; `None` where there is no surface.
fn shown(folder: &Path, posed: &PosedViews) -> anyhow::Result<Option<Shown>> {
    let asset = folder.join("asset.glb");
    if asset.exists() {
        let mut surface = read_asset_mesh(&asset, &ViewerFrame::from_views(posed))?;
        let num_triangles = surface.mesh.triangles.len();
        lighten(&mut surface);
        let texture = |name: &str| -> anyhow::Result<Option<Vec<u8>>> {
            let bytes = std::fs::read(folder.join("asset").join(name))?;
            Ok(picture_as_jpeg(&bytes, TEXTURE_SIDE, TEXTURE_BYTES))
        };
        let textures = texture("base_color.png")?.zip(texture("normal.png")?);
        // 16 bits name the vertices of the page's script.
        let fits = surface.mesh.vertices.len() <= usize::from(u16::MAX);
        if let Some((colors, normals)) = textures.filter(|_| fits) {
            return Ok(Some(Shown {
                bounds: surface.mesh.bounds().unwrap_or_default(),
                textures: Some([colors, normals]),
                surface,
                of: ("asset.glb", num_triangles),
            }));
        }
    }
    let path = folder.join("mesh.ply");
    if !path.exists() {
        return Ok(None);
    }
    let CoarseMesh {
        mesh,
        num_triangles,
        bounds,
    } = read_coarse_mesh_ply(&path, MAX_NUM_VERTICES)?;
    Ok((!mesh.triangles.is_empty()).then(|| Shown {
        surface: AssetMesh {
            mesh,
            ..AssetMesh::default()
        },
        bounds,
        textures: None,
        of: ("mesh.ply", num_triangles),
    }))
}

/// Leaves about [`MAX_NUM_FACES`]; seams of the texture stay closed.
fn lighten(surface: &mut AssetMesh) {
    let AssetMesh {
        mesh,
        texture_coords,
        tangents,
    } = surface;
    if mesh.triangles.len() > MAX_NUM_FACES {
        let corners = meshopt::simplify_decoder(
            mesh.triangles.as_flattened(),
            &mesh.vertices,
            3 * MAX_NUM_FACES,
            f32::MAX,
            meshopt::SimplifyOptions::None,
            None,
        );
        mesh.triangles = corners.as_chunks::<3>().0.to_vec();
    }
    let kept = renumber(&mut mesh.triangles, mesh.vertices.len());
    mesh.vertices = kept.iter().map(|&v| mesh.vertices[v]).collect();
    mesh.normals = kept.iter().map(|&v| mesh.normals[v]).collect();
    *texture_coords = kept.iter().map(|&v| texture_coords[v]).collect();
    *tangents = kept.iter().map(|&v| tangents[v]).collect();
}

fn pack(shown: &Shown) -> Vec<u8> {
    let Shown {
        surface,
        bounds: [low, high],
        ..
    } = shown;
    let mesh = &surface.mesh;
    let mut bytes = Vec::with_capacity(mesh.vertices.len() * 18 + mesh.triangles.len() * 6);
    let whole = |share: f32| ((share.clamp(0.0, 1.0) * 65535.0).round() as u16).to_le_bytes();
    let signed = |c: f32| (c.clamp(-1.0, 1.0) * 127.0).round() as i8 as u8;
    for (index, vertex) in mesh.vertices.iter().enumerate() {
        for axis in 0..3 {
            let extent = (high[axis] - low[axis]).max(f32::MIN_POSITIVE);
            bytes.extend(whole((vertex[axis] - low[axis]) / extent));
        }
        let coords = surface.texture_coords.get(index).copied();
        bytes.extend(coords.unwrap_or_default().map(whole).as_flattened());
        let normal = mesh.normals.get(index).copied().unwrap_or_default();
        bytes.extend(normal.map(signed));
        match surface.tangents.get(index) {
            Some(tangent) => bytes.extend(tangent.map(signed)),
            None => {
                bytes.extend(mesh.colors.get(index).copied().unwrap_or([128; 3]));
                bytes.push(0);
            }
        }
        bytes.push(0);
    }
    let corners = mesh.triangles.iter().flatten();
    bytes.extend(corners.flat_map(|&corner| (corner as u16).to_le_bytes()));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Mesh;

    #[test]
    fn a_surface_of_many_triangles_is_lightened_with_what_its_vertices_have() {
        let side = 200_u32;
        let at = |k: u32| [(k % side) as f32, (k / side) as f32, 0.0];
        let corner = |k: u32| [k, k + 1, k + side, k + 1, k + side + 1, k + side];
        let squares = (0..side * (side - 1)).filter(|k| k % side + 1 < side);
        let corners: Vec<u32> = squares.flat_map(corner).collect();
        let num = (side * side) as usize;
        let mut surface = AssetMesh {
            mesh: Mesh {
                vertices: (0..side * side).map(at).collect(),
                normals: vec![[0.0, 0.0, 1.0]; num],
                colors: Vec::new(),
                triangles: corners.as_chunks::<3>().0.to_vec(),
            },
            texture_coords: (0..side * side).map(|k| [at(k)[0], at(k)[1]]).collect(),
            tangents: vec![[1.0, 0.0, 0.0, 1.0]; num],
        };
        lighten(&mut surface);
        let mesh = &surface.mesh;
        assert!((2..=MAX_NUM_FACES).contains(&mesh.triangles.len()));
        assert_eq!(mesh.vertices.len(), surface.tangents.len());
        assert_eq!(mesh.vertices.len(), mesh.normals.len());
        for (v, coords) in mesh.vertices.iter().zip(&surface.texture_coords) {
            assert_eq!(v[..2], coords[..]);
        }
    }

    #[test]
    fn a_mesh_is_packed_over_its_bounds() {
        let mesh = Mesh {
            vertices: vec![[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
            normals: vec![[0.0, -1.0, 0.0]; 3],
            colors: vec![[1, 2, 3]; 3],
            triangles: vec![[0, 2, 1]],
        };
        let mut shown = Shown {
            bounds: mesh.bounds().expect("vertices"),
            surface: AssetMesh {
                mesh,
                ..AssetMesh::default()
            },
            textures: None,
            of: ("mesh.ply", 1),
        };
        let bytes = pack(&shown);
        assert_eq!(bytes.len(), 3 * 18 + 6);
        assert_eq!(bytes[..2], [0, 0]);
        assert_eq!(bytes[18..20], [255, 255]);
        assert_eq!(bytes[6..18], [0, 0, 0, 0, 0, 129, 0, 1, 2, 3, 0, 0]);
        assert_eq!(bytes[54..], [0, 0, 2, 0, 1, 0]);
        shown.surface.texture_coords = vec![[0.0, 1.0]; 3];
        shown.surface.tangents = vec![[1.0, 0.0, 0.0, -1.0]; 3];
        let bytes = pack(&shown);
        assert_eq!(bytes[6..18], [0, 0, 255, 255, 0, 129, 0, 127, 0, 0, 129, 0]);
        assert_eq!(escape_script("a</script>"), "a\\u003c/script>");
    }
}
