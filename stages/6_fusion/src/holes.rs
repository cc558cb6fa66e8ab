//! Closes a mesh where nothing was seen.
//!
//! A loop of boundary edges is filled with rings of vertices that become fewer towards its middle,
//! and these are moved to where the surface bends least: with `L x_v = x_v − Σ w_vu x_u / Σ w_vu`
//! over the neighbours `u`, `w_vu = 1 / |x_v − x_u|` and `h_v` the mean of these lengths, the
//! curvature is `4 L x_v / h_v²`, and the sum of its square times the area `h_v²` over the new
//! vertices and the loop is least, so that the surface goes on as it ends at the loop (the thin
//! plate of Kobbelt and others, "Interactive multi-resolution modeling on arbitrary meshes",
//! SIGGRAPH 1998, with the scale-dependent umbrella of Desbrun and others, 1999). The filling says
//! nothing about the object.

use nalgebra::Vector3;
use rilievo_numerics::sparse_cholesky;
use rilievo_scene::Mesh;
use std::collections::BTreeMap;

/// Growth of the edges from ring to ring.
const GROWTH: f64 = 1.3;
/// Height of a ring over the length of its edges: equilateral triangles.
const RING_HEIGHT: f64 = 0.866;
/// What was closed.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Closed {
    pub num_holes: usize,
    /// Area of the fillings.
    pub area: f64,
}

/// Length of a loop.
pub(crate) fn length(mesh: &Mesh, ring: &[u32]) -> f64 {
    let edges = (0..ring.len()).map(|k| [ring[k], ring[(k + 1) % ring.len()]]);
    edges
        .map(|[a, b]| (mesh.vertex(a) - mesh.vertex(b)).norm())
        .sum()
}

/// Colour of a vertex, black in a mesh without.
fn color(mesh: &Mesh, v: u32) -> Vector3<f64> {
    let color = mesh.colors.get(v as usize).copied().unwrap_or_default();
    Vector3::from(color.map(f64::from))
}

/// Fills loops, which run against the triangles that they bound.
pub(crate) fn close(mesh: &mut Mesh, loops: &[Vec<u32>]) -> Closed {
    let mut neighbours: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for &v in loops.iter().flatten() {
        neighbours.insert(v, Vec::new());
    }
    for triangle in &mesh.triangles {
        for &v in triangle {
            if let Some(near) = neighbours.get_mut(&v) {
                near.extend(triangle.iter().filter(|&&other| other != v));
            }
        }
    }
    let mut closed = Closed::default();
    for ring in loops.iter().filter(|ring| ring.len() > 2) {
        let filling = Filling::new(mesh, ring);
        filling.bend_least(mesh, &neighbours);
        closed.area += filling.finish(mesh);
        closed.num_holes += 1;
    }
    closed
}

/// The new vertices and triangles of a loop.
struct Filling {
    /// The loop.
    ring: Vec<u32>,
    /// Mean place and colour of its vertices.
    center: Vector3<f64>,
    mean_color: Vector3<f64>,
    /// Number of the first new vertex; all that follow are its.
    first: u32,
    triangles: Vec<[u32; 3]>,
}

impl Filling {
    /// Rings that shrink towards the loop's centroid.
    fn new(mesh: &mut Mesh, ring: &[u32]) -> Self {
        let mean = |of: &dyn Fn(u32) -> Vector3<f64>| {
            ring.iter().map(|&v| of(v)).sum::<Vector3<f64>>() / ring.len() as f64
        };
        let mut filling = Self {
            ring: ring.to_vec(),
            center: mean(&|v| mesh.vertex(v)),
            mean_color: mean(&|v| color(mesh, v)),
            first: mesh.vertices.len() as u32,
            triangles: Vec::new(),
        };
        if let [a, b, c] = *ring {
            filling.triangles.push([a, b, c]);
            return filling;
        }
        let mut edge = length(mesh, ring) / ring.len() as f64;
        let whole = ring.len() as f64 * edge / std::f64::consts::TAU;
        let mut radius = whole;
        let mut outer = ring.to_vec();
        loop {
            radius -= RING_HEIGHT * edge;
            edge *= GROWTH;
            let count = (std::f64::consts::TAU * radius / edge).round().max(0.0) as usize;
            // A few triangles around one vertex end it.
            if count < 4 {
                break;
            }
            let share = radius / whole;
            let inner: Vec<u32> = (0..count)
                .map(|k| {
                    let place = k as f64 / count as f64 * ring.len() as f64;
                    filling.add(mesh, place, share)
                })
                .collect();
            filling.strip(&outer, &inner);
            outer = inner;
        }
        let hub = filling.add(mesh, 0.0, 0.0);
        let next = |k: usize| outer[(k + 1) % outer.len()];
        let fan = (0..outer.len()).map(|k| [outer[k], next(k), hub]);
        filling.triangles.extend(fan);
        filling
    }

