//! The shading term: intensities explained by the light at the surface's normal.
//!
//! Per pixel and channel `r = (l·h(n(∇ζ)) − Ĩ (1 + e)) / (σ_s ‖Ĩ‖)`, with nine coefficients `l` of that
//! pixel (eq. 1 with the lighting varying over the image), Huber's weight on the channels' RMS.
//! `Ĩ` averages the intensities of all views that see the point: noise and gloss shrink.
//! `e` is a smooth multiplicative correction, the mean of `l·h(n)/Ĩ − 1` over a bell: what the light
//! model and a uniform albedo miss on a larger scale moves no surface.

use super::level::{Level, LevelView};
use super::plate;
use super::sampling;
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_numerics::plate_system::PlateSystem;
use rilievo_scene::{Raster, SphericalHarmonics};

/// Nine coefficients for each of three channels, camera frame.
pub(crate) type PixelHarmonics = [[f32; 9]; 3];

/// The basis of eq. 1.
#[inline]
pub(crate) fn basis(n: [f64; 3]) -> [f64; 9] {
    SphericalHarmonics::basis(&Vector3::from(n))
}

/// Derivative of the basis when the normal moves by `d`.
#[inline]
fn basis_derivative(n: [f64; 3], d: [f64; 3]) -> [f64; 9] {
    [
        d[0],
        d[1],
        d[2],
        0.0,
        d[0] * n[1] + n[0] * d[1],
        d[0] * n[2] + n[0] * d[2],
        d[1] * n[2] + n[1] * d[2],
        2.0 * (n[0] * d[0] - n[1] * d[1]),
        6.0 * n[2] * d[2],
    ]
}

#[inline]
fn dot(l: &[f32; 9], h: &[f64; 9]) -> f64 {
    l.iter().zip(h).map(|(a, b)| f64::from(*a) * b).sum()
}

/// Intensity of a pixel with normal `n`.
#[inline]
pub(crate) fn render(light: &PixelHarmonics, n: [f64; 3]) -> [f64; 3] {
    let h = basis(n);
    [0, 1, 2].map(|c| dot(&light[c], &h))
}

/// Derivatives of [`render`] when the normal moves by `dp` or `dq`.
#[inline]
pub(crate) fn render_derivatives(
    light: &PixelHarmonics,
    n: [f64; 3],
    dp: [f64; 3],
    dq: [f64; 3],
) -> ([f64; 3], [f64; 3]) {
    let (hp, hq) = (basis_derivative(n, dp), basis_derivative(n, dq));
    (
        [0, 1, 2].map(|c| dot(&light[c], &hp)),
        [0, 1, 2].map(|c| dot(&light[c], &hq)),
    )
}

/// The light of one view's pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelLight<'a> {
    /// Coefficients.
    pub harmonics: &'a [PixelHarmonics],
    /// Albedo that is divided out of the photos.
    pub pigment: Option<&'a [[f32; 3]]>,
    /// Scales each pixel's weight, 0 to 1.
    pub trust: Option<&'a [f32]>,
    /// Log depth difference at which another view's intensity loses its say; 0: it has none.
    pub mean_tolerance: f64,
}

/// How shading is weighed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShadingWeights {
    /// Standard deviation of the model, relative to the intensity.
    pub sigma: f64,
    /// Residual (in σ) beyond which the penalty grows only linearly.
    pub knee: f64,
    /// Standard deviation of the correction's bell, pixels; 0 turns the correction off.
    pub correction_px: f64,
    /// Largest correction.
    pub max_correction: f64,
}

/// The term of one view, ready to be linearised at any depth near the one it was built at.
#[derive(Clone, Debug)]
pub(crate) struct ShadingTerm<'a> {
    pub light: &'a [PixelHarmonics],
    /// `Ĩ (1 + e)`.
    pub target: Vec<[f32; 3]>,
    /// `1 / (σ_s ‖Ĩ‖)`, 0 where the pixel takes no part.
    pub scale: Vec<f32>,
    pub knee: f64,
}

impl<'a> ShadingTerm<'a> {
    /// Builds the term at the current depths.
    pub fn new(
        level: &Level,
        index: usize,
        depth: &[f64],
        rasters: &[Raster<f32>],
        light: &PixelLight<'a>,
        weights: &ShadingWeights,
    ) -> Self {
        let view = &level.views[index];
        let n = view.pixels.len();
        let mut target = mean_intensities(level, index, depth, rasters, light.mean_tolerance);
        if let Some(albedo) = light.pigment {
            for (t, a) in target.iter_mut().zip(albedo) {
                for c in 0..3 {
                    t[c] /= a[c].max(0.1);
                }
            }
        }
        let mean =
            target.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / (3 * n).max(1) as f64;
        let floor = (0.02 * mean) as f32;
        let grey: Vec<f32> = target
            .iter()
            .map(|t| ((t[0] + t[1] + t[2]) / 3.0).max(floor))
            .collect();
        let usable: Vec<f32> = (0..n)
            .map(|i| f32::from(u8::from(view.is_usable(i))))
            .collect();
        if weights.correction_px > 0.0 {
            let normals = plate::normals(view, depth);
            let limit = weights.max_correction as f32;
            let relative: Vec<[f32; 3]> = (0..n)
                .map(|i| {
                    let s = render(&light.harmonics[i], normals[i]);
                    [0, 1, 2].map(|c| {
                        (s[c] as f32 / target[i][c].max(0.3 * floor) - 1.0).clamp(-limit, limit)
                    })
                })
                .collect();
            let smooth = sampling::smooth(&view.pixels, &relative, &usable, weights.correction_px);
            for (t, e) in target.iter_mut().zip(&smooth) {
                for c in 0..3 {
                    t[c] *= 1.0 + e[c];
                }
            }
        }
        let scale = (0..n)
            .map(|i| {
                let trust = light.trust.map_or(1.0, |t| t[i].max(0.0).sqrt());
                usable[i] * trust / (weights.sigma as f32 * grey[i])
            })
            .collect();
        Self {
            light: light.harmonics,
            target,
            scale,
            knee: weights.knee,
        }
    }

