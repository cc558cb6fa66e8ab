//! A mesh in which at most two triangles share an edge.
//!
//! Where two pieces of surface pass through one cell of the net, or through neighbouring ones, more
//! triangles meet in an edge. They are separated: each that runs along the edge belongs with the
//! one that bounds the same solid beside it, and what belongs together keeps the edge's vertices,
//! while the others get copies. An edge that is the only one between its two sheets is divided in
//! one of them.

use crate::rim::key;
use nalgebra::Vector3;
use rilievo_scene::Mesh;
use std::collections::{BTreeMap, BTreeSet};

/// Share of the way to its triangles' other corners by which a copy moves: programs that join equal
/// vertices leave the sheets apart, and triangles ten pixels large show less than a tenth of one.
const APART: f32 = 1.0 / 128.0;
/// Edges that are looked at together: 12 bytes each.
const EDGES_AT_ONCE: usize = 1 << 23;

/// Separates sheets that share edges; returns the number of such edges.
pub(crate) fn separate(mesh: &mut Mesh) -> usize {
    let edges = shared_edges(mesh);
    let num_edges = edges.len();
    if num_edges > 0 {
        let pairs = pairs(mesh, &edges);
        split_vertices(mesh, &edges, &pairs);
        // Sheets that are joined beyond both ends of an edge still share it. An edge beside one
        // that was divided waits for the next round.
        let mut rest = shared_edges(mesh);
        while !rest.is_empty() {
            divide(mesh, &rest);
            rest = shared_edges(mesh);
        }
    }
    num_edges
}

type Edge = (u32, u32);

/// Edges of more than two triangles, with these.
fn shared_edges(mesh: &Mesh) -> BTreeMap<Edge, Vec<u32>> {
    let mut shared = BTreeMap::new();
    let num_edges = 3 * mesh.triangles.len();
    let num_rounds = num_edges.div_ceil(EDGES_AT_ONCE).max(1);
    let per_round = mesh.vertices.len().div_ceil(num_rounds).max(1);
    for first in (0..mesh.vertices.len()).step_by(per_round) {
        let range = first as u32..(first + per_round) as u32;
        let mut edges: Vec<(Edge, u32)> = Vec::new();
        for (t, corners) in mesh.triangles.iter().enumerate() {
            for k in 0..3 {
                let edge = key(corners[k], corners[(k + 1) % 3]);
                if range.contains(&edge.0) {
                    edges.push((edge, t as u32));
                }
            }
        }
        edges.sort_unstable();
        for same in edges
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|same| same.len() > 2)
        {
            let triangles = same.iter().map(|(_, t)| *t).collect();
            shared.insert(same[0].0, triangles);
        }
    }
    shared
}

/// Triangles that belong together, by shared edge.
type Pairs = BTreeMap<Edge, Vec<[u32; 2]>>;

fn pairs(mesh: &Mesh, edges: &BTreeMap<Edge, Vec<u32>>) -> Pairs {
    let pair = |(edge, triangles): (&Edge, &Vec<u32>)| (*edge, pairs_of(mesh, *edge, triangles));
    edges.iter().map(pair).collect()
}

/// A triangle `(a, b, c)` has the solid on the side from which its angle around the edge falls, one
/// of `(b, a, c)` on the other; the two around one solid are a pair.
fn pairs_of(mesh: &Mesh, (a, b): Edge, triangles: &[u32]) -> Vec<[u32; 2]> {
    let Some(axis) = (mesh.vertex(b) - mesh.vertex(a)).try_normalize(0.0) else {
        return Vec::new();
    };
    let side = axis.cross(&if axis.x.abs() < 0.5 {
        Vector3::x()
    } else {
        Vector3::y()
    });
    let up = axis.cross(&side);
    let (mut forward, mut backward) = (Vec::new(), Vec::new());
    for &t in triangles {
        let corners = mesh.triangles[t as usize];
        let Some(k) = (0..3).find(|&k| key(corners[k], corners[(k + 1) % 3]) == (a, b)) else {
            continue;
        };
        let third = mesh.vertex(corners[(k + 2) % 3]) - mesh.vertex(a);
        let angle = third.dot(&up).atan2(third.dot(&side));
        if corners[k] == a {
            forward.push((angle, t));
        } else {
            backward.push((angle, t));
        }
    }
    forward.sort_by(|x, y| x.0.total_cmp(&y.0));
    let mut pairs = Vec::new();
    for (angle, t) in forward {
        let before = |other: f64| (angle - other).rem_euclid(std::f64::consts::TAU);
        let nearest = (0..backward.len())
            .min_by(|&i, &j| before(backward[i].0).total_cmp(&before(backward[j].0)));
        if let Some(i) = nearest {
            pairs.push([t, backward.remove(i).1]);
        }
    }
    pairs
}

