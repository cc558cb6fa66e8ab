//! The environment's radiance, one value per cell and channel, from points whose intensity is
//! known: `min_{L ≥ 0, b ≥ 0} Σ w ρ(r) + λ Σ (L_k − L_k')²` over neighbouring cells, `r = (S − I) / ½ (S + I)`
//! with the intensity `S = T L + b B` and the sample's weight `w`. Where a photo is clipped `I` is a lower
//! bound: only `S < I` costs. The first solve does without such samples; each later one replaces their `I` by `max(I, S)` of the
//! solve before, a quadratic majoriser of that one-sided penalty.
//!
//! `T` is what a point sees, `B` what its surroundings send, `b` their common factor (the albedo over
//! the one contained in `L`). Solved on the normal equations by cyclic coordinate descent with
//! clipping at zero; weights are refined between solves.
//!
//! An error is a share of the mean of observed and fitted intensity. As a share of the observed one alone, points in a
//! shadow that the shape does not explain weigh most, and a light that is too dark costs least: none
//! at all misses every point by 1. `½ d(r²)/dS = (S − I) I / (½ (S + I))³` gives the weights of the normal
//! equations.

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, Mat, Par};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_numerics::robust::{RobustLoss, median};

/// One point with a known intensity.
#[derive(Clone, Debug)]
pub struct EnvironmentSample {
    /// Weight of every cell, see [`super::Transfer::row`].
    pub row: Vec<f32>,
    /// What the surroundings send.
    pub nearby: [f32; 3],
    /// Observed intensity.
    pub intensity: [f32; 3],
    /// Whether the photo is clipped there in any channel: the surface is at least as bright in all.
    pub is_clipped: bool,
    /// Relative weight of the sample.
    pub weight: f32,
}

/// The environment that explains the samples.
#[derive(Clone, Debug)]
pub struct EnvironmentFit {
    /// Radiance per cell, times albedo.
    pub radiance: Vec<[f32; 3]>,
    /// Factor of what the surroundings send.
    pub bounce: [f32; 3],
    /// Residual (RMS over the channels) of every sample, relative to the mean of observed and fitted
    /// intensity; 0 where a bound is met.
    pub residuals: Vec<f32>,
}

/// Intensity under which all is equally dark.
const MIN_INTENSITY: f64 = 1e-5;
/// Rounds of re-weighting.
const NUM_ROUNDS: usize = 5;
/// Most sweeps of coordinate descent; the smoothness keeps the system well conditioned.
const MAX_SWEEPS: usize = 150;
/// Change of a cell in a sweep, as a share of the brightest one, below which the descent ends. The surface's normals keep
/// within .01° of those after all sweeps.
const STILL: f64 = 1e-6;

/// Fits the environment whose cells lie in `directions` from the centre. `smoothness` is λ relative
/// to the mean diagonal of `TᵀT`.
///
/// `None` without unclipped samples.
pub fn fit_environment(
    samples: &[EnvironmentSample],
    directions: &[Vector3<f32>],
    smoothness: f64,
) -> Option<EnvironmentFit> {
    let count = directions.len();
    if samples.iter().all(|s| s.is_clipped) {
        return None;
    }
    let links = links(directions);
    let mut targets: Vec<[f32; 3]> = samples.iter().map(|s| s.intensity).collect();
    // What the points are lit by on average serves until there is a fit.
    let average = targets.iter().map(|&t| mean(t)).sum::<f64>() / targets.len() as f64;
    let mut fitted = vec![average; samples.len()];
    let known_at_once = samples.iter().map(|s| f64::from(u8::from(!s.is_clipped)));
    let mut robust: Vec<f64> = known_at_once.collect();
    let mut fit = EnvironmentFit {
        radiance: vec![[0.0; 3]; count],
        bounce: [0.0; 3],
        residuals: vec![0.0; samples.len()],
    };
    for _ in 0..NUM_ROUNDS {
        let weight = |i: usize| {
            let observed = mean(targets[i]);
            let typical = typical_of(observed, fitted[i]);
            f64::from(samples[i].weight) * robust[i] * observed / typical.powi(3)
        };
        let weights: Vec<f64> = (0..samples.len()).map(weight).collect();
        let mut matrix = gram(samples, &weights, count);
        let trace: f64 = (0..count).map(|k| matrix[(k, k)]).sum();
        let lambda = smoothness * trace / count as f64;
        for &(k, j) in &links {
            matrix[(k, k)] += lambda;
            matrix[(j, j)] += lambda;
            matrix[(k, j)] -= lambda;
            matrix[(j, k)] -= lambda;
        }
        let channels: Vec<(Vec<f64>, f64)> = (0..3)
            .into_par_iter()
            .map(|channel| {
                let equations = Equations::new(&matrix, (samples, &targets), &weights, channel);
                let radiance = fit.radiance.iter().map(|l| f64::from(l[channel]));
                equations.solve(radiance.collect(), f64::from(fit.bounce[channel]))
            })
            .collect();
        for (channel, (radiance, bounce)) in channels.into_iter().enumerate() {
            for (l, v) in fit.radiance.iter_mut().zip(radiance) {
                l[channel] = v as f32;
            }
            fit.bounce[channel] = bounce as f32;
        }
        for (i, sample) in samples.iter().enumerate() {
            let light = fit.intensity(sample);
            if sample.is_clipped {
                targets[i] = std::array::from_fn(|c| sample.intensity[c].max(light[c]));
            }
            fitted[i] = mean(light);
            let typical = typical_of(mean(targets[i]), fitted[i]);
            let errors = light.iter().zip(targets[i]);
            let squares = errors.map(|(l, o)| (f64::from(l - o) / typical).powi(2));
            fit.residuals[i] = (squares.sum::<f64>() / 3.0).sqrt() as f32;
        }
        let known = samples.iter().zip(&fit.residuals);
        let known = known.filter(|(sample, _)| !sample.is_clipped);
        let mut known: Vec<f64> = known.map(|(_, &r)| f64::from(r)).collect();
        // Huber at a little more than twice the median.
        let threshold = 2.25 * median(&mut known).unwrap_or(0.0).max(1e-6);
        for (w, &r) in robust.iter_mut().zip(&fit.residuals) {
            *w = RobustLoss::Huber(threshold).weight(f64::from(r));
        }
    }
    Some(fit)
}

