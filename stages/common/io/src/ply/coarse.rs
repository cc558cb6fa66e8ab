//! A mesh of few vertices in the place of a large one, read in the memory of its vertices' cells.

use super::header::{Element, Format, Header, Scalar};
use super::read::{Body, NO_POSITIONS, byte, next_vertex, slots};
use crate::error::IoError;
use crate::files::open_regular;
use rilievo_scene::Mesh;
use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// A mesh whose vertices were gathered into cubic cells: each cell's vertices became their mean.
#[derive(Clone, Debug, PartialEq)]
pub struct CoarseMesh {
    /// Vertices, with normals and colours where the file has both, and the triangles that still have three corners.
    pub mesh: Mesh,
    /// Triangles of the whole mesh.
    pub num_triangles: usize,
    /// The whole mesh's smallest and largest coordinates.
    pub bounds: [[f32; 3]; 2],
}

/// Bytes of a file that hold its header.
const HEADER_BYTES: u64 = 1 << 16;
/// Steps of the finest grid along the longest side: three coordinates fit 30 bits.
const STEPS: u32 = 1 << 10;
/// Bytes of a face: the length of its list, and three indices.
const FACE_BYTES: usize = 13;

/// Reads a binary mesh of triangles, such as this program writes, as one of at most `most` vertices.
///
/// # Errors
/// When the file cannot be read, or is no binary PLY of vertices with `x y z`, then triangles.
pub fn read_coarse_mesh_ply(path: &Path, most: usize) -> Result<CoarseMesh, IoError> {
    let failed = |error: std::io::Error| IoError::read(path, &error);
    let not_such = |reason: String| IoError::input(path, reason);
    let mut head = Vec::new();
    let start = open_regular(path)?
        .take(HEADER_BYTES)
        .read_to_end(&mut head);
    start.map_err(failed)?;
    let header = Header::parse(&head).map_err(not_such)?;
    let (vertices, faces) = elements(&header)
        .ok_or_else(|| not_such("is no binary mesh of plain vertices and triangles".to_owned()))?;
    let reader = || -> Result<Records, IoError> {
        let mut file = open_regular(path)?;
        let body = SeekFrom::Start(header.body_at as u64);
        file.seek(body).map_err(failed)?;
        Ok(Records {
            file: BufReader::with_capacity(1 << 20, file),
            record: Vec::new(),
            big_endian: header.format == Format::BigEndian,
        })
    };

    let bytes = vertices.properties.iter().map(|p| p.scalar.size()).sum();
    let slots = slots(vertices);
    let has = |slot: usize| slots.iter().flatten().any(|(known, _)| *known == slot);
    if !(0..3).all(has) {
        return Err(not_such(NO_POSITIONS.to_owned()));
    }
    let mut values = Vec::new();
    let mut each = |seen: &mut dyn FnMut([f64; 11])| -> Result<Records, IoError> {
        let mut records = reader()?;
        for _ in 0..vertices.count {
            let mut body = records.next(bytes).map_err(failed)?;
            let vertex = next_vertex(vertices, &slots, &mut body, &mut values);
            seen(vertex.map_err(not_such)?);
        }
        Ok(records)
    };

    let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    each(&mut |vertex| {
        for (axis, &value) in vertex[..3].iter().enumerate() {
            bounds[0][axis] = bounds[0][axis].min(value as f32);
            bounds[1][axis] = bounds[1][axis].max(value as f32);
        }
    })?;
    let extent = (0..3).map(|k| bounds[1][k] - bounds[0][k]);
    let step = extent.fold(f32::MIN_POSITIVE, f32::max) / (STEPS - 1) as f32;
    // Capacities follow the vertices that are there, not those that a header claims.
    let mut places: Vec<u32> = Vec::new();
    each(&mut |vertex| {
        let at = |k: usize| (((vertex[k] as f32 - bounds[0][k]) / step) as u32).min(STEPS - 1);
        places.push(at(0) * STEPS * STEPS + at(1) * STEPS + at(2));
    })?;

    let cells = Cells::of(&places, most.max(8));
    drop(places);
    let mut sums = vec![[0.0; 11]; cells.count];
    let mut counts = vec![0_u32; cells.count];
    let mut number = 0;
    let mut records = each(&mut |vertex| {
        let cell = cells.of_vertex[number] as usize;
        (0..9).for_each(|k| sums[cell][k] += vertex[k]);
        counts[cell] += 1;
        number += 1;
    })?;
    let mut triangles = Vec::new();
    let mut known = HashSet::new();
    for _ in 0..faces.count {
        let mut body = records.next(FACE_BYTES).map_err(failed)?;
        let corners = cells.corners(&mut body).map_err(not_such)?;
        if let Some(corners) = corners.filter(|corners| known.insert(*corners)) {
            triangles.push(corners);
        }
    }
    let mean = |cell: usize, k: usize| sums[cell][k] / f64::from(counts[cell]);
    let all = |of: &dyn Fn(usize) -> [f32; 3]| (0..cells.count).map(of).collect();
    let triple = |cell, at| std::array::from_fn(|k| mean(cell, at + k) as f32);
    Ok(CoarseMesh {
        mesh: Mesh {
            vertices: all(&|cell| triple(cell, 0)),
            normals: if has(3) {
                all(&|cell| unit(triple(cell, 3)))
            } else {
                Vec::new()
            },
            colors: if has(6) {
                let color = |cell| std::array::from_fn(|k| byte(mean(cell, 6 + k)));
                (0..cells.count).map(color).collect()
            } else {
                Vec::new()
            },
            triangles,
        },
        num_triangles: faces.count,
        bounds,
    })
}

