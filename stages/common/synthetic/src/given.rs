//! A mesh of the user's as the object: onto the mat, scaled, with a normal at every vertex.

use nalgebra::Vector3;
use rilievo_scene::Mesh;

/// Extents over the largest below which a mesh is flat.
const MIN_EXTENT: f64 = 1e-3;
/// Area of all triangles over the squared largest extent below which a mesh is a line or less.
const MIN_AREA: f64 = 1e-6;

/// Moves a mesh onto the middle of `z = 0`, scales it to a height, and makes normals where there
/// are none: the mean of the faces around a vertex, weighted by their areas.
pub(crate) fn standing(mut mesh: Mesh, height: f64) -> Result<Mesh, String> {
    let num = mesh.vertices.len();
    if mesh.triangles.is_empty() {
        return Err("it has no triangles".to_owned());
    }
    if let Some(corner) = mesh
        .triangles
        .iter()
        .flatten()
        .find(|&&v| v as usize >= num)
    {
        return Err(format!("a triangle has the corner {corner} of {num}"));
    }
    let to_vector = |v: &[f32; 3]| Vector3::from(v.map(f64::from));
    let numbers = mesh.vertices.iter().chain(&mesh.normals);
    if numbers.flatten().any(|c| !c.is_finite()) {
        return Err("a vertex or normal is not a finite number".to_owned());
    }
    let [low, high] = mesh
        .bounds()
        .unwrap_or_default()
        .map(|corner| to_vector(&corner));
    let extent = high - low;
    if extent.min() <= MIN_EXTENT * extent.max() {
        return Err(format!(
            "it is flat: {} x {} x {}",
            extent.x, extent.y, extent.z
        ));
    }
    let foot = Vector3::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), low.z);
    let scale = height / extent.z;
    for vertex in &mut mesh.vertices {
        *vertex = ((to_vector(vertex) - foot) * scale)
            .map(|c| c as f32)
            .into();
    }
    let faces: Vec<Vector3<f64>> = mesh
        .triangles
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(|v| to_vector(&mesh.vertices[v as usize]));
            (b - a).cross(&(c - a))
        })
        .collect();
    let area = 0.5 * faces.iter().map(Vector3::norm).sum::<f64>();
    let size = extent.max() * scale;
    if area <= MIN_AREA * size * size {
        return Err("its triangles have hardly any area for its size".to_owned());
    }
    if mesh.normals.len() != num {
        let mut sums = vec![Vector3::zeros(); num];
        for (triangle, face) in mesh.triangles.iter().zip(&faces) {
            triangle.iter().for_each(|&v| sums[v as usize] += *face);
        }
        mesh.normals = sums
            .iter()
            // A vertex without faces is never seen.
            .map(|sum| sum.try_normalize(0.0).unwrap_or_else(Vector3::z))
            .map(|normal| normal.map(|c| c as f32).into())
            .collect();
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(vertices: &[[f32; 3]], triangles: &[[u32; 3]], normals: &[[f32; 3]]) -> String {
        let mesh = Mesh {
            vertices: vertices.to_vec(),
            triangles: triangles.to_vec(),
            normals: normals.to_vec(),
            ..Mesh::default()
        };
        standing(mesh, 0.2).err().unwrap_or_default()
    }

    #[test]
    fn what_is_no_surface_is_named() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.5]];
        let line = [0.0, 1.0, 2.0].map(|k| [k, 2.0 * k, 3.0 * k]);
        let (upright, none) = ([0.0, 0.0, 1.0], [f32::NAN, 0.0, 1.0]);
        assert_eq!(told(&corners, &[[0, 1, 2]], &[upright; 3]), "");
        assert_eq!(told(&corners, &[[0, 1, 2]; 500], &[]), "");
        for (message, reason) in [
            (told(&corners, &[], &[]), "no triangles"),
            (told(&corners, &[[0, 1, 3]], &[]), "corner 3 of 3"),
            (told(&line, &[[0, 1, 2]], &[]), "hardly any area"),
            (
                told(&corners, &[[0, 0, 1], [2, 2, 2]], &[]),
                "hardly any area",
            ),
            (
                told(&[none, upright, upright], &[[0, 1, 2]], &[]),
                "not a finite",
            ),
            (told(&corners, &[[0, 1, 2]], &[none; 3]), "not a finite"),
            (told(&[upright; 3], &[[0, 1, 2]], &[]), "flat"),
        ] {
            assert!(message.contains(reason), "{message}: {reason}");
        }
    }
}
