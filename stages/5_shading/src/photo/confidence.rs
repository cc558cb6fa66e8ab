//! How far each normal of the photo model can be trusted.
//!
//! The expected angle between a normal and the truth is
//!
//! `e = e₀ · (1 + tan τ)^0.4 · v · (r / r̃)^0.3`,
//!
//! with the tilt `τ` of the surface against the ray (foreshortening, and depth edges near by);
//! `v` = 2.5, 1.5, 1 where none, one, more of the other views have the same surface within a pixel
//! of disparity; and the local mean `r` of `|ln(Ĩ / I)|`, what shape and light leave of the photo, in
//! units of its median `r̃` over the view. Confidence is `1 / (1 + e²/E²)` with `E` five degrees.
//!
//! Exponents and factors were fitted to the errors of rendered and real objects of known shape,
//! each judged by the fit to the others: RMS errors in the quintiles of `e` are 0.7 to 1.6 times
//! `e`. The variance that follows from the normal equations ranks those errors no better than
//! chance: the light's error is systematic, and the equations do not contain it.

use super::appearance::Appearance;
use rayon::prelude::*;
use rilievo_scene::Raster;
use rilievo_stereo::level::Level;
use rilievo_stereo::{plate, sampling};

/// Error of a frontal normal that several views agree on, radians: 5.5 degrees.
const FRONTAL_ERROR: f64 = 0.096;
/// Angle at which the confidence is one half, radians: five degrees.
const HALF_ANGLE: f64 = 0.0873;
const TILT_EXPONENT: f64 = 0.4;
/// Tangent beyond which a steeper tilt makes no difference.
const MAX_TAN: f64 = 6.0;
/// Factors for none, one, and more agreeing views.
const ALONE: [f64; 3] = [2.5, 1.5, 1.0];
/// Disparity within which another view has the same surface, pixels.
const AGREE_PX: f64 = 1.0;
const RESIDUAL_EXPONENT: f64 = 0.3;
/// Standard deviation of the Gaussian over the photo's residual, pixels.
const RESIDUAL_SIGMA_PX: f64 = 3.0;
/// Residuals count between these multiples of the usual one.
const RESIDUAL_RANGE: (f64, f64) = (0.3, 10.0);

/// Confidence of all masked pixels of view `index`; `appearance` without an image leaves
/// the photo's residual out.
pub(crate) fn estimate(
    level: &Level,
    index: usize,
    depth: &[f64],
    rasters: &[Raster<f32>],
    appearance: &Appearance,
) -> Vec<f32> {
    let view = &level.views[index];
    let normals = plate::normals(view, depth);
    let unexplained = unexplained(level, index, appearance);
    (0..view.pixels.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|p| {
            let cosine = view.incidence_cosine(p, normals[p]);
            let tan = if cosine > 0.0 {
                ((1.0 - cosine * cosine).max(0.0).sqrt() / cosine).min(MAX_TAN)
            } else {
                MAX_TAN
            };
            let alone = ALONE[num_agreeing(level, index, p, depth[p], rasters).min(2)];
            let photo = unexplained
                .as_ref()
                .map_or(1.0, |r| r[p].powf(RESIDUAL_EXPONENT));
            let angle = FRONTAL_ERROR * (1.0 + tan).powf(TILT_EXPONENT) * alone * photo;
            (1.0 / (1.0 + (angle / HALF_ANGLE).powi(2))) as f32
        })
        .collect()
}

/// Other views whose surface lies within [`AGREE_PX`] of a pixel's point.
fn num_agreeing(
    level: &Level,
    index: usize,
    pixel: usize,
    zeta: f64,
    rasters: &[Raster<f32>],
) -> usize {
    let sightings = level.sightings(rasters, index, (pixel, zeta));
    sightings
        .filter(|s| s.behind.abs() * s.at.du.hypot(s.at.dv) < AGREE_PX)
        .count()
}

/// Local mean of `|ln(rendered / photo)|` in units of the view's median; `None` without an image.
fn unexplained(level: &Level, index: usize, appearance: &Appearance) -> Option<Vec<f64>> {
    let view = &level.views[index];
    let n = view.pixels.len();
    if appearance.rendered.len() != n {
        return None;
    }
    let grey = |v: [f32; 3]| (v[0] + v[1] + v[2]) / 3.0;
    let photo: Vec<f32> = (0..n).map(|p| grey(view.intensity(p))).collect();
    let floor = 0.01 * photo.iter().sum::<f32>() / n.max(1) as f32;
    let ratio: Vec<[f32; 1]> = (0..n)
        .map(|p| {
            let rendered = grey(appearance.rendered[p]).max(floor);
            [(rendered / photo[p].max(floor)).ln().abs()]
        })
        .collect();
    let usable: Vec<f32> = (0..n)
        .map(|p| if view.is_usable(p) { 1.0 } else { 0.0 })
        .collect();
    let local = sampling::smooth(&view.pixels, &ratio, &usable, RESIDUAL_SIGMA_PX);
    let mut all: Vec<f64> = local.iter().map(|r| f64::from(r[0])).collect();
    let usual = rilievo_numerics::robust::median(&mut all)?.max(1e-6);
    Some(
        local
            .iter()
            .map(|r| (f64::from(r[0]) / usual).clamp(RESIDUAL_RANGE.0, RESIDUAL_RANGE.1))
            .collect(),
    )
}
