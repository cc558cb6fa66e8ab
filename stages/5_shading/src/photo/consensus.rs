//! One surface for all views: nearness of a view's depth to the others', and their fusion.
//!
//! Seen along the ray of pixel `x`, view j's surface is where `r(ζ) = ζ_j(x'(ζ)) − ln z_j(ζ)`
//! vanishes, `z_j` the point's depth in view j; `∂r/∂ζ = ∇ζ_j · ∂x'/∂ζ − ∂ ln z_j/∂ζ`. One Newton step
//! gives the depth that view j proposes. Proposals within the truncation are averaged with weights
//! cos² of the angle between view j's ray and its surface: the zero of the weighted signed distances
//! (Curless, Levoy, SIGGRAPH 1996) without a volume.

use super::level::{Level, LevelView};
use super::plate;
use super::sampling;
use rayon::prelude::*;
use rilievo_scene::Raster;

/// Weight of every view's own pixels: cos² of the angle of incidence, small at the mask's rim.
pub(crate) fn incidence_weights(level: &Level, depths: &[Vec<f64>]) -> Vec<Raster<f32>> {
    level
        .views
        .par_iter()
        .zip(depths)
        .map(|(view, depth)| {
            let normals = plate::normals(view, depth);
            let weights: Vec<f64> = (0..view.pixels.len())
                .map(|i| {
                    let cos = view.incidence_cosine(i, normals[i]);
                    let rim = if is_rim(view, i) { 0.1 } else { 1.0 };
                    rim * cos.clamp(0.05, 1.0).powi(2)
                })
                .collect();
            view.spread(&weights, 0.0)
        })
        .collect()
}

/// Whether the mask ends within two pixels.
pub(crate) fn is_rim(view: &LevelView, pixel: usize) -> bool {
    [
        (2, 0),
        (-2, 0),
        (0, 2),
        (0, -2),
        (1, 1),
        (-1, 1),
        (1, -1),
        (-1, -1),
    ]
    .iter()
    .any(|&(dx, dy)| view.pixels.neighbour(pixel, dx, dy).is_none())
}

/// Depth that source `k` of view `index` proposes at a pixel, when it lies within `reach`.
#[inline]
pub(crate) fn propose(
    level: &Level,
    index: usize,
    k: usize,
    pixel: usize,
    zeta: f64,
    rasters: &[Raster<f32>],
    reach: f64,
) -> Option<(f64, f64, f64, f64)> {
    let (j, warp) = &level.sources[index][k];
    let (x, y) = level.views[index].xy(pixel);
    let landing = warp.land(x, y, zeta)?;
    if !level.views[*j].has_surface_at(&rasters[*j], landing.u, landing.v) {
        return None;
    }
    let (other, gx, gy) = sampling::bilinear_with_slope(&rasters[*j], landing.u, landing.v);
    let r = landing.zeta - other;
    if r.abs() > reach {
        return None;
    }
    let slope = (landing.dzeta - gx * landing.du - gy * landing.dv).clamp(-3.0, 3.0);
    Some((r, slope, landing.u, landing.v))
}

/// Adds nearness to the sources' surfaces: residual `r / σ`, redescending beyond σ.
pub(crate) fn add_terms(
    level: &Level,
    index: usize,
    depth: &[f64],
    rasters: &[Raster<f32>],
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
            for k in 0..level.sources[index].len() {
                if let Some((r, slope, _, _)) =
                    propose(level, index, k, p, depth[p], rasters, reach)
                {
                    let ratio = (r / sigma).abs();
                    let robust = if ratio < 1.0 {
                        1.0
                    } else {
                        1.0 / (ratio * ratio)
                    };
                    *h += inverse * robust * slope * slope;
                    *b -= inverse * robust * slope * r;
                }
            }
        });
}

/// Fuses all views: every pixel moves to the weighted mean of its own and its sources' surfaces
/// within `truncation` (log depth).
pub(crate) fn fuse(level: &Level, depths: &[Vec<f64>], truncation: f64) -> Vec<Vec<f64>> {
    let rasters = super::level::depth_rasters(level, depths);
    let weights = incidence_weights(level, depths);
    (0..level.views.len())
        .map(|i| {
            let view = &level.views[i];
            (0..view.pixels.len())
                .into_par_iter()
                .with_min_len(1024)
                .map(|p| {
                    let zeta = depths[i][p];
                    let own = f64::from(
                        *weights[i].at(view.pixels.xs[p] as usize, view.pixels.ys[p] as usize),
                    );
                    let (mut sum, mut total) = (0.0, own);
                    for (k, (j, _)) in level.sources[i].iter().enumerate() {
                        let Some((r, slope, u, v)) =
                            propose(level, i, k, p, zeta, &rasters, truncation)
                        else {
                            continue;
                        };
                        // A surface seen edge-on proposes nothing reliable.
                        if slope < 0.2 {
                            continue;
                        }
                        let weight = f64::from(sampling::bilinear(&weights[*j], u, v));
                        let step = (-r / slope).clamp(-truncation, truncation);
                        // Signed distances are truncated smoothly.
                        let fade = 1.0 - (r / truncation).powi(2);
                        sum += weight * fade * step;
                        total += weight * fade;
                    }
                    zeta + sum / total.max(1e-9)
                })
                .collect()
        })
        .collect()
}
