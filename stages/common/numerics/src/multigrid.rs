//! Multigrid for Poisson operators on corner grids, as a preconditioner.
//!
//! **Problem.** Approximate `x ≈ A⁻¹ b` for the operator of [`crate::corner_poisson`],
//!
//! ```text
//! zᵀ A z = Σ_cells w (p² + q² + h (a − b − c + d)²/4) + Σ_nodes m z²,
//! ```
//!
//! by one V-cycle: damped Jacobi before and after, transposed bilinear restriction, bilinear
//! prolongation. Coarse cells carry the mean weight of their four children (a 2-D stiffness does
//! not depend on the spacing), coarse nodes the lumped mass.
//!
//! **The hourglass mode.** With small `h` the finest operator nearly splits into two grids of
//! opposite parity: beside the smooth functions, smooth functions times `(−1)^(x+y)` have small
//! energy too, which neither the smoother nor a bilinear coarse grid reduces. In that second family
//! the energy is again a Poisson one, with the additional mass `4 h` per cell. So the finest level
//! has two coarse corrections, one for each family, and stays symmetric. Coarser levels take the
//! exactly integrated bilinear element, `h = 1/3`.
//!
//! Everything runs in `f32`; rows are independent, so results do not depend on the thread count.

use rayon::prelude::*;

/// Hourglass coefficient of the exactly integrated bilinear element.
const EXACT_HOURGLASS: f32 = 1.0 / 3.0;
/// Damping of Jacobi: least smoothing factor for the nine-point stencil of `h = 1/3`.
const DAMPING: f32 = 0.8;
/// Nodes per side at and below which a level is solved directly.
const MAX_DIRECT_SIDE: usize = 9;
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
                let cells = weight[i] + weight[i - 1] + weight[i - stride] + weight[i - stride - 1];
                let diagonal = centre * cells + mass[i];
                *out = if cells > 0.0 { 1.0 / diagonal } else { 0.0 };
            }
        });
    }

    /// `out = A z` on one row, compiled for the widest vectors of this processor (measured: half the
    /// time of the baseline on a processor with AVX2).
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
    fn add_jacobi(&self, r: &[f32], x: &mut [f32]) {
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
    fn set_jacobi(&self, b: &[f32], x: &mut [f32]) {
        let s = self.stride;
        for_rows(s, x, |y, x| {
            let b = &b[y * s..(y + 1) * s];
            let inverse = &self.inverse_diagonal[y * s..(y + 1) * s];
            for ((x, b), inverse) in x.iter_mut().zip(b).zip(inverse) {
                *x = DAMPING * inverse * b;
            }
        });
    }
}

/// Size of a coarse raster along one axis for a fine one, border included.
fn coarse_len(fine: usize) -> usize {
    // `fine - 2` nodes, the coarse ones at every second, one more to cover an odd last cell.
    (fine - 2) / 2 + 1 + 2
}

/// `coarse = Pᵀ fine`, where `sign` multiplies fine nodes of odd parity.
fn restrict(
    fine: &[f32],
    (fine_stride, fine_rows): (usize, usize),
    coarse: &mut [f32],
    coarse_stride: usize,
    sign: f32,
) {
    for_rows(coarse_stride, coarse, |cy, out| {
        let fy = 2 * cy as isize - 1;
        if cy == 0 || fy >= fine_rows as isize {
            return;
        }
        out.fill(0.0);
        for (dy, weight_y) in [(-1, 0.5), (0, 1.0), (1, 0.5)] {
            let y = fy + dy;
            if y < 1 || y as usize + 1 >= fine_rows {
                continue;
            }
            let row = &fine[y as usize * fine_stride..(y as usize + 1) * fine_stride];
            // Coarse nodes have odd x and y in padded rasters, so parity follows the offsets.
            let (even, odd) = if dy == 0 { (1.0, sign) } else { (sign, 1.0) };
            for (cx, out) in out.iter_mut().enumerate().skip(1) {
                let fx = 2 * cx - 1;
                if fx >= fine_stride {
                    break;
                }
                let right = if fx + 1 < fine_stride {
                    row[fx + 1]
                } else {
                    0.0
                };
                let sides = if fx > 1 { row[fx - 1] } else { 0.0 } + right;
                *out += weight_y * (even * row[fx] + 0.5 * odd * sides);
            }
        }
    });
}

