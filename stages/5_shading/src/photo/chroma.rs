//! Brightness and chroma of what the light leaves, each in units of its own noise.
//!
//! With residuals relative to the intensity, `u_c = l·h(n)/Ĩ_c − 1`, brightness `m = mean_c u_c` holds
//! what a light model misses: shadow, bounce and speckle of the albedo change all channels together.
//! Chroma `d = (u_r − u_g, u_b − u_g)` is spared most of it and keeps little but the photos' own noise.
//! Light whose colour varies with direction puts the normal into it all the same, above all the tilt
//! across the gradient of brightness, on which brightness does not depend. So
//!
//! `v = (m/σ_s, C^(−1/2) d / k)`
//!
//! has three independent components of unit variance. `C` is measured from `d` less its mean over a
//! Gaussian: median absolute deviations, and the correlation of clipped values. `k` is the factor by which
//! brightness, too, is held tighter or looser than its residual.

use rilievo_numerics::robust::{SIGMA_FROM_MAD, median};
use rilievo_stereo::level::LevelView;
use serde::{Deserialize, Serialize};

/// Chroma noise below which rounding to eight bits would be taken for a signal.
const MIN_NOISE: f64 = 2e-3;
/// Deviations, in standard deviations, at which pixels are clipped for the correlation.
const CLIP: f64 = 2.5;
/// Largest correlation of the two components: beyond it the covariance is nearly singular.
const MAX_CORRELATION: f64 = 0.95;

/// Red less green, and blue less green.
#[inline]
pub(crate) fn chroma(u: [f32; 3]) -> [f32; 2] {
    [u[0] - u[1], u[2] - u[1]]
}

/// What the photos' own noise and the light's colour leave in chroma.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ChromaNoise {
    /// Standard deviations of both components.
    pub sigma: [f64; 2],
    /// Their correlation.
    pub correlation: f64,
}

impl ChromaNoise {
    /// From the chroma of a view's pixels less its slow part.
    pub fn measure(view: &LevelView, local: &[[f32; 2]]) -> Self {
        let used: Vec<[f64; 2]> = (0..local.len())
            .filter(|&i| view.shows_surface(i))
            .map(|i| local[i].map(f64::from))
            .collect();
        let sigma = [0, 1].map(|k| {
            let mut sizes: Vec<f64> = used.iter().map(|d| d[k].abs()).collect();
            (SIGMA_FROM_MAD * median(&mut sizes).unwrap_or(0.0)).max(MIN_NOISE)
        });
        let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
        for d in &used {
            let [a, b] = [0, 1].map(|k| (d[k] / sigma[k]).clamp(-CLIP, CLIP));
            aa += a * a;
            ab += a * b;
            bb += b * b;
        }
        let correlation =
            (ab / (aa * bb).sqrt().max(1e-12)).clamp(-MAX_CORRELATION, MAX_CORRELATION);
        Self { sigma, correlation }
    }

    /// Medians over several parts of one view; none where there is no part.
    pub fn median_of(parts: &[Self]) -> Option<Self> {
        let middle =
            |of: &dyn Fn(&Self) -> f64| median(&mut parts.iter().map(of).collect::<Vec<f64>>());
        Some(Self {
            sigma: [middle(&|n| n.sigma[0])?, middle(&|n| n.sigma[1])?],
            correlation: middle(&|n| n.correlation)?,
        })
    }
}

/// Rows that turn relative residuals of the channels into `v`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Whitening {
    rows: [[f64; 3]; 3],
}

impl Whitening {
    /// From brightness' standard deviation and the noise of chroma, scaled by the factor `share`, the `k` above.
    pub fn of_noise(sigma: f64, noise: &ChromaNoise, share: f64) -> Self {
        Self::new(sigma, noise.sigma.map(|n| n * share), noise.correlation)
    }

    /// From standard deviations of brightness and of both chroma components, and their correlation.
    pub fn new(sigma: f64, noise: [f64; 2], correlation: f64) -> Self {
        let mean = 1.0 / (3.0 * sigma);
        let [a, b] = noise.map(|n| 1.0 / n);
        // Inverse of the covariance's Cholesky factor.
        let rest = 1.0 / (1.0 - correlation * correlation).sqrt();
        let (from_first, from_second) = (-rest * correlation * a, rest * b);
        Self {
            rows: [
                [mean; 3],
                [a, -a, 0.0],
                [from_first, -from_first - from_second, from_second],
            ],
        }
    }

    /// Brightness, and two components of chroma.
    #[inline]
    pub fn of(&self, u: [f64; 3]) -> [f64; 3] {
        self.rows.map(|r| r[0] * u[0] + r[1] * u[1] + r[2] * u[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitened_noise_has_unit_variance_and_no_correlation() {
        let mut state = 11_u64;
        let mut next = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / (1u64 << 24) as f64 - 0.5
        };
        // Uniform noise of width one has variance 1/12.
        let unit = 12.0_f64.sqrt();
        let whitening = Whitening::new(0.05, [0.01, 0.02], 0.6);
        let (mut moments, count) = ([[0.0; 3]; 3], 200_000);
        for _ in 0..count {
            let [m, a, b] = [next() * unit, next() * unit, next() * unit];
            let red = 0.01 * a;
            let blue = 0.02 * (0.6 * a + 0.8 * b);
            // Green so that the channels' mean is the brightness.
            let green = 0.05 * m - (red + blue) / 3.0;
            let v = whitening.of([green + red, green, green + blue]);
            for i in 0..3 {
                for j in 0..3 {
                    moments[i][j] += v[i] * v[j] / f64::from(count);
                }
            }
        }
        for (i, row) in moments.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((value - expected).abs() < 0.02, "{moments:?}");
            }
        }
    }

    #[test]
    fn brightness_alone_leaves_chroma_at_zero() {
        let v = Whitening::new(0.02, [0.01, 0.01], -0.3).of([0.04; 3]);
        assert!((v[0] - 2.0).abs() < 1e-12, "{v:?}");
        assert!(v[1].abs() < 1e-12 && v[2].abs() < 1e-12, "{v:?}");
    }
}
