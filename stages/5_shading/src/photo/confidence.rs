//! How well the data determine each normal of the photo model.
//!
//! Slopes `θ = (p, q)` of a pixel have the information
//!
//! `M = I/D² + Jᵀ J/σ_s² + κ h/f² I`:
//!
//! a start's error `D`; shading with Jacobian `J` and the standard deviation that it was given; and
//! the agreement between photos, whose curvature `h` in log depth, averaged over a bell, bounds the
//! tilt of a patch of `κ` pixels² (focal length `f`). Its expected squared slope error `tr M⁻¹` grows
//! by what contradicts: the residual between photos in units of their usual one, the distance of the
//! other views' surfaces, and one-sided differences at the mask's border. Confidence is
//! `1/(1 + e²/E²)` with the error `e` of the normal in radians and `E` five degrees. It ranks errors;
//! it is no calibrated probability.

use super::consensus;
use super::level::Level;
use super::light::Light;
use super::matching::{self, MatchOptions};
use super::{plate, sampling, shading};
use rayon::prelude::*;
use rilievo_scene::Raster;

/// Slope by which an undetermined surface errs.
const START_ERROR: f64 = 0.35;
/// Angle at which the confidence is one half, radians: five degrees.
const HALF_ANGLE: f64 = 0.0873;
/// Bell over the curvature of the photos' agreement, pixels.
const BELL_PX: f64 = 3.0;
/// Σ dx² over a 9×9 patch, less what correlated residuals of neighbouring pixels take from it.
const PATCH_TILT: f64 = 540.0 / 20.0;
/// Slope error of one-sided differences at the border, and its reach in pixels.
const BORDER_ERROR: f64 = 0.3;
const BORDER_REACH_PX: usize = 5;

/// Confidence of all masked pixels of view `index`.
pub(crate) fn estimate(
    level: &Level,
    index: usize,
    depth: &[f64],
    rasters: &[Raster<f32>],
    matching: &MatchOptions,
    light: Option<(&Light, f64)>,
) -> Vec<f32> {
    let view = &level.views[index];
    let terms = matching::terms(level, index, depth, rasters, matching);
    let n = view.pixels.len();
    let ones = vec![1.0_f32; n];
    let raw: Vec<[f32; 2]> = (0..n)
        .map(|p| [terms.hessian[p] as f32, terms.residual[p].powi(2)])
        .collect();
    let smooth = sampling::smooth(&view.pixels, &raw, &ones, BELL_PX);
    let focal = view.camera.focal();
    let border = border_distance(level, index);
    let usual = {
        let mut all: Vec<f64> = smooth.iter().map(|s| f64::from(s[1])).collect();
        rilievo_numerics::robust::median(&mut all)
            .unwrap_or(0.0)
            .max(1e-6)
    };
    (0..n)
        .into_par_iter()
        .with_min_len(1024)
        .map(|p| {
            let (fp, fq) = plate::slopes(view, p);
            let (normal, dp, dq) =
                plate::normal_with_derivatives(view, p, fp.of(depth), fq.of(depth));
            // Length of the unnormalised normal: an angle is a slope over its square at most.
            let length = 1.0
                / (dp
                    .iter()
                    .map(|v| v * v)
                    .sum::<f64>()
                    .sqrt()
                    .max(dq.iter().map(|v| v * v).sum::<f64>().sqrt()))
                .max(1e-6);
            let stereo = PATCH_TILT * f64::from(smooth[p][0]) / (focal * focal);
            let base = 1.0 / (START_ERROR * START_ERROR) + stereo;
            let (mut a, mut b, mut d) = (base, 0.0, base);
            if let Some((light, sigma)) = light
                && view.is_usable(p)
            {
                let l = &light.harmonics[index][p];
                let s = shading::render(l, normal);
                let grey = ((s[0] + s[1] + s[2]) / 3.0).max(1e-4);
                let scale = 1.0 / (3.0 * (sigma * grey).powi(2));
                let (jp, jq) = shading::render_derivatives(l, normal, dp, dq);
                for c in 0..3 {
                    a += scale * jp[c] * jp[c];
                    b += scale * jp[c] * jq[c];
                    d += scale * jq[c] * jq[c];
                }
            }
            let open = (a + d) / (a * d - b * b).max(1e-12);
            let mut sum = 0.0;
            for k in 0..level.sources[index].len() {
                if let Some((r, _, _, _)) = consensus::propose(
                    level,
                    index,
                    k,
                    p,
                    depth[p],
                    rasters,
                    2.0 * matching.visible_tolerance,
                ) {
                    // A step of a pixel's footprint over a few pixels.
                    sum += (r * focal / 6.0).powi(2);
                }
            }
            let conflict = sum / f64::from(terms.num_visible[p].max(1));
            let unlike = (f64::from(smooth[p][1]) / usual - 1.0).clamp(0.0, 20.0);
            let rim =
                BORDER_ERROR * (1.0 - f64::from(border[p]) / (BORDER_REACH_PX + 1) as f64).max(0.0);
            let slope = (open * (1.0 + 0.25 * unlike)).min(2.0 * START_ERROR.powi(2))
                + conflict
                + rim * rim;
            let angle = slope / (length * length);
            (1.0 / (1.0 + angle / (HALF_ANGLE * HALF_ANGLE))) as f32
        })
        .collect()
}

/// Rings between every masked pixel and the mask's border, up to one more than the reach.
fn border_distance(level: &Level, index: usize) -> Vec<u8> {
    let pixels = &level.views[index].pixels;
    let far = BORDER_REACH_PX as u8 + 1;
    let mut distance: Vec<u8> = (0..pixels.len())
        .map(|p| {
            let edge = [(1, 0), (-1, 0), (0, 1), (0, -1)]
                .iter()
                .any(|&(dx, dy)| pixels.neighbour(p, dx, dy).is_none());
            if edge { 0 } else { far }
        })
        .collect();
    for ring in 0..BORDER_REACH_PX as u8 {
        for p in 0..distance.len() {
            if distance[p] != ring {
                continue;
            }
            for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if let Some(q) = pixels.neighbour(p, dx, dy)
                    && distance[q] > ring + 1
                {
                    distance[q] = ring + 1;
                }
            }
        }
    }
    distance
}
