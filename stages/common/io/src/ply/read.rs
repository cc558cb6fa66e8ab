//! Reading clouds and meshes.

use super::header::{Element, Format, Header, Property, Scalar};
use crate::error::IoError;
use crate::files::read_regular;
use rilievo_scene::{CloudPoint, Mesh, PointCloud};
use std::path::Path;

/// Values of a vertex that are understood, in the order of their slots.
const VERTEX_PROPERTIES: [&str; 11] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "red",
    "green",
    "blue",
    "confidence",
    "views",
];

/// Numbers of the body, one after another.
enum Body<'a> {
    Text(std::str::SplitAsciiWhitespace<'a>),
    Binary { bytes: &'a [u8], big_endian: bool },
}

const NO_POSITIONS: &str = "has no vertices with x, y and z";

const TOO_SHORT: &str = "the file ends too early";

impl<'a> Body<'a> {
    fn new(header: &Header, bytes: &'a [u8]) -> Result<Self, String> {
        let body = bytes.get(header.body_at..).unwrap_or_default();
        Ok(match header.format {
            Format::Ascii => {
                let text = std::str::from_utf8(body).map_err(|_| "its numbers are no text")?;
                Self::Text(text.split_ascii_whitespace())
            }
            format => Self::Binary {
                bytes: body,
                big_endian: format == Format::BigEndian,
            },
        })
    }

    fn next(&mut self, scalar: Scalar) -> Result<f64, String> {
        match self {
            Self::Text(words) => {
                let word = words.next().ok_or(TOO_SHORT)?;
                word.parse()
                    .map_err(|_| format!("\"{word}\" is not a number"))
            }
            Self::Binary { bytes, big_endian } => {
                let size = scalar.size();
                let (piece, rest) = bytes.split_at_checked(size).ok_or(TOO_SHORT)?;
                *bytes = rest;
                let mut word = [0u8; 8];
                word[..size].copy_from_slice(piece);
                if *big_endian {
                    word[..size].reverse();
                }
                let [a, b, c, d, ..] = word;
                Ok(match scalar {
                    Scalar::I8 => f64::from(a as i8),
                    Scalar::U8 => f64::from(a),
                    Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
                    Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
                    Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                    Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                    Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                    Scalar::F64 => f64::from_le_bytes(word),
                })
            }
        }
    }

    /// Reads a property's numbers into `values`.
    fn property(&mut self, property: &Property, values: &mut Vec<f64>) -> Result<(), String> {
        values.clear();
        let len = match property.list {
            None => 1,
            Some(scalar) => {
                let len = self.next(scalar)?;
                if !(0.0..=f64::from(u32::MAX)).contains(&len) {
                    return Err(format!("a list of {} has the length {len}", property.name));
                }
                len as usize
            }
        };
        for _ in 0..len {
            values.push(self.next(property.scalar)?);
        }
        Ok(())
    }
}

/// A vertex, in the order of [`VERTEX_PROPERTIES`].
type Vertex = [f32; VERTEX_PROPERTIES.len()];

struct Content {
    vertices: Vec<Vertex>,
    /// Which of the vertex's values the file has.
    has: [bool; VERTEX_PROPERTIES.len()],
    triangles: Vec<[u32; 3]>,
    /// Metres or the like per unit of the file, and what is taken off then.
    local: Option<(f64, [f64; 3])>,
    /// What the file says is to be added to its positions.
    offset: [f64; 3],
}

/// `local`: see [`read_mesh_ply_near`]; nothing where positions are taken as they stand.
fn parse(bytes: &[u8], local: Option<(f64, [f64; 3])>) -> Result<Content, String> {
    let header = Header::parse(bytes)?;
    let mut body = Body::new(&header, bytes)?;
    let mut content = Content {
        vertices: Vec::new(),
        has: [false; VERTEX_PROPERTIES.len()],
        triangles: Vec::new(),
        local,
        offset: header.offset,
    };
    let mut seen_vertices = false;
    for element in &header.elements {
        // An element without properties takes no bytes, whatever its count claims.
        if element.properties.is_empty() {
            continue;
        }
        match element.name.as_str() {
            "vertex" => {
                parse_vertices(element, &mut body, &mut content)?;
                seen_vertices = true;
            }
            "face" => parse_faces(element, &mut body, &mut content)?,
            _ => {
                let mut values = Vec::new();
                for _ in 0..element.count {
                    for property in &element.properties {
                        body.property(property, &mut values)?;
                    }
                }
            }
        }
    }
    if !seen_vertices || !content.has[..3].iter().all(|&has| has) {
        return Err(NO_POSITIONS.to_owned());
    }
    let num_vertices = content.vertices.len();
    for (i, vertex) in content.vertices.iter().enumerate() {
        if vertex[..3].iter().any(|coordinate| !coordinate.is_finite()) {
            return Err(format!("vertex {i} lies at {:?}", &vertex[..3]));
        }
    }
    for triangle in &content.triangles {
        if let Some(index) = triangle.iter().find(|&&i| i as usize >= num_vertices) {
            return Err(format!("a face names vertex {index} of {num_vertices}"));
        }
    }
    Ok(content)
}

/// For every property of a vertex its slot and the factor of its values, where it is understood.
fn slots(element: &Element) -> Vec<Option<(usize, f64)>> {
    element
        .properties
        .iter()
        .map(|property| {
            let name = property
                .name
                .strip_prefix("diffuse_")
                .unwrap_or(&property.name);
            let slot = VERTEX_PROPERTIES.iter().position(|known| *known == name)?;
            let is_color = (6..9).contains(&slot);
            let scale = if is_color && property.scalar.is_float() {
                255.0
            } else {
                1.0
            };
            (property.list.is_none()).then_some((slot, scale))
        })
        .collect()
}

fn point(v: &Vertex) -> CloudPoint {
    CloudPoint {
        position: [v[0], v[1], v[2]],
        normal: [v[3], v[4], v[5]],
        color: [byte(v[6]), byte(v[7]), byte(v[8])],
        confidence: v[9],
        num_views: byte(v[10]),
    }
}

fn parse_vertices(
    element: &Element,
    body: &mut Body<'_>,
    content: &mut Content,
) -> Result<(), String> {
    let slots = slots(element);
    for (slot, _) in slots.iter().flatten() {
        content.has[*slot] = true;
    }
    // Known before the body is read: a vertex of a byte would take the memory of eleven numbers.
    if !content.has[..3].iter().all(|&has| has) {
        return Err(NO_POSITIONS.to_owned());
    }
    let mut values = Vec::new();
    for _ in 0..element.count {
        let mut vertex = [0.0; VERTEX_PROPERTIES.len()];
        for (property, slot) in element.properties.iter().zip(&slots) {
            body.property(property, &mut values)?;
            if let (Some((slot, scale)), [value]) = (slot, &values[..]) {
                let value = match (content.local, content.offset.get(*slot)) {
                    (Some((factor, origin)), Some(offset)) => {
                        (value + offset) * factor - origin[*slot]
                    }
                    _ => value * scale,
                };
                vertex[*slot] = value as f32;
            }
        }
        content.vertices.push(vertex);
    }
    Ok(())
}

fn parse_faces(
    element: &Element,
    body: &mut Body<'_>,
    content: &mut Content,
) -> Result<(), String> {
    let mut values = Vec::new();
    for _ in 0..element.count {
        for property in &element.properties {
            body.property(property, &mut values)?;
            let is_face = property.list.is_some()
                && matches!(property.name.as_str(), "vertex_indices" | "vertex_index");
            if !is_face {
                continue;
            }
            if let Some(index) = values
                .iter()
                .find(|&&i| !(0.0..=f64::from(u32::MAX)).contains(&i) || i.fract() != 0.0)
            {
                return Err(format!("a face names vertex {index}"));
            }
            // Polygons are cut into a fan around their first corner.
            for pair in values.get(1..).unwrap_or_default().windows(2) {
                content
                    .triangles
                    .push([values[0] as u32, pair[0] as u32, pair[1] as u32]);
            }
        }
    }
    Ok(())
}

fn load(path: &Path, local: Option<(f64, [f64; 3])>) -> Result<Content, IoError> {
    let bytes = read_regular(path)?;
    parse(&bytes, local).map_err(|reason| IoError::input(path, reason))
}

/// A colour or count; the cast saturates, as one out of range should.
fn byte(value: f32) -> u8 {
    value.round() as u8
}

/// Reads a cloud; properties that are absent are zero.
///
/// # Errors
/// When the file cannot be read or is no PLY with `x y z`.
pub fn read_cloud_ply(path: &Path) -> Result<PointCloud, IoError> {
    let content = load(path, None)?;
    let points = content.vertices.iter().map(point).collect();
    Ok(PointCloud { points })
}

/// Reads a mesh; polygons are cut into triangles.
///
/// # Errors
/// When the file cannot be read or is no PLY with `x y z`.
pub fn read_mesh_ply(path: &Path) -> Result<Mesh, IoError> {
    Ok(mesh_of(load(path, None)?))
}

/// The same in a local frame: `factor · (x + offset) − origin` in double precision, where `offset` is
/// the one that the file states.
///
/// # Errors
/// As [`read_mesh_ply`].
pub fn read_mesh_ply_near(path: &Path, factor: f64, origin: [f64; 3]) -> Result<Mesh, IoError> {
    Ok(mesh_of(load(path, Some((factor, origin)))?))
}

fn mesh_of(content: Content) -> Mesh {
    let vertices = content.vertices.iter();
    let triple = |at: usize| -> Vec<[f32; 3]> {
        let has = content.has[at..at + 3].iter().all(|&has| has);
        let values = vertices.clone().map(|v| [v[at], v[at + 1], v[at + 2]]);
        if has { values.collect() } else { Vec::new() }
    };
    let colors = triple(6).into_iter();
    Mesh {
        vertices: triple(0),
        normals: triple(3),
        colors: colors.map(|color| color.map(byte)).collect(),
        triangles: content.triangles,
    }
}
