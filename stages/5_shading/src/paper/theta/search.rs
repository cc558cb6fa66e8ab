//! A start from far: the best of a fixed set of normals, pixel by pixel.

// Arrays of lanes are indexed in parallel: zipped iterators would hide the lane.
#![allow(clippy::needless_range_loop)]

use super::block::Block;
use crate::paper::model::harmonics;
use crate::paper::pixels::{Coefficients, LANES, Pixels};

/// Candidate normals of a global search, with their shading where the lighting is uniform.
#[derive(Clone, Debug)]
pub(crate) struct Candidates {
    normals: Vec<[f32; 3]>,
    // `channels` values per normal, empty for per-pixel lighting.
    shading: Vec<f32>,
}

impl Candidates {
    /// `rings` rings of normals around the axis, up to a slope of `max_slope`.
    pub(crate) fn new(pixels: &Pixels, rings: usize, max_slope: f32) -> Self {
        let mut normals = vec![[0.0, 0.0, -1.0]];
        for ring in 1..=rings {
            // Rings crowd at small slopes, where most of a surface lies.
            let slope = max_slope * (ring as f32 / rings as f32).powf(1.5);
            let tilt = slope.atan();
            let num = 6 * ring;
            for k in 0..num {
                let azimuth =
                    std::f32::consts::TAU * (k as f32 + 0.5 * (ring % 2) as f32) / num as f32;
                normals.push([
                    tilt.sin() * azimuth.cos(),
                    tilt.sin() * azimuth.sin(),
                    -tilt.cos(),
                ]);
            }
        }
        let shading = match &pixels.light {
            Coefficients::Uniform(rows) => normals
                .iter()
                .flat_map(|&n| rows.iter().map(move |l| harmonics(l, n).0))
                .collect(),
            Coefficients::PerPixel(_) => Vec::new(),
        };
        Self { normals, shading }
    }
}

/// Replaces slopes by those of the best candidate normal, where that is better.
#[inline(always)]
pub(super) fn search<const C: usize>(
    block: &Block<C>,
    candidates: &Candidates,
    slopes: &mut [[f32; LANES]; 2],
) {
    let mut best = [0.0; LANES];
    for k in 0..LANES {
        best[k] = block.evaluate(k, [slopes[0][k], slopes[1][k]]).value;
    }
    for (index, n) in candidates.normals.iter().enumerate() {
        for k in 0..LANES {
            let towards = n[0] * block.ray[0][k] + n[1] * block.ray[1][k] + n[2];
            let scale = -1.0 / towards.min(-1e-3);
            let (p, q) = (n[0] * scale, n[1] * scale);
            let (dp, dq) = (p - block.target[0][k], q - block.target[1][k]);
            let mut squared = 0.0;
            for c in 0..C {
                let shade = if candidates.shading.is_empty() {
                    let mut l = [0.0; 9];
                    for j in 0..9 {
                        l[j] = block.light[c][j][k];
                    }
                    harmonics(&l, *n).0
                } else {
                    candidates.shading[index * C + c]
                };
                let r = shade - block.intensity[c][k];
                squared += r * r;
            }
            let w = 1.0 + block.ray[0][k] * p + block.ray[1][k] * q;
            let value = block.weight[k] * squared
                + 0.5 * block.beta[k] * (dp * dp + dq * dq)
                + block.area * (p * p + q * q + w * w).sqrt();
            let better = value < best[k];
            best[k] = if better { value } else { best[k] };
            slopes[0][k] = if better { p } else { slopes[0][k] };
            slopes[1][k] = if better { q } else { slopes[1][k] };
        }
    }
}
