//! Cells of normals: a sphere compared with itself, without a model of the light.
//!
//! A matte sphere under a resting light has one brightness per surface point, whatever the
//! viewpoint; under a light fixed to the camera, one per normal in the camera's frame. Brightness
//! is therefore averaged over cells of normals (about 8°), view by view, and the logarithms
//! compared:
//! ```text
//! ln I(v, cell) = ln g_v + e(cell) + noise
//! ```
//! with a gain per view. Shadow and bounce light, fixed to the surface, are part of `e(cell)` and
//! do not disturb. The robust two-way fit gives the gains ([`crate::gains`]), and its scatter under
//! both kinds of cells decides the kind of light ([`crate::kind`]).

use nalgebra::Vector3;
use rilievo_numerics::robust::{SIGMA_FROM_MAD, median};
use rilievo_photometry::samples::{NUM_CELLS, cell_of};

/// Fewest pixels that make a cell's mean.
const MIN_PIXELS: usize = 4;

/// One view's mean logarithm of brightness in a cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CellMean {
    /// View (position among the views given).
    pub view: usize,
    /// Cell.
    pub cell: usize,
    /// Mean of `ln I`, or of `ln (I / prediction)`.
    pub value: f64,
}

/// Cell means of one sphere in one view: `(normal, positive value)` pairs. The sphere's cells begin
/// at `first_cell`.
pub(crate) fn cell_means(
    view: usize,
    first_cell: usize,
    samples: impl Iterator<Item = (Vector3<f64>, f64)>,
) -> Vec<CellMean> {
    let mut by_cell: Vec<Vec<f64>> = vec![Vec::new(); NUM_CELLS];
    for (normal, value) in samples {
        if value > 0.0 {
            by_cell[cell_of(&normal)].push(value.ln());
        }
    }
    by_cell
        .iter_mut()
        .enumerate()
        .filter(|(_, values)| values.len() >= MIN_PIXELS)
        .filter_map(|(cell, values)| {
            let value = median(values)?;
            Some(CellMean {
                view,
                cell: first_cell + cell,
                value,
            })
        })
        .collect()
}

/// Result of the two-way fit.
#[derive(Clone, Debug)]
pub(crate) struct TwoWay {
    /// Logarithm of each view's gain, with mean 0 over the views that are connected.
    pub ln_gain: Vec<f64>,
    /// Its standard deviation; `None` where the view shares too few cells with the others.
    pub sigma: Vec<Option<f64>>,
    /// Robust scatter of the residuals.
    pub scatter: f64,
    /// Cells that two views or more share.
    pub num_shared: usize,
}

/// Cells that a view must share with others before its gain counts.
const MIN_SHARED: usize = 6;

/// Robust two-way fit by re-weighted alternation.
pub(crate) fn two_way(num_views: usize, means: &[CellMean]) -> TwoWay {
    let num_cells = means.iter().map(|m| m.cell + 1).max().unwrap_or(0);
    let mut count = vec![0_usize; num_cells];
    for mean in means {
        count[mean.cell] += 1;
    }
    let shared: Vec<&CellMean> = means.iter().filter(|m| count[m.cell] >= 2).collect();
    let mut ln_gain = vec![0.0; num_views];
    let mut level = vec![0.0; num_cells];
    let mut weights = vec![1.0; shared.len()];
    let mut scatter = 0.0;
    for iteration in 0..100 {
        let mut sums = vec![(0.0, 0.0); num_cells];
        for (mean, w) in shared.iter().zip(&weights) {
            sums[mean.cell].0 += w * (mean.value - ln_gain[mean.view]);
            sums[mean.cell].1 += w;
        }
        for (value, (sum, weight)) in level.iter_mut().zip(&sums) {
            if *weight > 0.0 {
                *value = sum / weight;
            }
        }
        let mut change = 0.0_f64;
        let mut sums = vec![(0.0, 0.0); num_views];
        for (mean, w) in shared.iter().zip(&weights) {
            sums[mean.view].0 += w * (mean.value - level[mean.cell]);
            sums[mean.view].1 += w;
        }
        for (gain, (sum, weight)) in ln_gain.iter_mut().zip(&sums) {
            if *weight > 0.0 {
                change = change.max((*gain - sum / weight).abs());
                *gain = sum / weight;
            }
        }
        let residual = |mean: &CellMean| mean.value - ln_gain[mean.view] - level[mean.cell];
        let mut sizes: Vec<f64> = shared.iter().map(|m| residual(m).abs()).collect();
        scatter = SIGMA_FROM_MAD * median(&mut sizes).unwrap_or(0.0);
        let scale = scatter.max(1e-6);
        for (mean, w) in shared.iter().zip(weights.iter_mut()) {
            let r = residual(mean) / (2.0 * scale);
            *w = 1.0 / (1.0 + r * r).powi(2);
        }
        if iteration > 5 && change < 1e-9 {
            break;
        }
    }
    let mut per_view = vec![0.0; num_views];
    for (mean, w) in shared.iter().zip(&weights) {
        per_view[mean.view] += w;
    }
    let sigma: Vec<Option<f64>> = per_view
        .iter()
        .map(|&n| (n >= MIN_SHARED as f64).then(|| scatter / n.sqrt()))
        .collect();
    let known: Vec<f64> = (0..num_views)
        .filter(|&v| sigma[v].is_some())
        .map(|v| ln_gain[v])
        .collect();
    let gauge = known.iter().sum::<f64>() / known.len().max(1) as f64;
    for (gain, s) in ln_gain.iter_mut().zip(&sigma) {
        *gain = if s.is_some() { *gain - gauge } else { 0.0 };
    }
    let num_shared = count.iter().filter(|&&n| n >= 2).count();
    TwoWay {
        ln_gain,
        sigma,
        scatter,
        num_shared,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_tile_the_sphere_and_gains_are_recovered() {
        let mut means = Vec::new();
        let truth = [0.1, -0.05, -0.15, 0.1];
        let mut used = std::collections::BTreeSet::new();
        for (view, gain) in truth.iter().enumerate() {
            let samples = (0..20_000).map(|i| {
                let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 20_000.0;
                let angle = f64::from(i) * 2.399_963_229_728_653;
                let r = (1.0 - z * z).sqrt();
                let n = Vector3::new(r * angle.cos(), r * angle.sin(), z);
                (n, (1.0 + 0.5 * n.x) * f64::exp(*gain))
            });
            let visible = samples.filter(|(n, _)| n.y > 0.3 * view as f64 - 0.6);
            let found = cell_means(view, 0, visible);
            used.extend(found.iter().map(|m| m.cell));
            means.extend(found);
        }
        assert!(used.len() > NUM_CELLS / 2, "{} cells", used.len());
        let fit = two_way(4, &means);
        let mean = truth.iter().sum::<f64>() / 4.0;
        for (found, gain) in fit.ln_gain.iter().zip(truth) {
            assert!(
                (found - (gain - mean)).abs() < 2e-3,
                "{found} for {}",
                gain - mean
            );
        }
    }
}