fn unit(vector: [f32; 3]) -> [f32; 3] {
    let length = vector.iter().map(|v| v * v).sum::<f32>().sqrt();
    vector.map(|v| v / length.max(f32::MIN_POSITIVE))
}

/// The vertices and the triangles of a binary mesh that has these alone.
fn elements(header: &Header) -> Option<(&Element, &Element)> {
    let [vertices, faces] = &header.elements[..] else {
        return None;
    };
    let plain = vertices.properties.iter().all(|p| p.list.is_none());
    let [list] = &faces.properties[..] else {
        return None;
    };
    let triangles = matches!(list.list, Some(Scalar::U8))
        && matches!(list.scalar, Scalar::I32 | Scalar::U32)
        && faces.name == "face";
    let binary = header.format != Format::Ascii;
    (binary && vertices.name == "vertex" && plain && triangles).then_some((vertices, faces))
}

/// A file's body, record by record.
struct Records {
    file: BufReader<File>,
    record: Vec<u8>,
    big_endian: bool,
}

impl Records {
    fn next(&mut self, bytes: usize) -> std::io::Result<Body<'_>> {
        self.record.resize(bytes, 0);
        self.file.read_exact(&mut self.record)?;
        Ok(Body::Binary {
            bytes: &self.record,
            big_endian: self.big_endian,
        })
    }
}

/// Which cell every vertex lies in.
struct Cells {
    of_vertex: Vec<u32>,
    count: usize,
}

impl Cells {
    /// The smallest cells of which at most `most` are taken.
    fn of(places: &[u32], most: usize) -> Self {
        let mut side = 1;
        loop {
            let mut numbers: HashMap<u32, u32> = HashMap::new();
            let mut of_vertex = Vec::with_capacity(places.len());
            for &place in places {
                let coordinates = [place >> 20, place >> 10 & (STEPS - 1), place & (STEPS - 1)];
                let cell = coordinates.map(|c| c / side);
                let cell = cell[0] << 20 | cell[1] << 10 | cell[2];
                let next = numbers.len() as u32;
                of_vertex.push(*numbers.entry(cell).or_insert(next));
                if numbers.len() > most {
                    break;
                }
            }
            if numbers.len() <= most {
                let count = numbers.len();
                return Self { of_vertex, count };
            }
            side += 1;
        }
    }

    /// The cells of a triangle's corners, the smallest first; `None` where two are the same.
    fn corners(&self, body: &mut Body<'_>) -> Result<Option<[u32; 3]>, String> {
        if body.next(Scalar::U8)? != 3.0 {
            return Err("has a face that is no triangle".to_owned());
        }
        let mut cells = [0; 3];
        for cell in &mut cells {
            let index = body.next(Scalar::U32)?;
            let found = self.of_vertex.get(index as usize);
            *cell = *found.ok_or_else(|| format!("a face names vertex {index}"))?;
        }
        let [a, b, c] = cells;
        if a == b || b == c || c == a {
            return Ok(None);
        }
        let first = (0..3).min_by_key(|&k| cells[k]).unwrap_or(0);
        cells.rotate_left(first);
        Ok(Some(cells))
    }
}
