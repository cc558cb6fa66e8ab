//! Brings the views' depth maps onto each other where they are off by a smooth offset.
//!
//! Every view gets a correction of its log depth, `z' = z e^{u(x, y)}`, bilinear between nodes of
//! a coarse grid ([`Corrections`]), so that it can bend but not follow detail. All are found together:
//!
//! `min Σ_pairs ρ((d + s_i u_i + s_j u_j) / (σ a)) + Σ_nodes (f u / τ)² + Σ_edges (2 f Δu / τ)²`
//!
//! with the distance `d` of a [`Pair`], its slopes `s`, footprint `a`, the robust spread σ of the
//! distances in footprints, ρ Cauchy's loss, and τ (`reconcile_sigma_px`) the offsets that a map
//! may have, in footprints; `f u` is an offset in footprints. The second term is also what fixes
//! the common part of all corrections, which no pair sees: their mean stays zero.
//!
//! Steps: pairs on a grid; weights; conjugate gradients on the normal equations; correct; again.

use crate::correction::{Corrections, Grid};
use crate::error::FusionError;
use crate::options::FusionOptions;
use crate::pairs::{Pair, find_pairs, layering};
use crate::report::Layering;
use crate::view::View;
use crate::views::Stock;
use rilievo_numerics::conjugate_gradients::{Stop, conjugate_gradients};
use rilievo_numerics::robust::{RobustLoss, SIGMA_FROM_MAD, median};
use rilievo_scene::{Event, Flow, Observer, StageId};

/// Iterations of pairing and solving: the second sees what the first made visible, later ones move
/// nothing.
const MAX_NUM_ITERATIONS: usize = 4;
/// Re-weightings in an iteration.
const NUM_WEIGHTINGS: usize = 3;
/// An iteration that lowers the smooth distance by less than this share is the last.
const MIN_GAIN: f64 = 0.05;
/// Spread of the distances, in footprints, below which nothing is gained by trusting them more.
const MIN_SPREAD_PX: f64 = 0.02;
/// Where conjugate gradients stop: well below the noise of the distances.
const CG_STOP: Stop = Stop {
    tolerance: 1e-6,
    max_num_iterations: 300,
};
/// Pairs are drawn about this densely: enough that a node sees dozens, few enough to be quick.
const MAX_NUM_PAIRS: usize = 400_000;

/// Outcome of [`reconcile`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Reconciliation {
    pub before: Layering,
    pub after: Layering,
    pub num_iterations: usize,
    /// What brings the views onto each other, where anything does.
    pub corrections: Option<Corrections>,
}

/// Distance of the sampled pixels that keeps the number of pairs in bounds.
pub(crate) fn stride_for(views: &[View], num_neighbours: usize) -> usize {
    let pixels: usize = views.iter().map(|v| v.num_depths).sum();
    let wanted = (pixels * num_neighbours.max(1)) as f64 / MAX_NUM_PAIRS as f64;
    (wanted.sqrt().ceil() as usize).max(2)
}

