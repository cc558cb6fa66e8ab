//! From the implicit shape to a triangle mesh: surface nets, then every vertex moved onto the
//! surface.

use crate::error::SyntheticError;
use crate::shape::Shape;
use fast_surface_nets::ndshape::{RuntimeShape, Shape as _};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_scene::Mesh;

/// Newton steps onto the surface; each squares the error of a vertex that lies within a cell.
const NUM_PROJECTIONS: usize = 3;

/// Meshes the surface of `shape` with edges of about `spacing` heights; lengths of the result are
/// multiplied by `height`.
pub(crate) fn extract(
    shape: &Shape,
    spacing: f64,
    height: f64,
    seed: u64,
) -> Result<Mesh, SyntheticError> {
    let (low, high) = shape.bounds();
    // A cell of air on every side closes the surface.
    let low = low - Vector3::repeat(2.0 * spacing);
    let cells = ((high - low) / spacing).map(|c| c.ceil() as u32 + 3);
    let grid = RuntimeShape::<u32, 3>::new([cells.x, cells.y, cells.z]);
    let slice = (cells.x * cells.y) as usize;
    let values: Vec<f32> = (0..cells.z)
        .into_par_iter()
        .flat_map_iter(|k| {
            (0..slice as u32).map(move |i| {
                let at = Vector3::new(f64::from(i % cells.x), f64::from(i / cells.x), f64::from(k));
                shape.value(&(low + at * spacing)) as f32
            })
        })
        .collect();
    debug_assert_eq!(values.len(), grid.usize());
    let mut buffer = SurfaceNetsBuffer::default();
    surface_nets(
        &values,
        &grid,
        [0; 3],
        [cells.x - 1, cells.y - 1, cells.z - 1],
        &mut buffer,
    );
    if buffer.positions.is_empty() {
        return Err(SyntheticError::EmptyShape { seed });
    }
    let projected: Vec<([f32; 3], [f32; 3])> = buffer
        .positions
        .par_iter()
        .map(|p| {
            let start = low + Vector3::from(p.map(f64::from)) * spacing;
            let mut at = start;
            let mut normal = shape.normal(&at);
            for _ in 0..NUM_PROJECTIONS {
                let step = shape.value(&at);
                if (at - normal * step - start).norm() > 2.0 * spacing {
                    break;
                }
                at -= normal * step;
                normal = shape.normal(&at);
            }
            (
                (at * height).map(|c| c as f32).into(),
                normal.map(|c| c as f32).into(),
            )
        })
        .collect();
    let (vertices, normals) = projected.into_iter().unzip();
    let triangles = buffer
        .indices
        .chunks_exact(3)
        .map(|t| [t[0], t[1], t[2]])
        .collect();
    Ok(Mesh {
        vertices,
        normals,
        colors: Vec::new(),
        triangles,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::Subject;

    #[test]
    fn an_ellipsoid_is_closed_turned_outwards_and_on_its_surface() {
        let shape = Shape::new(Subject::Ellipsoid, 0.0, 1);
        let mesh = extract(&shape, 0.03, 1.0, 1).expect("a surface");
        let at = |v: u32| Vector3::from(mesh.vertices[v as usize].map(f64::from));
        let volume: f64 = mesh
            .triangles
            .iter()
            .map(|t| at(t[0]).dot(&at(t[1]).cross(&at(t[2]))) / 6.0)
            .sum();
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.36 * 0.30 * 0.5;
        assert!((volume / exact - 1.0).abs() < 0.01, "{volume} {exact}");
        let worst = (0..mesh.vertices.len() as u32)
            .map(|v| shape.value(&at(v)).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1e-5, "{worst}");
        for (v, n) in mesh.vertices.iter().zip(&mesh.normals) {
            let outwards = Vector3::from(*v) - Vector3::new(0.0, 0.0, 0.5);
            assert!(outwards.dot(&Vector3::from(*n)) > 0.0);
        }
    }
}
