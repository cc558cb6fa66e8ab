//! Rays against a triangle mesh: a bounding-volume hierarchy.
//!
//! Built by splitting the triangles' centroids at the middle of the longest axis (into halves by
//! number where that separates little, and below a depth); traversed front to back with a fixed stack. Intersection of
//! Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.

use rilievo_scene::Mesh;

#[derive(Clone, Copy, Debug)]
struct Node {
    low: [f32; 3],
    high: [f32; 3],
    /// First triangle of a leaf, else the right child; the left one follows its parent.
    start: u32,
    /// Triangles of a leaf, 0 for an inner node.
    count: u32,
}

/// A mesh that answers rays.
#[derive(Clone, Debug)]
pub struct Bvh {
    nodes: Vec<Node>,
    /// Corner and two edges of each triangle, in leaf order.
    triangles: Vec<[[f32; 3]; 3]>,
    /// Index in the mesh of each triangle, in leaf order.
    order: Vec<u32>,
}

/// Where a ray meets the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter.
    pub t: f32,
    /// Triangle of the mesh.
    pub triangle: u32,
    /// Weights of its second and third corner.
    pub uv: [f32; 2],
}

/// Triangles in a leaf: fewer makes the tree deeper than it pays for.
const LEAF: usize = 4;
/// Depth that the stack allows.
const STACK: usize = 64;
/// Depth below which triangles are halved by number: the rest of the stack does for 2^32 triangles,
/// however they lie.
const MAX_UNEVEN_DEPTH: usize = 32;

fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Bvh {
    /// Of all triangles of a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        let corners: Vec<[[f32; 3]; 3]> = mesh
            .triangles
            .iter()
            .map(|t| t.map(|v| mesh.vertices[v as usize]))
            .collect();
        let centers: Vec<[f32; 3]> = corners
            .iter()
            .map(|[a, b, c]| std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0))
            .collect();
        let mut order: Vec<u32> = (0..corners.len() as u32).collect();
        let mut nodes = Vec::with_capacity(corners.len() / 2 + 1);
        if !order.is_empty() {
            split(&corners, &centers, &mut order, (0, 0), &mut nodes);
        }
        let triangles = order
            .iter()
            .map(|&t| {
                let [a, b, c] = corners[t as usize];
                [a, sub(b, a), sub(c, a)]
            })
            .collect();
        Self {
            nodes,
            triangles,
            order,
        }
    }

    /// First hit with `t` in `(t_min, t_max)`; with `any`, some hit.
    pub fn cast(
        &self,
        origin: [f32; 3],
        direction: [f32; 3],
        t_min: f32,
        t_max: f32,
        any: bool,
    ) -> Option<Hit> {
        if self.nodes.is_empty() {
            return None;
        }
        let inverse = direction.map(|d| 1.0 / d);
        // Entry of the ray into a box, infinite for a miss.
        let entry = |node: &Node, t_max: f32| -> f32 {
            let (mut near, mut far) = (t_min, t_max);
            for i in 0..3 {
                let a = (node.low[i] - origin[i]) * inverse[i];
                let b = (node.high[i] - origin[i]) * inverse[i];
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            }
            if near <= far { near } else { f32::INFINITY }
        };
        let mut best: Option<Hit> = None;
        let mut limit = t_max;
        let mut stack = [(0_u32, 0.0_f32); STACK];
        let mut top = 0;
        let root = entry(&self.nodes[0], limit);
        if root == f32::INFINITY {
            return None;
        }
        stack[top] = (0, root);
        top += 1;
        while top > 0 {
            top -= 1;
            let (index, near) = stack[top];
            if near > limit {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for i in node.start..node.start + node.count {
                    let met = self.meet(i as usize, origin, direction);
                    if let Some((t, uv)) = met.filter(|(t, _)| *t > t_min && *t < limit) {
                        limit = t;
                        best = Some(Hit {
                            t,
                            triangle: self.order[i as usize],
                            uv,
                        });
                        if any {
                            return best;
                        }
                    }
                }
                continue;
            }
            let (left, right) = (index + 1, node.start);
            let (a, b) = (
                entry(&self.nodes[left as usize], limit),
                entry(&self.nodes[right as usize], limit),
            );
            // The nearer child is taken first.
            let ordered = if a <= b {
                [(right, b), (left, a)]
            } else {
                [(left, a), (right, b)]
            };
            for child in ordered {
                if child.1 != f32::INFINITY && top < STACK {
                    stack[top] = child;
                    top += 1;
                }
            }
        }
        best
    }

    fn meet(&self, index: usize, origin: [f32; 3], direction: [f32; 3]) -> Option<(f32, [f32; 2])> {
        let [a, e1, e2] = self.triangles[index];
        let p = cross(direction, e2);
        let determinant = dot(e1, p);
        if determinant == 0.0 {
            return None;
        }
        let scale = 1.0 / determinant;
        let s = sub(origin, a);
        let u = dot(s, p) * scale;
        // A hair's breadth of overlap closes the seams between neighbours.
        const SEAM: f32 = 1e-5;
        if !(-SEAM..=1.0 + SEAM).contains(&u) {
            return None;
        }
        let q = cross(s, e1);
        let v = dot(direction, q) * scale;
        if v < -SEAM || u + v > 1.0 + SEAM {
            return None;
        }
        Some((dot(e2, q) * scale, [u, v]))
    }
}

