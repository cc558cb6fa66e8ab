//! One surface for all views: nearness of a view's depth to the others', and their fusion.
//!
//! Views see a point at different angles; the one that faces it tells its depth best. With `c` the cos² of
//! the angle between a view's ray and its surface, a tenth of it at the mask's rim
//! (`surfaces::incidence_weights`), nearness of view i to view j weighs `w_ij = min(c_j / c_i, 2)`, the
//! fusion `c_j`: a rim follows the views that look into it, and they hardly follow it. In the fusion,
//! proposals within the truncation are averaged: the zero of the weighted signed distances (Curless,
//! Levoy, SIGGRAPH 1996) without a volume.

use super::level::Level;
use super::surfaces::{Proposal, Reading, Surfaces};
use rayon::prelude::*;

/// Largest weight of another view's surface against a pixel's own: at a grazing angle the ratio would
/// give all to the other view, whose depth errs as well.
const MAX_RELATIVE_WEIGHT: f64 = 2.0;

/// Adds nearness to the sources' surfaces: residual `r / σ`, redescending beyond σ, weighed with how
/// much better or worse than the view itself a source sees the point.
pub(crate) fn add_terms(
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
            for k in 0..surfaces.level.sources[index].len() {
                if let Some(proposal) = surfaces.propose(index, k, p, depth[p], reach) {
                    let Proposal { r, slope, weight } = proposal;
                    let relative = (weight / own).min(MAX_RELATIVE_WEIGHT);
                    let ratio = (r / sigma).abs();
                    let robust = if ratio < 1.0 {
                        1.0
                    } else {
                        1.0 / (ratio * ratio)
                    };
                    let weight = inverse * relative * robust;
                    *h += weight * slope * slope;
                    *b -= weight * slope * r;
                }
            }
        });
}

/// Fuses all views: every pixel moves to the weighted mean of its own and its sources' surfaces
/// within `truncation` (log depth).
pub(crate) fn fuse(
    level: &Level,
    depths: &[Vec<f64>],
    truncation: f64,
    reading: Reading,
) -> Vec<Vec<f64>> {
    let surfaces = Surfaces::new(level, depths, reading);
    (0..level.views.len())
        .map(|i| {
            (0..level.views[i].pixels.len())
                .into_par_iter()
                .with_min_len(1024)
                .map(|p| {
                    let zeta = depths[i][p];
                    let (mut sum, mut total) = (0.0, surfaces.weight(i, p));
                    for k in 0..level.sources[i].len() {
                        let Some(proposal) = surfaces.propose(i, k, p, zeta, truncation) else {
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
        })
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::photo::rendered_tests::{depths, loaded, options, photographed};
    use nalgebra::{Point2, Vector3};
    use rilievo_numerics::robust::median;
    use rilievo_synthetic::{LightModel, Subject};

    #[test]
    fn the_view_that_faces_the_surface_counts_for_more() {
        let (scene, mut render) = options(Subject::Ellipsoid, LightModel::Harmonics, (240, 180));
        render.num_views = 2;
        render.arc_deg = 60.0;
        let world = photographed(scene, &render, None);
        let scene = loaded(&world);
        let truth = depths(&world, &scene);
        let level = Level::new(scene.pyramid[0].views.clone(), &[vec![1], vec![0]]);
        let surfaces = Surfaces::new(&level, &truth, Reading::Cubic);
        let n = truth[0].len();
        let (mut hessian, mut rhs) = (vec![0.0; n], vec![0.0; n]);
        let terms = (hessian.as_mut_slice(), rhs.as_mut_slice());
        add_terms(&surfaces, 0, &truth[0], 1.0, 0.1, terms);

        let (here, other) = (&world.views[0], &world.views[1]);
        let world_from_here = here.cam_from_world.inverse();
        let corner = scene.frames[0].corner;
        let (mut bounded, mut better, mut worse) = (Vec::new(), Vec::new(), Vec::new());
        for p in 0..n {
            let Some(proposal) = surfaces.propose(0, 0, p, truth[0][p], 0.1) else {
                continue;
            };
            let pixels = &level.views[0].pixels;
            let (x, y) = (
                pixels.xs[p] as usize + corner.0,
                pixels.ys[p] as usize + corner.1,
            );
            let normal: Vector3<f64> = here.normal.normal(x, y).unwrap();
            let at = Point2::new(x as f64, y as f64);
            let point = here.intrinsics.unproject(&at, truth[0][p].exp());
            let facing = -normal.dot(&point.coords.normalize());
            let seen = other.cam_from_world.apply(&world_from_here.apply(&point));
            let turned = other.cam_from_world.rotation * (world_from_here.rotation * normal);
            let facing_other = -turned.dot(&seen.coords.normalize());
            // At a grazing angle a facet tells little.
            if facing.min(facing_other) < 0.5 {
                continue;
            }
            let expected = (facing_other / facing).powi(2);
            let found = hessian[p] / proposal.slope.powi(2);
            let deviation = |expected: f64| (found / expected - 1.0).abs();
            if expected > 1.4 * MAX_RELATIVE_WEIGHT {
                bounded.push(deviation(MAX_RELATIVE_WEIGHT));
            } else if (1.2..0.95 * MAX_RELATIVE_WEIGHT).contains(&expected) {
                better.push(deviation(expected));
            } else if expected < 0.67 {
                worse.push(deviation(expected));
            }
        }
        // The mesh's facets turn their normals by a degree or two.
        for mut deviations in [bounded, better, worse] {
            let count = deviations.len();
            let middle = median(&mut deviations).unwrap();
            assert!(count > 100 && middle < 0.1, "{count} pixels: {middle}");
        }
    }
}
