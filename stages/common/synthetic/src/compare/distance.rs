//! How far points lie from a mesh: exact distances to the triangles of the nearest samples on it.

use super::nearest::PointTree;
use nalgebra::{Point3, Vector3};
use rilievo_scene::Mesh;

/// At most this many samples on the surface, which bounds memory at about 100 MB.
const MAX_NUM_SAMPLES: f64 = 1.5e6;
/// Triangles that compete for being nearest: a point above an edge finds both sides among them.
const NUM_CANDIDATES: usize = 8;

/// Samples on a mesh, with the triangle of each.
pub(super) struct Samples {
    pub points: Vec<[f64; 3]>,
    pub triangles: Vec<u32>,
    pub areas: Vec<f64>,
}

pub(super) fn corners(mesh: &Mesh, triangle: usize) -> [Point3<f64>; 3] {
    mesh.triangles[triangle].map(|v| mesh.vertex(v).into())
}

/// Points on the triangles, at most `spacing` apart.
fn sample(mesh: &Mesh, spacing: f64) -> Samples {
    let mut samples = Samples {
        points: Vec::new(),
        triangles: Vec::new(),
        areas: Vec::new(),
    };
    for triangle in 0..mesh.triangles.len() {
        let [a, b, c] = corners(mesh, triangle);
        let (ab, ac) = (b - a, c - a);
        let area = 0.5 * ab.cross(&ac).norm();
        if area.is_nan() || area <= 0.0 {
            continue;
        }
        let longest = ab.norm().max(ac.norm()).max((c - b).norm());
        let n = (longest / spacing).ceil().clamp(1.0, 200.0) as usize;
        // The centroids of the n² similar triangles.
        for i in 0..n {
            for j in 0..n - i {
                let mut add = |s: f64, t: f64| {
                    let p = a + ab * (s / n as f64) + ac * (t / n as f64);
                    samples.points.push([p.x, p.y, p.z]);
                    samples.triangles.push(triangle as u32);
                    samples.areas.push(area / (n * n) as f64);
                };
                add(i as f64 + 1.0 / 3.0, j as f64 + 1.0 / 3.0);
                if i + j + 1 < n {
                    add(i as f64 + 2.0 / 3.0, j as f64 + 2.0 / 3.0);
                }
            }
        }
    }
    samples
}

/// Distance of a point from a triangle.
fn distance_to_triangle(p: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> f64 {
    let segment = |a: &Point3<f64>, b: &Point3<f64>| {
        let ab = b - a;
        let t = ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
        (p - (a + ab * t)).norm()
    };
    let normal: Vector3<f64> = (b - a).cross(&(c - a));
    let inside = [(a, b), (b, c), (c, a)]
        .iter()
        .all(|(u, v)| (*v - *u).cross(&(p - *u)).dot(&normal) >= 0.0);
    if inside {
        return ((p - a).dot(&normal) / normal.norm()).abs();
    }
    segment(a, b).min(segment(b, c)).min(segment(c, a))
}

/// A mesh that answers how far points lie from it.
pub struct MeshDistance<'a> {
    mesh: &'a Mesh,
    samples: Samples,
    tree: PointTree,
}

impl<'a> MeshDistance<'a> {
    /// Indexes the surface with samples at most `spacing` apart; `None` for an empty one.
    pub fn new(mesh: &'a Mesh, spacing: f64) -> Option<Self> {
        let area: f64 = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = corners(mesh, t);
                0.5 * (b - a).cross(&(c - a)).norm()
            })
            .sum();
        // Two samples per square of the spacing.
        let samples = sample(mesh, spacing.max((2.0 * area / MAX_NUM_SAMPLES).sqrt()));
        (!samples.points.is_empty()).then(|| Self {
            mesh,
            tree: PointTree::new(&samples.points),
            samples,
        })
    }

    /// The samples.
    pub(super) fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Distance of a finite point from the surface, and the nearest triangle.
    pub fn nearest(&self, p: &Point3<f64>) -> (f64, usize) {
        self.tree
            .nearest::<NUM_CANDIDATES>(&[p.x, p.y, p.z])
            .into_iter()
            .filter(|(distance, _)| distance.is_finite())
            .map(|(_, sample)| {
                let triangle = self.samples.triangles[sample as usize] as usize;
                (
                    distance_to_triangle(p, &corners(self.mesh, triangle)),
                    triangle,
                )
            })
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            .unwrap_or((f64::INFINITY, 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_is_exact_over_faces_edges_and_corners() {
        // The unit square in `z = 0`.
        let mesh = Mesh {
            vertices: [[0, 0], [1, 0], [1, 1], [0, 1]]
                .map(|[x, y]| [x as f32, y as f32, 0.0])
                .to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let surface = MeshDistance::new(&mesh, 0.05).expect("a surface");
        for (p, expected) in [
            (Point3::new(0.31, 0.77, 0.2), 0.2),
            (Point3::new(-0.3, 0.5, 0.4), 0.5),
            (Point3::new(1.2, 1.1, -0.2), 0.3),
        ] {
            let (d, _) = surface.nearest(&p);
            assert!((d - expected).abs() < 1e-12, "{p:?}: {d} {expected}");
        }
    }
}
