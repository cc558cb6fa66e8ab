//! Closes a mesh where nothing was seen: every boundary loop gets a lid.
//!
//! A loop of boundary edges is filled with a fan of triangles around its centroid. The lid says
//! nothing about the object; it only makes the mesh a solid that programs for printing accept.

use crate::rim::on_rim;
use nalgebra::Vector3;
use rilievo_scene::Mesh;
use std::collections::BTreeMap;

/// Adds lids to all boundary loops.
pub(crate) fn close(mesh: &mut Mesh) {
    // A directed edge that is run through more often than its opposite is a boundary; a lid needs
    // the opposite direction. As a boundary the edges are balanced in every vertex, so that a walk
    // along them always closes, also where loops touch.
    let on_rim = on_rim(mesh);
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            if !(on_rim[a as usize] && on_rim[b as usize]) {
                continue;
            }
            *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
        }
    }
    let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (&(a, b), &excess) in &edges {
        let (from, to) = if excess > 0 { (b, a) } else { (a, b) };
        for _ in 0..excess.abs() {
            next.entry(from).or_default().push(to);
        }
    }
    while let Some((&start, _)) = next.first_key_value() {
        let mut ring = vec![start];
        let mut at = start;
        while let Some(successors) = next.get_mut(&at) {
            let to = successors.pop();
            if successors.is_empty() {
                next.remove(&at);
            }
            match to {
                Some(to) if to != start => {
                    ring.push(to);
                    at = to;
                }
                _ => break,
            }
        }
        fan(mesh, &ring);
    }
}

fn fan(mesh: &mut Mesh, ring: &[u32]) {
    if ring.len() < 3 {
        return;
    }
    if let [a, b, c] = *ring {
        mesh.triangles.push([a, b, c]);
        return;
    }
    // The hub is as its ring is on average.
    let mean = |value: &dyn Fn(usize) -> [f32; 3]| -> Vector3<f64> {
        let values = ring
            .iter()
            .map(|&v| Vector3::from(value(v as usize).map(f64::from)));
        values.sum::<Vector3<f64>>() / ring.len() as f64
    };
    let center = mean(&|v| mesh.vertices[v]);
    if !mesh.normals.is_empty() {
        let normal = mean(&|v| mesh.normals[v]).try_normalize(0.0);
        let normal = normal.unwrap_or_else(Vector3::z).map(|c| c as f32);
        mesh.normals.push(normal.into());
    }
    if !mesh.colors.is_empty() {
        let color = mean(&|v| mesh.colors[v].map(f32::from));
        mesh.colors.push(color.map(|c| c.round() as u8).into());
    }
    let hub = mesh.vertices.len() as u32;
    mesh.vertices.push(center.map(|c| c as f32).into());
    for k in 0..ring.len() {
        mesh.triangles
            .push([ring[k], ring[(k + 1) % ring.len()], hub]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Boundary edges of a mesh.
    fn num_open(mesh: &Mesh) -> usize {
        let edges: std::collections::BTreeSet<(u32, u32)> = mesh
            .triangles
            .iter()
            .flat_map(|t| (0..3).map(|k| (t[k], t[(k + 1) % 3])))
            .collect();
        edges
            .iter()
            .filter(|(a, b)| !edges.contains(&(*b, *a)))
            .count()
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
        assert_eq!(num_open(&mesh), 8);
        close(&mut mesh);
        assert_eq!(num_open(&mesh), 0);
        assert_eq!(mesh.triangles.len(), 8 + 8);
    }
}
