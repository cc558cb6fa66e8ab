//! Normal equations of a bundle and their solution by the Schur complement of the points.
//!
//! ```text
//! [ U   W ] [δ_r]     [g_r]     U  poses and cameras, n × n     δ_p = −V⁻¹ (g_p + Wᵀ δ_r)
//! [ Wᵀ  V ] [δ_p] = − [g_p]     V  points, 3 × 3 blocks         (U − W V⁻¹ Wᵀ) δ_r = −g_r + W V⁻¹ g_p
//! ```
//! (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6.1.) With
//! `V = L Lᵀ` and `T = W L⁻ᵀ` of one point, its share of the complement is `T Tᵀ`, touching only
//! the columns of the views that see it. Damping multiplies the diagonals of `U` and `V` by
//! `1 + λ`. The reduced matrix is dense: below some hundred views its factorisation costs less
//! than its assembly.

use super::bundle::{Bundle, PRIOR_LOSS};
use crate::projection::{NUM_INTRINSICS, project_with_jacobian};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::{Mat, Par};
use nalgebra::{Matrix3, Matrix6, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::Intrinsics;

/// Column of each parameter in the reduced system; `None` where it is fixed.
pub struct Layout {
    /// Per view: `(ω, δ)`.
    pub views: Vec<[Option<usize>; 6]>,
    /// Per camera.
    pub cameras: Vec<[Option<usize>; NUM_INTRINSICS]>,
    num_columns: usize,
}

impl Layout {
    /// Numbers the free parameters, views first.
    pub fn new(bundle: &Bundle) -> Self {
        let mut next = 0;
        let mut number = |free: bool| {
            free.then(|| {
                next += 1;
                next - 1
            })
        };
        let views = bundle
            .views
            .iter()
            .map(|v| v.free.map(&mut number))
            .collect();
        let cameras = bundle
            .cameras
            .iter()
            .map(|c| c.prior_sigma.map(|s| number(s.is_some())))
            .collect();
        Self {
            views,
            cameras,
            num_columns: next,
        }
    }
}

/// One point's share: `V`, `g_p`, and its rows of `W`.
struct PointBlock {
    v: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// Range of its rows in the chunk.
    rows: std::ops::Range<usize>,
}

/// A range of points.
struct Chunk {
    points: Vec<PointBlock>,
    /// Rows of `W`: column in the reduced system and three entries, ascending per point.
    rows: Vec<(usize, Vector3<f64>)>,
}

/// The normal equations at one state.
pub struct System {
    u: Mat<f64>,
    gradient: Vec<f64>,
    chunks: Vec<Chunk>,
}

/// A step of all parameters.
pub struct Step {
    /// Poses and cameras, by column.
    pub reduced: Vec<f64>,
    /// Points.
    pub points: Vec<Vector3<f64>>,
    /// Decrease of the cost that the quadratic model predicts.
    pub predicted_decrease: f64,
}

impl Step {
    /// Euclidean length.
    pub fn norm(&self) -> f64 {
        let reduced: f64 = self.reduced.iter().map(|v| v * v).sum();
        let points: f64 = self.points.iter().map(Vector3::norm_squared).sum();
        (reduced + points).sqrt()
    }
}

/// Covariances in a fixed gauge.
pub struct Covariances {
    /// Per view, of `(ω, δ)`; zero for what is fixed.
    pub poses: Vec<Matrix6<f64>>,
    /// Per point.
    pub points: Vec<Matrix3<f64>>,
}

/// Adds `value` to the row of a column, keeping rows ascending.
fn add_row(
    rows: &mut Vec<(usize, Vector3<f64>)>,
    start: usize,
    column: usize,
    value: Vector3<f64>,
) {
    match rows[start..].binary_search_by_key(&column, |r| r.0) {
        Ok(at) => rows[start + at].1 += value,
        Err(at) => rows.insert(start + at, (column, value)),
    }
}

/// Cholesky factor in place; `false` when the matrix is not positive definite.
fn factorize(matrix: &mut Mat<f64>) -> bool {
    let scratch =
        factor::cholesky_in_place_scratch::<f64>(matrix.nrows(), Par::Seq, faer::Spec::default());
    let mut memory = faer::dyn_stack::MemBuffer::new(scratch);
    // One thread: the blocking of more would change the last bits.
    factor::cholesky_in_place(
        matrix.as_mut(),
        factor::LltRegularization::default(),
        Par::Seq,
        faer::dyn_stack::MemStack::new(&mut memory),
        faer::Spec::default(),
    )
    .is_ok()
}

fn solve_factored(factor: &Mat<f64>, right: &mut Mat<f64>) {
    let mut memory = faer::dyn_stack::MemBuffer::new(solve::solve_in_place_scratch::<f64>(
        factor.nrows(),
        right.ncols(),
        Par::Seq,
    ));
    solve::solve_in_place(
        factor.as_ref(),
        right.as_mut(),
        Par::Seq,
        faer::dyn_stack::MemStack::new(&mut memory),
    );
}

impl System {
    /// Linearises a bundle with the weights of the loss at its state.
    pub fn build(bundle: &Bundle, layout: &Layout, loss: RobustLoss) -> Self {
        let n = layout.num_columns;
        let cameras: Vec<Intrinsics> = bundle.cameras.iter().map(|c| c.current()).collect();
        let parts: Vec<(Chunk, Mat<f64>, Vec<f64>)> = bundle
            .point_chunks()
            .into_par_iter()
            .map(|range| build_chunk(bundle, layout, &cameras, loss, range))
            .collect();
        let mut u = Mat::<f64>::zeros(n, n);
        let mut gradient = vec![0.0; n];
        let mut chunks = Vec::with_capacity(parts.len());
        for (chunk, part, part_gradient) in parts {
            u += &part;
            for (sum, value) in gradient.iter_mut().zip(&part_gradient) {
                *sum += value;
            }
            chunks.push(chunk);
        }
        for (camera, columns) in bundle.cameras.iter().zip(&layout.cameras) {
            for ((column, sigma), deviation) in columns
                .iter()
                .zip(&camera.prior_sigma)
                .zip(&camera.deviation)
            {
                if let (Some(c), Some(sigma)) = (column, sigma) {
                    let precision = PRIOR_LOSS.weight(deviation / sigma) / (sigma * sigma);
                    u[(*c, *c)] += precision;
                    gradient[*c] += precision * deviation;
                }
            }
        }
        Self {
            u,
            gradient,
            chunks,
        }
    }

    /// Lower triangle of the damped Schur complement and its right-hand side.
    fn reduced(&self, lambda: f64) -> Option<(Mat<f64>, Vec<f64>)> {
        let n = self.gradient.len();
        let parts: Option<Vec<(Mat<f64>, Vec<f64>)>> = self
            .chunks
            .par_iter()
            .map(|chunk| {
                let mut s = Mat::<f64>::zeros(n, n);
                let mut right = vec![0.0; n];
                let mut t = Vec::new();
                for point in &chunk.points {
                    let l = damped(&point.v, lambda).cholesky()?.l();
                    let rows = &chunk.rows[point.rows.clone()];
                    let y = l.solve_lower_triangular(&point.gradient)?;
                    t.clear();
                    for (_, w) in rows {
                        t.push(l.solve_lower_triangular(w)?);
                    }
                    for (j, (column, _)) in rows.iter().enumerate() {
                        right[*column] += t[j].dot(&y);
                        let slice = s.col_mut(*column);
                        let target = slice.try_as_col_major_mut()?.as_slice_mut();
                        for (i, (row, _)) in rows.iter().enumerate().skip(j) {
                            target[*row] -= t[i].dot(&t[j]);
                        }
                    }
                }
                Some((s, right))
            })
            .collect();
        let mut s = self.u.clone();
        let mut right: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        for (part, part_right) in parts? {
            s += &part;
            for (sum, value) in right.iter_mut().zip(&part_right) {
                *sum += value;
            }
        }
        for k in 0..n {
            s[(k, k)] += lambda * self.u[(k, k)];
        }
        Some((s, right))
    }

    /// The damped step; `None` when the system is singular.
    pub fn solve(&self, lambda: f64) -> Option<Step> {
        let (mut s, right) = self.reduced(lambda)?;
        let n = right.len();
        let mut solution = Mat::from_fn(n, 1, |row, _| right[row]);
        if n > 0 {
            if !factorize(&mut s) {
                return None;
            }
            solve_factored(&s, &mut solution);
        }
        let reduced: Vec<f64> = (0..n).map(|k| solution[(k, 0)]).collect();
        if reduced.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mut points = Vec::new();
        // −gᵀδ − ½ δᵀHδ with H δ = −g − λ D δ gives ½ (λ δᵀDδ − gᵀδ).
        let mut decrease: f64 = reduced
            .iter()
            .enumerate()
            .map(|(k, d)| 0.5 * (lambda * self.u[(k, k)] * d * d - self.gradient[k] * d))
            .sum();
        for chunk in &self.chunks {
            for point in &chunk.points {
                let mut right = point.gradient;
                for (column, w) in &chunk.rows[point.rows.clone()] {
                    right += w * reduced[*column];
                }
                let delta = -damped(&point.v, lambda).cholesky()?.solve(&right);
                let damping = point.v.diagonal().component_mul(&delta).dot(&delta);
                decrease += 0.5 * (lambda * damping - point.gradient.dot(&delta));
                points.push(delta);
            }
        }
        Some(Step {
            reduced,
            points,
            predicted_decrease: decrease,
        })
    }

    /// Blocks of the inverse of the undamped normal matrix.
    pub fn covariances(&self, layout: &Layout) -> Option<Covariances> {
        let (mut s, _) = self.reduced(0.0)?;
        let n = s.nrows();
        let mut inverse = Mat::<f64>::identity(n, n);
        if n > 0 {
            if !factorize(&mut s) {
                return None;
            }
            solve_factored(&s, &mut inverse);
        }
        let poses = layout
            .views
            .iter()
            .map(|columns| {
                Matrix6::from_fn(|i, j| match (columns[i], columns[j]) {
                    (Some(a), Some(b)) => inverse[(a, b)],
                    _ => 0.0,
                })
            })
            .collect();
        let mut points = Vec::new();
        for chunk in &self.chunks {
            for point in &chunk.points {
                let v_inverse = point.v.try_inverse()?;
                let rows = &chunk.rows[point.rows.clone()];
                let mut inner = Matrix3::zeros();
                for (a, wa) in rows {
                    for (b, wb) in rows {
                        inner += wa * wb.transpose() * inverse[(*a, *b)];
                    }
                }
                points.push(v_inverse + v_inverse * inner * v_inverse);
            }
        }
        Some(Covariances { poses, points })
    }
}

fn damped(v: &Matrix3<f64>, lambda: f64) -> Matrix3<f64> {
    let mut damped = *v;
    for k in 0..3 {
        damped[(k, k)] *= 1.0 + lambda;
    }
    damped
}

fn build_chunk(
    bundle: &Bundle,
    layout: &Layout,
    cameras: &[Intrinsics],
    loss: RobustLoss,
    range: std::ops::Range<usize>,
) -> (Chunk, Mat<f64>, Vec<f64>) {
    let n = layout.num_columns;
    let mut u = Mat::<f64>::zeros(n, n);
    let mut gradient = vec![0.0; n];
    let mut chunk = Chunk {
        points: Vec::with_capacity(range.len()),
        rows: Vec::new(),
    };
    // Columns and derivatives of one observation, at most 6 + 8.
    let mut columns: Vec<(usize, [f64; 2])> = Vec::with_capacity(6 + NUM_INTRINSICS);
    for p in range {
        let start = chunk.rows.len();
        let mut block = PointBlock {
            v: Matrix3::zeros(),
            gradient: Vector3::zeros(),
            rows: start..start,
        };
        for o in &bundle.observations[bundle.offsets[p]..bundle.offsets[p + 1]] {
            let view = &bundle.views[o.view];
            let camera = &cameras[view.camera];
            let Some((seen, j)) = project_with_jacobian(camera, &view.pose, &bundle.points[p])
            else {
                continue;
            };
            let residual = seen - o.pixel;
            let weight = o.weight * loss.weight(o.weight.sqrt() * residual.norm());
            block.v += j.by_point.transpose() * j.by_point * weight;
            block.gradient += j.by_point.transpose() * residual * weight;
            columns.clear();
            for (k, column) in layout.views[o.view].iter().enumerate() {
                if let Some(c) = column {
                    columns.push((*c, [j.by_pose[(0, k)], j.by_pose[(1, k)]]));
                }
            }
            for (k, column) in layout.cameras[view.camera].iter().enumerate() {
                if let Some(c) = column {
                    columns.push((*c, [j.by_intrinsics[(0, k)], j.by_intrinsics[(1, k)]]));
                }
            }
            for (a, (column, d)) in columns.iter().enumerate() {
                gradient[*column] += weight * (d[0] * residual.x + d[1] * residual.y);
                let w = (j.by_point.row(0) * d[0] + j.by_point.row(1) * d[1]).transpose() * weight;
                add_row(&mut chunk.rows, start, *column, w);
                // Columns ascend, so this fills the lower triangle.
                for (row, e) in &columns[a..] {
                    u[(*row, *column)] += weight * (d[0] * e[0] + d[1] * e[1]);
                }
            }
        }
        block.rows = start..chunk.rows.len();
        chunk.points.push(block);
    }
    (chunk, u, gradient)
}