/// Gives every fan of triangles around the ends of shared edges a vertex of its own.
fn split_vertices(mesh: &mut Mesh, edges: &BTreeMap<Edge, Vec<u32>>, pairs: &Pairs) {
    let mut around: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for &(a, b) in edges.keys() {
        around.insert(a, Vec::new());
        around.insert(b, Vec::new());
    }
    for (t, corners) in mesh.triangles.iter().enumerate() {
        for v in corners {
            if let Some(triangles) = around.get_mut(v) {
                triangles.push(t as u32);
            }
        }
    }
    // All fans are found before any vertex is replaced.
    let mut replaced: Vec<(u32, Vec<u32>)> = Vec::new();
    for (&v, triangles) in &around {
        let fans = fans(mesh, v, triangles, pairs);
        replaced.extend(fans.into_iter().skip(1).map(|fan| (v, fan)));
    }
    for (v, fan) in replaced {
        let copy = add_copy(mesh, v);
        let corners = fan.iter().flat_map(|&t| mesh.triangles[t as usize]);
        let others: Vec<u32> = corners.filter(|c| *c != v).collect();
        let here = Vector3::from(mesh.vertices[v as usize]);
        let steps = others
            .iter()
            .map(|&c| Vector3::from(mesh.vertices[c as usize]) - here);
        let step = steps.sum::<Vector3<f32>>() * (APART / others.len().max(1) as f32);
        mesh.vertices[copy as usize] = (here + step).into();
        for t in fan {
            let corners = &mut mesh.triangles[t as usize];
            corners
                .iter_mut()
                .filter(|c| **c == v)
                .for_each(|c| *c = copy);
        }
    }
}

/// The triangles around a vertex, by what hangs together across edges at it.
fn fans(mesh: &Mesh, v: u32, triangles: &[u32], pairs: &Pairs) -> Vec<Vec<u32>> {
    let mut by_edge: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (i, &t) in triangles.iter().enumerate() {
        for &other in mesh.triangles[t as usize].iter().filter(|c| **c != v) {
            by_edge.entry(other).or_default().push(i);
        }
    }
    let mut fan: Vec<usize> = (0..triangles.len()).collect();
    let join = |fan: &mut Vec<usize>, i: usize, j: usize| {
        let (from, to) = (fan[i].max(fan[j]), fan[i].min(fan[j]));
        fan.iter_mut().filter(|f| **f == from).for_each(|f| *f = to);
    };
    for (other, at_edge) in by_edge {
        match pairs.get(&key(v, other)) {
            None => at_edge
                .windows(2)
                .for_each(|two| join(&mut fan, two[0], two[1])),
            Some(pairs) => {
                for pair in pairs {
                    let place = pair.map(|t| triangles.iter().position(|&other| other == t));
                    if let [Some(i), Some(j)] = place {
                        join(&mut fan, i, j);
                    }
                }
            }
        }
    }
    let mut fans: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
    for (i, &t) in triangles.iter().enumerate() {
        fans.entry(fan[i]).or_default().push(t);
    }
    fans.into_values().collect()
}

/// Gives all pairs but the first, and triangles without a partner, a vertex in the middle of the
/// edge which only they have.
fn divide(mesh: &mut Mesh, edges: &BTreeMap<Edge, Vec<u32>>) {
    let pairs = pairs(mesh, edges);
    let mut touched = BTreeSet::new();
    for (&(a, b), pairs) in &pairs {
        if edges[&(a, b)].iter().any(|t| touched.contains(t)) {
            continue;
        }
        touched.extend(edges[&(a, b)].iter().copied());
        // What has no partner ends at the edge.
        let mut alone = edges[&(a, b)].clone();
        alone.retain(|t| !pairs.iter().flatten().any(|paired| paired == t));
        let groups = pairs.iter().map(|pair| pair.to_vec());
        let groups = groups.chain(alone.into_iter().map(|t| vec![t]));
        for group in groups.skip(1) {
            let middle = add_copy(mesh, a);
            let ends = [a, b].map(|v| Vector3::from(mesh.vertices[v as usize]));
            mesh.vertices[middle as usize] = ((ends[0] + ends[1]) / 2.0).into();
            for t in group {
                let corners = mesh.triangles[t as usize];
                let with = |end: u32| corners.map(|c| if c == end { middle } else { c });
                mesh.triangles[t as usize] = with(a);
                mesh.triangles.push(with(b));
            }
        }
    }
}

