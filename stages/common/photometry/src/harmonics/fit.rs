//! Robust weighted least squares for harmonics.
//!
//! # Problem
//! `min over l of Σ_i w_i ρ(r_i / (s_i σ))`, `r_i = l · h(n_i) − I_i`, for each channel by itself:
//! samples `i` with unit normals `n_i`, intensities `I_i`, weights `w_i`. What disturbs (photon
//! noise, texture, bounce light) grows with brightness, so residuals are measured in
//! `s_i = max(l · h(n_i) / mean I, 0.3)`; `σ` is their scale at mean brightness (1.4826
//! times the median of `|r_i| / s_i`).
//!
//! # Steps
//! 1. Iteratively re-weighted least squares on all samples, first Huber (convex), then
//!    Geman–McClure (redescending), then Tukey's biweight: a whole patch of gross errors pulls
//!    even with small weights, so they end at none.
//! 2. A shadow covers a connected patch of normals, which the fit of step 1 bends to explain.
//!    So there are further starts: plain fits that each leave out the samples around one of
//!    twenty directions, of which one has hardly seen the patch, each improved by least trimmed
//!    squares (refitting the six tenths of the samples that agree best). The best few go
//!    through the redescending phase alone, as a convex one would forget the start. Of all
//!    results the one with the smallest truncated cost at a common scale is taken.
//! 3. Conditioning of the columns scaled to unit length. Where nine coefficients cannot be
//!    separated (few or nearly parallel normals), four are fitted instead.
//! 4. Covariance `σ² (Σ w h hᵀ / s²)⁻¹` with the final weights.

use super::least_squares::{Noise, SVector, Sample, predict, solve};
use super::options::{FitOptions, HUBER_SIGMAS, NOISE_FLOOR, REDESCENDING_SIGMAS};
use super::reading::Reading;
use super::starts::partial_starts;
use nalgebra::{DMatrix, SMatrix, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::{RobustLoss, SIGMA_FROM_MAD, median, tukey_weight};
use rilievo_scene::{Lighting, SphericalHarmonics};
use serde::{Deserialize, Serialize};

/// Why no lighting could be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Not enough samples.
    #[error("{available} usable samples, at least {needed} are needed")]
    TooFewSamples {
        /// Samples with a positive weight.
        available: usize,
        /// What is needed.
        needed: usize,
    },
    /// The normals do not determine even four coefficients.
    #[error("normals too much alike: condition number {condition:.1e} for four coefficients")]
    Degenerate {
        /// Condition number of the four-column problem.
        condition: f64,
    },
    /// A sample is NaN or infinite.
    #[error("sample {sample_idx} is not a finite number")]
    NotFinite {
        /// Its index.
        sample_idx: usize,
    },
    /// Slices of different lengths.
    #[error("{normals} normals but {values} values")]
    Lengths {
        /// Number of normals.
        normals: usize,
        /// Number of intensities or weights.
        values: usize,
    },
}

/// One channel's coefficients with how far to trust them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HarmonicsFit {
    /// The coefficients; the last five are 0 where only four were fitted.
    pub coefficients: SphericalHarmonics,
    /// Order that was fitted, 1 or 2.
    pub order: u8,
    /// Samples with a positive weight.
    pub num_samples: usize,
    /// Scale of the residuals at mean brightness (from their median absolute value), in intensity.
    pub sigma: f64,
    /// Root mean square of the residuals of the samples within three `sigma`, relative to the root
    /// mean square of the intensities.
    pub relative_rms: f64,
    /// Share of samples within three `sigma`.
    pub inlier_share: f64,
    /// Condition number of the columns that were fitted, scaled to unit length.
    pub condition: f64,
    /// Covariance of the coefficients, 9 by 9 row by row; zero rows where not fitted. It holds
    /// for independent samples; correlated model errors make the true one larger.
    pub covariance: Vec<f64>,
}

/// All channels of a lighting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightingFit {
    /// One fit per channel.
    pub channels: Vec<HarmonicsFit>,
}

impl LightingFit {
    /// The coefficients alone.
    pub fn lighting(&self) -> Lighting {
        Lighting {
            channels: self.channels.iter().map(|fit| fit.coefficients).collect(),
        }
    }

    /// Relative residual of all channels together (root mean square).
    pub fn relative_rms(&self) -> f64 {
        let sum: f64 = self.channels.iter().map(|f| f.relative_rms.powi(2)).sum();
        (sum / self.channels.len().max(1) as f64).sqrt()
    }
}

