//! Pigment: what the surface's colour takes from the light, separated from relief by its chroma.
//!
//! Where light explains a pixel by `S = l·h(n)`, `u_c = ln Ĩ_c − ln S_c` holds albedo and the error of
//! the normal alike. A wrong normal changes all channels together, as far as the light has one colour;
//! pigment and dirt change them in a fixed proportion. With brightness `m = mean_c u_c` and chroma
//! `d_c = u_c − m`, both less their mean over a Gaussian,
//!
//! `m ≈ A·d`, `s = A·d`, `ln a_c = s (1 + k_c)`, `k_c = Σ d_c s / Σ s²`,
//!
//! with one `A` for the object, since it carries one kind of stain: least squares over all views, in
//! which noise of the chroma only makes `A` smaller. Normals that err into all directions leave no
//! correlation; `R²` of the regression decides how far `s` counts, so that unpigmented objects under
//! coloured light keep their shading. Slow changes are left to the shading term's own correction.
//! The albedo sits on the surface: every pixel takes the mean over the views that see its point.

use super::shading::{self, HarmonicsOf};
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use rilievo_scene::Raster;
use rilievo_stereo::level::{Level, LevelView, depth_rasters};
use rilievo_stereo::{plate, sampling};
use serde::{Deserialize, Serialize};

/// Standard deviation of the Gaussian that separates stains from slow changes, pixels.
const SLOW_SIGMA_PX: f64 = 16.0;
/// Standard deviation of the Gaussian over chroma, pixels: photos hold it at half resolution, and noisy.
const CHROMA_SIGMA_PX: f64 = 1.0;
/// Depth difference, in pixel footprints, at which another view's albedo no longer counts.
const TOLERANCE_PX: f64 = 1.8;
/// Largest `|u|` that counts as pigment: beyond it the light or the surface is wrong.
const MAX_LOG: f32 = 0.7;
/// `R²` at which pigment counts half. A tenth is what correlated errors of normals reach by themselves.
const HALF_R2: f64 = 0.2;
/// Variance of chroma under which there is nothing but noise: a third of a per cent.
const CHROMA_FLOOR: f64 = 1e-5;

/// Albedo of all views at one level, relative to the mean albedo that the light contains.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Albedo {
    /// Per view and masked pixel.
    pub relative: Vec<Vec<[f32; 3]>>,
    /// Share of the brightness' small-scale variance that chroma predicts.
    pub explained: f64,
    /// How far the pigment counts, 0 to 1.
    pub belief: f64,
}

/// Brightness and chroma (red, blue) of the ratio between photo and light.
struct Ratios {
    /// Less the mean over the Gaussian.
    small: Vec<[f32; 3]>,
    /// Chroma at all scales.
    chroma: Vec<[f32; 2]>,
    weight: Vec<f32>,
}

/// Estimates the pigment at the current shape and light.
pub(crate) fn estimate(
    level: &Level,
    depths: &[Vec<f64>],
    harmonics: &HarmonicsOf<'_>,
    mean_tolerance: f64,
) -> Albedo {
    let rasters = depth_rasters(level, depths);
    let ratios: Vec<Ratios> = (0..level.views.len())
        .into_par_iter()
        .with_max_len(1)
        .map(|i| {
            let target = shading::mean_intensities(level, i, &depths[i], &rasters, mean_tolerance);
            ratios(&level.views[i], &depths[i], &harmonics(i), &target)
        })
        .collect();
    let regression = regress(&ratios);
    // Most of the surface is taken for clean, whatever tint the light's fit has left to it.
    let clean = clean_chroma(&ratios);
    let logs: Vec<Vec<f32>> = ratios
        .iter()
        .map(|r| {
            r.chroma
                .iter()
                .map(|d| {
                    (regression.slope[0] * (d[0] - clean[0])
                        + regression.slope[1] * (d[1] - clean[1]))
                        .clamp(-MAX_LOG, MAX_LOG)
                })
                .collect()
        })
        .collect();
    let relative = (0..level.views.len())
        .into_par_iter()
        .map(|i| {
            common(level, i, &depths[i], &rasters, &logs)
                .iter()
                .map(|&s| regression.proportion.map(|k| (s * k).exp()))
                .collect()
        })
        .collect();
    Albedo {
        relative,
        explained: regression.explained,
        belief: regression.belief,
    }
}

