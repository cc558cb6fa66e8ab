//! Binary glTF 2.0: one mesh with normals and colours, for viewers and the web.
//!
//! glTF wants metres, y up and the front towards z. A level world is turned by a quarter; any other has no
//! such axes, and [`ViewerFrame`] takes them from the cameras: up is the mean of their upward axes, the front is
//! where they stand. Vertex colours are linear by the specification and stored with 16 bits, since
//! eight would show steps in dark tones.
//!
//! Layout: header, JSON chunk, binary chunk (positions, normals, colours, indices; little endian).
//!
//! Source: Khronos Group, glTF 2.0 specification, sections 3.7.2 (meshes) and 4 (GLB).

use super::check::check;
use crate::error::IoError;
use crate::files::write_pieces;
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{Mesh, PosedViews, Unit, WorldFrame, srgb};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

const MAGIC: u32 = 0x4654_6c67;
const VERSION: u32 = 2;
const CHUNK_JSON: u32 = 0x4e4f_534a;
const CHUNK_BINARY: u32 = 0x004e_4942;
/// Component types of the specification.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
/// Bytes a vertex and a triangle.
const FLOATS_BYTES: usize = 12;
const COLOR_BYTES: usize = 8;

/// Rotation from the world to axes that viewers expect: y up, z towards the viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewerFrame {
    /// `viewer_from_world`.
    pub rotation: Matrix3<f64>,
}

impl ViewerFrame {
    /// A level world's own axes. Else up from the cameras' upward axes, the front from where they look; the first
    /// camera's axes where those contradict each other.
    pub fn from_views(posed: &PosedViews) -> Self {
        if posed.frame == WorldFrame::Level {
            let rotation = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0);
            return Self { rotation };
        }
        let mean = |axis: Vector3<f64>| -> Vector3<f64> {
            let axes = posed.views.iter();
            axes.map(|v| v.cam_from_world.rotation.inverse() * axis)
                .sum()
        };
        let frame = |up: Vector3<f64>, back: Vector3<f64>| {
            let y = up.try_normalize(1e-3)?;
            let z = (back - y * y.dot(&back)).try_normalize(1e-3)?;
            Some(Matrix3::from_rows(&[
                y.cross(&z).transpose(),
                y.transpose(),
                z.transpose(),
            ]))
        };
        let first = posed.views.first().map(|v| {
            let rotation = v.cam_from_world.rotation.to_rotation_matrix().into_inner();
            Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) * rotation
        });
        let num = posed.views.len().max(1) as f64;
        let rotation = frame(mean(-Vector3::y()) / num, mean(-Vector3::z()) / num)
            .or(first)
            .unwrap_or_else(Matrix3::identity);
        Self { rotation }
    }

    fn turn(&self, v: [f32; 3]) -> [f32; 3] {
        (self.rotation * Vector3::from(v.map(f64::from)))
            .map(|c| c as f32)
            .into()
    }
}

fn linear(byte: u8) -> u16 {
    (srgb::decode(f64::from(byte) / 255.0) * 65535.0).round() as u16
}

/// Writes a mesh as GLB.
///
/// # Errors
/// When the file cannot be written, the mesh is empty or inconsistent, or it exceeds the 4 GB of
/// the format.
pub fn write_mesh_glb(
    path: &Path,
    mesh: &Mesh,
    unit: Unit,
    frame: &ViewerFrame,
) -> Result<(), IoError> {
    check(path, mesh)?;
    if mesh.triangles.is_empty() {
        return Err(IoError::write(path, "the mesh has no triangles"));
    }
    let (text, num_bytes) = description(mesh, frame, unit);
    let total = 12 + 8 + text.len() + 8 + num_bytes;
    let length = |bytes: usize| {
        u32::try_from(bytes)
            .map_err(|_| IoError::write(path, "the mesh exceeds the 4 GB that GLB can hold"))
    };
    let (total, text_length, binary_length) =
        (length(total)?, length(text.len())?, length(num_bytes)?);
    write_pieces(path, |out| {
        for word in [MAGIC, VERSION, total, text_length, CHUNK_JSON] {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(text.as_bytes())?;
        for word in [binary_length, CHUNK_BINARY] {
            out.write_all(&word.to_le_bytes())?;
        }
        let turned = mesh.vertices.iter().chain(&mesh.normals);
        for c in turned.flat_map(|&v| frame.turn(v)) {
            out.write_all(&c.to_le_bytes())?;
        }
        for color in &mesh.colors {
            let [r, g, b] = color.map(linear);
            for c in [r, g, b, u16::MAX] {
                out.write_all(&c.to_le_bytes())?;
            }
        }
        for v in mesh.triangles.iter().flatten() {
            out.write_all(&v.to_le_bytes())?;
        }
        Ok(())
    })
}

/// The JSON chunk, padded, and the length of the binary one.
fn description(mesh: &Mesh, frame: &ViewerFrame, unit: Unit) -> (String, usize) {
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    let mut attributes = serde_json::Map::new();
    let mut offset = 0;
    let num = mesh.vertices.len();
    let mut add = |name: &str, bytes: usize, target: u32, accessor: Value| {
        if !name.is_empty() {
            attributes.insert(name.to_owned(), json!(views.len()));
        }
        let mut accessor = accessor;
        accessor["bufferView"] = json!(views.len());
        accessors.push(accessor);
        views.push(json!({
            "buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": target,
        }));
        offset += bytes;
    };
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for p in mesh.vertices.iter().map(|&v| frame.turn(v)) {
        for k in 0..3 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    const ARRAY: u32 = 34962;
    const ELEMENTS: u32 = 34963;
    add(
        "POSITION",
        num * FLOATS_BYTES,
        ARRAY,
        json!({"componentType": FLOAT, "count": num, "type": "VEC3", "min": low, "max": high}),
    );
    if !mesh.normals.is_empty() {
        let accessor = json!({"componentType": FLOAT, "count": num, "type": "VEC3"});
        add("NORMAL", num * FLOATS_BYTES, ARRAY, accessor);
    }
    if !mesh.colors.is_empty() {
        let accessor = json!({
            "componentType": UNSIGNED_SHORT, "normalized": true, "count": num, "type": "VEC4",
        });
        add("COLOR_0", num * COLOR_BYTES, ARRAY, accessor);
    }
    let num_indices = 3 * mesh.triangles.len();
    let accessor = json!({"componentType": UNSIGNED_INT, "count": num_indices, "type": "SCALAR"});
    add("", 4 * num_indices, ELEMENTS, accessor);
    let indices = accessors.len() - 1;
    let unit = match unit {
        Unit::Metre => unit.name(),
        Unit::Arbitrary => "arbitrary: the scale is unknown",
    };
    let document = json!({
        "asset": {
            "version": "2.0",
            "generator": concat!("rilievo ", env!("CARGO_PKG_VERSION")),
            "extras": {"unit": unit},
        },
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "object"}],
        "meshes": [{"primitives": [{
            "attributes": attributes, "indices": indices, "material": 0, "mode": 4,
        }]}],
        "materials": [{
            "name": "matte",
            "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
            "doubleSided": true,
        }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    });
    let mut text = document.to_string();
    // Chunks are multiples of four bytes; JSON is filled up with spaces.
    while !text.len().is_multiple_of(4) {
        text.push(' ');
    }
    (text, offset)
}