/// Fits one channel.
///
/// # Shapes
/// `intensities`, and `weights` where given, have one entry per normal. A weight of 0 leaves a
/// sample out.
///
/// # Errors
/// See [`FitError`].
pub fn fit_robust(
    normals: &[Vector3<f64>],
    intensities: &[f64],
    weights: Option<&[f64]>,
) -> Result<HarmonicsFit, FitError> {
    fit_with(normals, intensities, weights, &FitOptions::THOROUGH)
}

/// [`fit_robust`] of another kind.
pub(crate) fn fit_with(
    normals: &[Vector3<f64>],
    intensities: &[f64],
    weights: Option<&[f64]>,
    options: &FitOptions,
) -> Result<HarmonicsFit, FitError> {
    for values in [Some(intensities), weights].into_iter().flatten() {
        if values.len() != normals.len() {
            return Err(FitError::Lengths {
                normals: normals.len(),
                values: values.len(),
            });
        }
    }
    let samples = collect_samples(normals, intensities, weights)?;
    let order_two = (samples.len() >= 9)
        .then(|| fit_order::<9>(&samples, options))
        .flatten()
        .filter(|fit| fit.condition <= options.max_condition);
    if let Some(fit) = order_two {
        return Ok(fit);
    }
    if samples.len() < 4 {
        return Err(FitError::TooFewSamples {
            available: samples.len(),
            needed: 4,
        });
    }
    match fit_order::<4>(&samples, options) {
        Some(fit) if fit.condition <= options.max_condition => Ok(fit),
        Some(fit) => Err(FitError::Degenerate {
            condition: fit.condition,
        }),
        None => Err(FitError::Degenerate {
            condition: f64::INFINITY,
        }),
    }
}

