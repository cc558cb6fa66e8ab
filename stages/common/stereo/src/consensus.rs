//! One surface for all views: nearness of a view's depth to the others', and their fusion.
//!
//! Views see a point at different angles; the one that faces it knows its depth best. With `c` the
//! cos² of the angle between a view's ray and its surface, a tenth of it at the mask's rim, times
//! the photo's squared sharpness (`surfaces::incidence_weights`), nearness of view i to view j
//! weighs `w_ij = min(c_j / c_i, 2)`, the fusion `c_j`: a rim follows the views that look into it,
//! and they hardly follow it. In the fusion, proposals within the truncation are averaged: the zero
//! of the weighted signed distances (Curless, Levoy, SIGGRAPH 1996) without a volume.

use crate::level::Level;
use crate::surfaces::{Proposal, Reading, Surfaces};
use rayon::prelude::*;
use rilievo_numerics::robust::log_weight;

/// Largest weight of another view's surface against a pixel's own: at a grazing angle the other
/// view would count alone, whose depth errs as well.
pub const MAX_RELATIVE_WEIGHT: f64 = 2.0;

/// Adds nearness to the sources' surfaces: residual `r / σ`, redescending beyond σ, weighed with how
/// much better or worse than the view itself a source sees the point, and with how certain the surfaces are there.
pub fn add_terms(
    surfaces: &Surfaces,
    index: usize,
    depth: &[f64],
    sigma: f64,
    reach: f64,
    out: (&mut [f64], &mut [f64]),
) {
    let (hessian, rhs) = out;
    let inverse = 1.0 / (sigma * sigma);
    hessian
        .par_iter_mut()
        .zip(rhs.par_iter_mut())
        .enumerate()
        .with_min_len(1024)
        .for_each(|(p, (h, b))| {
            let own = surfaces.weight(index, p);
            let inverse = surfaces.certainty(index, p) * inverse;
            for k in 0..surfaces.level.sources[index].len() {
                if let Some(proposal) = surfaces.propose(index, k, p, depth[p], reach) {
                    let Proposal { r, slope, weight } = proposal;
                    let relative = (weight / own).min(MAX_RELATIVE_WEIGHT);
                    let robust = log_weight(r / sigma);
                    let weight = inverse * relative * robust;
                    *h += weight * slope * slope;
                    *b -= weight * slope * r;
                }
            }
        });
}

/// Fuses all views: every pixel moves to the weighted mean of its own and its sources' surfaces
/// within `truncation` (log depth).
pub fn fuse(
    level: &Level,
    depths: &[Vec<f64>],
    truncation: f64,
    reading: Reading,
) -> Vec<Vec<f64>> {
    let surfaces = Surfaces::new(level, depths, reading);
    let views = depths.iter().enumerate();
    views
        .map(|(i, depth)| fused_view(&surfaces, i, depth, truncation))
        .collect()
}

/// [`fuse`] of view `index` alone, whose log depths are `depth`.
pub fn fused_view(surfaces: &Surfaces, index: usize, depth: &[f64], truncation: f64) -> Vec<f64> {
    depth
        .par_iter()
        .enumerate()
        .with_min_len(1024)
        .map(|(p, &zeta)| {
            let (mut sum, mut total) = (0.0, surfaces.weight(index, p));
            for k in 0..surfaces.level.sources[index].len() {
                let Some(proposal) = surfaces.propose(index, k, p, zeta, truncation) else {
                    continue;
                };
                let Proposal { r, slope, weight } = proposal;
                // A surface seen edge-on proposes nothing reliable.
                if slope < 0.2 {
                    continue;
                }
                let step = (-r / slope).clamp(-truncation, truncation);
                // Signed distances are truncated smoothly.
                let fade = 1.0 - (r / truncation).powi(2);
                sum += weight * fade * step;
                total += weight * fade;
            }
            zeta + sum / total.max(1e-9)
        })
        .collect()
}
