//! Exact Euclidean distance transform: how far every place of a grid lies from the nearest one that
//! is set.
//!
//! `d²(p) = min over q of |p − q|² + f(q)`, `f` 0 where set: the lower envelope of parabolas, axis
//! by axis (Felzenszwalb, Huttenlocher, "Distance Transforms of Sampled Functions", Theory of
//! Computing 8, 2012). A label of the nearest place travels along, so that the same transform
//! answers "which one".

use rayon::prelude::*;

/// Squared distance where nothing is set.
pub const FAR: f32 = 1e12;

/// Squared distances in cells, in place, on a grid of `size` (x fastest): 0 where set and [`FAR`]
/// elsewhere at the start. Labels become those of the nearest set place; `()` where only distances
/// are wanted.
pub fn transform<L: Copy + Send + Sync>(squared: &mut [f32], labels: &mut [L], size: [usize; 3]) {
    let [nx, ny, nz] = size;
    let plane = (nx * ny).max(1);
    squared
        .par_chunks_mut(plane)
        .zip(labels.par_chunks_mut(plane))
        .for_each(|(squared, labels)| {
            let mut line = Line::new(nx.max(ny));
            (0..ny).for_each(|y| line.envelope(squared, labels, y * nx, 1, nx));
            (0..nx).for_each(|x| line.envelope(squared, labels, x, nx, ny));
        });
    if nz < 2 {
        return;
    }
    let columns: Vec<(Vec<f32>, Vec<L>)> = (0..plane)
        .into_par_iter()
        .with_min_len(256)
        .map_init(
            || Line::new(nz),
            |line, at| {
                let mut column: Vec<f32> = (0..nz).map(|z| squared[z * plane + at]).collect();
                let mut names: Vec<L> = (0..nz).map(|z| labels[z * plane + at]).collect();
                line.envelope(&mut column, &mut names, 0, 1, nz);
                (column, names)
            },
        )
        .collect();
    for (at, (column, names)) in columns.into_iter().enumerate() {
        for (z, (value, name)) in column.into_iter().zip(names).enumerate() {
            squared[z * plane + at] = value;
            labels[z * plane + at] = name;
        }
    }
}

/// Buffers of one line of the grid.
struct Line<L> {
    values: Vec<f32>,
    labels: Vec<L>,
    /// Parabolas of the envelope, and from where on each is the lowest.
    vertices: Vec<usize>,
    borders: Vec<f32>,
}

impl<L: Copy> Line<L> {
    fn new(longest: usize) -> Self {
        Self {
            values: Vec::with_capacity(longest),
            labels: Vec::with_capacity(longest),
            vertices: vec![0; longest],
            borders: vec![0.0; longest + 1],
        }
    }

    fn envelope(
        &mut self,
        squared: &mut [f32],
        labels: &mut [L],
        start: usize,
        stride: usize,
        count: usize,
    ) {
        let places = || (0..count).map(|k| start + k * stride);
        self.values.clear();
        self.values.extend(places().map(|at| squared[at]));
        self.labels.clear();
        self.labels.extend(places().map(|at| labels[at]));
        let (f, vertices, borders) = (&self.values, &mut self.vertices, &mut self.borders);
        let mut last = 0;
        vertices[0] = 0;
        borders[0] = f32::NEG_INFINITY;
        borders[1] = f32::INFINITY;
        for q in 1..count {
            let qf = q as f32;
            loop {
                let v = vertices[last];
                let vf = v as f32;
                let crossing = ((f[q] + qf * qf) - (f[v] + vf * vf)) / (2.0 * (qf - vf));
                if crossing > borders[last] {
                    last += 1;
                    borders[last] = crossing;
                } else if last > 0 {
                    last -= 1;
                    continue;
                }
                vertices[last] = q;
                borders[last + 1] = f32::INFINITY;
                break;
            }
        }
        let mut k = 0;
        for (q, at) in places().enumerate() {
            while borders[k + 1] < q as f32 {
                k += 1;
            }
            let d = q as f32 - vertices[k] as f32;
            squared[at] = d * d + f[vertices[k]];
            labels[at] = self.labels[vertices[k]];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_place_finds_the_nearest_set_one() {
        let size = [13, 9, 7];
        let place = |k: usize| [k % 13, k / 13 % 9, k / (13 * 9)].map(|v| v as f32);
        let set: Vec<usize> = (0..13 * 9 * 7).filter(|k| k * k % 97 == 4).collect();
        assert!(set.len() > 5, "{}", set.len());
        let mut squared = vec![FAR; 13 * 9 * 7];
        set.iter().for_each(|&k| squared[k] = 0.0);
        let mut labels: Vec<usize> = (0..squared.len()).collect();
        transform(&mut squared, &mut labels, size);
        let between = |a: usize, b: usize| -> f32 {
            let (a, b) = (place(a), place(b));
            (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
        };
        for (k, (&found, &label)) in squared.iter().zip(&labels).enumerate() {
            let expected = set.iter().map(|&s| between(k, s)).fold(FAR, f32::min);
            assert_eq!(found, expected, "at {k}");
            assert_eq!(between(k, label), expected, "label of {k}");
        }
    }
}