/// Finds the corrections of all views, or only measures where `options` switch them off.
pub(crate) fn reconcile(
    stock: &Stock,
    neighbours: &[Vec<usize>],
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Reconciliation, FusionError> {
    let most = neighbours.iter().map(Vec::len).max().unwrap_or(0);
    let stride = stride_for(&stock.views, most);
    let mut pairs = find_pairs(stock, None, neighbours, stride, options)?;
    let before = layering(&pairs, options);
    let mut result = Reconciliation {
        before,
        after: before,
        num_iterations: 0,
        corrections: None,
    };
    if !options.reconcile || pairs.is_empty() {
        return Ok(result);
    }
    let mut corrections = Corrections::none(&stock.views, options.reconcile_grid_px);
    let num_nodes = corrections.values.len();
    for iteration in 0..MAX_NUM_ITERATIONS {
        let total = &corrections.values;
        let step = solve(&pairs, &corrections.grids, total, options, num_nodes);
        let tried = Corrections {
            values: total.iter().zip(&step).map(|(sum, u)| sum + u).collect(),
            ..corrections.clone()
        };
        let moved = find_pairs(stock, Some(&tried), neighbours, stride, options)?;
        let after = layering(&moved, options);
        let gain = 1.0 - after.smooth_rms / result.after.smooth_rms;
        // An iteration must never push the views apart.
        if gain.is_nan() || gain < 0.0 {
            break;
        }
        corrections = tried;
        pairs = moved;
        result.after = after;
        result.num_iterations = iteration + 1;
        let flow = observer.event(Event::Iteration {
            stage: StageId::Fusion,
            iteration,
            max_num_iterations: MAX_NUM_ITERATIONS,
            energy: after.smooth_rms,
            primal_residual: None,
            dual_residual: None,
            beta: None,
        });
        if flow == Flow::Stop {
            return Err(FusionError::Interrupted);
        }
        if gain < MIN_GAIN {
            break;
        }
    }
    result.corrections = (result.num_iterations > 0).then_some(corrections);
    Ok(result)
}

/// A residual that is linear in eight unknowns.
struct Row {
    nodes: [u32; 8],
    slopes: [f64; 8],
    value: f64,
}

/// Regularisation: `Σ weight² (Σ ± u)²` over nodes and edges.
struct Regularizer {
    nodes: Vec<(u32, f64)>,
    edges: Vec<(u32, u32, f64)>,
}

fn regularizer(grids: &[Grid], sigma_px: f64) -> Regularizer {
    let mut terms = Regularizer {
        nodes: Vec::new(),
        edges: Vec::new(),
    };
    for grid in grids {
        let weight = (grid.focal_px / sigma_px).powi(2);
        for j in 0..grid.rows {
            for i in 0..grid.columns {
                let here = (grid.start + j * grid.columns + i) as u32;
                terms.nodes.push((here, weight));
                if i + 1 < grid.columns {
                    terms.edges.push((here, here + 1, 4.0 * weight));
                }
                if j + 1 < grid.rows {
                    terms
                        .edges
                        .push((here, here + grid.columns as u32, 4.0 * weight));
                }
            }
        }
    }
    terms
}

/// The step from the corrections `total` to the minimum.
fn solve(
    pairs: &[Pair],
    grids: &[Grid],
    total: &[f64],
    options: &FusionOptions,
    num_nodes: usize,
) -> Vec<f64> {
    let rows: Vec<Row> = pairs
        .iter()
        .map(|pair| {
            let mut row = Row {
                nodes: [0; 8],
                slopes: [0.0; 8],
                value: pair.distance / pair.footprint,
            };
            for side in 0..2 {
                let grid = &grids[usize::from(pair.views[side])];
                let [x, y] = pair.pixels[side].map(f64::from);
                let nodes = grid.nodes(x, y, options.reconcile_grid_px);
                for (k, (node, weight)) in nodes.into_iter().enumerate() {
                    row.nodes[4 * side + k] = node as u32;
                    row.slopes[4 * side + k] = pair.slopes[side] * weight / pair.footprint;
                }
            }
            row
        })
        .collect();
    let terms = regularizer(grids, options.reconcile_sigma_px);
    let mut step = vec![0.0; num_nodes];
    for _ in 0..NUM_WEIGHTINGS {
        let residuals: Vec<f64> = rows.iter().map(|row| row.value + dot(row, &step)).collect();
        let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
        let spread = (SIGMA_FROM_MAD * median(&mut sizes).unwrap_or(0.0)).max(MIN_SPREAD_PX);
        // Cauchy's loss reaches 95 % efficiency on normal noise at 2.4 standard deviations.
        let loss = RobustLoss::Cauchy(2.4 * spread);
        let weights: Vec<f64> = residuals
            .iter()
            .map(|&r| loss.weight(r) / (spread * spread))
            .collect();
        step = weighted_step(&rows, &weights, &terms, total, step);
    }
    step
}

fn dot(row: &Row, u: &[f64]) -> f64 {
    row.nodes
        .iter()
        .zip(&row.slopes)
        .map(|(&node, slope)| slope * u[node as usize])
        .sum()
}

/// `out = (JᵀWJ + regulariser) u`.
fn multiply(rows: &[Row], weights: &[f64], terms: &Regularizer, u: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    for (row, weight) in rows.iter().zip(weights) {
        let value = weight * dot(row, u);
        for (&node, slope) in row.nodes.iter().zip(&row.slopes) {
            out[node as usize] += slope * value;
        }
    }
    add_regularizer(terms, u, out, 1.0);
}

fn add_regularizer(terms: &Regularizer, u: &[f64], out: &mut [f64], sign: f64) {
    for &(node, weight) in &terms.nodes {
        out[node as usize] += sign * weight * u[node as usize];
    }
    for &(a, b, weight) in &terms.edges {
        let difference = sign * weight * (u[a as usize] - u[b as usize]);
        out[a as usize] += difference;
        out[b as usize] -= difference;
    }
}

/// The step that minimises the weighted squares, by conjugate gradients from `start` with the diagonal as
/// preconditioner.
fn weighted_step(
    rows: &[Row],
    weights: &[f64],
    terms: &Regularizer,
    total: &[f64],
    start: Vec<f64>,
) -> Vec<f64> {
    let num = start.len();
    let mut diagonal = vec![0.0; num];
    let mut right = vec![0.0; num];
    for (row, weight) in rows.iter().zip(weights) {
        for (&node, slope) in row.nodes.iter().zip(&row.slopes) {
            diagonal[node as usize] += weight * slope * slope;
            right[node as usize] -= weight * slope * row.value;
        }
    }
    for &(node, weight) in &terms.nodes {
        diagonal[node as usize] += weight;
    }
    for &(a, b, weight) in &terms.edges {
        diagonal[a as usize] += weight;
        diagonal[b as usize] += weight;
    }
    // The regulariser holds the whole correction, not this step alone.
    add_regularizer(terms, total, &mut right, -1.0);
    let mut step = start;
    let precondition = |r: &[f64], out: &mut [f64]| {
        for ((out, r), d) in out.iter_mut().zip(r).zip(&diagonal) {
            *out = r / d;
        }
    };
    // Where rounding ends the iteration early, what is reached is the step.
    let _ = conjugate_gradients(
        &right,
        &mut step,
        |u, out| multiply(rows, weights, terms, u, out),
        precondition,
        CG_STOP,
    );
    step
}
