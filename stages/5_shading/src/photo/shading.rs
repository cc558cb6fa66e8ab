//! The shading term: intensities explained by the light at the surface's normal.
//!
//! Per pixel and channel `u = l·h(n(∇ζ)) / (Ĩ (1 + e)) − 1`, with nine coefficients `l` of that pixel
//! (eq. 1 with the lighting varying over the image); brightness and chroma of `u`, each in units of its
//! own noise (`chroma`), with Huber's weight of each.
//! `Ĩ` averages the intensities of all views that see the point, so that noise and gloss shrink, over what
//! the relief around leaves of the light (`hidden_light`).
//! `e` is a smooth multiplicative correction, the mean of `l·h(n)/Ĩ − 1` over a Gaussian: what the light
//! model and a uniform albedo miss on a larger scale moves no surface.
//!
//! A clipped pixel is at least as bright as the photo shows: there brightness alone counts, only
//! where the light makes the surface darker, and with a redescending weight, since gloss is
//! brighter than any normal explains. Pixels on the outline, whose intensity is partly the
//! background's, take no part.

use super::chroma::{self, ChromaNoise, Whitening};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_numerics::plate_system::PlateSystem;
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::{Raster, SphericalHarmonics};
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::openness::openness;
use rilievo_stereo::plate;
use rilievo_stereo::sampling;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Nine coefficients for each of three channels, camera frame.
pub(crate) type PixelHarmonics = [[f32; 9]; 3];

/// Returns the coefficients of a view's pixels.
pub(crate) type HarmonicsOf<'a> = dyn Fn(usize) -> Cow<'a, [PixelHarmonics]> + Sync + 'a;

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

/// The light of one view's pixels.
#[derive(Clone, Debug)]
pub(crate) struct PixelLight<'a> {
    /// Coefficients.
    pub harmonics: Cow<'a, [PixelHarmonics]>,
    /// Albedo that is divided out of the photos.
    pub pigment: Option<Cow<'a, [[f32; 3]]>>,
    /// Scales each pixel's weight, 0 to 1.
    pub trust: Option<Cow<'a, [f32]>>,
    /// Log depth difference at which another view's intensity no longer counts; 0: never counts.
    pub mean_tolerance: f64,
    /// Exponent of openness; 0: relief hides nothing of the light.
    pub openness_exponent: f32,
}

/// How shading is weighed.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct ShadingWeights {
    /// Standard deviation of the model's brightness, relative to the intensity.
    pub sigma: f64,
    /// Standard deviation of its chroma over the noise that chroma shows.
    pub chroma_share: f64,
    /// Residual (in σ) beyond which the penalty grows only linearly.
    pub threshold: f64,
    /// Standard deviation of the correction's Gaussian, pixels; 0 turns the correction off.
    pub correction_px: f64,
    /// Largest correction.
    pub max_correction: f64,
    /// Noise of chroma where it is known already, so that the parts of a view are weighed alike; else it is measured
    /// on the pixels themselves.
    pub chroma_noise: Option<ChromaNoise>,
}

/// Residual, in σ, at which a clipped pixel's weight has fallen to a half.
const CLIPPED_SCALE: f64 = 6.0;

/// Standard deviation of the Gaussian over chroma where there is no correction, pixels.
const CHROMA_SIGMA_PX: f64 = 8.0;

/// The term of one view, ready to be linearised at any depth near the one it was built at.
#[derive(Clone, Debug)]
pub(crate) struct ShadingTerm<'a> {
    pub light: &'a [PixelHarmonics],
    /// `Ĩ (1 + e)`.
    pub target: Vec<[f32; 3]>,
    /// Square root of the pixel's weight, 0 where it takes no part.
    pub scale: Vec<f32>,
    pub whitening: Whitening,
    /// The noise of chroma that it is made from.
    pub chroma_noise: ChromaNoise,
    /// Intensity under which a pixel is as dark as the photo's noise.
    pub floor: f32,
    pub threshold: f64,
}

