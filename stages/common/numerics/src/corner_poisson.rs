//! Least-squares integration of slopes on a corner grid, with point and area constraints.
//!
//! **Problem.** Over node values `y` of a [`CornerGrid`],
//!
//! ```text
//! min Σ_cells w ((p − P)² + (q − Q)² + h (a − b − c + d)²/4) + Σ_nodes m (y − y₀)²
//!     + Σ_k w_k (b_kᵀ y − v_k)²
//! ```
//!
//! with cell weights `w` (0 to 1; small where the surface breaks), hourglass stabilisation `h`,
//! nodal masses `m` (a depth prior) and point constraints at sub-pixel positions, `b_k` their
//! bilinear weights. The normal equations are solved by conjugate gradients, preconditioned by one
//! cycle of `multigrid`, where the point constraints appear as lumped masses.
//!
//! Source: the z-step of Quéau et al., ICCV 2017 (`queau2017`), eq. 12, on corner nodes; `f32` for
//! fields and `f64` for inner products.

use crate::corner_grid::CornerGrid;
use crate::corner_operator::{Operator, for_rows};
use crate::multigrid::Multigrid;
use rayon::prelude::*;

/// Mass that holds every node lightly at its value before a solve. Nothing else keeps the constant
/// of a surface without constraints (one per island of the mask) from gathering rounding errors;
/// waves shorter than some 2π/√mass pixels do not feel it.
const PROXIMITY: f32 = 1e-6;

/// A value wanted at a sub-pixel position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointConstraint {
    /// Cell position in padded rasters, see [`CornerGrid::locate`].
    pub cell: usize,
    /// Bilinear weights of the corners `a b c d`.
    pub corners: [f32; 4],
    /// Weight of the squared difference.
    pub weight: f32,
    /// Wanted value.
    pub value: f32,
}

impl PointConstraint {
    /// Its four nodes with their bilinear weights.
    fn terms(&self, stride: usize) -> impl Iterator<Item = (usize, f32)> {
        let nodes = [0, 1, stride, stride + 1].map(|offset| self.cell + offset);
        nodes.into_iter().zip(self.corners)
    }

    /// Value of a field at the constraint's position.
    pub fn interpolate(&self, stride: usize, field: &[f32]) -> f32 {
        self.terms(stride).map(|(i, b)| b * field[i]).sum()
    }
}

/// Outcome of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CgInfo {
    /// Iterations made.
    pub num_iterations: usize,
    /// Norm of the residual over that at the start.
    pub relative_residual: f64,
}

/// The system with its preconditioner and buffers.
#[derive(Clone, Debug)]
pub struct CornerPoisson {
    operator: Operator,
    // Masses without the lumped constraints.
    mass: Vec<f32>,
    constraints: Vec<PointConstraint>,
    multigrid: Multigrid,
    buffers: Buffers,
}

/// Arrays of an iteration, kept from solve to solve.
#[derive(Clone, Debug, Default)]
struct Buffers {
    r: Vec<f32>,
    direction: Vec<f32>,
    /// The matrix times the direction.
    image: Vec<f32>,
    preconditioned: Vec<f32>,
}

impl CornerPoisson {
    /// A system with the given weight of every mask cell (compact order) and hourglass coefficient.
    pub fn new(grid: &CornerGrid, cell_weights: &[f32], hourglass: f32) -> Self {
        let len = grid.padded_len();
        let operator = Operator::new(
            grid.stride,
            grid.scatter(cell_weights),
            vec![PROXIMITY; len],
            hourglass,
        );
        let zeros = vec![0.0; len];
        Self {
            multigrid: Multigrid::new(&operator),
            operator,
            mass: zeros.clone(),
            constraints: Vec::new(),
            buffers: Buffers {
                r: zeros.clone(),
                direction: zeros.clone(),
                image: zeros.clone(),
                preconditioned: zeros,
            },
        }
    }