fn ratios(
    view: &LevelView,
    depth: &[f64],
    light: &[shading::PixelHarmonics],
    target: &[[f32; 3]],
) -> Ratios {
    let normals = plate::normals(view, depth);
    let mean = target.iter().flatten().map(|&v| f64::from(v)).sum::<f64>()
        / (3 * target.len()).max(1) as f64;
    let floor = (0.05 * mean) as f32;
    let mut weight = vec![0.0_f32; target.len()];
    let values: Vec<[f32; 3]> = (0..target.len())
        .map(|i| {
            let s = shading::render(&light[i], normals[i]).map(|v| v as f32);
            let dark = s.iter().chain(&target[i]).any(|&v| v < floor);
            if dark || !view.shows_surface(i) {
                return [0.0; 3];
            }
            let u = [0, 1, 2].map(|c| (target[i][c] / s[c]).ln());
            let m = (u[0] + u[1] + u[2]) / 3.0;
            if m.abs() > MAX_LOG {
                return [0.0; 3];
            }
            weight[i] = 1.0;
            [m, u[0] - m, u[2] - m]
        })
        .collect();
    let soft = sampling::smooth(&view.pixels, &values, &weight, CHROMA_SIGMA_PX);
    let slow = sampling::smooth(&view.pixels, &values, &weight, SLOW_SIGMA_PX);
    let small = (0..values.len())
        .map(|i| {
            [
                values[i][0] - slow[i][0],
                soft[i][1] - slow[i][1],
                soft[i][2] - slow[i][2],
            ]
        })
        .collect();
    // Clipped and dark pixels have the chroma of their neighbours.
    let chroma = (0..values.len())
        .map(|i| {
            let v = if weight[i] > 0.0 { &soft[i] } else { &slow[i] };
            [v[1], v[2]]
        })
        .collect();
    Ratios {
        small,
        chroma,
        weight,
    }
}

/// Median chroma of all usable pixels.
fn clean_chroma(ratios: &[Ratios]) -> [f32; 2] {
    [0, 1].map(|k| {
        let mut all: Vec<f64> = ratios
            .iter()
            .flat_map(|r| r.chroma.iter().zip(&r.weight))
            .step_by(5)
            .filter(|(_, w)| **w > 0.0)
            .map(|(d, _)| f64::from(d[k]))
            .collect();
        rilievo_numerics::robust::median(&mut all).unwrap_or(0.0) as f32
    })
}

struct Regression {
    /// `A` for red and blue, already scaled by how far it can be believed.
    slope: [f32; 2],
    /// `1 + k_c`.
    proportion: [f32; 3],
    explained: f64,
    belief: f64,
}

fn regress(ratios: &[Ratios]) -> Regression {
    let (mut dd, mut dm, mut mm, mut count) = (Matrix2::zeros(), Vector2::zeros(), 0.0, 0.0);
    for view in ratios {
        for (v, &w) in view.small.iter().zip(&view.weight) {
            if w <= 0.0 {
                continue;
            }
            let d = Vector2::new(f64::from(v[1]), f64::from(v[2]));
            let m = f64::from(v[0]);
            dd += d * d.transpose();
            dm += d * m;
            mm += m * m;
            count += 1.0;
        }
    }
    let none = Regression {
        slope: [0.0; 2],
        proportion: [1.0; 3],
        explained: 0.0,
        belief: 0.0,
    };
    if count < 100.0 || mm <= 0.0 {
        return none;
    }
    let ridge = Matrix2::identity() * (count * CHROMA_FLOOR);
    let Some(inverse) = (dd + ridge).try_inverse() else {
        return none;
    };
    let a: Vector2<f64> = inverse * dm;
    let explained = (a.dot(&dm) / mm).clamp(0.0, 1.0);
    let ss = a.dot(&(dd * a));
    if ss <= 0.0 || !explained.is_finite() {
        return none;
    }
    let k = dd * a / ss;
    let belief = explained.powi(4) / (explained.powi(4) + HALF_R2.powi(4));
    Regression {
        slope: [(belief * a.x) as f32, (belief * a.y) as f32],
        proportion: [1.0 + k.x, 1.0 - k.x - k.y, 1.0 + k.y].map(|v| v as f32),
        explained,
        belief,
    }
}