impl<'a> ShadingTerm<'a> {
    /// Builds the term at the current depths.
    pub fn new(
        level: &Level,
        index: usize,
        depth: &[f64],
        rasters: &[Raster<f32>],
        light: &'a PixelLight<'_>,
        weights: &ShadingWeights,
    ) -> Self {
        let view = &level.views[index];
        let n = view.pixels.len();
        let mut target = mean_intensities(level, index, depth, rasters, light.mean_tolerance);
        if let Some(albedo) = &light.pigment {
            for (t, a) in target.iter_mut().zip(albedo.iter()) {
                for c in 0..3 {
                    t[c] /= a[c].max(0.1);
                }
            }
        }
        let usable: Vec<f32> = (0..n)
            .map(|i| f32::from(u8::from(view.shows_surface(i))))
            .collect();
        let normals = plate::normals(view, depth);
        if light.openness_exponent > 0.0 {
            for (t, open) in target.iter_mut().zip(openness(view, depth, &normals)) {
                *t = t.map(|v| v / open.powf(light.openness_exponent));
            }
        }
        let relative: Vec<[f32; 3]> = (0..n)
            .map(|i| {
                let s = render(&light.harmonics[i], normals[i]);
                [0, 1, 2].map(|c| s[c] as f32 / target[i][c].max(0.3 * view.dark) - 1.0)
            })
            .collect();
        let limit = weights.max_correction as f32;
        let clipped: Vec<[f32; 3]> = relative
            .iter()
            .map(|u| u.map(|v| v.clamp(-limit, limit)))
            .collect();
        let sigma_px = if weights.correction_px > 0.0 {
            weights.correction_px
        } else {
            CHROMA_SIGMA_PX
        };
        let smooth = sampling::smooth(&view.pixels, &clipped, &usable, sigma_px);
        let chroma_noise = weights.chroma_noise.unwrap_or_else(|| {
            let local: Vec<[f32; 2]> = relative
                .iter()
                .zip(&smooth)
                .map(|(u, e)| {
                    let (u, e) = (chroma::chroma(*u), chroma::chroma(*e));
                    [u[0] - e[0], u[1] - e[1]]
                })
                .collect();
            ChromaNoise::measure(view, &local)
        });
        let whitening = Whitening::of_noise(weights.sigma, &chroma_noise, weights.chroma_share);
        if weights.correction_px > 0.0 {
            for (t, e) in target.iter_mut().zip(&smooth) {
                for c in 0..3 {
                    t[c] *= 1.0 + e[c];
                }
            }
        }
        let scale = (0..n)
            .map(|i| {
                if view.is_on_outline(i) {
                    0.0
                } else {
                    light.trust.as_ref().map_or(1.0, |t| t[i].max(0.0).sqrt())
                }
            })
            .collect();
        Self {
            light: &light.harmonics,
            target,
            scale,
            whitening,
            chroma_noise,
            floor: view.dark,
            threshold: weights.threshold,
        }
    }

    /// Adds the linearised term for the increment of `depth`.
    pub fn add(&self, view: &LevelView, depth: &[f64], system: &mut PlateSystem) {
        for i in 0..view.pixels.len() {
            if self.scale[i] <= 0.0 {
                continue;
            }
            let (fp, fq) = plate::slopes(view, i, depth);
            let (p, q) = (fp.of(depth), fq.of(depth));
            let (n, dp, dq) = plate::normal_with_derivatives(view, i, p, q);
            let (h, hp, hq) = (basis(n), basis_derivative(n, dp), basis_derivative(n, dq));
            let (r, a, b) = self.residual(i, [&h, &hp, &hq]);
            let is_clipped = !view.is_usable(i);
            if is_clipped && r[0] > 0.0 {
                continue;
            }
            let num_parts = if is_clipped { 1 } else { 2 };
            for part in [0..1, 1..3].into_iter().take(num_parts) {
                let (mut rr, mut pp, mut qq, mut pq, mut pr, mut qr) =
                    (0.0_f64, 0.0, 0.0, 0.0, 0.0, 0.0);
                for k in part {
                    rr += r[k] * r[k];
                    pp += a[k] * a[k];
                    qq += b[k] * b[k];
                    pq += a[k] * b[k];
                    pr += a[k] * r[k];
                    qr += b[k] * r[k];
                }
                let norm = rr.sqrt();
                let w = if is_clipped {
                    // What no diffuse surface under this light reaches is gloss.
                    1.0 / (1.0 + (norm / CLIPPED_SCALE).powi(2))
                } else {
                    RobustLoss::Huber(self.threshold).weight(norm)
                };
                system.add_pair(
                    &view.pixels,
                    [&fp, &fq],
                    [w * pp, w * pq, w * qq],
                    [-w * pr, -w * qr],
                );
            }
        }
    }