fn add_copy(mesh: &mut Mesh, v: u32) -> u32 {
    let copy = mesh.vertices.len() as u32;
    mesh.vertices.push(mesh.vertices[v as usize]);
    if let Some(&normal) = mesh.normals.get(v as usize) {
        mesh.normals.push(normal);
    }
    if let Some(&color) = mesh.colors.get(v as usize) {
        mesh.colors.push(color);
    }
    copy
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cubes of unit edge with outward triangles, whose equal corners are one vertex.
    fn cubes(corners: &[[i32; 3]]) -> Mesh {
        let mut vertices: Vec<[i32; 3]> = Vec::new();
        let mut triangles = Vec::new();
        for corner in corners {
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                for side in 0..2 {
                    let mut number = |p: i32, q: i32| -> u32 {
                        let mut at = *corner;
                        at[axis] += side;
                        at[u] += p;
                        at[v] += q;
                        let found = vertices.iter().position(|known| *known == at);
                        found.unwrap_or_else(|| {
                            vertices.push(at);
                            vertices.len() - 1
                        }) as u32
                    };
                    let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(p, q)| number(p, q));
                    let (one, two) = ([a, b, c], [a, c, d]);
                    let turned =
                        |[a, b, c]: [u32; 3]| if side == 1 { [a, b, c] } else { [a, c, b] };
                    triangles.extend([turned(one), turned(two)]);
                }
            }
        }
        Mesh {
            vertices: vertices.iter().map(|v| v.map(|c| c as f32)).collect(),
            triangles,
            ..Mesh::default()
        }
    }

    /// How many edges have one, two and more triangles.
    fn counts(mesh: &Mesh) -> [usize; 3] {
        let mut edges: BTreeMap<Edge, usize> = BTreeMap::new();
        for t in &mesh.triangles {
            (0..3).for_each(|k| *edges.entry(key(t[k], t[(k + 1) % 3])).or_default() += 1);
        }
        let count = |of: fn(usize) -> bool| edges.values().filter(|n| of(**n)).count();
        [count(|n| n == 1), count(|n| n == 2), count(|n| n > 2)]
    }

    #[test]
    fn cubes_that_touch_along_an_edge_become_two() {
        let mut mesh = cubes(&[[0, 0, 0], [1, 1, 0]]);
        assert_eq!(counts(&mesh)[2], 1);
        let num_vertices = mesh.vertices.len();
        assert_eq!(separate(&mut mesh), 1);
        assert_eq!(counts(&mesh), [0, 36, 0]);
        // Copies lie apart, so that they stay two where equal vertices are joined.
        let mut places = mesh
            .vertices
            .iter()
            .map(|v| v.map(f32::to_bits))
            .collect::<Vec<_>>();
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), mesh.vertices.len());
        assert_eq!(mesh.vertices.len(), num_vertices + 2);
    }

    #[test]
    fn an_edge_whose_ends_are_joined_elsewhere_is_divided() {
        // Two cubes that touch along an edge, with blocks above and below that join them.
        let ring = [[0, 0, 1], [1, 1, 1]];
        let caps = [0, 2]
            .into_iter()
            .flat_map(|z| [[0, 0, z], [0, 1, z], [1, 0, z], [1, 1, z]]);
        let solid: Vec<[i32; 3]> = ring.into_iter().chain(caps).collect();
        // Faces between two cubes are inside, and go.
        let mut mesh = cubes(&solid);
        let corners = |t: &[u32; 3]| {
            let mut sorted = t.map(|v| mesh.vertices[v as usize].map(|c| c as i32));
            sorted.sort_unstable();
            sorted
        };
        let mut seen: BTreeMap<[[i32; 3]; 3], usize> = BTreeMap::new();
        for t in &mesh.triangles {
            *seen.entry(corners(t)).or_default() += 1;
        }
        let outer: Vec<[u32; 3]> = mesh
            .triangles
            .iter()
            .copied()
            .filter(|t| seen[&corners(t)] == 1)
            .collect();
        mesh.triangles = outer;
        assert_eq!(counts(&mesh)[2], 1);
        separate(&mut mesh);
        let [open, _, shared] = counts(&mesh);
        assert_eq!((open, shared), (0, 0));
    }

    #[test]
    fn a_manifold_stays_as_it_is() {
        let mut mesh = cubes(&[[0, 0, 0]]);
        let before = mesh.clone();
        assert_eq!(separate(&mut mesh), 0);
        assert_eq!(mesh, before);
    }
}
