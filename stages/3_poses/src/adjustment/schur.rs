//! Normal equations of a bundle and their solution by the Schur complement of the points.
//!
//! ```text
//! [ U   W ] [δ_r]     [g_r]     U  poses and cameras, n × n     δ_p = −V⁻¹ (g_p + Wᵀ δ_r)
//! [ Wᵀ  V ] [δ_p] = − [g_p]     V  points, 3 × 3 blocks         (U − W V⁻¹ Wᵀ) δ_r = −g_r + W V⁻¹ g_p
//! ```
//! (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6.1.) With
//! `V = L Lᵀ` and `T = W L⁻ᵀ` of one point, its share of the complement is `T Tᵀ`, touching only
//! the columns of the views that see it. Damping multiplies the diagonals of `U` and `V` by
//! `1 + λ`. The reduced matrix has entries where views share points ([`layout`](super::layout)) and is
//! factored dense or sparse ([`factor`](super::factor)).

use super::bundle::{Bundle, PRIOR_LOSS};
use super::factor::Method;
use super::layout::{Layout, Pattern};
use crate::projection::{NUM_INTRINSICS, project_with_jacobian};
use nalgebra::{Matrix3, Matrix6, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::Intrinsics;

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
pub(crate) struct System {
    /// Lower triangle of `U`, on the pattern of the complement.
    u: Vec<f64>,
    gradient: Vec<f64>,
    chunks: Vec<Chunk>,
}

/// A step of all parameters.
pub(crate) struct Step {
    /// Poses and cameras, by column.
    pub reduced: Vec<f64>,
    pub points: Vec<Vector3<f64>>,
    /// Decrease of the cost that the quadratic model predicts.
    pub predicted_decrease: f64,
}

impl Step {
    pub fn norm(&self) -> f64 {
        let reduced: f64 = self.reduced.iter().map(|v| v * v).sum();
        let points: f64 = self.points.iter().map(Vector3::norm_squared).sum();
        (reduced + points).sqrt()
    }
}

/// Covariances in a fixed gauge.
pub(crate) struct Covariances {
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

impl System {
    /// Linearises a bundle with the weights of the loss at its state.
    pub fn build(bundle: &Bundle, layout: &Layout, loss: RobustLoss) -> Self {
        let pattern = &layout.pattern;
        let cameras = bundle.intrinsics();
        let parts: Vec<(Chunk, Vec<f64>, Vec<f64>)> = bundle
            .point_chunks()
            .into_par_iter()
            .map(|range| build_chunk(bundle, layout, &cameras, loss, range))
            .collect();
        let mut u = vec![0.0; pattern.len()];
        let mut gradient = vec![0.0; pattern.num_columns()];
        let mut chunks = Vec::with_capacity(parts.len());
        for (chunk, part, part_gradient) in parts {
            add(&mut u, &part);
            add(&mut gradient, &part_gradient);
            chunks.push(chunk);
        }
        for (camera, columns) in bundle.cameras.iter().zip(&layout.cameras) {
            for (k, deviation, sigma) in camera.priors() {
                if let Some(c) = columns[k] {
                    let precision = PRIOR_LOSS.weight(deviation / sigma) / (sigma * sigma);
                    u[pattern.column_starts[c]] += precision;
                    gradient[c] += precision * deviation;
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
    pub fn reduced(&self, pattern: &Pattern, lambda: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let n = self.gradient.len();
        let parts: Option<Vec<(Vec<f64>, Vec<f64>)>> = self
            .chunks
            .par_iter()
            .map(|chunk| {
                let mut s = vec![0.0; pattern.len()];
                let mut right = vec![0.0; n];
                // By coordinate, so that runs are sums of whole slices.
                let mut t: [Vec<f64>; 3] = Default::default();
                for point in &chunk.points {
                    let l = damped(&point.v, lambda).cholesky()?.l();
                    let rows = &chunk.rows[point.rows.clone()];
                    let y = l.solve_lower_triangular(&point.gradient)?;
                    t.iter_mut().for_each(Vec::clear);
                    for (column, w) in rows {
                        let solved = l.solve_lower_triangular(w)?;
                        right[*column] += solved.dot(&y);
                        for (t, value) in t.iter_mut().zip(solved.iter()) {
                            t.push(*value);
                        }
                    }
                    let [x, y, z] = &t;
                    pattern.for_runs(rows, |j, run, at| {
                        let (a, b, c) = (x[j], y[j], z[j]);
                        let entries = s[at..at + run.len()].iter_mut();
                        let others = x[run.clone()].iter().zip(&y[run.clone()]).zip(&z[run]);
                        for (entry, ((x, y), z)) in entries.zip(others) {
                            *entry -= x * a + y * b + z * c;
                        }
                    });
                }
                Some((s, right))
            })
            .collect();
        let mut s = self.u.clone();
        let mut right: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        for (part, part_right) in parts? {
            add(&mut s, &part);
            add(&mut right, &part_right);
        }
        for &diagonal in &pattern.column_starts[..n] {
            s[diagonal] += lambda * self.u[diagonal];
        }
        Some((s, right))
    }

    /// The damped step; `None` when the system is singular.
    pub fn solve(&self, method: &Method<'_>, lambda: f64) -> Option<Step> {
        let (s, mut reduced) = self.reduced(method.pattern(), lambda)?;
        method.solve(&s, &mut reduced)?;
        let mut points = Vec::new();
        // −gᵀδ − ½ δᵀHδ with H δ = −g − λ D δ gives ½ (λ δᵀDδ − gᵀδ).
        let mut decrease: f64 = reduced
            .iter()
            .zip(&method.pattern().column_starts)
            .zip(&self.gradient)
            .map(|((d, diagonal), g)| 0.5 * (lambda * self.u[*diagonal] * d * d - g * d))
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
    pub fn covariances(&self, layout: &Layout, method: &Method<'_>) -> Option<Covariances> {
        let pattern = &layout.pattern;
        let (s, _) = self.reduced(pattern, 0.0)?;
        let inverse = method.inverse(&s)?;
        let entry = |a: usize, b: usize| Some(inverse[pattern.place(a.max(b), a.min(b))?]);
        let poses = layout
            .views
            .iter()
            .map(|columns| {
                Matrix6::from_fn(|i, j| {
                    let both = columns[i].zip(columns[j]);
                    both.and_then(|(a, b)| entry(a, b)).unwrap_or(0.0)
                })
            })
            .collect();
        let mut points = Vec::new();
        for chunk in &self.chunks {
            for point in &chunk.points {
                let v_inverse = point.v.try_inverse()?;
                let rows = &chunk.rows[point.rows.clone()];
                let mut inner = Matrix3::zeros();
                pattern.for_runs(rows, |j, run, start| {
                    for (i, value) in run.clone().zip(&inverse[start..start + run.len()]) {
                        let share = rows[i].1 * rows[j].1.transpose() * *value;
                        inner += share;
                        if i != j {
                            inner += share.transpose();
                        }
                    }
                });
                points.push(v_inverse + v_inverse * inner * v_inverse);
            }
        }
        Some(Covariances { poses, points })
    }
}

/// Adds one list of numbers to another.
fn add(sum: &mut [f64], part: &[f64]) {
    for (sum, value) in sum.iter_mut().zip(part) {
        *sum += value;
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
) -> (Chunk, Vec<f64>, Vec<f64>) {
    let pattern = &layout.pattern;
    let mut u = vec![0.0; pattern.len()];
    let mut gradient = vec![0.0; pattern.num_columns()];
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
        for o in bundle.seen(p) {
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
            columns.sort_unstable_by_key(|(column, _)| *column);
            for (a, (column, d)) in columns.iter().enumerate() {
                gradient[*column] += weight * (d[0] * residual.x + d[1] * residual.y);
                let w = (j.by_point.row(0) * d[0] + j.by_point.row(1) * d[1]).transpose() * weight;
                add_row(&mut chunk.rows, start, *column, w);
                // Columns ascend, so this fills the lower triangle.
                for (row, e) in &columns[a..] {
                    if let Some(at) = pattern.place(*row, *column) {
                        u[at] += weight * (d[0] * e[0] + d[1] * e[1]);
                    }
                }
            }
        }
        block.rows = start..chunk.rows.len();
        chunk.points.push(block);
    }
    (chunk, u, gradient)
}