    /// Replaces masses (padded raster) and point constraints.
    pub fn set_constraints(&mut self, mass: Option<&[f32]>, constraints: &[PointConstraint]) {
        match mass {
            Some(mass) => self.mass.copy_from_slice(mass),
            None => self.mass.fill(0.0),
        }
        self.constraints.clear();
        self.constraints.extend_from_slice(constraints);
        // diag(b) ⪰ b bᵀ because the bilinear weights sum to one: the lumped preconditioner is
        // safe.
        for (total, mass) in self.operator.mass.iter_mut().zip(&self.mass) {
            *total = mass + PROXIMITY;
        }
        for constraint in &self.constraints {
            for (node, b) in constraint.terms(self.operator.stride) {
                self.operator.mass[node] += constraint.weight * b;
            }
        }
        self.operator.update_diagonal();
        self.multigrid.update_mass(&self.operator);
    }

    /// Adds the constraints' part `Σ w_k b_k v_k` of the right-hand side.
    pub fn add_constraints_to(&self, rhs: &mut [f32]) {
        for constraint in &self.constraints {
            for (node, b) in constraint.terms(self.operator.stride) {
                rhs[node] += constraint.weight * b * constraint.value;
            }
        }
    }

    /// `out = A x` with the exact, not the lumped, constraints, and the proximity mass.
    pub fn apply(&self, x: &[f32], out: &mut [f32]) {
        self.operator.apply(x, out);
        let stride = self.operator.stride;
        for constraint in &self.constraints {
            let value = constraint.interpolate(stride, x);
            for (node, b) in constraint.terms(stride) {
                out[node] += constraint.weight * b * (value - x[node]);
            }
        }
    }

    /// Improves `x` towards `A x = rhs` until the residual has shrunk by `tolerance` or
    /// `max_num_iterations` are made.
    pub fn solve(
        &mut self,
        rhs: &[f32],
        x: &mut [f32],
        tolerance: f64,
        max_num_iterations: usize,
    ) -> CgInfo {
        self.solve_with(rhs, x, tolerance, max_num_iterations, |_, _| {})
    }

    /// The same for `A + B`, where `add_product(x, out)` adds `B x` to `out`; `A + B` must be
    /// positive definite, and `A` alone is the preconditioner.
    pub fn solve_with(
        &mut self,
        rhs: &[f32],
        x: &mut [f32],
        tolerance: f64,
        max_num_iterations: usize,
        mut add_product: impl FnMut(&[f32], &mut [f32]),
    ) -> CgInfo {
        let stride = self.operator.stride;
        let mut buffers = std::mem::take(&mut self.buffers);
        let Buffers {
            r,
            direction,
            image,
            preconditioned,
        } = &mut buffers;
        self.apply(x, image);
        add_product(x, image);
        for_rows(stride, r, |y, r| {
            let range = y * stride..(y + 1) * stride;
            for ((r, b), a) in r.iter_mut().zip(&rhs[range.clone()]).zip(&image[range]) {
                *r = b - a;
            }
            // Nearness to the present x: its pull is zero at the start.
            for (r, x) in r.iter_mut().zip(&x[y * stride..]) {
                *r += PROXIMITY * x;
            }
        });
        let start = dot(stride, r, r);
        let mut squared = start;
        let (mut best, mut since_best) = (start, 0);
        let mut rho_before = 0.0;
        let mut num_iterations = 0;
        while num_iterations < max_num_iterations && squared > tolerance * tolerance * start {
            self.multigrid.cycle(&self.operator, r, preconditioned);
            let rho = dot(stride, r, preconditioned);
            if rho.is_nan() || rho <= 0.0 {
                break;
            }
            if num_iterations == 0 {
                direction.copy_from_slice(preconditioned);
            } else {
                let along = (rho / rho_before) as f32;
                for_rows(stride, direction, |y, d| {
                    for (d, z) in d.iter_mut().zip(&preconditioned[y * stride..]) {
                        *d = z + along * *d;
                    }
                });
            }
            self.apply(direction, image);
            add_product(direction, image);
            let curvature = dot(stride, direction, image);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let step = (rho / curvature) as f32;
            add_scaled(stride, step, direction, x);
            add_scaled(stride, -step, image, r);
            squared = dot(stride, r, r);
            rho_before = rho;
            num_iterations += 1;
            // Residuals of conjugate gradients may rise for a step or two; not falling for longer
            // means that the rounding of f32 is reached.
            if squared < best {
                best = squared;
                since_best = 0;
            } else {
                since_best += 1;
                if since_best > 3 {
                    break;
                }
            }
        }
        self.buffers = buffers;
        CgInfo {
            num_iterations,
            relative_residual: if start > 0.0 {
                (squared / start).sqrt()
            } else {
                0.0
            },
        }
    }
}

