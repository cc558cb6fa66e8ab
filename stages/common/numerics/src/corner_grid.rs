//! A masked pixel grid whose unknowns sit at the pixels' corners.
//!
//! **Problem.** Slopes are needed where intensities live, at pixel centres, on an irregular mask.
//! With the unknown `y` at the four corners `a b / c d` of a pixel, the one-point quadrature of the
//! bilinear cell gives
//!
//! ```text
//! p = (b + d − a − c) / 2,   q = (c + d − a − b) / 2,   value = (a + b + c + d) / 4,
//! ```
//!
//! second-order exact at the centre. Every pixel of the mask owns its four corners, so that there
//! is no special case at the mask's edge. The price is the hourglass mode `a − b − c + d`, to which
//! slopes and value are blind; [`crate::corner_poisson`] holds it down.
//!
//! # Layout
//! Rasters of nodes and of cells share one stride and a border of one element, so that cell `i` has
//! the corners `i, i + 1, i + stride, i + stride + 1` and no stencil needs a test. Cells of the mask
//! are also numbered compactly, row by row, in contiguous [`Span`]s.

use rilievo_scene::Mask;

/// A run of neighbouring mask pixels in one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Position of the first cell in padded rasters.
    pub cell: usize,
    /// Compact index of the first cell.
    pub first: usize,
    /// Number of cells.
    pub len: usize,
}

/// Geometry of a masked grid, cropped to the mask's bounding box.
#[derive(Clone, Debug)]
pub struct CornerGrid {
    /// Column of the first cell in the image.
    pub origin_x: usize,
    /// Row of the first cell in the image.
    pub origin_y: usize,
    /// Number of cell columns.
    pub width: usize,
    /// Number of cell rows.
    pub height: usize,
    /// Row stride of padded rasters, `width + 3`.
    pub stride: usize,
    /// Number of cells in the mask.
    pub num_cells: usize,
    spans: Vec<Span>,
    // First span of every cell row, and one past the last.
    row_spans: Vec<usize>,
}

impl CornerGrid {
    /// The grid of a mask; `None` when the mask is empty.
    pub fn new(mask: &Mask) -> Option<Self> {
        let [[x0, last_x], [y0, last_y]] = mask.bounds(|&inside| inside)?;
        let (x1, y1) = (last_x + 1, last_y + 1);
        let (width, height) = (x1 - x0, y1 - y0);
        let stride = width + 3;
        let (mut spans, mut row_spans, mut num_cells) = (Vec::new(), vec![0], 0);
        for y in 0..height {
            let row = &mask.data[(y + y0) * mask.width + x0..(y + y0) * mask.width + x1];
            let mut x = 0;
            while x < width {
                if row[x] {
                    let len = row[x..].iter().take_while(|&&inside| inside).count();
                    spans.push(Span {
                        cell: (y + 1) * stride + x + 1,
                        first: num_cells,
                        len,
                    });
                    num_cells += len;
                    x += len;
                } else {
                    x += 1;
                }
            }
            row_spans.push(spans.len());
        }
        Some(Self {
            origin_x: x0,
            origin_y: y0,
            width,
            height,
            stride,
            num_cells,
            spans,
            row_spans,
        })
    }

    /// Length of padded rasters.
    pub fn padded_len(&self) -> usize {
        self.stride * (self.height + 3)
    }

    /// Position in padded rasters of cell or node `(x, y)`, counted from the crop's origin.
    #[inline]
    pub fn index(&self, x: usize, y: usize) -> usize {
        (y + 1) * self.stride + x + 1
    }

    /// All runs of mask pixels in order.
    pub fn spans(&self) -> &[Span] {
        &self.spans
    }

    /// Runs of one cell row.
    pub fn row(&self, y: usize) -> &[Span] {
        &self.spans[self.row_spans[y]..self.row_spans[y + 1]]
    }

