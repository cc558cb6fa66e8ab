//! The surface `D = 0` as triangles.
//!
//! Surface nets block by block (each block with one layer of its neighbours), welded by the cell
//! that each vertex lies in; triangles with a corner in a cell that touches an unknown voxel are
//! no surface but the end of what was seen, and are dropped; so are small loose pieces. The end is
//! smoothed ([`rim`]); vertices take normals and colours from the cloud.

use crate::error::FusionError;
use crate::holes::close;
use crate::options::FusionOptions;
use crate::points::blend;
use crate::report::MeshReport;
use crate::rim;
use crate::tsdf::{Key, SIDE, UNKNOWN, VOLUME, Volume};
use fast_surface_nets::ndshape::{ConstShape, ConstShape3u32};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_scene::{CloudPoint, Mesh, Observer, StageId};
use std::num::NonZero;

/// A block with one layer of neighbours on either side.
const PADDED: u32 = SIDE as u32 + 2;
type PaddedShape = ConstShape3u32<PADDED, PADDED, PADDED>;

/// A piece with fewer triangles than this share of the largest one is no surface.
const MIN_PIECE: f64 = 0.005;
/// Cloud points that a vertex takes its normal and colour from.
const NUM_NEAREST: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(5);
/// A vertex of a block: the cell that it lies in, in voxels of the whole volume, and its place.
struct Vertex {
    cell: [i32; 3],
    position: [f32; 3],
    /// Whether all eight voxels around it are known.
    is_known: bool,
}

struct Piece {
    vertices: Vec<Vertex>,
    triangles: Vec<[u32; 3]>,
}

