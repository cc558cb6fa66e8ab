//! Binary glTF 2.0 for viewers and the web: one mesh with normals and colours, or an asset.
//!
//! glTF wants metres, y up and the front towards z. A level world is turned by a quarter; any other
//! has no such axes, and [`ViewerFrame`] takes them from the cameras: up is the mean of their
//! upward axes, the front is where they stand. Vertex colours are linear by the specification and
//! stored with 16 bits, since eight would show steps in dark tones.
//!
//! Layout: header, JSON chunk, binary chunk (positions, normals, what else a vertex has, indices,
//! images; little endian).
//!
//! Source: Khronos Group, glTF 2.0 specification, sections 3.7.2 (meshes) and 4 (GLB).

use super::check::check;
use crate::error::IoError;
use crate::files::write_pieces;
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{Asset, Mesh, PosedViews, Unit, WorldCoordinates, WorldFrame, srgb};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

const MAGIC: u32 = 0x4654_6c67;
const VERSION: u32 = 2;
const CHUNK_JSON: u32 = 0x4e4f_534a;
const CHUNK_BINARY: u32 = 0x004e_4942;
/// Component types of the specification.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
/// What parts of the binary chunk are for.
const ARRAY: u32 = 34962;
const ELEMENTS: u32 = 34963;
/// Filters of a texture: linear between texels and between its levels, linear.
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const LINEAR: u32 = 9729;
const CLAMP_TO_EDGE: u32 = 33071;

/// Rotation from the world to axes that viewers expect: y up, z towards the viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewerFrame {
    /// `viewer_from_world`.
    pub rotation: Matrix3<f64>,
}

impl ViewerFrame {
    /// A level world's own axes. Else up from the cameras' upward axes, the front from where they
    /// look; the first camera's axes where those contradict each other.
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

    /// The other way.
    pub(super) fn turn_back(&self, v: [f32; 3]) -> [f32; 3] {
        (self.rotation.transpose() * Vector3::from(v.map(f64::from)))
            .map(|c| c as f32)
            .into()
    }
}

fn linear(byte: u8) -> u16 {
    (srgb::decode(f64::from(byte) / 255.0) * 65535.0).round() as u16
}

/// Textures of an asset as PNG.
pub(super) struct AssetImages {
    pub base_color: Vec<u8>,
    pub normal: Vec<u8>,
    /// Occlusion in red, roughness in green, metal in blue.
    pub occlusion: Vec<u8>,
}

/// Writes a mesh as GLB.
///
/// # Errors
/// When the file cannot be written, the mesh is empty or inconsistent, or it exceeds the 4 GB of
/// the format.
pub fn write_mesh_glb(
    path: &Path,
    mesh: &Mesh,
    world: impl Into<WorldCoordinates>,
    frame: &ViewerFrame,
) -> Result<(), IoError> {
    let mut file = Glb::of(path, mesh, frame)?;
    if !mesh.colors.is_empty() {
        let accessor = json!({"componentType": UNSIGNED_SHORT, "normalized": true, "type": "VEC4"});
        let colors = mesh.colors.iter().flat_map(|color| {
            let [r, g, b] = color.map(linear);
            [r, g, b, u16::MAX].into_iter().flat_map(u16::to_le_bytes)
        });
        file.attribute("COLOR_0", mesh.colors.len(), accessor, (8, colors));
    }
    let material = json!({
        "name": "matte",
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
        "doubleSided": true,
    });
    file.write(path, mesh, (material, world.into()))
}

/// Writes an asset as GLB, its textures inside.
pub(super) fn write_asset_glb(
    path: &Path,
    asset: &Asset,
    images: &AssetImages,
    world: WorldCoordinates,
    frame: &ViewerFrame,
) -> Result<(), IoError> {
    let mut file = Glb::of(path, &asset.mesh, frame)?;
    let num = asset.mesh.vertices.len();
    let tangents = asset.tangents.iter().flat_map(|&[x, y, z, sign]| {
        let [x, y, z] = frame.turn([x, y, z]);
        [x, y, z, sign].into_iter().flat_map(f32::to_le_bytes)
    });
    let accessor = json!({"componentType": FLOAT, "type": "VEC4"});
    file.attribute("TANGENT", num, accessor, (16, tangents));
    let coords = asset.texture_coords.iter().flatten();
    let accessor = json!({"componentType": FLOAT, "type": "VEC2"});
    file.attribute(
        "TEXCOORD_0",
        num,
        accessor,
        (8, coords.copied().flat_map(f32::to_le_bytes)),
    );
    file.texture("base colour", &images.base_color);
    file.texture("normals, OpenGL: green up", &images.normal);
    file.texture("occlusion, roughness, metal", &images.occlusion);
    let material = json!({
        "name": "matte",
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0},
            "metallicRoughnessTexture": {"index": 2},
            "metallicFactor": 1,
            "roughnessFactor": 1,
        },
        "normalTexture": {"index": 1},
        "occlusionTexture": {"index": 2},
        "doubleSided": true,
        "extras": {
            "base_color": asset.shows.sentence(),
            "normal_map": "OpenGL convention, green up; tangents by MikkTSpace",
        },
    });
    file.write(path, &asset.mesh, (material, world))
}

/// A part of the binary chunk: its length, and its bytes in pieces.
type Part<'a> = (
    usize,
    Box<dyn FnMut(&mut BufWriter<File>) -> std::io::Result<()> + 'a>,
);

/// A file while it is gathered: parts of the JSON and of the binary chunk, which is made last.
struct Glb<'a> {
    attributes: serde_json::Map<String, Value>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    textures: Vec<Value>,
    images: Vec<Value>,
    parts: Vec<Part<'a>>,
    num_bytes: usize,
}

