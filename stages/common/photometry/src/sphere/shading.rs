//! Whether what lies inside an outline is shaded as a matte sphere.

use super::cone::OutlineCone;
use super::posed_image::Photo;
use crate::harmonics::{FitOptions, fit_with};
use nalgebra::Vector3;

/// Share of samples that may be shadowed, dirty or hidden without counting against a candidate.
const TOLERATED: f64 = 0.1;

/// How nine harmonics over the exact normals of a cone explain the pixels inside it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shading {
    /// Relative residual, root mean square over all but the worst tenth of the pixels.
    pub residual: f64,
    /// Share of the variance of brightness that is explained. A flat patch of background has a
    /// small residual because it has little to explain; a sphere is shaded.
    pub explained: f64,
}

impl Shading {
    /// Smallest explained share of a sphere; noise and compression leave more than this of the
    /// shading of any light with a direction.
    const MIN_EXPLAINED: f64 = 0.8;

    /// Whether a matte sphere looks like this.
    pub fn is_sphere(&self, max_residual: f64) -> bool {
        self.residual <= max_residual && self.explained >= Self::MIN_EXPLAINED
    }
}

/// Measures it; `None` with too few unclipped pixels.
pub(super) fn shading(photo: &Photo, cone: &OutlineCone) -> Option<Shading> {
    let sphere = cone.sphere(1.0);
    let radius_px = sphere.radius_px(photo.intrinsics);
    let pixels = sphere.pixels(photo.intrinsics, 2.0_f64.min(0.2 * radius_px));
    // A few thousand pixels are as good as all.
    let stride = pixels.len().div_ceil(1500).max(1);
    let (mut normals, mut values): (Vec<Vector3<f64>>, Vec<f64>) = (Vec::new(), Vec::new());
    for pixel in pixels.iter().step_by(stride) {
        let hidden = photo.is_object(pixel.x as isize, pixel.y as isize);
        let channels = photo.image.pixel(pixel.x, pixel.y);
        let clipped = channels.iter().any(|&v| v >= 0.97 * photo.clip_level);
        if hidden || clipped || pixel.cos_view < 0.1 {
            continue;
        }
        normals.push(pixel.normal_in_cam);
        values.push(f64::from(channels.iter().sum::<f32>()) / channels.len() as f64);
    }
    if normals.len() < 80 {
        return None;
    }
    let fit = fit_with(&normals, &values, None, &FitOptions::EXPLAINING).ok()?;
    let mut residuals: Vec<f64> = normals
        .iter()
        .zip(&values)
        .map(|(n, v)| (fit.coefficients.evaluate(n) - v).powi(2))
        .collect();
    residuals.sort_by(f64::total_cmp);
    let kept = ((1.0 - TOLERATED) * residuals.len() as f64) as usize;
    let num = values.len() as f64;
    let mean = values.iter().sum::<f64>() / num;
    let size = values.iter().map(|v| v * v).sum::<f64>() / num;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / num;
    let square = residuals[..kept].iter().sum::<f64>() / kept.max(1) as f64;
    (size > 0.0 && variance > 0.0).then(|| Shading {
        residual: (square / size).sqrt(),
        explained: 1.0 - square / variance,
    })
}