/// Mean of a value over the views that see the same point.
fn common(
    level: &Level,
    index: usize,
    depth: &[f64],
    rasters: &[Raster<f32>],
    values: &[Vec<f32>],
) -> Vec<f32> {
    let tolerance = TOLERANCE_PX / level.focal();
    let others: Vec<Raster<f32>> = level.sources[index]
        .iter()
        .map(|(j, _)| {
            let spread: Vec<f64> = values[*j].iter().map(|&v| f64::from(v)).collect();
            level.views[*j].spread(&spread, 0.0)
        })
        .collect();
    (0..depth.len())
        .map(|p| {
            let (mut sum, mut total) = (values[index][p], 1.0_f32);
            for seen in level.sightings(rasters, index, (p, depth[p])) {
                if !seen.is_unclipped() {
                    continue;
                }
                let miss = seen.behind / tolerance;
                let weight = (-0.5 * (miss * miss).min(100.0) as f32).exp();
                sum += weight * sampling::bilinear(&others[seen.source], seen.at.u, seen.at.v);
                total += weight;
            }
            sum / total
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small-scale ratios of an object: relief in all channels together, stains in a fixed
    /// proportion, noise.
    fn scattered(stain: f32, noise: f32) -> (Vec<Ratios>, Vec<f32>) {
        let mut state = 7_u64;
        let mut next = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
        };
        let mut truth = Vec::new();
        let small = (0..20_000)
            .map(|i| {
                let s = if (i / 50) % 4 == 0 {
                    -stain
                } else {
                    stain / 3.0
                };
                truth.push(s);
                let relief = 0.1 * next();
                [
                    s + relief,
                    0.4 * s + noise * next(),
                    -0.5 * s + noise * next(),
                ]
            })
            .collect();
        let weight = vec![1.0; 20_000];
        let chroma = Vec::new();
        (
            vec![Ratios {
                small,
                chroma,
                weight,
            }],
            truth,
        )
    }

    #[test]
    fn stains_are_told_from_relief_by_their_chroma() {
        let (ratios, truth) = scattered(0.25, 0.02);
        let found = regress(&ratios);
        let errors: f32 = ratios[0]
            .small
            .iter()
            .zip(&truth)
            .map(|(v, s)| (found.slope[0] * v[1] + found.slope[1] * v[2] - s).powi(2))
            .sum();
        let rms = (errors / truth.len() as f32).sqrt();
        assert!(rms < 0.03, "log albedo errs by {rms}");
        for (k, expected) in found.proportion.iter().zip([1.4, 1.1, 0.5]) {
            assert!((k - expected).abs() < 0.1, "{:?}", found.proportion);
        }
        assert!(found.explained > 0.6, "{}", found.explained);
    }

    #[test]
    fn an_object_of_one_colour_keeps_its_shading() {
        let (ratios, _) = scattered(0.0, 0.02);
        let found = regress(&ratios);
        let worst = ratios[0]
            .small
            .iter()
            .map(|v| (found.slope[0] * v[1] + found.slope[1] * v[2]).abs())
            .fold(0.0, f32::max);
        assert!(worst < 1e-3, "albedo {worst} where there is none");
    }
}
