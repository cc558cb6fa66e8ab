//! Loose pieces of a mesh.

use rilievo_scene::Mesh;

/// A piece with fewer triangles than this share of the largest one is no surface.
pub(crate) const MIN_PIECE: f64 = 0.005;

/// What became of the pieces.
#[derive(Debug, PartialEq)]
pub(crate) struct Pieces {
    pub num_kept: usize,
    pub num_dropped: usize,
    /// Share of all triangles that were dropped.
    pub dropped_share: f64,
}

/// Drops pieces that are small against the largest one, and vertices that no triangle uses.
pub(crate) fn drop_small(mesh: &mut Mesh) -> Pieces {
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    fn root(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    for triangle in &mesh.triangles {
        let mut low = root(&mut parent, triangle[0]);
        for &v in &triangle[1..] {
            let other = root(&mut parent, v);
            let lower = low.min(other);
            parent[low as usize] = lower;
            parent[other as usize] = lower;
            low = lower;
        }
    }
    let mut sizes = vec![0_u32; mesh.vertices.len()];
    for t in &mesh.triangles {
        sizes[root(&mut parent, t[0]) as usize] += 1;
    }
    let largest = sizes.iter().copied().max().unwrap_or(0);
    let is_small = |size: u32| f64::from(size) < MIN_PIECE * f64::from(largest);
    let there = sizes.iter().filter(|&&size| size > 0);
    let (dropped, kept): (Vec<u32>, Vec<u32>) = there.partition(|&&size| is_small(size));
    let num_triangles = mesh.triangles.len();
    mesh.triangles
        .retain(|t| !is_small(sizes[root(&mut parent, t[0]) as usize]));
    drop_unused(mesh, parent);
    Pieces {
        num_kept: kept.len(),
        num_dropped: dropped.len(),
        dropped_share: dropped.iter().map(|&size| f64::from(size)).sum::<f64>()
            / num_triangles.max(1) as f64,
    }
}

/// Drops vertices that no triangle uses; the others keep their order. `index` is memory for a
/// number a vertex, of any content.
pub(crate) fn drop_unused(mesh: &mut Mesh, mut index: Vec<u32>) {
    index.fill(u32::MAX);
    for v in mesh.triangles.iter().flatten() {
        index[*v as usize] = 0;
    }
    let mut count = 0;
    for (v, i) in index.iter_mut().enumerate() {
        if *i == 0 {
            *i = count as u32;
            mesh.vertices[count] = mesh.vertices[v];
            mesh.normals[count] = mesh.normals[v];
            mesh.colors[count] = mesh.colors[v];
            count += 1;
        }
    }
    mesh.vertices.truncate(count);
    mesh.normals.truncate(count);
    mesh.colors.truncate(count);
    for v in mesh.triangles.iter_mut().flatten() {
        *v = index[*v as usize];
    }
}