    /// Image pixel `(x, y)` of every cell, in compact order.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.spans.iter().flat_map(move |span| {
            let (y, x) = (span.cell / self.stride - 1, span.cell % self.stride - 1);
            (0..span.len).map(move |k| (x + k + self.origin_x, y + self.origin_y))
        })
    }

    /// Slopes `(p, q)` of node values at the centres of the cells of the mask.
    pub fn gradient(&self, nodes: &[f32], p: &mut [f32], q: &mut [f32]) {
        for span in &self.spans {
            let n = span.len;
            let top = &nodes[span.cell..span.cell + n + 1];
            let bottom = &nodes[span.cell + self.stride..span.cell + self.stride + n + 1];
            let p = &mut p[span.first..span.first + n];
            let q = &mut q[span.first..span.first + n];
            for x in 0..n {
                let falling = bottom[x + 1] - top[x];
                let rising = top[x + 1] - bottom[x];
                p[x] = 0.5 * (falling + rising);
                q[x] = 0.5 * (falling - rising);
            }
        }
    }

    /// Adds the transpose of [`Self::gradient`], applied to `scale · (p, q)`, to `nodes`.
    pub fn add_divergence(&self, scale: f32, p: &[f32], q: &[f32], nodes: &mut [f32]) {
        for span in &self.spans {
            let n = span.len;
            let p = &p[span.first..span.first + n];
            let q = &q[span.first..span.first + n];
            let (upper, lower) = nodes.split_at_mut(span.cell + self.stride);
            let top = &mut upper[span.cell..span.cell + n + 1];
            let bottom = &mut lower[..n + 1];
            let half = 0.5 * scale;
            for x in 0..n {
                top[x] -= half * (p[x] + q[x]);
                bottom[x] += half * (q[x] - p[x]);
            }
            for x in 0..n {
                top[x + 1] += half * (p[x] - q[x]);
                bottom[x + 1] += half * (p[x] + q[x]);
            }
        }
    }

    /// Node values averaged at the centres of the cells of the mask.
    pub fn values(&self, nodes: &[f32], values: &mut [f32]) {
        for span in &self.spans {
            let n = span.len;
            let top = &nodes[span.cell..span.cell + n + 1];
            let bottom = &nodes[span.cell + self.stride..span.cell + self.stride + n + 1];
            for (x, value) in values[span.first..span.first + n].iter_mut().enumerate() {
                *value = 0.25 * ((top[x] + top[x + 1]) + (bottom[x] + bottom[x + 1]));
            }
        }
    }

    /// A padded raster from values at the cells of the mask, 0 elsewhere.
    pub fn scatter(&self, values: &[f32]) -> Vec<f32> {
        let mut raster = vec![0.0; self.padded_len()];
        for span in &self.spans {
            raster[span.cell..span.cell + span.len]
                .copy_from_slice(&values[span.first..span.first + span.len]);
        }
        raster
    }

    /// Bilinear weights of the four nodes around an image position, which lies in the cell whose
    /// centre is nearest: `(cell position in padded rasters, weights of its corners a b c d)`.
    /// `None` where that cell is not in the mask.
    pub fn locate(&self, x_px: f64, y_px: f64) -> Option<(usize, [f32; 4])> {
        // Node (x, y) of the crop lies at image position origin + (x, y) − ½.
        let u = x_px - self.origin_x as f64 + 0.5;
        let v = y_px - self.origin_y as f64 + 0.5;
        let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
        if !inside {
            return None;
        }
        let (x, y) = (u.floor(), v.floor());
        let cell = self.index(x as usize, y as usize);
        let in_mask = self
            .row(y as usize)
            .iter()
            .any(|span| cell >= span.cell && cell < span.cell + span.len);
        if !in_mask {
            return None;
        }
        let (s, t) = ((u - x) as f32, (v - y) as f32);
        Some((
            cell,
            [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t],
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc() -> CornerGrid {
        let mask = Mask::from_fn(23, 19, |x, y| {
            (x as f64 - 11.0).powi(2) + (y as f64 - 8.0).powi(2) < 50.0
        });
        CornerGrid::new(&mask).expect("not empty")
    }

    #[test]
    fn a_plane_has_its_slopes_and_values_everywhere() {
        let grid = disc();
        let mut nodes = vec![0.0; grid.padded_len()];
        for y in 0..=grid.height {
            for x in 0..=grid.width {
                nodes[grid.index(x, y)] = 0.5 * x as f32 - 0.25 * y as f32;
            }
        }
        let n = grid.num_cells;
        let (mut p, mut q, mut v) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        grid.gradient(&nodes, &mut p, &mut q);
        grid.values(&nodes, &mut v);
        for (k, (x, y)) in grid.pixels().enumerate() {
            let expected = 0.5 * (x as f32 - grid.origin_x as f32 + 0.5)
                - 0.25 * (y as f32 - grid.origin_y as f32 + 0.5);
            assert!((p[k] - 0.5).abs() < 1e-6 && (q[k] + 0.25).abs() < 1e-6);
            assert!((v[k] - expected).abs() < 1e-5, "{} {expected}", v[k]);
        }
        let (cell, weights) = grid.locate(10.25, 8.75).expect("inside");
        let corners = [cell, cell + 1, cell + grid.stride, cell + grid.stride + 1];
        let value: f32 = corners
            .iter()
            .zip(weights)
            .map(|(&i, w)| nodes[i] * w)
            .sum();
        let expected =
            0.5 * (10.25 - grid.origin_x as f32 + 0.5) - 0.25 * (8.75 - grid.origin_y as f32 + 0.5);
        assert!((value - expected).abs() < 1e-5, "{value} {expected}");
    }

    #[test]
    fn divergence_is_the_transpose_of_the_gradient() {
        let grid = disc();
        let nodes: Vec<f32> = (0..grid.padded_len())
            .map(|i| ((i * 37) % 11) as f32)
            .collect();
        let n = grid.num_cells;
        let a: Vec<f32> = (0..n).map(|i| ((i * 13) % 7) as f32 - 3.0).collect();
        let b: Vec<f32> = (0..n).map(|i| ((i * 29) % 5) as f32 - 2.0).collect();
        let (mut p, mut q) = (vec![0.0; n], vec![0.0; n]);
        grid.gradient(&nodes, &mut p, &mut q);
        let mut transposed = vec![0.0; grid.padded_len()];
        grid.add_divergence(1.0, &a, &b, &mut transposed);
        let left: f32 = (0..n).map(|k| p[k] * a[k] + q[k] * b[k]).sum();
        let right: f32 = nodes.iter().zip(&transposed).map(|(x, y)| x * y).sum();
        assert!((left - right).abs() < 1e-2, "{left} {right}");
    }

    #[test]
    fn an_empty_mask_has_no_grid() {
        assert!(CornerGrid::new(&Mask::filled(5, 4, false)).is_none());
        let single = Mask::from_fn(5, 4, |x, y| x == 2 && y == 1);
        assert_eq!(CornerGrid::new(&single).map(|g| g.num_cells), Some(1));
    }
}
