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

use crate::corner_operator::{Operator, for_rows};

/// Hourglass coefficient of the exactly integrated bilinear element.
const EXACT_HOURGLASS: f32 = 1.0 / 3.0;
/// Nodes per side at and below which a level is solved directly.
const MAX_DIRECT_SIDE: usize = 9;
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
        while levels.is_empty() || size.0.max(size.1) > MAX_DIRECT_SIDE + 2 {
            let (stride, rows) = (coarse_len(size.0), coarse_len(size.1));
            weight = coarse_weights(&weight, size, stride, rows);
            let zeros = vec![0.0; stride * rows];
            let (weight, mass) = (weight.clone(), zeros.clone());
            levels.push(Level {
                operator: Operator::new(stride, weight, mass, EXACT_HOURGLASS),
                x: zeros.clone(),
                b: zeros.clone(),
                r: zeros,
            });
            size = (stride, rows);
        }
        let direct = DirectSolve::default();
        let mut hierarchy = Self { levels, direct };
        hierarchy.update_mass(fine, fine_mass);
        hierarchy
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
                let cells = Operator::cells_around(&fine.weight, stride, y * stride + x);
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
