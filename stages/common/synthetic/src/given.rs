//! A mesh of the user's as the object: onto the mat, scaled, with a normal at every vertex.

use nalgebra::Vector3;
use rilievo_scene::Mesh;

/// Extents over the largest below which a mesh is flat.
const MIN_EXTENT: f64 = 1e-3;

/// Moves a mesh onto the middle of `z = 0`, scales it to a height, and makes normals where there are
/// none: the mean of the faces around a vertex, weighted by their areas.
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
    if mesh.vertices.iter().flatten().any(|c| !c.is_finite()) {
        return Err("a vertex is not a finite number".to_owned());
    }
    let start = (
        Vector3::repeat(f64::INFINITY),
        Vector3::repeat(f64::NEG_INFINITY),
    );
    let (low, high) = mesh.vertices.iter().fold(start, |(low, high), v| {
        (low.inf(&to_vector(v)), high.sup(&to_vector(v)))
    });
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
    if mesh.normals.len() != num {
        let mut sums = vec![Vector3::zeros(); num];
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| to_vector(&mesh.vertices[v as usize]));
            let face = (b - a).cross(&(c - a));
            triangle.iter().for_each(|&v| sums[v as usize] += face);
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