    /// Adds the linearised term for the increment of `depth`.
    pub fn add(&self, view: &LevelView, depth: &[f64], system: &mut PlateSystem) {
        for i in 0..view.pixels.len() {
            if self.scale[i] <= 0.0 {
                continue;
            }
            let (fp, fq) = plate::slopes(view, i);
            let (p, q) = (fp.of(depth), fq.of(depth));
            let (n, dp, dq) = plate::normal_with_derivatives(view, i, p, q);
            let (h, hp, hq) = (basis(n), basis_derivative(n, dp), basis_derivative(n, dq));
            let scale = f64::from(self.scale[i]);
            let (mut rr, mut pp, mut qq, mut pq, mut pr, mut qr) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
            for c in 0..3 {
                let l = &self.light[i][c];
                let r = (dot(l, &h) - f64::from(self.target[i][c])) * scale;
                let (a, b) = (dot(l, &hp) * scale, dot(l, &hq) * scale);
                rr += r * r / 3.0;
                pp += a * a / 3.0;
                qq += b * b / 3.0;
                pq += a * b / 3.0;
                pr += a * r / 3.0;
                qr += b * r / 3.0;
            }
            let norm = rr.sqrt();
            let w = if norm < self.knee {
                1.0
            } else {
                self.knee / norm
            };
            system.add_product(&view.pixels, &fp, &fp, 0.5 * w * pp);
            system.add_product(&view.pixels, &fq, &fq, 0.5 * w * qq);
            system.add_product(&view.pixels, &fp, &fq, w * pq);
            for &(k, c) in fp.terms() {
                system.rhs[k as usize] -= w * pr * c;
            }
            for &(k, c) in fq.terms() {
                system.rhs[k as usize] -= w * qr * c;
            }
        }
    }
}

/// Mean of a pixel's intensity over the views that see the same point and agree on it.
pub(crate) fn mean_intensities(
    level: &Level,
    index: usize,
    depth: &[f64],
    rasters: &[Raster<f32>],
    tolerance: f64,
) -> Vec<[f32; 3]> {
    let view = &level.views[index];
    (0..view.pixels.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|p| {
            let own = view.intensity(p);
            let mean = (own.iter().sum::<f32>() / 3.0).max(1e-6);
            let (mut sum, mut total) = (own, 1.0_f32);
            let (x, y) = view.xy(p);
            for (j, warp) in &level.sources[index] {
                if tolerance <= 0.0 {
                    break;
                }
                let other = &level.views[*j];
                let Some(l) = warp.land(x, y, depth[p]) else {
                    continue;
                };
                if !sampling::inside(&other.mask, l.u, l.v)
                    || sampling::bilinear(&other.usable, l.u, l.v) < 0.999
                {
                    continue;
                }
                let miss =
                    (l.zeta - f64::from(sampling::bilinear(&rasters[*j], l.u, l.v))) / tolerance;
                if miss.abs() > 4.0 {
                    continue;
                }
                let (value, _, _) = sampling::bicubic(&other.image, l.u, l.v);
                let unlike = (0..3)
                    .map(|c| (value[c] - own[c]).abs())
                    .fold(0.0_f32, f32::max)
                    / mean
                    / 0.1;
                let weight = (-0.5 * (miss * miss) as f32 - 0.5 * unlike * unlike).exp();
                for c in 0..3 {
                    sum[c] += weight * value[c];
                }
                total += weight;
            }
            sum.map(|v| v / total)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_along_slopes_agree_with_differences() {
        let light: [f32; 9] = [0.2, -0.4, -0.7, 0.5, 0.1, -0.2, 0.15, 0.05, 0.08];
        let ray = [0.2, -0.1];
        let normal = |p: f64, q: f64| {
            let m = [p, q, -1.0 - ray[0] * p - ray[1] * q];
            let length = m.iter().map(|v| v * v).sum::<f64>().sqrt();
            (m.map(|v| v / length), length)
        };
        let shade = |p: f64, q: f64| dot(&light, &basis(normal(p, q).0));
        let (p, q, step) = (0.7, -0.3, 1e-6);
        let (n, length) = normal(p, q);
        for (axis, e) in [[1.0, 0.0, -ray[0]], [0.0, 1.0, -ray[1]]]
            .iter()
            .enumerate()
        {
            let along = n.iter().zip(e).map(|(a, b)| a * b).sum::<f64>();
            let d = [0, 1, 2].map(|k| (e[k] - n[k] * along) / length);
            let analytic = dot(&light, &basis_derivative(n, d));
            let (dp, dq) = if axis == 0 { (step, 0.0) } else { (0.0, step) };
            let numeric = (shade(p + dp, q + dq) - shade(p - dp, q - dq)) / (2.0 * step);
            assert!(
                (analytic - numeric).abs() < 1e-8,
                "axis {axis}: {analytic} against {numeric}"
            );
        }
    }
}
