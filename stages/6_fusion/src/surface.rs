//! The surface `D = 0` as triangles.
//!
//! Surface nets block by block (each block with one layer of its neighbours); a vertex belongs to
//! the block of its cell, which determines its normal and colour ([`dress`]), and triangles name
//! vertices by their cells. The pieces are stored until the number of vertices is known, then
//! joined. Triangles with a corner in a cell that touches an unknown voxel are no surface but the
//! end of what was seen, and are dropped. Sheets that share an edge are separated ([`manifold`]),
//! the end is smoothed ([`rim`]), small loose pieces are dropped ([`pieces`]) and small holes
//! closed ([`holes`]).

use crate::dress::{Dressed, Dresser};
use crate::error::FusionError;
use crate::options::FusionOptions;
use crate::report::MeshReport;
use crate::tsdf::{BLOCKS_AT_ONCE, Key, SIDE, UNKNOWN, VOLUME, Volume};
use crate::views::LoadedViews;
use crate::{holes, manifold, pieces, rim, simplify};
use fast_surface_nets::ndshape::{ConstShape, ConstShape3u32};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_scene::team::divided;
use rilievo_scene::{Mesh, Observer, PageCaches, Room, Scratch, ScratchError, StageId};
use serde::{Deserialize, Serialize};

/// A block with one layer of neighbours on either side.
const PADDED: u32 = SIDE as u32 + 2;
type PaddedShape = ConstShape3u32<PADDED, PADDED, PADDED>;

/// Holes with a shorter edge than this many cells are closed: they are three times as wide as the
/// views are averaged.
const MAX_HOLE_CELLS: f64 = 40.0;
/// Cells along the edge of a block with those of the next blocks that its triangles touch.
const CELLS: u32 = SIDE as u32 + 1;
/// Bytes of a stored vertex and triangle.
const VERTEX_BYTES: usize = 12 + 12 + 3;
const TRIANGLE_BYTES: usize = 3 * 2;

/// Deviation from the surface of all cells within which flat places are coarser, pixel footprints.
/// Leaves .15 of the demo's triangles.
const DEVIATION_PX: f64 = 0.1;
/// Rounds of mending: a filling may open what touches it, and one round more closes that.
const MAX_MENDINGS: usize = 8;
/// Blocks that are worked on one after the other.
const BLOCKS_IN_ROW: usize = 32;

/// The surface in one block.
#[derive(Default, Serialize, Deserialize)]
struct Piece {
    /// Number of each vertex's cell in the block, ascending.
    cells: Vec<u16>,
    vertices: Vec<Dressed>,
    /// Corners by the numbers of their cells, of [`CELLS`] along each edge.
    triangles: Vec<[u16; 3]>,
}

/// The pieces of all blocks, out of core.
struct Pieces {
    room: Box<dyn Room>,
    /// Number of the first vertex of every block, and of the end.
    first_vertex: Vec<u32>,
    num_triangles: Vec<u32>,
    /// Cells of all vertices.
    cells: Vec<u16>,
    /// Sum of the vertices' distances from the views' surfaces, and how many have one.
    distances: (f64, usize),
}

