//! How much of a uniform sky reaches each vertex past the mesh itself.

use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::bvh::Bvh;
use rilievo_scene::Mesh;

/// Rays of each vertex.
const NUM_RAYS: usize = 96;

/// Share, weighted by the cosine, of the rays from each vertex that leave the mesh, which begin
/// `lift` (world's unit) before it.
pub(super) fn open_sky(mesh: &Mesh, lift: f64) -> Vec<f32> {
    let bvh = Bvh::new(mesh);
    let rays = rays();
    let vertices = mesh.vertices.par_iter().zip(&mesh.normals);
    vertices
        .map(|(vertex, normal)| {
            let normal = Vector3::from(normal.map(f64::from));
            // A normal straight down has no shortest turn from the axis.
            let turn = Rotation3::rotation_between(&Vector3::z(), &normal).unwrap_or_else(|| {
                Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
            });
            let from = (Vector3::from(vertex.map(f64::from)) + lift * normal).map(|c| c as f32);
            let is_free = |ray: &&Vector3<f64>| {
                let ray = (turn * **ray).map(|c| c as f32);
                bvh.cast(from.into(), ray.into(), 0.0, f32::INFINITY, true)
                    .is_none()
            };
            rays.iter().filter(is_free).count() as f32 / NUM_RAYS as f32
        })
        .collect()
}

/// Directions around the z axis, spread by the golden angle, as many towards each place as its
/// cosine.
fn rays() -> Vec<Vector3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let ray = |k: usize| {
        let squared = (k as f64 + 0.5) / NUM_RAYS as f64;
        let (sin, cos) = (golden * k as f64).sin_cos();
        let radius = squared.sqrt();
        Vector3::new(radius * cos, radius * sin, (1.0 - squared).sqrt())
    };
    (0..NUM_RAYS).map(ray).collect()
}
