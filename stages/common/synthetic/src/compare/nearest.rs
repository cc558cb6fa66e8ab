//! Nearest neighbours among points, with work that is bounded for queries from anywhere.
//!
//! A tree whose nodes know the boxes around their points. A tree of splitting planes alone does not
//! know where its outermost cells end: from a query far outside it has to look into all of them.

/// Points in a leaf: fewer makes the tree deeper than it pays for.
const LEAF: usize = 8;

struct Node {
    low: [f64; 3],
    high: [f64; 3],
    /// First point of a leaf, else the right child; the left one follows its parent.
    start: usize,
    /// Points of a leaf, 0 for an inner node.
    count: usize,
}

/// Points that answer which of them are nearest.
pub(super) struct PointTree {
    nodes: Vec<Node>,
    /// Points in leaf order, with their index in the input.
    points: Vec<([f64; 3], u32)>,
}

/// A neighbour: squared distance, and index of the point.
pub(super) type Neighbour = (f64, u32);

fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum()
}

impl Node {
    /// Squared distance of a point from the box.
    fn squared_distance(&self, p: &[f64; 3]) -> f64 {
        let inside = std::array::from_fn(|i| p[i].max(self.low[i]).min(self.high[i]));
        squared_distance(p, &inside)
    }
}

impl PointTree {
    /// Indexes finite points.
    pub fn new(points: &[[f64; 3]]) -> Self {
        let mut points: Vec<([f64; 3], u32)> = points.iter().copied().zip(0..).collect();
        let mut nodes = Vec::with_capacity(points.len() / 2 + 1);
        if !points.is_empty() {
            split(&mut points, 0, &mut nodes);
        }
        Self { nodes, points }
    }

    /// The `N` nearest points, nearest first; at infinity where there are fewer.
    pub fn nearest<const N: usize>(&self, p: &[f64; 3]) -> [Neighbour; N] {
        let mut found = [(f64::INFINITY, 0); N];
        if let Some(root) = self.nodes.first() {
            self.search(0, root.squared_distance(p), p, &mut found);
        }
        found
    }

    fn search<const N: usize>(
        &self,
        index: usize,
        at_least: f64,
        p: &[f64; 3],
        found: &mut [Neighbour; N],
    ) {
        if at_least >= found[N - 1].0 {
            return;
        }
        let node = &self.nodes[index];
        if node.count > 0 {
            for (point, idx) in &self.points[node.start..node.start + node.count] {
                let distance = squared_distance(p, point);
                if distance < found[N - 1].0 {
                    let place = found.partition_point(|(d, _)| *d <= distance);
                    found[place..].rotate_right(1);
                    found[place] = (distance, *idx);
                }
            }
            return;
        }
        let children = [index + 1, node.start];
        let [left, right] = children.map(|child| self.nodes[child].squared_distance(p));
        let (near, far) = if left <= right { (0, 1) } else { (1, 0) };
        let distances = [left, right];
        self.search(children[near], distances[near], p, found);
        self.search(children[far], distances[far], p, found);
    }
}

fn split(points: &mut [([f64; 3], u32)], offset: usize, nodes: &mut Vec<Node>) {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for (point, _) in points.iter() {
        for i in 0..3 {
            low[i] = low[i].min(point[i]);
            high[i] = high[i].max(point[i]);
        }
    }
    let index = nodes.len();
    nodes.push(Node {
        low,
        high,
        start: offset,
        count: points.len(),
    });
    if points.len() <= LEAF {
        return;
    }
    let extent = |i: usize| high[i] - low[i];
    let axis = (1..3).fold(0, |best, i| if extent(i) > extent(best) { i } else { best });
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| {
        a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
    });
    let (left, right) = points.split_at_mut(middle);
    split(left, offset, nodes);
    nodes[index].start = nodes.len();
    nodes[index].count = 0;
    split(right, offset + middle, nodes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::unit;

    fn cloud(count: u32) -> Vec<[f64; 3]> {
        (0..count)
            .map(|i| std::array::from_fn(|k| unit([i, k as u32, 7, 7])))
            .collect()
    }

    #[test]
    fn agrees_with_looking_at_every_point() {
        let points = cloud(500);
        let tree = PointTree::new(&points);
        for i in 0..300 {
            let far = [1.0, 3.0, 1e4][i as usize % 3];
            let p: [f64; 3] = std::array::from_fn(|k| far * (unit([i, k as u32, 8, 8]) - 0.5));
            let mut all: Vec<f64> = points.iter().map(|q| squared_distance(&p, q)).collect();
            all.sort_by(f64::total_cmp);
            let found = tree.nearest::<5>(&p);
            assert_eq!(found.map(|(d, _)| d).to_vec(), all[..5], "{p:?}");
            for (d, idx) in found {
                assert_eq!(d, squared_distance(&p, &points[idx as usize]));
            }
        }
    }

    #[test]
    fn few_points_alike_points_and_none() {
        assert_eq!(
            PointTree::new(&[]).nearest::<1>(&[0.0; 3])[0].0,
            f64::INFINITY
        );
        let tree = PointTree::new(&[[1.0, 0.0, 0.0]; 40]);
        assert_eq!(tree.nearest::<2>(&[0.0; 3]).map(|(d, _)| d), [1.0; 2]);
        let two = PointTree::new(&cloud(2)).nearest::<3>(&[0.0; 3]);
        assert!(two[1].0.is_finite() && two[2].0 == f64::INFINITY, "{two:?}");
    }

    #[test]
    fn a_far_query_looks_at_few_boxes() {
        // On the surface of a ball, as samples of a shape are.
        let points: Vec<[f64; 3]> = cloud(100_000)
            .iter()
            .map(|p| {
                let v = p.map(|c| c - 0.5);
                let length = squared_distance(&v, &[0.0; 3]).sqrt().max(1e-9);
                v.map(|c| c / length)
            })
            .collect();
        let tree = PointTree::new(&points);
        // Boxes that a query cannot pass over: those nearer than what it finds.
        let looked_at = |p: [f64; 3]| {
            let [(nearest, _)] = tree.nearest::<1>(&p);
            let nearer = |node: &&Node| node.squared_distance(&p) < nearest;
            tree.nodes.iter().filter(nearer).count()
        };
        for far in [1e1, 1e3, 1e6] {
            let count = looked_at([far, -2.0 * far, 0.7 * far]);
            assert!(count < 400, "{count} of {} at {far}", tree.nodes.len());
        }
    }
}