/// `fine += P coarse`, where `sign` multiplies fine nodes of odd parity; nodes without a stencil
/// are left alone.
fn add_prolonged(
    coarse: &[f32],
    coarse_stride: usize,
    fine: &mut [f32],
    operator: &Operator,
    sign: f32,
) {
    let (fine_stride, fine_rows) = (operator.stride, operator.rows);
    for_rows(fine_stride, fine, |y, out| {
        if y == 0 || y + 1 >= fine_rows {
            return;
        }
        let cy = y.div_ceil(2);
        let top = &coarse[cy * coarse_stride..(cy + 1) * coarse_stride];
        let next = if y % 2 == 1 { cy } else { cy + 1 };
        let bottom = &coarse[next * coarse_stride..(next + 1) * coarse_stride];
        let (on, off) = if y % 2 == 1 { (1.0, sign) } else { (sign, 1.0) };
        let active = &operator.inverse_diagonal[y * fine_stride..(y + 1) * fine_stride];
        let gate = |x: usize, value: f32| if active[x] > 0.0 { value } else { 0.0 };
        let mut x = 1;
        let mut cx = 1;
        while x + 1 < fine_stride {
            let left = 0.5 * (top[cx] + bottom[cx]);
            out[x] += gate(x, on * left);
            if x + 2 < fine_stride {
                let right = 0.5 * (top[cx + 1] + bottom[cx + 1]);
                out[x + 1] += gate(x + 1, off * 0.5 * (left + right));
            }
            x += 2;
            cx += 1;
        }
    });
}

/// Means of four children; cells beyond the raster count as 0.
fn coarse_weights(
    fine: &[f32],
    (stride, rows): (usize, usize),
    coarse_stride: usize,
    coarse_rows: usize,
) -> Vec<f32> {
    let mut coarse = vec![0.0; coarse_stride * coarse_rows];
    for_rows(coarse_stride, &mut coarse, |cy, out| {
        if cy == 0 {
            return;
        }
        for (cx, out) in out.iter_mut().enumerate().skip(1) {
            let mut sum = 0.0;
            for y in [2 * cy - 1, 2 * cy] {
                for x in [2 * cx - 1, 2 * cx] {
                    if x < stride && y < rows {
                        sum += fine[y * stride + x];
                    }
                }
            }
            *out = 0.25 * sum;
        }
    });
    coarse
}

#[derive(Clone, Debug)]
struct Level {
    operator: Operator,
    x: Vec<f32>,
    b: Vec<f32>,
    r: Vec<f32>,
}

/// Coarse levels of one family of functions, from half resolution down to a direct solve.
#[derive(Clone, Debug)]
struct Hierarchy {
    levels: Vec<Level>,
    direct: DirectSolve,
}

impl Hierarchy {
    fn new(fine: &Operator, fine_mass: &[f32]) -> Self {
        let mut levels: Vec<Level> = Vec::new();
        let mut size = (fine.stride, fine.rows);
        let mut weight = fine.weight.clone();
        let mut mass = fine_mass.to_vec();
        while levels.is_empty() || size.0.max(size.1) > MAX_DIRECT_SIDE + 2 {
            let (stride, rows) = (coarse_len(size.0), coarse_len(size.1));
            let coarse_weight = coarse_weights(&weight, size, stride, rows);
            let mut coarse_mass = vec![0.0; stride * rows];
            restrict(&mass, size, &mut coarse_mass, stride, 1.0);
            let operator = Operator::new(
                stride,
                coarse_weight.clone(),
                coarse_mass.clone(),
                EXACT_HOURGLASS,
            );
            let zeros = vec![0.0; stride * rows];
            levels.push(Level {
                operator,
                x: zeros.clone(),
                b: zeros.clone(),
                r: zeros,
            });
            (weight, mass, size) = (coarse_weight, coarse_mass, (stride, rows));
        }
        let direct = levels
            .last()
            .map(|level| DirectSolve::new(&level.operator))
            .unwrap_or_default();
        Self { levels, direct }
    }

    fn update_mass(&mut self, fine: &Operator, fine_mass: &[f32]) {
        let mut size = (fine.stride, fine.rows);
        let mut above: Option<Vec<f32>> = None;
        for level in &mut self.levels {
            let operator = &mut level.operator;
            let source = above.as_deref().unwrap_or(fine_mass);
            restrict(source, size, &mut operator.mass, operator.stride, 1.0);
            operator.update_diagonal();
            size = (operator.stride, operator.rows);
            above = Some(operator.mass.clone());
        }
        if let Some(level) = self.levels.last() {
            self.direct = DirectSolve::new(&level.operator);
        }
    }

    /// One V-cycle from the first level's `b` to its `x`.
    fn cycle(&mut self) {
        Self::descend(&mut self.levels, &self.direct);
    }

    fn descend(levels: &mut [Level], direct: &DirectSolve) {
        let Some((level, coarser)) = levels.split_first_mut() else {
            return;
        };
        let Some(next) = coarser.first_mut() else {
            direct.solve(&level.b, &mut level.x);
            return;
        };
        let operator = &level.operator;
        operator.set_jacobi(&level.b, &mut level.x);
        operator.residual(&level.b, &level.x, &mut level.r);
        let size = (operator.stride, operator.rows);
        restrict(&level.r, size, &mut next.b, next.operator.stride, 1.0);
        Self::descend(coarser, direct);
        if let Some(next) = coarser.first() {
            let stride = next.operator.stride;
            add_prolonged(&next.x, stride, &mut level.x, operator, 1.0);
        }
        operator.residual(&level.b, &level.x, &mut level.r);
        operator.add_jacobi(&level.r, &mut level.x);
    }
}