    /// A vertex at a place along the loop, in vertices, at a share of the way from the center to
    /// it.
    fn add(&self, mesh: &mut Mesh, place: f64, share: f64) -> u32 {
        let number = self.ring.len();
        let (k, part) = (place as usize % number, place.fract());
        let ends = [self.ring[k], self.ring[(k + 1) % number]];
        let rim = mesh.vertex(ends[0]).lerp(&mesh.vertex(ends[1]), part);
        let position = self.center.lerp(&rim, share);
        mesh.vertices.push(position.map(|c| c as f32).into());
        if !mesh.colors.is_empty() {
            let [a, b] = ends.map(|v| color(mesh, v));
            let color = self.mean_color.lerp(&a.lerp(&b, part), share);
            mesh.colors.push(color.map(|c| c.round() as u8).into());
        }
        if !mesh.normals.is_empty() {
            mesh.normals.push([0.0; 3]);
        }
        mesh.vertices.len() as u32 - 1
    }

    /// Triangles between two rings that begin at the same place.
    fn strip(&mut self, outer: &[u32], inner: &[u32]) {
        let (mut i, mut j) = (0, 0);
        while i < outer.len() || j < inner.len() {
            let (a, b) = (outer[i % outer.len()], inner[j % inner.len()]);
            let next = |k: usize, len: usize| (k + 1) as f64 / len as f64;
            if next(i, outer.len()) <= next(j, inner.len()) {
                i += 1;
                self.triangles.push([a, outer[i % outer.len()], b]);
            } else {
                j += 1;
                self.triangles.push([a, inner[j % inner.len()], b]);
            }
        }
    }

    /// Moves the new vertices to where the surface bends least.
    fn bend_least(&self, mesh: &mut Mesh, outside: &BTreeMap<u32, Vec<u32>>) {
        let num_new = mesh.vertices.len() - self.first as usize;
        if num_new == 0 {
            return;
        }
        let mut around: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for triangle in &self.triangles {
            for &v in triangle {
                let near = around.entry(v).or_default();
                near.extend(triangle.iter().filter(|&&other| other != v));
            }
        }
        let rows: Vec<Row> = around
            .into_iter()
            .map(|(v, mut near)| {
                near.extend(outside.get(&v).into_iter().flatten());
                near.sort_unstable();
                near.dedup();
                Row::new(mesh, v, &near, self.first)
            })
            .collect();
        let mut matrix: BTreeMap<(usize, usize), f64> = BTreeMap::new();
        let mut right_sides = vec![vec![0.0; num_new]; 3];
        for Row { unknown, known } in &rows {
            for (i, a) in unknown {
                let lower = unknown.iter().filter(|(j, _)| j <= i);
                lower.for_each(|(j, b)| *matrix.entry((*j, *i)).or_default() += a * b);
                for (axis, right) in right_sides.iter_mut().enumerate() {
                    right[*i] -= a * known[axis];
                }
            }
        }
        // Where they cannot be found, the rings serve as they are.
        if sparse_cholesky::solve(&matrix, &mut right_sides).is_some() {
            let new = mesh.vertices[self.first as usize..].iter_mut();
            for (k, vertex) in new.enumerate() {
                *vertex = [0, 1, 2].map(|axis| right_sides[axis][k] as f32);
            }
        }
    }

    /// Puts the triangles into the mesh, and gives the new vertices normals; returns the area.
    fn finish(self, mesh: &mut Mesh) -> f64 {
        let mut area = 0.0;
        let mut sums = vec![Vector3::zeros(); mesh.vertices.len() - self.first as usize];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|v| mesh.vertex(v));
            let normal = (b - a).cross(&(c - a));
            area += 0.5 * normal.norm();
            for v in triangle {
                if let Some(k) = v.checked_sub(self.first) {
                    sums[k as usize] += normal;
                }
            }
        }
        if !mesh.normals.is_empty() {
            for (normal, sum) in mesh.normals[self.first as usize..].iter_mut().zip(sums) {
                let unit = sum.try_normalize(0.0).unwrap_or_else(Vector3::z);
                *normal = unit.map(|c| c as f32).into();
            }
        }
        mesh.triangles.extend(self.triangles);
        area
    }
}

/// `L x` at a vertex, as a sum over the new vertices and what the others give.
struct Row {
    unknown: Vec<(usize, f64)>,
    known: Vector3<f64>,
}