impl EnvironmentFit {
    /// The intensity that the environment gives a sample.
    pub fn intensity(&self, sample: &EnvironmentSample) -> [f32; 3] {
        std::array::from_fn(|c| {
            let rays = sample.row.iter().zip(&self.radiance);
            let light: f32 = rays.map(|(t, l)| t * l[c]).sum();
            light + self.bounce[c] * sample.nearby[c]
        })
    }
}

fn mean(intensity: [f32; 3]) -> f64 {
    intensity.iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0
}

/// The intensity of which a sample's error is a share.
fn typical_of(observed: f64, fitted: f64) -> f64 {
    (0.5 * (observed + fitted)).max(MIN_INTENSITY)
}

/// Every direction with each of its six nearest.
fn links(directions: &[Vector3<f32>]) -> Vec<(usize, usize)> {
    let of = |(k, d): (usize, &Vector3<f32>)| {
        let mut order: Vec<usize> = (0..directions.len()).filter(|&j| j != k).collect();
        order.sort_by(|&a, &b| directions[b].dot(d).total_cmp(&directions[a].dot(d)));
        order.into_iter().take(6).map(move |j| (k, j))
    };
    directions.iter().enumerate().flat_map(of).collect()
}

/// `Σ w TᵀT`, summed over fixed chunks of samples.
fn gram(samples: &[EnvironmentSample], weights: &[f64], count: usize) -> Mat<f64> {
    const CHUNK: usize = 512;
    let chunks = samples.par_chunks(CHUNK).zip(weights.par_chunks(CHUNK));
    let parts: Vec<Mat<f64>> = chunks
        .map(|(samples, weights)| {
            let roots: Vec<f64> = weights.iter().map(|w| w.sqrt()).collect();
            let rows = Mat::from_fn(samples.len(), count, |i, k| {
                roots[i] * f64::from(samples[i].row[k])
            });
            let mut part = Mat::zeros(count, count);
            matmul(
                part.as_mut(),
                BlockStructure::TriangularLower,
                Accum::Replace,
                rows.transpose(),
                BlockStructure::Rectangular,
                rows.as_ref(),
                BlockStructure::Rectangular,
                1.0,
                Par::Seq,
            );
            part
        })
        .collect();
    let mut total = Mat::zeros(count, count);
    for part in parts {
        total += part;
    }
    for k in 0..count {
        for j in 0..k {
            total[(j, k)] = total[(k, j)];
        }
    }
    total
}

/// Normal equations of a channel: of its radiances `x` and of the factor `b` of what the surroundings send.
struct Equations<'a> {
    matrix: &'a Mat<f64>,
    rhs: Vec<f64>,
    /// Of `x` with `b`.
    cross: Vec<f64>,
    bounce_square: f64,
    bounce_rhs: f64,
}

impl<'a> Equations<'a> {
    fn new(
        matrix: &'a Mat<f64>,
        (samples, targets): (&[EnvironmentSample], &[[f32; 3]]),
        weights: &[f64],
        channel: usize,
    ) -> Self {
        let count = matrix.ncols();
        let mut out = Self {
            matrix,
            rhs: vec![0.0; count],
            cross: vec![0.0; count],
            bounce_square: 0.0,
            bounce_rhs: 0.0,
        };
        for ((sample, target), &w) in samples.iter().zip(targets).zip(weights) {
            let b = f64::from(sample.nearby[channel]);
            let y = f64::from(target[channel]);
            out.bounce_square += w * b * b;
            out.bounce_rhs += w * b * y;
            add_scaled(&mut out.rhs, w * y, &sample.row);
            add_scaled(&mut out.cross, w * b, &sample.row);
        }
        out
    }