/// Fits every channel.
///
/// # Errors
/// As [`fit_robust`], for the first channel that fails.
pub fn fit_lighting(readings: &[Reading]) -> Result<LightingFit, FitError> {
    let num_channels = readings.first().map_or(1, |reading| reading.values.len());
    let normals: Vec<Vector3<f64>> = readings.iter().map(|reading| reading.normal).collect();
    let channels = (0..num_channels)
        .into_par_iter()
        .map(|channel| {
            let values: Vec<f64> = readings.iter().map(|r| r.values[channel]).collect();
            let usable = readings.iter().map(|r| r.usable[channel]);
            let weights: Vec<f64> = usable.map(|flag| f64::from(u8::from(flag))).collect();
            fit_robust(&normals, &values, Some(&weights))
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(LightingFit { channels })
}

fn collect_samples(
    normals: &[Vector3<f64>],
    intensities: &[f64],
    weights: Option<&[f64]>,
) -> Result<Vec<Sample>, FitError> {
    let mut samples = Vec::with_capacity(normals.len());
    for (sample_idx, (normal, &value)) in normals.iter().zip(intensities).enumerate() {
        let weight = weights.map_or(1.0, |w| w[sample_idx]);
        if weight == 0.0 {
            continue;
        }
        if !(normal.iter().all(|v| v.is_finite()) && value.is_finite() && weight > 0.0) {
            return Err(FitError::NotFinite { sample_idx });
        }
        samples.push(Sample {
            normal: *normal,
            basis: SphericalHarmonics::basis(normal),
            value,
            weight,
        });
    }
    Ok(samples)
}

/// Residual scale below which data count as exact, relative to the mean intensity; it keeps the
/// robust weights finite on exact data.
const EXACT: f64 = 1e-9;

fn fit_order<const N: usize>(samples: &[Sample], options: &FitOptions) -> Option<HarmonicsFit> {
    let mean = samples.iter().map(|s| s.value.abs()).sum::<f64>() / samples.len() as f64;
    let noise = Noise {
        mean: mean.max(f64::MIN_POSITIVE),
        floor: NOISE_FLOOR,
    };
    let (_, all) = solve::<N>(samples, |k| samples[k].weight)?;
    let mut results = vec![iterate(samples, all, 0, noise, options)?];
    for start in partial_starts::<N>(samples, noise, options)? {
        results.extend(iterate(samples, start, 1, noise, options));
    }
    let common = results
        .iter()
        .map(|r| r.sigma)
        .fold(f64::INFINITY, f64::min);
    let truncated = |r: &Iterated<N>| -> f64 {
        let costs = r.scaled.iter().zip(samples);
        costs
            .map(|(d, s)| s.weight * (d / common).powi(2).min(TRUNCATION * TRUNCATION))
            .sum()
    };
    // The fit on all samples stands unless another is clearly better.
    let mut best = (0.98 * truncated(&results[0]), 0);
    for (k, result) in results.iter().enumerate().skip(1) {
        let cost = truncated(result);
        if cost < best.0 {
            best = (cost, k);
        }
    }
    let Iterated {
        l,
        sigma,
        scaled,
        normal_matrix,
    } = results.swap_remove(best.1);
    let mut coefficients = [0.0; 9];
    coefficients[..N].copy_from_slice(l.as_slice());
    let inverse = DMatrix::from_fn(N, N, |r, c| normal_matrix[(r, c)]).try_inverse()?;
    let mut covariance = vec![0.0; 81];
    for row in 0..N {
        for column in 0..N {
            covariance[row * 9 + column] = sigma * sigma * inverse[(row, column)];
        }
    }
    let inliers: Vec<usize> = (0..samples.len())
        .filter(|&k| scaled[k] <= 3.0 * sigma)
        .collect();
    let (mut error, mut total) = (0.0, 0.0);
    for &k in &inliers {
        error += (predict(&l, &samples[k]) - samples[k].value).powi(2);
        total += samples[k].value * samples[k].value;
    }
    Some(HarmonicsFit {
        coefficients: SphericalHarmonics(coefficients),
        order: if N == 9 { 2 } else { 1 },
        num_samples: samples.len(),
        sigma,
        relative_rms: (error / total.max(f64::MIN_POSITIVE)).sqrt(),
        inlier_share: inliers.len() as f64 / samples.len() as f64,
        condition: condition(&normal_matrix),
        covariance,
    })
}

/// Result of the re-weighted iteration from one start.
struct Iterated<const N: usize> {
    l: SVector<N>,
    sigma: f64,
    /// Absolute residuals over their scale.
    scaled: Vec<f64>,
    /// Normal matrix with the last weights: those of the covariance.
    normal_matrix: SMatrix<f64, N, N>,
}

/// Residuals count up to this many deviations when results are compared.
const TRUNCATION: f64 = 3.0;

fn iterate<const N: usize>(
    samples: &[Sample],
    start: SVector<N>,
    first_phase: usize,
    noise: Noise,
    options: &FitOptions,
) -> Option<Iterated<N>> {
    let mut l = start;
    let mut scaled = vec![0.0; samples.len()];
    let mut scales = vec![1.0; samples.len()];
    let mut sorted = Vec::with_capacity(samples.len());
    let mut measure = |l: &SVector<N>, scaled: &mut [f64], scales: &mut [f64]| {
        for ((residual, scale), sample) in scaled.iter_mut().zip(scales).zip(samples) {
            let predicted = predict(l, sample);
            *scale = noise.scale(predicted);
            *residual = (predicted - sample.value).abs() / *scale;
        }
        sorted.clear();
        sorted.extend_from_slice(scaled);
        Some((SIGMA_FROM_MAD * median(&mut sorted)?).max(EXACT * noise.mean))
    };
    let mut sigma = measure(&l, &mut scaled, &mut scales)?;
    let mut normal_matrix = SMatrix::<f64, N, N>::zeros();
    for phase in first_phase..3 {
        for _ in 0..options.max_num_iterations {
            let weight = |k: usize| {
                let r = scaled[k] / sigma;
                let robust = match phase {
                    0 => RobustLoss::Huber(HUBER_SIGMAS).weight(r),
                    1 => RobustLoss::GemanMcClure(REDESCENDING_SIGMAS).weight(r),
                    _ => tukey_weight(r / (1.5 * REDESCENDING_SIGMAS)),
                };
                samples[k].weight * robust / (scales[k] * scales[k])
            };
            let (matrix, next) = solve::<N>(samples, weight)?;
            let change = (next - l).norm();
            normal_matrix = matrix;
            l = next;
            sigma = measure(&l, &mut scaled, &mut scales)?;
            if change <= 1e-6 * l.norm() {
                break;
            }
        }
    }
    Some(Iterated {
        l,
        sigma,
        scaled,
        normal_matrix,
    })
}

/// Condition number of the design matrix with columns of unit length.
fn condition<const N: usize>(normal_matrix: &SMatrix<f64, N, N>) -> f64 {
    let scaled = DMatrix::from_fn(N, N, |r, c| {
        normal_matrix[(r, c)] / (normal_matrix[(r, r)] * normal_matrix[(c, c)]).sqrt()
    });
    if scaled.iter().any(|v| !v.is_finite()) {
        return f64::INFINITY;
    }
    let eigenvalues = scaled.symmetric_eigenvalues();
    let (smallest, largest) = (eigenvalues.min(), eigenvalues.max());
    if smallest <= 0.0 {
        return f64::INFINITY;
    }
    (largest / smallest).sqrt()
}
