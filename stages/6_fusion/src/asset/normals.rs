//! Smooth normals of a light mesh.

use nalgebra::Vector3;
use rilievo_scene::Mesh;

/// Gives every vertex the mean normal of its triangles, weighted by their angles there (Thürmer and
/// Wüthrich, "Computing vertex normals from polygonal facets", 1998). A vertex of triangles without
/// area keeps its own.
pub(super) fn smooth(mesh: &mut Mesh) {
    let mut sums = vec![Vector3::<f64>::zeros(); mesh.vertices.len()];
    for t in &mesh.triangles {
        let corner = t.map(|v| mesh.vertex(v));
        let face = (corner[1] - corner[0]).cross(&(corner[2] - corner[0]));
        let Some(face) = face.try_normalize(0.0) else {
            continue;
        };
        for k in 0..3 {
            let next = corner[(k + 1) % 3] - corner[k];
            let last = corner[(k + 2) % 3] - corner[k];
            sums[t[k] as usize] += face * next.angle(&last);
        }
    }
    for (normal, sum) in mesh.normals.iter_mut().zip(&sums) {
        if let Some(mean) = sum.try_normalize(1e-9) {
            *normal = mean.map(|c| c as f32).into();
        }
    }
}