    /// Non-negative `x` and `b`, from a start.
    fn solve(&self, mut x: Vec<f64>, mut b: f64) -> (Vec<f64>, f64) {
        let column = |k: usize| self.matrix.col_as_slice(k);
        // Rest of the equations of x.
        let mut rest = self.rhs.clone();
        add_scaled(&mut rest, -b, &self.cross);
        for (k, &value) in x.iter().enumerate() {
            add_scaled(&mut rest, -value, column(k));
        }
        for _ in 0..MAX_SWEEPS {
            let (mut largest_change, mut largest) = (0.0_f64, 0.0_f64);
            for k in 0..x.len() {
                let own = column(k)[k] + 1e-12;
                let value = (x[k] + rest[k] / own).max(0.0);
                let change = value - x[k];
                if change != 0.0 {
                    x[k] = value;
                    add_scaled(&mut rest, -change, column(k));
                }
                largest_change = largest_change.max(change.abs());
                largest = largest.max(value);
            }
            if self.bounce_square > 0.0 {
                let light: f64 = self.cross.iter().zip(&x).map(|(a, x)| a * x).sum();
                let value = ((self.bounce_rhs - light) / self.bounce_square).max(0.0);
                add_scaled(&mut rest, b - value, &self.cross);
                b = value;
            }
            if largest_change <= STILL * largest {
                break;
            }
        }
        (x, b)
    }
}