impl<'a> Glb<'a> {
    /// With positions and normals.
    fn of(path: &Path, mesh: &'a Mesh, frame: &'a ViewerFrame) -> Result<Self, IoError> {
        check(path, mesh)?;
        if mesh.triangles.is_empty() {
            return Err(IoError::write(path, "the mesh has no triangles"));
        }
        let mut file = Self {
            attributes: serde_json::Map::new(),
            views: Vec::new(),
            accessors: Vec::new(),
            textures: Vec::new(),
            images: Vec::new(),
            parts: Vec::new(),
            num_bytes: 0,
        };
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        for p in mesh.vertices.iter().map(|&v| frame.turn(v)) {
            for k in 0..3 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        let turned = |values: &'a [[f32; 3]]| {
            let values = values.iter().flat_map(|&v| frame.turn(v));
            values.flat_map(f32::to_le_bytes)
        };
        let accessor = json!({"componentType": FLOAT, "type": "VEC3", "min": low, "max": high});
        let num = mesh.vertices.len();
        file.attribute("POSITION", num, accessor, (12, turned(&mesh.vertices)));
        if !mesh.normals.is_empty() {
            let accessor = json!({"componentType": FLOAT, "type": "VEC3"});
            file.attribute("NORMAL", num, accessor, (12, turned(&mesh.normals)));
        }
        Ok(file)
    }

    /// Adds a part for a purpose; returns its number. Parts begin at multiples of four bytes.
    fn part(
        &mut self,
        num_bytes: usize,
        target: Option<u32>,
        mut bytes: impl Iterator<Item = u8> + 'a,
    ) -> usize {
        let mut view = json!({
            "buffer": 0, "byteOffset": self.num_bytes, "byteLength": num_bytes,
        });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        let padded = num_bytes.next_multiple_of(4);
        let write = move |out: &mut BufWriter<File>| {
            let padding = std::iter::repeat_n(0, padded - num_bytes);
            for byte in bytes.by_ref().chain(padding) {
                out.write_all(&[byte])?;
            }
            Ok(())
        };
        self.parts.push((padded, Box::new(write)));
        self.num_bytes += padded;
        self.views.len() - 1
    }

    /// Adds what `num` vertices have, of so many bytes each.
    fn attribute(
        &mut self,
        name: &str,
        num: usize,
        mut accessor: Value,
        (bytes_each, bytes): (usize, impl Iterator<Item = u8> + 'a),
    ) {
        accessor["bufferView"] = json!(self.part(num * bytes_each, Some(ARRAY), bytes));
        accessor["count"] = json!(num);
        self.attributes
            .insert(name.to_owned(), json!(self.accessors.len()));
        self.accessors.push(accessor);
    }

    /// Adds a PNG as the next texture.
    fn texture(&mut self, name: &str, png: &'a [u8]) {
        let view = self.part(png.len(), None, png.iter().copied());
        self.textures
            .push(json!({"sampler": 0, "source": self.images.len()}));
        self.images
            .push(json!({"name": name, "mimeType": "image/png", "bufferView": view}));
    }

    /// Adds the triangles and writes all.
    fn write(
        mut self,
        path: &Path,
        mesh: &'a Mesh,
        (material, world): (Value, WorldCoordinates),
    ) -> Result<(), IoError> {
        let num = 3 * mesh.triangles.len();
        let corners = mesh.triangles.iter().flatten().copied();
        let view = self.part(4 * num, Some(ELEMENTS), corners.flat_map(u32::to_le_bytes));
        let indices = self.accessors.len();
        self.accessors.push(json!({
            "componentType": UNSIGNED_INT, "count": num, "type": "SCALAR", "bufferView": view,
        }));
        let mut extras = json!({"unit": match world.unit {
            Unit::Arbitrary => "arbitrary: the scale is unknown",
            unit => unit.name(),
        }});
        // In the world's axes, as of the PLY; as a node's place, single precision would lose it.
        if let Some(offset) = world.offset() {
            extras["offset_in_world"] = json!(offset);
        }
        let mut document = json!({
            "asset": {
                "version": "2.0",
                "generator": concat!("rilievo ", env!("CARGO_PKG_VERSION")),
                "extras": extras,
            },
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": "object"}],
            "meshes": [{"primitives": [{
                "attributes": self.attributes, "indices": indices, "material": 0, "mode": 4,
            }]}],
            "materials": [material],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": self.num_bytes}],
        });
        if !self.textures.is_empty() {
            document["textures"] = json!(self.textures);
            document["images"] = json!(self.images);
            document["samplers"] = json!([{
                "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR,
                "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE,
            }]);
        }
        let mut text = document.to_string();
        // Chunks are multiples of four bytes; JSON is filled up with spaces.
        while !text.len().is_multiple_of(4) {
            text.push(' ');
        }
        let length = |bytes: usize| {
            u32::try_from(bytes)
                .map_err(|_| IoError::write(path, "the mesh exceeds the 4 GB that GLB can hold"))
        };
        let total = length(12 + 8 + text.len() + 8 + self.num_bytes)?;
        let (text_length, binary_length) = (length(text.len())?, length(self.num_bytes)?);
        write_pieces(path, |out| {
            for word in [MAGIC, VERSION, total, text_length, CHUNK_JSON] {
                out.write_all(&word.to_le_bytes())?;
            }
            out.write_all(text.as_bytes())?;
            for word in [binary_length, CHUNK_BINARY] {
                out.write_all(&word.to_le_bytes())?;
            }
            self.parts.iter_mut().try_for_each(|(_, write)| write(out))
        })
    }
}