fn split(
    corners: &[[[f32; 3]; 3]],
    centers: &[[f32; 3]],
    order: &mut [u32],
    (depth, offset): (usize, u32),
    nodes: &mut Vec<Node>,
) {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let (mut center_low, mut center_high) = (low, high);
    for &t in order.iter() {
        for i in 0..3 {
            for corner in &corners[t as usize] {
                low[i] = low[i].min(corner[i]);
                high[i] = high[i].max(corner[i]);
            }
            center_low[i] = center_low[i].min(centers[t as usize][i]);
            center_high[i] = center_high[i].max(centers[t as usize][i]);
        }
    }
    let index = nodes.len();
    nodes.push(Node {
        low,
        high,
        start: offset,
        count: order.len() as u32,
    });
    if order.len() <= LEAF {
        return;
    }
    let extent = sub(center_high, center_low);
    let axis = (0..3).fold(0, |best, i| if extent[i] > extent[best] { i } else { best });
    let middle = 0.5 * (center_low[axis] + center_high[axis]);
    let mut cut = 0;
    for i in 0..order.len() {
        if centers[order[i] as usize][axis] < middle {
            order.swap(i, cut);
            cut += 1;
        }
    }
    // A lopsided cut would only deepen the tree, and centroids that coincide have none but by number.
    let least = (order.len() / 8).max(1);
    if !(least..=order.len() - least).contains(&cut) || depth >= MAX_UNEVEN_DEPTH {
        cut = order.len() / 2;
        order.select_nth_unstable_by(cut, |a, b| {
            centers[*a as usize][axis]
                .total_cmp(&centers[*b as usize][axis])
                .then(a.cmp(b))
        });
    }
    let (left, right) = order.split_at_mut(cut);
    split(corners, centers, left, (depth + 1, offset), nodes);
    nodes[index].start = nodes.len() as u32;
    nodes[index].count = 0;
    let offset = offset + cut as u32;
    split(corners, centers, right, (depth + 1, offset), nodes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Triangles by themselves, each with its own corners.
    fn soup(triangles: &[[[f32; 3]; 3]]) -> Mesh {
        Mesh {
            vertices: triangles.concat(),
            triangles: (0..triangles.len() as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
            ..Mesh::default()
        }
    }

    #[test]
    fn triangles_that_no_plane_separates_are_met_as_well() {
        let triangle = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
        for count in [1, 4, 5, 6, 7, 8, 9, 1000] {
            let bvh = Bvh::new(&soup(&vec![triangle; count]));
            let hit = bvh.cast([0.2, 0.2, 0.0], [0.0, 0.0, 1.0], 0.0, 9.0, false);
            assert_eq!(hit.map(|hit| hit.t), Some(1.0), "{count} alike");
        }
    }

    #[test]
    fn triangles_at_ever_smaller_distances_stay_within_the_stack() {
        // Each cut at the middle takes off an eighth: uneven cuts alone would go 70 levels deep.
        let (mut triangles, mut left, mut x) = (Vec::new(), 40_000, 1.0_f32);
        while left > 0 {
            let taken = left / 8 + 1;
            let triangle = [[x, -1.0, 0.0], [x, 1.0, 0.0], [x, 0.0, 1.0]];
            triangles.extend(std::iter::repeat_n(triangle, taken));
            (left, x) = (left - taken, 0.45 * x);
        }
        let bvh = Bvh::new(&soup(&triangles));
        let mut depth = vec![1; bvh.nodes.len()];
        for (k, node) in bvh.nodes.iter().enumerate() {
            if node.count == 0 {
                depth[k + 1] = depth[k] + 1;
                depth[node.start as usize] = depth[k] + 1;
            }
        }
        let deepest = depth.iter().max();
        assert!(deepest.is_some_and(|&d| d < STACK), "{deepest:?}");
    }

    #[test]
    fn agrees_with_testing_every_triangle() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut place = || -> [f32; 3] { std::array::from_fn(|_| random.random()) };
        let mut vertices = Vec::new();
        for _ in 0..300 {
            let base = place();
            for _ in 0..3 {
                let aside = place();
                vertices.push(std::array::from_fn(|k| base[k] + 0.2 * aside[k]));
            }
        }
        let triangles = (0..300).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mesh = Mesh {
            vertices,
            triangles,
            ..Mesh::default()
        };
        let bvh = Bvh::new(&mesh);
        let mut hits = 0;
        for i in 0..2000 {
            let origin = place().map(|c| 3.0 * c - 1.0);
            let target = place();
            let direction = sub(target, origin);
            let brute = (0..300)
                .filter_map(|t| bvh.meet(t, origin, direction))
                .map(|(t, _)| t)
                .filter(|&t| t > 0.0)
                .min_by(f32::total_cmp);
            let found = bvh.cast(origin, direction, 0.0, f32::INFINITY, false);
            assert_eq!(found.map(|h| h.t), brute, "ray {i}");
            assert_eq!(
                bvh.cast(origin, direction, 0.0, f32::INFINITY, true)
                    .is_some(),
                brute.is_some()
            );
            hits += usize::from(brute.is_some());
        }
        assert!(hits > 500, "{hits}");
    }
}