/// Extracts the mesh of a volume with normals and colours of the cloud.
pub(crate) fn extract(
    volume: &Volume,
    points: &[CloudPoint],
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<(Mesh, MeshReport), FusionError> {
    let step = |step: &str, done: usize| {
        let flow = observer.progress(StageId::Fusion, step, (done, 3));
        flow.ok_or(FusionError::Interrupted)
    };
    step("extracting the surface", 0)?;
    let pieces: Vec<Piece> = volume
        .keys
        .par_iter()
        .map_init(SurfaceNetsBuffer::default, |buffer, key| {
            extract_block(volume, key, buffer)
        })
        .collect();
    step("joining the surface", 1)?;
    let mut mesh = weld(volume, pieces);
    rim::smooth(&mut mesh);
    let num_dropped_pieces = drop_small_pieces(&mut mesh);
    if options.watertight {
        close(&mut mesh);
    }
    step("colouring the surface", 2)?;
    let mean_distance_to_cloud = dress(&mut mesh, points, volume.voxel);
    let report = MeshReport {
        num_vertices: mesh.vertices.len(),
        num_triangles: mesh.triangles.len(),
        voxel: volume.voxel,
        coarsened_by: volume.coarsened_by,
        memory_mib: volume.memory_mib(),
        num_dropped_pieces,
        mean_distance_to_cloud,
    };
    Ok((mesh, report))
}

fn extract_block(volume: &Volume, key: &Key, buffer: &mut SurfaceNetsBuffer) -> Piece {
    // The block's voxels and one more on the far sides, where the next block begins.
    let blocks: Vec<Option<&[f32; VOLUME]>> = (0..8)
        .map(|n| volume.block(&[key[0] + (n & 1), key[1] + (n >> 1 & 1), key[2] + (n >> 2)]))
        .collect();
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
    // false walls, which `is_known` tells apart.
    surface_nets(&values, &PaddedShape {}, [0; 3], [PADDED - 1; 3], buffer);
    let vertices = buffer
        .positions
        .iter()
        .zip(&buffer.surface_points)
        .map(|(position, cell)| {
            let is_known = (0..8).all(|n| {
                value([
                    cell[0] as usize + (n & 1),
                    cell[1] as usize + (n >> 1 & 1),
                    cell[2] as usize + (n >> 2),
                ]) != UNKNOWN
            });
            let first = key.map(|k| k * SIDE as i32);
            Vertex {
                cell: std::array::from_fn(|i| first[i] + cell[i] as i32),
                position: std::array::from_fn(|i| position[i] - cell[i] as f32),
                is_known,
            }
        })
        .collect();
    let triangles = buffer
        .indices
        .chunks_exact(3)
        .map(|t| [t[0], t[1], t[2]])
        .collect();
    Piece {
        vertices,
        triangles,
    }
}

/// Joins the blocks' pieces at the cells they share.
fn weld(volume: &Volume, pieces: Vec<Piece>) -> Mesh {
    let mut cells: Vec<([i32; 3], [f32; 3])> = pieces
        .iter()
        .flat_map(|p| p.vertices.iter().filter(|v| v.is_known))
        .map(|v| (v.cell, v.position))
        .collect();
    // Copies of a vertex differ by rounding at most; the sort makes the choice among them fixed.
    cells.par_sort_unstable_by(|a, b| {
        let order = a.0.cmp(&b.0);
        (0..3).fold(order, |order, i| {
            order.then_with(|| a.1[i].total_cmp(&b.1[i]))
        })
    });
    cells.dedup_by_key(|c| c.0);
    let vertices = cells
        .iter()
        .map(|(cell, position)| {
            let at = Vector3::from_fn(|i, _| {
                // Voxel centres lie half a voxel from the corner of their block.
                (f64::from(cell[i]) + f64::from(position[i]) + 0.5) * volume.voxel
            });
            (volume.origin + at).coords.map(|c| c as f32).into()
        })
        .collect();
    let index = |v: &Vertex| {
        let found = cells.binary_search_by_key(&v.cell, |c| c.0);
        found.ok().filter(|_| v.is_known).map(|i| i as u32)
    };
    let triangles = pieces
        .into_par_iter()
        .flat_map_iter(|piece| {
            let welded: Vec<Option<u32>> = piece.vertices.iter().map(index).collect();
            piece.triangles.into_iter().filter_map(move |triangle| {
                let [a, b, c] = triangle.map(|v| welded[v as usize]);
                Some([a?, b?, c?])
            })
        })
        .collect();
    Mesh {
        vertices,
        triangles,
        ..Mesh::default()
    }
}

/// Drops pieces that are small against the largest one, and vertices that no triangle uses.
fn drop_small_pieces(mesh: &mut Mesh) -> usize {
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    fn root(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    for triangle in &mesh.triangles {
        let mut low = root(&mut parent, triangle[0]);
        for &v in &triangle[1..] {
            let other = root(&mut parent, v);
            let lower = low.min(other);
            parent[low as usize] = lower;
            parent[other as usize] = lower;
            low = lower;
        }
    }
    let mut sizes = vec![0_usize; mesh.vertices.len()];
    let roots: Vec<u32> = mesh
        .triangles
        .iter()
        .map(|t| root(&mut parent, t[0]))
        .collect();
    for &r in &roots {
        sizes[r as usize] += 1;
    }
    let largest = sizes.iter().copied().max().unwrap_or(0);
    let limit = MIN_PIECE * largest as f64;
    let num_dropped = sizes
        .iter()
        .filter(|&&s| s > 0 && (s as f64) < limit)
        .count();
    let mut keep = roots.iter().map(|&r| sizes[r as usize] as f64 >= limit);
    mesh.triangles.retain(|_| keep.next().unwrap_or(false));
    // Compact the vertices in their order.
    let mut index = vec![u32::MAX; mesh.vertices.len()];
    for v in mesh.triangles.iter().flatten() {
        index[*v as usize] = 0;
    }
    let mut count = 0;
    let mut vertices = Vec::new();
    for (v, i) in index.iter_mut().enumerate() {
        if *i == 0 {
            *i = count;
            count += 1;
            vertices.push(mesh.vertices[v]);
        }
    }
    mesh.vertices = vertices;
    for v in mesh.triangles.iter_mut().flatten() {
        *v = index[*v as usize];
    }
    num_dropped
}

/// A vertex with what the cloud gives it.
struct Dressed {
    normal: [f32; 3],
    color: [u8; 3],
    /// Distance from the cloud's planes, world's unit.
    distance: f64,
}

/// Gives vertices the cloud's normals and colours; returns the mean distance from its planes. The
/// vertices stay: the zero of the distances is nearer to the surface than the mean of the planes of a
/// few points, which curvature bends outwards.
fn dress(mesh: &mut Mesh, points: &[CloudPoint], voxel: f64) -> Option<f64> {
    let positions: Vec<[f32; 3]> = points.iter().map(|p| p.position).collect();
    let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&positions).ok()?;
    let dressed: Vec<Dressed> = mesh
        .vertices
        .par_iter()
        .map(|vertex| {
            let nearest: Vec<(usize, f64)> = tree
                .query(vertex)
                .nearest_n::<SquaredEuclidean<f32>>(NUM_NEAREST)
                .execute()
                .into_iter()
                .map(|n| (n.item as usize, f64::from(n.distance)))
                .collect();
            let at = Vector3::from(vertex.map(f64::from));
            // Mean distance to the tangent planes, near ones counting most.
            let (mut offset, mut weights) = (0.0, 0.0);
            for &(i, square) in &nearest {
                let point = &points[i];
                let normal = Vector3::from(point.normal.map(f64::from));
                let from = at - Vector3::from(point.position.map(f64::from));
                let weight = (-square / (voxel * voxel)).exp() * f64::from(point.confidence);
                offset += weight * normal.dot(&from);
                weights += weight;
            }
            let offset = if weights > 1e-6 {
                offset / weights
            } else {
                0.0
            };
            let (normal, color) = blend(points, &nearest);
            Dressed {
                normal: normal.into(),
                color,
                distance: offset.abs(),
            }
        })
        .collect();
    let mean = dressed.iter().map(|d| d.distance).sum::<f64>() / dressed.len().max(1) as f64;
    mesh.normals = dressed.iter().map(|d| d.normal).collect();
    mesh.colors = dressed.iter().map(|d| d.color).collect();
    (!dressed.is_empty()).then_some(mean)
}