/// `to += factor values`.
fn add_scaled<T: Copy + Into<f64>>(to: &mut [f64], factor: f64, values: &[T]) {
    for (t, &v) in to.iter_mut().zip(values) {
        *t += factor * v.into();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a sphere under a sky, without bounce, from which some of the rays are hidden.
    fn sphere_under_sky(
        rays: &[Vector3<f32>],
        is_hidden: impl Fn(usize, &Vector3<f32>) -> bool,
    ) -> Vec<EnvironmentSample> {
        let sky: Vec<f32> = rays.iter().map(|d| (1.5 * d.y + 0.4).max(0.0)).collect();
        let normals = super::super::directions(700).into_iter().enumerate();
        normals
            .map(|(i, n)| {
                let scale = 4.0 / rays.len() as f32;
                let cosine = |d: &Vector3<f32>| n.dot(d).max(0.0);
                let seen = |d| {
                    if is_hidden(i, d) {
                        0.0
                    } else {
                        cosine(d) * scale
                    }
                };
                let row: Vec<f32> = rays.iter().map(seen).collect();
                let light: f32 = row.iter().zip(&sky).map(|(t, l)| t * l).sum();
                EnvironmentSample {
                    row,
                    nearby: [0.0; 3],
                    intensity: [light; 3],
                    is_clipped: false,
                    weight: 1.0,
                }
            })
            .collect()
    }

    #[test]
    fn a_known_sky_and_bounce_are_found_again() {
        let rays = super::super::directions(48);
        // Part of the sky is hidden from every second point, which gets bounce instead.
        let mut samples = sphere_under_sky(&rays, |i, d| i % 2 == 0 && d.x > 0.3);
        for (i, sample) in samples.iter_mut().enumerate() {
            let nearby = if i % 2 == 0 { 0.2 } else { 0.05 };
            sample.nearby = [nearby; 3];
            sample.intensity = sample.intensity.map(|light| light + 0.8 * nearby);
        }
        let fit = fit_environment(&samples, &rays, 1e-5);
        let Some(fit) = fit else { panic!("no fit") };
        assert!((fit.bounce[1] - 0.8).abs() < 0.15, "{:?}", fit.bounce);
        let worst = fit.residuals.iter().copied().fold(0.0, f32::max);
        let mean = fit.residuals.iter().sum::<f32>() / fit.residuals.len() as f32;
        assert!(mean < 0.02, "mean {mean}, worst {worst}");
        assert!(fit.radiance.iter().flatten().all(|&l| l >= 0.0));
        assert!(fit_environment(&[], &rays, 1e-3).is_none());
    }

    #[test]
    fn clipped_samples_are_at_least_as_bright() {
        let rays = super::super::directions(48);
        let truth = sphere_under_sky(&rays, |_, _| false);
        let mut sorted: Vec<f32> = truth.iter().map(|s| s.intensity[0]).collect();
        sorted.sort_by(f32::total_cmp);
        let limit = sorted[sorted.len() * 6 / 10];
        let mut samples = truth.clone();
        for (i, sample) in samples.iter_mut().enumerate() {
            let noise = 1.0 + 0.07 * (i as f32 * 2.4).sin();
            sample.is_clipped = sample.intensity[0] > limit;
            sample.intensity = sample.intensity.map(|v| (noise * v).min(limit));
        }
        // Mean of what the clipped ones are rendered as, over what they are.
        let rendered = |fitted_on: &[EnvironmentSample]| {
            let Some(fit) = fit_environment(fitted_on, &rays, 1e-3) else {
                panic!("no fit")
            };
            let clipped = truth.iter().zip(&samples).filter(|(_, s)| s.is_clipped);
            let ratios = clipped.map(|(t, _)| fit.intensity(t)[0] / t.intensity[0]);
            ratios.clone().sum::<f32>() / ratios.count() as f32
        };
        let as_values = samples.iter().map(|s| EnvironmentSample {
            is_clipped: false,
            ..s.clone()
        });
        let as_values: Vec<_> = as_values.collect();
        let unclipped: Vec<_> = samples.iter().filter(|s| !s.is_clipped).cloned().collect();
        let [bounds, left_out, values] =
            [&samples, &unclipped, &as_values].map(|fitted_on| rendered(fitted_on));
        eprintln!("as bounds {bounds}, left out {left_out}, as values {values}");
        assert!(bounds > left_out && bounds > values + 0.05);
        let clipped: Vec<_> = samples.into_iter().filter(|s| s.is_clipped).collect();
        assert!(fit_environment(&clipped, &rays, 1e-3).is_none());
    }

    #[test]
    fn products_are_those_of_the_sums() {
        let rays = super::super::directions(20);
        // More than a chunk.
        let samples = sphere_under_sky(&rays, |i, d| i % 3 == 0 && d.y > 0.0);
        let weights: Vec<f64> = (0..samples.len()).map(|i| 0.1 + (i % 5) as f64).collect();
        let products = gram(&samples, &weights, rays.len());
        for a in 0..rays.len() {
            for b in 0..rays.len() {
                let terms = samples.iter().zip(&weights);
                let sum: f64 = terms
                    .map(|(s, w)| w * f64::from(s.row[a]) * f64::from(s.row[b]))
                    .sum();
                assert!((products[(a, b)] - sum).abs() <= 1e-12 * sum.max(1.0));
            }
        }
    }

    /// At a minimum the gradient is nothing where a radiance is positive, and leads below zero elsewhere.
    #[test]
    fn a_descent_ends_where_the_gradient_allows_no_step() {
        let rays = super::super::directions(48);
        let mut samples = sphere_under_sky(&rays, |_, _| false);
        for (i, sample) in samples.iter_mut().enumerate() {
            sample.nearby = [0.1 * (i % 4) as f32; 3];
        }
        let weights = vec![1.0; samples.len()];
        let mut matrix = gram(&samples, &weights, rays.len());
        // As much as smoothness adds.
        for k in 0..rays.len() {
            matrix[(k, k)] *= 1.01;
        }
        let targets: Vec<[f32; 3]> = samples.iter().map(|s| s.intensity).collect();
        let equations = Equations::new(&matrix, (&samples, &targets), &weights, 1);
        let (x, b) = equations.solve(vec![0.0; rays.len()], 0.0);
        assert!(x.contains(&0.0) && x.iter().any(|&x| x > 0.0));
        let scale = equations.rhs.iter().copied().fold(0.0, f64::max);
        for k in 0..rays.len() {
            let product: f64 = (0..rays.len()).map(|j| matrix[(k, j)] * x[j]).sum();
            let rest = equations.rhs[k] - equations.cross[k] * b - product;
            let share = if x[k] > 0.0 { rest.abs() } else { rest } / scale;
            assert!(share < 5e-4, "cell {k}: {share}");
        }
    }

    /// A quarter of the points lie in a shadow that nothing explains.
    #[test]
    fn unexplained_shadow_does_not_darken_the_light() {
        let rays = super::super::directions(48);
        let mut samples = sphere_under_sky(&rays, |_, _| false);
        for sample in samples.iter_mut().step_by(4) {
            sample.intensity = sample.intensity.map(|light| 0.02 * light);
        }
        let Some(fit) = fit_environment(&samples, &rays, 1e-3) else {
            panic!("no fit")
        };
        let lit = samples.iter().enumerate().filter(|(i, _)| i % 4 != 0);
        let mut ratios: Vec<f64> = lit
            .map(|(_, s)| f64::from(fit.intensity(s)[1] / s.intensity[1]))
            .collect();
        let median = rilievo_numerics::robust::median(&mut ratios).unwrap_or(0.0);
        assert!(
            (median - 1.0).abs() < 0.15,
            "rendered {median} of the lit points"
        );
    }
}