    /// Brightness and chroma in units of their noise at a basis `h`, and their derivatives where the
    /// basis moves by `hp` or `hq`.
    fn residual(
        &self,
        pixel: usize,
        [h, hp, hq]: [&[f64; 9]; 3],
    ) -> ([f64; 3], [f64; 3], [f64; 3]) {
        let (mut u, mut up, mut uq) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for c in 0..3 {
            let (l, target) = (&self.light[pixel][c], self.target[pixel][c]);
            let scale = f64::from(self.scale[pixel] / target.max(self.floor));
            u[c] = (dot(l, h) - f64::from(target)) * scale;
            up[c] = dot(l, hp) * scale;
            uq[c] = dot(l, hq) * scale;
        }
        (
            self.whitening.of(u),
            self.whitening.of(up),
            self.whitening.of(uq),
        )
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
    let is_compared = tolerance > 0.0;
    (0..view.pixels.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|p| {
            let own = view.intensity(p);
            let mean = (own.iter().sum::<f32>() / 3.0).max(1e-6);
            // A photo out of focus has lost detail that the others show.
            let own_weight = view.sharpness.powi(2) as f32;
            let (mut sum, mut total) = (own.map(|v| v * own_weight), own_weight);
            let sightings = is_compared.then(|| level.sightings(rasters, index, (p, depth[p])));
            for seen in sightings.into_iter().flatten() {
                let miss = seen.behind / tolerance;
                if miss.abs() > 4.0 || !seen.is_unclipped() {
                    continue;
                }
                let (value, _, _) = sampling::bicubic(&seen.view.image, seen.at.u, seen.at.v);
                let unlike = (0..3)
                    .map(|c| (value[c] - own[c]).abs())
                    .fold(0.0_f32, f32::max)
                    / mean
                    / 0.1;
                let weight = (seen.view.sharpness.powi(2) as f32)
                    * (-0.5 * (miss * miss) as f32 - 0.5 * unlike * unlike).exp();
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
        let light: [PixelHarmonics; 1] = [[
            [0.2, -0.4, -0.7, 0.5, 0.1, -0.2, 0.15, 0.05, 0.08],
            [0.1, -0.3, -0.6, 0.6, 0.05, -0.1, 0.2, 0.02, 0.03],
            [-0.1, -0.3, -0.5, 0.7, 0.0, -0.05, 0.1, -0.06, 0.01],
        ]];
        let term = ShadingTerm {
            light: &light,
            target: vec![[0.9, 0.8, 0.7]],
            scale: vec![0.7],
            whitening: Whitening::new(0.03, [0.01, 0.015], 0.4),
            chroma_noise: ChromaNoise {
                sigma: [0.01, 0.015],
                correlation: 0.4,
            },
            floor: 0.01,
            threshold: 2.0,
        };
        let ray = [0.2, -0.1];
        let normal = |p: f64, q: f64| {
            let m = [p, q, -1.0 - ray[0] * p - ray[1] * q];
            let length = m.iter().map(|v| v * v).sum::<f64>().sqrt();
            (m.map(|v| v / length), length)
        };
        let (p, q, step) = (0.7, -0.3, 1e-6);
        let (n, length) = normal(p, q);
        let [dp, dq] = [[1.0, 0.0, -ray[0]], [0.0, 1.0, -ray[1]]].map(|e| {
            let along = n.iter().zip(&e).map(|(a, b)| a * b).sum::<f64>();
            [0, 1, 2].map(|k| (e[k] - n[k] * along) / length)
        });
        let at = |p: f64, q: f64| {
            let n = normal(p, q).0;
            let flat = basis_derivative(n, [0.0; 3]);
            term.residual(0, [&basis(n), &flat, &flat]).0
        };
        let (_, along_p, along_q) = term.residual(
            0,
            [
                &basis(n),
                &basis_derivative(n, dp),
                &basis_derivative(n, dq),
            ],
        );
        for (analytic, dp, dq) in [(along_p, step, 0.0), (along_q, 0.0, step)] {
            let (ahead, back) = (at(p + dp, q + dq), at(p - dp, q - dq));
            for k in 0..3 {
                let numeric = (ahead[k] - back[k]) / (2.0 * step);
                assert!(
                    (analytic[k] - numeric).abs() < 1e-6 * analytic[k].abs().max(1.0),
                    "component {k}: {} against {numeric}",
                    analytic[k]
                );
            }
        }
    }
}
