//! Whether a light from elsewhere (given, or of a calibration photo) can be the light of the photos.
//!
//! Asked at the surface that the photos' agreement found, before any shading has bent it. Per view two
//! relative residuals, each after the best gain: of the given nine harmonics, and of nine harmonics fitted on
//! the view itself. The second holds what no distant light explains (shadow, bounce, pigment, errors of the
//! normals), so that a right light comes near it, and one from another side does not.

use crate::error::{LightMisfit, ShadingError};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_photometry::harmonics::fit_robust;
use rilievo_scene::{Lighting, LightingCalibration, SphericalHarmonics};
use rilievo_stereo::level::Level;
use rilievo_stereo::plate;

/// Pixels of a view that are compared.
const NUM_PIXELS: usize = 4000;
/// A view contradicts where the given light leaves this many times as much as the fitted one, and more than
/// that by `SMALLEST_GAP` of the brightness. In single views of scenes with shadow, bounce and stains a sphere's
/// or the true light left at most 1.38 times as much, one mirrored in one or two axes at least 1.63 times.
const RATIO: f64 = 1.5;
/// Below it noise of the normals decides.
const SMALLEST_GAP: f64 = 0.06;

/// Refuses a light that contradicts most of the views that it was given for.
///
/// # Errors
/// [`ShadingError::LightContradicts`] with the figures of the views.
pub(crate) fn refuse(
    level: &Level,
    names: &[&str],
    depths: &[Vec<f64>],
    lighting: &LightingCalibration,
) -> Result<(), ShadingError> {
    let misfits: Vec<LightMisfit> = lighting
        .views
        .par_iter()
        .filter_map(|entry| {
            let idx = entry.view.0;
            let (given, fitted) = residuals(level, idx, &depths[idx], &entry.lighting)?;
            Some(LightMisfit {
                view: names[idx].to_owned(),
                given,
                fitted,
            })
        })
        .collect();
    let num_views = misfits.len();
    let contradicted: Vec<LightMisfit> = misfits
        .into_iter()
        .filter(|m| m.given > RATIO * m.fitted && m.given > m.fitted + SMALLEST_GAP)
        .collect();
    if 2 * contradicted.len() > num_views {
        return Err(ShadingError::LightContradicts {
            from: lighting.source,
            views: contradicted,
            num_views,
        });
    }
    Ok(())
}

/// Residuals of the given and of the fitted light; `None` where too few pixels are usable.
fn residuals(level: &Level, idx: usize, depth: &[f64], given: &Lighting) -> Option<(f64, f64)> {
    let view = &level.views[idx];
    let normals = plate::normals(view, depth);
    let step = (view.pixels.len() / NUM_PIXELS).max(1);
    let pixels: Vec<usize> = (0..view.pixels.len())
        .step_by(step)
        .filter(|&p| view.is_usable(p))
        .collect();
    let seen: Vec<Vector3<f64>> = pixels.iter().map(|&p| normals[p].into()).collect();
    let (mut left_given, mut left_fitted, mut all) = (0.0, 0.0, 0.0);
    for channel in 0..3 {
        let values: Vec<f64> = pixels
            .iter()
            .map(|&p| f64::from(view.intensity(p)[channel]))
            .collect();
        let fitted = fit_robust(&seen, &values, None).ok()?;
        let given = given.channels[channel.min(given.channels.len() - 1)];
        left_given += unexplained(&seen, &values, &given);
        left_fitted += unexplained(&seen, &values, &fitted.coefficients);
        all += values.iter().map(|v| v * v).sum::<f64>();
    }
    (all > 0.0).then(|| ((left_given / all).sqrt(), (left_fitted / all).sqrt()))
}

/// Sum of squares that a light times its best gain leaves.
fn unexplained(normals: &[Vector3<f64>], values: &[f64], light: &SphericalHarmonics) -> f64 {
    let (mut ss, mut si, mut ii) = (0.0, 0.0, 0.0);
    for (normal, value) in normals.iter().zip(values) {
        let predicted = light.evaluate(normal);
        ss += predicted * predicted;
        si += predicted * value;
        ii += value * value;
    }
    // A light that predicts darkness where there is light explains nothing by a negative gain.
    let explained = if ss > 0.0 {
        si.max(0.0).powi(2) / ss
    } else {
        0.0
    };
    (ii - explained).max(0.0)
}
