//! Where the mesh ends: a smooth rim instead of a stair of cells.
//!
//! A net of cells ends in steps and teeth. Triangles that hang on the mesh by one edge are cut off;
//! then every boundary vertex `x` with neighbours `a`, `b` along the boundary moves towards their
//! mean within its tangent plane, `x' = x + ½ (1 − n nᵀ)((a + b) / 2 − x)`: the surface stays where
//! it is up to `κ h² / 8` (curvature κ, cell h), only its end becomes smooth.

use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_scene::Mesh;
use std::collections::BTreeMap;

/// Rounds of cutting teeth: a tooth of two triangles takes two.
const NUM_CUTS: usize = 3;
/// Rounds of smoothing: a step of one cell spreads over as many cells.
const NUM_SMOOTHINGS: usize = 5;

type Edges = BTreeMap<(u32, u32), u32>;

/// An edge, whichever way it is run through.
pub(crate) fn key(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

/// Edges of a triangle, by their vertices in ascending order.
fn edges_of(t: [u32; 3]) -> [(u32, u32); 3] {
    [0, 1, 2].map(|k| key(t[k], t[(k + 1) % 3]))
}

/// Whether the triangles around a vertex leave a gap: around a closed fan every neighbour comes
/// once before and once after its successor, so that a sum over mixed indices with both signs is
/// zero.
fn on_rim(mesh: &Mesh) -> Vec<bool> {
    let mixed = |v: u32| {
        let v = (u64::from(v) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (v ^ v >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9)
    };
    let mut sums = vec![0_u64; mesh.vertices.len()];
    for &[a, b, c] in &mesh.triangles {
        let [of_a, of_b, of_c] = [a, b, c].map(mixed);
        for (v, next, last) in [(a, of_b, of_c), (b, of_c, of_a), (c, of_a, of_b)] {
            let sum = &mut sums[v as usize];
            *sum = sum.wrapping_add(next).wrapping_sub(last);
        }
    }
    sums.into_iter().map(|sum| sum != 0).collect()
}

/// How many of the triangles have an edge between two vertices on the rim.
fn rim_edges(mesh: &Mesh, triangles: &[usize], on_rim: &[bool]) -> Edges {
    let mut edges = Edges::new();
    for (a, b) in triangles.iter().flat_map(|&t| edges_of(mesh.triangles[t])) {
        if on_rim[a as usize] && on_rim[b as usize] {
            *edges.entry((a, b)).or_default() += 1;
        }
    }
    edges
}

/// Cuts teeth off and smooths the boundary. Vertices may remain without a triangle.
pub(crate) fn smooth(mesh: &mut Mesh) {
    // A tooth has all its vertices on the rim, so that cutting it opens edges between them only:
    // what is not on the rim now never is, and these triangles are all that matter.
    let on_rim = on_rim(mesh);
    let mut near: Vec<usize> = (0..mesh.triangles.len())
        .into_par_iter()
        .filter(|&t| {
            mesh.triangles[t]
                .iter()
                .filter(|&&v| on_rim[v as usize])
                .count()
                > 1
        })
        .collect();
    let mut counts = rim_edges(mesh, &near, &on_rim);
    let mut cut = vec![false; mesh.triangles.len()];
    for _ in 0..NUM_CUTS {
        let before = near.len();
        near.retain(|&t| {
            let edges = edges_of(mesh.triangles[t]);
            let num_open = edges.iter().filter(|e| counts.get(e) == Some(&1)).count();
            cut[t] = num_open > 1;
            !cut[t]
        });
        counts = rim_edges(mesh, &near, &on_rim);
        if near.len() == before {
            break;
        }
    }
    let mut is_cut = cut.iter();
    mesh.triangles.retain(|_| is_cut.next() != Some(&true));
    let mut along: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (&(a, b), _) in counts.iter().filter(|(_, count)| **count == 1) {
        along.entry(a).or_default().push(b);
        along.entry(b).or_default().push(a);
    }
    let mut normals: BTreeMap<u32, Vector3<f64>> =
        along.keys().map(|&v| (v, Vector3::zeros())).collect();
    for t in &mesh.triangles {
        if !t.iter().any(|v| normals.contains_key(v)) {
            continue;
        }
        let [a, b, c] = t.map(|v| mesh.vertex(v));
        let normal = (b - a).cross(&(c - a));
        for v in t {
            if let Some(sum) = normals.get_mut(v) {
                *sum += normal;
            }
        }
    }
    for _ in 0..NUM_SMOOTHINGS {
        let moved: Vec<(u32, Vector3<f64>)> = along
            .iter()
            .filter_map(|(&v, neighbours)| {
                // Where boundaries touch, there is no "along".
                let &[a, b] = neighbours.as_slice() else {
                    return None;
                };
                let normal = normals[&v].try_normalize(0.0)?;
                let here = mesh.vertex(v);
                let step = 0.5 * (0.5 * (mesh.vertex(a) + mesh.vertex(b)) - here);
                Some((v, here + step - normal * normal.dot(&step)))
            })
            .collect();
        for (v, position) in moved {
            mesh.vertices[v as usize] = position.map(|c| c as f32).into();
        }
    }
}

/// Loops of boundary edges, against the direction in which their triangles run along them. A loop
/// that meets a vertex twice is two.
pub(crate) fn boundary_loops(mesh: &Mesh) -> Vec<Vec<u32>> {
    let on_rim = on_rim(mesh);
    // A directed edge that is run through more often than its opposite is a boundary. As a boundary
    // the edges are balanced in every vertex, so that a walk along them always closes.
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            if on_rim[a as usize] && on_rim[b as usize] {
                *edges.entry(key(a, b)).or_default() += if a < b { 1 } else { -1 };
            }
        }
    }
    let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (&(a, b), &excess) in &edges {
        let (from, to) = if excess > 0 { (b, a) } else { (a, b) };
        for _ in 0..excess.abs() {
            next.entry(from).or_default().push(to);
        }
    }
    let mut loops = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut walk = vec![start];
        let mut place = BTreeMap::from([(start, 0)]);
        let mut at = start;
        while let Some(successors) = next.get_mut(&at) {
            let to = successors.pop();
            if successors.is_empty() {
                next.remove(&at);
            }
            let Some(to) = to else { break };
            if let Some(&begin) = place.get(&to) {
                let closed = walk.split_off(begin);
                closed.iter().for_each(|v| {
                    place.remove(v);
                });
                loops.push(closed);
            }
            place.insert(to, walk.len());
            walk.push(to);
            at = to;
        }
    }
    loops
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Length of all edges that one triangle alone has.
    fn length(mesh: &Mesh) -> f64 {
        let all: Vec<usize> = (0..mesh.triangles.len()).collect();
        rim_edges(mesh, &all, &vec![true; mesh.vertices.len()])
            .iter()
            .filter(|(_, count)| **count == 1)
            .map(|((a, b), _)| (mesh.vertex(*a) - mesh.vertex(*b)).norm())
            .sum()
    }

    /// Cells of a plane inside a disc, two triangles each.
    fn stairs(radius: f64) -> Mesh {
        let half = radius.ceil() as i32 + 1;
        let side = 2 * half + 1;
        let index = |x: i32, y: i32| ((y + half) * side + x + half) as u32;
        let mut mesh = Mesh::default();
        for y in -half..=half {
            for x in -half..=half {
                mesh.vertices.push([x as f32, y as f32, 0.0]);
                let middle = (f64::from(x) + 0.5).hypot(f64::from(y) + 0.5);
                if x < half && y < half && middle < radius {
                    let [a, b, c, d] =
                        [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(dx, dy)| index(x + dx, y + dy));
                    mesh.triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
        mesh
    }

    #[test]
    fn the_stairs_of_a_disc_become_its_circle() {
        let mut mesh = stairs(20.3);
        let circle = std::f64::consts::TAU * 20.0;
        assert!(length(&mesh) > 1.2 * circle, "{}", length(&mesh));
        smooth(&mut mesh);
        let ratio = length(&mesh) / circle;
        assert!((0.93..1.03).contains(&ratio), "{ratio}");
        // The surface stays in its plane, and no triangle turns over.
        assert!(mesh.vertices.iter().all(|v| v[2] == 0.0));
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| Vector3::from(mesh.vertices[v as usize]));
            let area = (b - a).cross(&(c - a)).z;
            assert!(area > 0.0, "{area}");
        }
    }

    #[test]
    fn a_closed_mesh_stays_as_it_is() {
        let mut mesh = Mesh {
            vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            ..Mesh::default()
        };
        let before = mesh.clone();
        smooth(&mut mesh);
        assert_eq!(mesh, before);
    }
}