fn add_scaled(stride: usize, scale: f32, from: &[f32], to: &mut [f32]) {
    for_rows(stride, to, |y, to| {
        for (to, from) in to.iter_mut().zip(&from[y * stride..]) {
            *to += scale * from;
        }
    });
}

/// Inner product: rows in `f32` lanes, their sums in `f64` in fixed order.
fn dot(stride: usize, a: &[f32], b: &[f32]) -> f64 {
    let row = |(a, b): (&[f32], &[f32])| {
        let mut lanes = [0.0_f32; 16];
        let (a_chunks, b_chunks) = (a.chunks_exact(16), b.chunks_exact(16));
        let rest: f32 = a_chunks
            .remainder()
            .iter()
            .zip(b_chunks.remainder())
            .map(|(a, b)| a * b)
            .sum();
        for (a, b) in a_chunks.zip(b_chunks) {
            for lane in 0..16 {
                lanes[lane] += a[lane] * b[lane];
            }
        }
        lanes.iter().map(|&lane| f64::from(lane)).sum::<f64>() + f64::from(rest)
    };
    if a.len() < 1 << 16 {
        return a.chunks(stride).zip(b.chunks(stride)).map(row).sum();
    }
    let rows: Vec<f64> = a
        .par_chunks(stride)
        .zip(b.par_chunks(stride))
        .with_min_len((1 << 15) / stride + 1)
        .map(row)
        .collect();
    rows.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Mask;

    /// A disc with a hole and a separate island.
    fn mask(size: usize) -> Mask {
        let centre = size as f64 / 2.0;
        Mask::from_fn(size, size, |x, y| {
            let r = (x as f64 - centre).hypot(y as f64 - 0.9 * centre) / size as f64;
            (r < 0.38 && r > 0.06) || (x < size / 10 && y > size * 9 / 10)
        })
    }

    fn surface(x: f64, y: f64, size: f64) -> f64 {
        size * (0.3 * (3.0 * x / size).sin() * (2.0 * y / size).cos() + 0.1 * x / size)
    }

    #[test]
    fn integrates_exact_slopes_of_a_smooth_surface_in_few_iterations() {
        let size = 200;
        let grid = CornerGrid::new(&mask(size)).expect("not empty");
        let mut truth = vec![0.0; grid.padded_len()];
        for y in 0..=grid.height {
            for x in 0..=grid.width {
                truth[grid.index(x, y)] = surface(x as f64, y as f64, size as f64) as f32;
            }
        }
        let n = grid.num_cells;
        let (mut p, mut q) = (vec![0.0; n], vec![0.0; n]);
        grid.gradient(&truth, &mut p, &mut q);
        for hourglass in [0.3, 0.01] {
            let mut system = CornerPoisson::new(&grid, &vec![1.0; n], hourglass);
            let mut rhs = vec![0.0; grid.padded_len()];
            grid.add_divergence(1.0, &p, &q, &mut rhs);
            let mut x = vec![0.0; grid.padded_len()];
            let info = system.solve(&rhs, &mut x, 1e-3, 60);
            let (mut ps, mut qs) = (vec![0.0; n], vec![0.0; n]);
            grid.gradient(&x, &mut ps, &mut qs);
            let worst = (0..n)
                .map(|k| (ps[k] - p[k]).abs().max((qs[k] - q[k]).abs()))
                .fold(0.0, f32::max);
            println!("h {hourglass}: {info:?}, worst slope {worst}");
            assert!(info.relative_residual <= 1e-3, "h {hourglass}: {info:?}");
            assert!(info.num_iterations <= 10, "h {hourglass}: {info:?}");
            assert!(worst < 1e-2, "h {hourglass}: {worst}");
        }
    }

    #[test]
    fn agrees_with_a_dense_factorisation() {
        let mask = Mask::from_fn(17, 14, |x, y| (x, y) != (5, 6) && x + y > 4);
        let grid = CornerGrid::new(&mask).expect("not empty");
        let weights: Vec<f32> = (0..grid.num_cells)
            .map(|k| 0.2 + 0.1 * (k % 9) as f32)
            .collect();
        let mut system = CornerPoisson::new(&grid, &weights, 0.05);
        let mass: Vec<f32> = (0..grid.padded_len())
            .map(|i| 0.01 * (i % 3) as f32)
            .collect();
        let (cell, corners) = grid.locate(9.3, 7.8).expect("inside");
        let constraint = PointConstraint {
            cell,
            corners,
            weight: 2.0,
            value: 1.0,
        };
        system.set_constraints(Some(&mass), &[constraint]);
        let mut active = Vec::new();
        let mut unit = vec![0.0; grid.padded_len()];
        for span in grid.spans() {
            for row in [span.cell, span.cell + grid.stride] {
                active.extend(row..=row + span.len);
            }
        }
        active.sort_unstable();
        active.dedup();
        let n = active.len();
        let mut matrix = nalgebra::DMatrix::<f64>::zeros(n, n);
        let mut column = vec![0.0; grid.padded_len()];
        for (j, &node) in active.iter().enumerate() {
            unit[node] = 1.0;
            system.apply(&unit, &mut column);
            unit[node] = 0.0;
            for (i, &row) in active.iter().enumerate() {
                matrix[(i, j)] = f64::from(column[row]);
            }
        }
        let asymmetry = (&matrix - matrix.transpose()).amax();
        assert!(asymmetry < 1e-6, "{asymmetry}");
        let mut rhs = vec![0.0; grid.padded_len()];
        for (k, &node) in active.iter().enumerate() {
            rhs[node] = ((k * 31) % 17) as f32 / 17.0 - 0.5;
        }
        system.add_constraints_to(&mut rhs);
        let b = nalgebra::DVector::from_iterator(n, active.iter().map(|&i| f64::from(rhs[i])));
        let exact = matrix.cholesky().expect("positive definite").solve(&b);
        let mut x = vec![0.0; grid.padded_len()];
        let info = system.solve(&rhs, &mut x, 1e-6, 100);
        let worst = active
            .iter()
            .zip(exact.iter())
            .map(|(&i, e)| (f64::from(x[i]) - e).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1e-3 * exact.amax(), "{worst} {info:?}");
    }

    #[test]
    fn point_constraints_are_met_and_hold_the_offset() {
        let grid = CornerGrid::new(&Mask::filled(60, 40, true)).expect("not empty");
        let n = grid.num_cells;
        let mut system = CornerPoisson::new(&grid, &vec![1.0; n], 0.1);
        let constraints: Vec<PointConstraint> = [(7.3, 5.2, 4.0), (50.1, 33.9, 4.0)]
            .iter()
            .filter_map(|&(x, y, value)| {
                let (cell, corners) = grid.locate(x, y)?;
                Some(PointConstraint {
                    cell,
                    corners,
                    weight: 10.0,
                    value,
                })
            })
            .collect();
        system.set_constraints(None, &constraints);
        let mut rhs = vec![0.0; grid.padded_len()];
        system.add_constraints_to(&mut rhs);
        let mut x = vec![0.0; grid.padded_len()];
        let info = system.solve(&rhs, &mut x, 1e-6, 100);
        let mut values = vec![0.0; n];
        grid.values(&x, &mut values);
        let worst = values.iter().map(|v| (v - 4.0).abs()).fold(0.0, f32::max);
        // The proximity mass holds the start back by its share of the constraints' weight.
        assert!(worst < 1e-2, "{worst} {info:?}");
    }
}