/// Extracts the mesh of a volume with normals and colours of the views.
pub(crate) fn extract(
    volume: Volume,
    loaded: &LoadedViews,
    caches: PageCaches<'_>,
    scratch: &dyn Scratch,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<(Mesh, MeshReport), FusionError> {
    let step = |step: &str, done: usize, all: usize| {
        let flow = observer.progress(StageId::Fusion, step, (done, all));
        flow.ok_or(FusionError::Interrupted)
    };
    let mut pieces = Pieces {
        room: scratch.room()?,
        first_vertex: vec![0],
        num_triangles: Vec::new(),
        cells: Vec::new(),
        distances: (0.0, 0),
    };
    let dresser = Dresser::new(&loaded.views, &volume, options);
    let mut place = 0;
    for first in (0..volume.num_blocks()).step_by(BLOCKS_AT_ONCE) {
        step("extracting the surface", first, volume.num_blocks())?;
        let end = volume.num_blocks().min(first + BLOCKS_AT_ONCE);
        let num_rows = (end - first).div_ceil(BLOCKS_IN_ROW);
        let made = divided(observer.team(), num_rows, usize::MAX, |row| {
            let begin = first + row * BLOCKS_IN_ROW;
            let mut buffer = SurfaceNetsBuffer::default();
            (begin..end.min(begin + BLOCKS_IN_ROW))
                .map(|idx| extract_block(&volume, &dresser, &caches, idx, &mut buffer))
                .collect::<Result<Vec<Piece>, FusionError>>()
        })?;
        place += pieces.store(made.into_iter().flatten().collect(), place)?;
    }
    drop(caches);
    step("joining the surface", 0, 1)?;
    let mut mesh = pieces.join(&volume)?;
    let (sum, count) = pieces.distances;
    let mut report = MeshReport {
        voxel: volume.voxel,
        coarsened_by: volume.coarsened_by,
        memory_mib: volume.memory_mib(),
        mean_distance_to_cloud: (count > 0).then(|| sum / count as f64),
        ..MeshReport::default()
    };
    drop((pieces, volume));
    report.num_separated_edges = manifold::separate(&mut mesh);
    rim::smooth(&mut mesh);
    let pieces = pieces::drop_small(&mut mesh);
    report.num_pieces = pieces.num_kept;
    report.num_dropped_pieces = pieces.num_dropped;
    report.dropped_share = pieces.dropped_share;
    let longest = if options.watertight {
        f64::INFINITY
    } else {
        // The outline of a piece that is just large enough to stay is no hole: N triangles of half
        // a cell's area are a disc of 2 π N cells² around.
        let smallest = pieces::MIN_PIECE * mesh.triangles.len() as f64;
        MAX_HOLE_CELLS.min((std::f64::consts::TAU * smallest).sqrt()) * report.voxel
    };
    let loops = rim::boundary_loops(&mesh);
    let short = loops
        .into_iter()
        .filter(|ring| holes::length(&mesh, ring) <= longest);
    let short: Vec<Vec<u32>> = short.collect();
    close(&mut mesh, &short, &mut report);
    mend(&mut mesh, options, &mut report);
    let num_before = mesh.triangles.len();
    if options.max_num_triangles > 0 {
        report.simplified_by = simplify::simplify(&mut mesh, options.max_num_triangles);
    } else if !options.full {
        step("making flat places coarser", 0, 1)?;
        let deviation = DEVIATION_PX * loaded.median_footprint;
        report.simplified_by = simplify::coarsen(&mut mesh, deviation);
    }
    mend(&mut mesh, options, &mut report);
    report.num_triangles_before = Some(num_before).filter(|&n| n > mesh.triangles.len());
    let open = rim::boundary_loops(&mesh);
    report.num_open_loops = open.len();
    report.boundary_length = open.iter().map(|ring| holes::length(&mesh, ring)).sum();
    report.bounds = mesh.bounds();
    report.num_vertices = mesh.vertices.len();
    report.num_triangles = mesh.triangles.len();
    Ok((mesh, report))
}

/// Closes loops, and counts them.
fn close(mesh: &mut Mesh, loops: &[Vec<u32>], report: &mut MeshReport) {
    let closed = holes::close(mesh, loops);
    report.num_closed_holes += closed.num_holes;
    report.closed_area += closed.area;
}

/// Separates sheets that a filling or a collapsed edge has joined, and closes what that opens where
/// the mesh shall be watertight.
fn mend(mesh: &mut Mesh, options: &FusionOptions, report: &mut MeshReport) {
    for _ in 0..MAX_MENDINGS {
        manifold::separate(mesh);
        let open = match options.watertight {
            true => rim::boundary_loops(mesh),
            false => Vec::new(),
        };
        if open.is_empty() {
            break;
        }
        close(mesh, &open, report);
    }
}

fn extract_block(
    volume: &Volume,
    dresser: &Dresser<'_>,
    caches: &PageCaches<'_>,
    idx: usize,
    buffer: &mut SurfaceNetsBuffer,
) -> Result<Piece, FusionError> {
    let key = volume.key(idx);
    // The block's voxels and two layers more on the far sides, where the next block begins.
    let mut blocks: [Option<[f32; VOLUME]>; 8] = [None; 8];
    for (n, block) in blocks.iter_mut().enumerate() {
        if let Some(found) = volume.find(neighbour(key, n)) {
            *block = Some(volume.read(found)?);
        }
    }
    let value = |at: [usize; 3]| -> f32 {
        let far = at.map(|c| c / SIDE);
        let near = at.map(|c| c % SIDE);
        blocks[far[0] + 2 * far[1] + 4 * far[2]]
            .map_or(UNKNOWN, |b| b[near[0] + SIDE * (near[1] + SIDE * near[2])])
    };
    let values: Vec<f32> = (0..PaddedShape::SIZE)
        .map(|i| value(PaddedShape::delinearize(i).map(|c| c as usize)))
        .collect();
    // Unknown voxels are larger than any truncated distance, hence outside: the nets end there in
    // false walls, which `is_known` marks.
    surface_nets(&values, &PaddedShape {}, [0; 3], [PADDED - 1; 3], buffer);
    let is_known: Vec<bool> = buffer
        .surface_points
        .iter()
        .map(|cell| {
            (0..8).all(|n| {
                let corner = [
                    cell[0] + (n & 1),
                    cell[1] + (n >> 1 & 1),
                    cell[2] + (n >> 2),
                ];
                values[PaddedShape::linearize(corner) as usize] != UNKNOWN
            })
        })
        .collect();
    let mut piece = Piece::default();
    let corner = volume.corner(idx);
    caches.with(|pixels| {
        let near = dresser.near(pixels, idx);
        for (i, cell) in buffer.surface_points.iter().enumerate() {
            if !is_known[i] || cell.iter().any(|&c| c as usize >= SIDE) {
                continue;
            }
            // Voxel centres lie half a voxel from the corner of their block.
            let at =
                Vector3::from(buffer.positions[i].map(|c| (f64::from(c) + 0.5) * volume.voxel));
            let gradient = Vector3::from(buffer.normals[i].map(f64::from));
            piece.cells.push(number_in_block(*cell));
            piece
                .vertices
                .push(dresser.dress(pixels, &near, &(corner + at), &gradient));
        }
    })?;
    let number = |v: u32| {
        let [x, y, z] = buffer.surface_points[v as usize];
        (x + CELLS * (y + CELLS * z)) as u16
    };
    piece.triangles = buffer
        .indices
        .chunks_exact(3)
        .filter(|t| t.iter().all(|&v| is_known[v as usize]))
        .map(|t| [number(t[0]), number(t[1]), number(t[2])])
        .collect();
    Ok(piece)
}

/// The `n`th of a block and those on its far sides.
fn neighbour(key: Key, n: usize) -> Key {
    std::array::from_fn(|i| key[i] + (n >> i & 1) as i32)
}

fn number_in_block([x, y, z]: [u32; 3]) -> u16 {
    (x + SIDE as u32 * (y + SIDE as u32 * z)) as u16
}

impl Pieces {
    /// Stores the pieces of the next blocks at a place; returns their bytes.
    fn store(&mut self, pieces: Vec<Piece>, place: u64) -> Result<u64, FusionError> {
        let mut bytes = Vec::new();
        for piece in pieces {
            for vertex in &piece.vertices {
                for value in vertex.position.iter().chain(&vertex.normal) {
                    bytes.extend(value.to_le_bytes());
                }
                bytes.extend(vertex.color);
                if let Some(distance) = vertex.distance {
                    self.distances.0 += distance;
                    self.distances.1 += 1;
                }
            }
            for corner in piece.triangles.iter().flatten() {
                bytes.extend(corner.to_le_bytes());
            }
            self.cells.extend(piece.cells);
            self.first_vertex.push(self.cells.len() as u32);
            self.num_triangles.push(piece.triangles.len() as u32);
        }
        self.room.write_at(&bytes, place)?;
        Ok(bytes.len() as u64)
    }

    /// Joins the pieces at the cells they share.
    fn join(&mut self, volume: &Volume) -> Result<Mesh, ScratchError> {
        let num_vertices = self.cells.len();
        let num_triangles = self.num_triangles.iter().map(|&n| n as usize).sum();
        let mut mesh = Mesh {
            vertices: Vec::with_capacity(num_vertices),
            normals: Vec::with_capacity(num_vertices),
            colors: Vec::with_capacity(num_vertices),
            triangles: Vec::with_capacity(num_triangles),
        };
        let mut place = 0;
        let float = |b: &[u8]| f32::from_le_bytes(b.try_into().unwrap_or_default());
        for first in (0..volume.num_blocks()).step_by(BLOCKS_AT_ONCE) {
            let blocks = first..volume.num_blocks().min(first + BLOCKS_AT_ONCE);
            let sizes = blocks.clone().map(|idx| {
                let num = self.first_vertex[idx + 1] - self.first_vertex[idx];
                let (vertices, triangles) = (num as usize, self.num_triangles[idx] as usize);
                (idx, vertices * VERTEX_BYTES, triangles * TRIANGLE_BYTES)
            });
            let sizes: Vec<(usize, usize, usize)> = sizes.collect();
            let mut bytes = vec![0; sizes.iter().map(|s| s.1 + s.2).sum()];
            self.room.read_at(&mut bytes, place)?;
            place += bytes.len() as u64;
            let mut rest = bytes.as_slice();
            let mut corners = Vec::with_capacity(sizes.len());
            for (idx, vertices, triangles) in sizes {
                let (here, next) = rest.split_at(vertices);
                for record in here.chunks_exact(VERTEX_BYTES) {
                    let three = |k: usize| [0, 4, 8].map(|c| float(&record[k + c..k + c + 4]));
                    mesh.vertices.push(three(0));
                    mesh.normals.push(three(12));
                    mesh.colors.push([record[24], record[25], record[26]]);
                }
                let (here, next) = next.split_at(triangles);
                corners.push((idx, here));
                rest = next;
            }
            let joined: Vec<Vec<[u32; 3]>> = corners
                .into_par_iter()
                .map(|(idx, corners)| self.triangles(volume, idx, corners))
                .collect();
            mesh.triangles.extend(joined.into_iter().flatten());
        }
        Ok(mesh)
    }

    /// Triangles of a block by their vertices.
    fn triangles(&self, volume: &Volume, idx: usize, corners: &[u8]) -> Vec<[u32; 3]> {
        let key = volume.key(idx);
        let mut found: [Option<Option<usize>>; 8] = [None; 8];
        found[0] = Some(Some(idx));
        let mut vertex = |number: u16| -> Option<u32> {
            let number = u32::from(number);
            let cell = [
                number % CELLS,
                number / CELLS % CELLS,
                number / (CELLS * CELLS),
            ];
            let n = (0..3).fold(0, |n, i| n | usize::from(cell[i] as usize == SIDE) << i);
            let block = (*found[n].get_or_insert_with(|| volume.find(neighbour(key, n))))?;
            let first = self.first_vertex[block] as usize;
            let cells = &self.cells[first..self.first_vertex[block + 1] as usize];
            let wanted = number_in_block(cell.map(|c| c % SIDE as u32));
            let place = cells.binary_search(&wanted).ok()?;
            Some((first + place) as u32)
        };
        corners
            .chunks_exact(TRIANGLE_BYTES)
            .filter_map(|three| {
                let corner = |k: usize| u16::from_le_bytes([three[2 * k], three[2 * k + 1]]);
                Some([vertex(corner(0))?, vertex(corner(1))?, vertex(corner(2))?])
            })
            .collect()
    }
}