/// Dense Cholesky factor of the coarsest level's active nodes.
#[derive(Clone, Debug, Default)]
struct DirectSolve {
    nodes: Vec<usize>,
    // Row-major lower triangle.
    factor: Vec<f64>,
}

impl DirectSolve {
    fn new(operator: &Operator) -> Self {
        let nodes: Vec<usize> = (0..operator.weight.len())
            .filter(|&i| operator.inverse_diagonal[i] > 0.0)
            .collect();
        let n = nodes.len();
        let mut unit = vec![0.0; operator.weight.len()];
        let mut column = unit.clone();
        let mut factor = vec![0.0; n * n];
        for j in 0..n {
            unit[nodes[j]] = 1.0;
            operator.apply(&unit, &mut column);
            unit[nodes[j]] = 0.0;
            for i in 0..n {
                factor[i * n + j] = f64::from(column[nodes[i]]);
            }
            // Rounding must not make a pivot negative.
            factor[j * n + j] *= 1.0 + 1e-3;
        }
        for j in 0..n {
            for k in 0..j {
                let ljk = factor[j * n + k];
                for i in j..n {
                    factor[i * n + j] -= factor[i * n + k] * ljk;
                }
            }
            let pivot = factor[j * n + j].max(1e-30).sqrt();
            for i in j..n {
                factor[i * n + j] /= pivot;
            }
        }
        Self { nodes, factor }
    }

    fn solve(&self, b: &[f32], x: &mut [f32]) {
        let n = self.nodes.len();
        let mut v: Vec<f64> = self.nodes.iter().map(|&i| f64::from(b[i])).collect();
        for i in 0..n {
            let sum: f64 = (0..i).map(|k| self.factor[i * n + k] * v[k]).sum();
            v[i] = (v[i] - sum) / self.factor[i * n + i];
        }
        for i in (0..n).rev() {
            let sum: f64 = (i + 1..n).map(|k| self.factor[k * n + i] * v[k]).sum();
            v[i] = (v[i] - sum) / self.factor[i * n + i];
        }
        for (&node, value) in self.nodes.iter().zip(v) {
            x[node] = value as f32;
        }
    }
}

/// The finest level with its two coarse corrections.
#[derive(Clone, Debug)]
pub(crate) struct Multigrid {
    smooth: Hierarchy,
    alternating: Hierarchy,
    r: Vec<f32>,
}

impl Multigrid {
    pub(crate) fn new(fine: &Operator) -> Self {
        let alternating_mass = Self::alternating_mass(fine);
        Self {
            smooth: Hierarchy::new(fine, &fine.mass),
            alternating: Hierarchy::new(fine, &alternating_mass),
            r: vec![0.0; fine.weight.len()],
        }
    }

    /// Masses of the second family: the hourglass energy `4 h w` per cell, shared by its corners.
    fn alternating_mass(fine: &Operator) -> Vec<f32> {
        let (stride, rows) = (fine.stride, fine.rows);
        let mut mass = fine.mass.clone();
        for_rows(stride, &mut mass, |y, mass| {
            if y == 0 || y + 1 >= rows {
                return;
            }
            for (x, mass) in mass.iter_mut().enumerate().skip(1) {
                let i = y * stride + x;
                let w = &fine.weight;
                let cells = w[i] + w[i - 1] + w[i - stride] + w[i - stride - 1];
                *mass += fine.hourglass * cells;
            }
        });
        mass
    }

    pub(crate) fn update_mass(&mut self, fine: &Operator) {
        self.smooth.update_mass(fine, &fine.mass);
        self.alternating
            .update_mass(fine, &Self::alternating_mass(fine));
    }

    /// One V-cycle: `x ≈ A⁻¹ b`.
    pub(crate) fn cycle(&mut self, fine: &Operator, b: &[f32], x: &mut [f32]) {
        let size = (fine.stride, fine.rows);
        fine.set_jacobi(b, x);
        fine.residual(b, x, &mut self.r);
        for (hierarchy, sign) in [(&mut self.smooth, 1.0), (&mut self.alternating, -1.0)] {
            if let Some(first) = hierarchy.levels.first_mut() {
                restrict(&self.r, size, &mut first.b, first.operator.stride, sign);
            }
            hierarchy.cycle();
            if let Some(first) = hierarchy.levels.first() {
                add_prolonged(&first.x, first.operator.stride, x, fine, sign);
            }
        }
        fine.residual(b, x, &mut self.r);
        fine.add_jacobi(&self.r, x);
    }
}