impl Row {
    fn new(mesh: &Mesh, v: u32, near: &[u32], first: u32) -> Self {
        let here = mesh.vertex(v);
        let lengths: Vec<f64> = near
            .iter()
            .map(|&u| (mesh.vertex(u) - here).norm())
            .collect();
        let mean = lengths.iter().sum::<f64>() / lengths.len().max(1) as f64;
        // Copies of a vertex lie on each other.
        let weights = lengths
            .iter()
            .map(|l| 1.0 / l.max(1e-3 * mean).max(f64::MIN_POSITIVE));
        let weights: Vec<f64> = weights.collect();
        let sum: f64 = weights.iter().sum();
        let mut row = Self {
            unknown: Vec::with_capacity(near.len() + 1),
            known: Vector3::zeros(),
        };
        let scale = 1.0 / mean.max(f64::MIN_POSITIVE);
        let terms = near
            .iter()
            .zip(&weights)
            .map(|(&u, weight)| (u, -weight / sum));
        for (u, weight) in terms.chain([(v, 1.0)]) {
            let weight = scale * weight;
            match u.checked_sub(first) {
                Some(k) => row.unknown.push((k as usize, weight)),
                None => row.known += weight * mesh.vertex(u),
            }
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rim::boundary_loops;

    /// A sphere of radius 1 without the cap within an angle of its pole.
    fn open_sphere(num: usize, cap_deg: f64) -> Mesh {
        let mut mesh = Mesh::default();
        let rows = num / 2;
        let cap = cap_deg.to_radians();
        for row in 0..rows {
            let theta = cap + (std::f64::consts::PI - cap) * row as f64 / rows as f64;
            for column in 0..num {
                let phi = std::f64::consts::TAU * column as f64 / num as f64;
                let at = [
                    theta.sin() * phi.cos(),
                    theta.sin() * phi.sin(),
                    theta.cos(),
                ];
                mesh.vertices.push(at.map(|c| c as f32));
            }
        }
        mesh.vertices.push([0.0, 0.0, -1.0]);
        let index = |row: usize, column: usize| (row * num + column % num) as u32;
        let pole = (rows * num) as u32;
        for row in 0..rows {
            for c in 0..num {
                let (a, b) = (index(row, c), index(row, c + 1));
                if row + 1 == rows {
                    mesh.triangles.push([a, pole, b]);
                } else {
                    let (d, e) = (index(row + 1, c), index(row + 1, c + 1));
                    mesh.triangles.extend([[a, d, b], [b, d, e]]);
                }
            }
        }
        mesh.normals = mesh.vertices.clone();
        mesh.colors = vec![[100, 150, 200]; mesh.vertices.len()];
        mesh
    }

    #[test]
    fn a_cap_of_a_sphere_comes_back() {
        let mut mesh = open_sphere(60, 25.0);
        let before = mesh.vertices.len();
        let loops = boundary_loops(&mesh);
        assert_eq!(loops.len(), 1);
        let closed = close(&mut mesh, &loops);
        assert_eq!(closed.num_holes, 1);
        assert!(boundary_loops(&mesh).is_empty());
        let cap = std::f64::consts::TAU * (1.0 - 25f64.to_radians().cos());
        assert!(
            (closed.area / cap - 1.0).abs() < 0.05,
            "{} {cap}",
            closed.area
        );
        for (vertex, normal) in mesh.vertices.iter().zip(&mesh.normals).skip(before) {
            // A flat lid would be off by 1 − cos 25° = .094.
            let v = Vector3::from(vertex.map(f64::from));
            assert!((v.norm() - 1.0).abs() < 0.02, "{v:?}");
            let along = v.normalize().dot(&Vector3::from(normal.map(f64::from)));
            assert!(along > 0.97, "{v:?} {along}");
        }
        assert!(mesh.colors[before..].iter().all(|c| *c == [100, 150, 200]));
    }

    #[test]
    fn a_cube_without_two_faces_is_closed() {
        let vertices = (0..8)
            .map(|i| [(i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32])
            .collect();
        // Four sides, top and bottom missing.
        let sides = [[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6]];
        let triangles = sides
            .iter()
            .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect();
        let mut mesh = Mesh {
            vertices,
            triangles,
            ..Mesh::default()
        };
        let loops = boundary_loops(&mesh);
        assert_eq!(loops.iter().map(Vec::len).collect::<Vec<_>>(), [4, 4]);
        assert_eq!(close(&mut mesh, &loops).num_holes, 2);
        assert!(boundary_loops(&mesh).is_empty());
    }
}
