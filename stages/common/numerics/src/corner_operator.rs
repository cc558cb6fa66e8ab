//! The operator of [`crate::corner_poisson`] as a nine-point stencil on padded rasters, with its
//! Jacobi step.
//!
//! Everything runs in `f32`; rows are independent, so results do not depend on the thread count.

use rayon::prelude::*;

/// Damping of Jacobi: least smoothing factor for the nine-point stencil of `h = 1/3`.
const DAMPING: f32 = 0.8;
/// Elements per parallel task; smaller rasters are not worth a task.
const TASK_LEN: usize = 1 << 15;

/// Runs `row(y, values)` on every row of a padded raster, in parallel where it pays.
pub(crate) fn for_rows(
    stride: usize,
    raster: &mut [f32],
    row: impl Fn(usize, &mut [f32]) + Sync + Send,
) {
    if raster.len() <= 2 * TASK_LEN {
        for (y, values) in raster.chunks_exact_mut(stride).enumerate() {
            row(y, values);
        }
        return;
    }
    let rows_per_task = TASK_LEN.div_ceil(stride);
    raster
        .par_chunks_mut(stride * rows_per_task)
        .enumerate()
        .for_each(|(task, rows)| {
            for (y, values) in rows.chunks_exact_mut(stride).enumerate() {
                row(task * rows_per_task + y, values);
            }
        });
}

/// The operator on one level: rasters with a border of one element (see [`crate::corner_grid`]).
#[derive(Clone, Debug)]
pub(crate) struct Operator {
    pub(crate) stride: usize,
    pub(crate) rows: usize,
    pub(crate) hourglass: f32,
    pub(crate) weight: Vec<f32>,
    pub(crate) mass: Vec<f32>,
    pub(crate) inverse_diagonal: Vec<f32>,
}

impl Operator {
    pub(crate) fn new(stride: usize, weight: Vec<f32>, mass: Vec<f32>, hourglass: f32) -> Self {
        let mut operator = Self {
            stride,
            rows: weight.len() / stride,
            hourglass,
            inverse_diagonal: vec![0.0; weight.len()],
            weight,
            mass,
        };
        operator.update_diagonal();
        operator
    }

    /// Recomputes what follows from weights and masses.
    pub(crate) fn update_diagonal(&mut self) {
        let (stride, rows) = (self.stride, self.rows);
        let (weight, mass) = (&self.weight, &self.mass);
        let centre = 0.5 + 0.25 * self.hourglass;
        for_rows(stride, &mut self.inverse_diagonal, |y, out| {
            if y == 0 || y + 1 >= rows {
                return;
            }
            for (x, out) in out.iter_mut().enumerate().skip(1) {
                let i = y * stride + x;
                let cells = Self::cells_around(weight, stride, i);
                let diagonal = centre * cells + mass[i];
                *out = if cells > 0.0 { 1.0 / diagonal } else { 0.0 };
            }
        });
    }

    /// `out = A z` on one row, compiled for the widest vectors of this processor (measured: half
    /// the time of the baseline on a processor with AVX2).
    fn apply_row(&self, y: usize, z: &[f32], out: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(operator: &Operator, y: usize, z: &[f32], out: &mut [f32]) {
                operator.stencil_row(y, z, out);
            }
            if is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has the feature that the function is compiled for.
                #[allow(unsafe_code)]
                unsafe {
                    wide(self, y, z, out);
                }
                return;
            }
        }
        self.stencil_row(y, z, out);
    }

    #[inline(always)]
    fn stencil_row(&self, y: usize, z: &[f32], out: &mut [f32]) {
        let s = self.stride;
        let n = s - 2;
        // All slices have n elements, so that the loop needs no bounds checks.
        let (a0, h0, b0) = ((y - 1) * s, y * s, (y + 1) * s);
        let at = |start: usize| &z[start..start + n];
        let (above_left, above, above_right) = (at(a0), at(a0 + 1), at(a0 + 2));
        let (left, here, right) = (at(h0), at(h0 + 1), at(h0 + 2));
        let (below_left, below, below_right) = (at(b0), at(b0 + 1), at(b0 + 2));
        let weight = |start: usize| &self.weight[start..start + n];
        let (wa, wb) = (weight(h0 + 1), weight(h0));
        let (wc, wd) = (weight(a0 + 1), weight(a0));
        let mass = &self.mass[h0 + 1..h0 + 1 + n];
        let out = &mut out[1..1 + n];
        let diagonal = 0.5 - 0.25 * self.hourglass;
        let edge = 0.25 * self.hourglass;
        for x in 0..n {
            let (a, b, c, d) = (wa[x], wb[x], wc[x], wd[x]);
            // Differences, so that a large constant does not drown them in rounding.
            let h = here[x];
            let corners = (a * (h - below_right[x]) + b * (h - below_left[x]))
                + (c * (h - above_right[x]) + d * (h - above_left[x]));
            let edges = ((a + c) * (h - right[x]) + (b + d) * (h - left[x]))
                + ((a + b) * (h - below[x]) + (c + d) * (h - above[x]));
            out[x] = diagonal * corners + edge * edges + mass[x] * h;
        }
    }

    /// `out = A z`.
    pub(crate) fn apply(&self, z: &[f32], out: &mut [f32]) {
        let rows = self.rows;
        for_rows(self.stride, out, |y, out| {
            if y > 0 && y + 1 < rows {
                self.apply_row(y, z, out);
            }
        });
    }

    /// `out = b − A z`.
    pub(crate) fn residual(&self, b: &[f32], z: &[f32], out: &mut [f32]) {
        let (rows, s) = (self.rows, self.stride);
        for_rows(s, out, |y, out| {
            if y > 0 && y + 1 < rows {
                self.apply_row(y, z, out);
                for (value, b) in out.iter_mut().zip(&b[y * s..(y + 1) * s]) {
                    *value = b - *value;
                }
            }
        });
    }

    /// `x += damping · D⁻¹ r`.
    pub(crate) fn add_jacobi(&self, r: &[f32], x: &mut [f32]) {
        let s = self.stride;
        for_rows(s, x, |y, x| {
            let r = &r[y * s..(y + 1) * s];
            let inverse = &self.inverse_diagonal[y * s..(y + 1) * s];
            for ((x, r), inverse) in x.iter_mut().zip(r).zip(inverse) {
                *x += DAMPING * inverse * r;
            }
        });
    }

    /// `x = damping · D⁻¹ b`.
    pub(crate) fn set_jacobi(&self, b: &[f32], x: &mut [f32]) {
        x.fill(0.0);
        self.add_jacobi(b, x);
    }

    /// Sum of the weights of the four cells around node `i`.
    #[inline]
    pub(crate) fn cells_around(weight: &[f32], stride: usize, i: usize) -> f32 {
        weight[i] + weight[i - 1] + weight[i - stride] + weight[i - stride - 1]
    }
}
