//! Starts of the robust fit that have not seen a shadow.
//!
//! A shadow covers a connected patch of normals. Plain fits that each leave out the samples around
//! one direction are improved by least trimmed squares,
//! `min over l of the sum of the h smallest (r_i / s_i)²`, and the best few are handed on.

use super::least_squares::{Noise, SVector, Sample, predict, solve};
use super::options::{FitOptions, START_LEFT_OUT, START_QUANTILE};
use nalgebra::Vector3;
use rilievo_numerics::robust::quantile;

/// Vertices of an icosahedron.
const NUM_VERTICES: usize = 12;

/// Directions whose surroundings the starts leave out: the twelve vertices of an icosahedron, and
/// eight around the mean normal, as the normals that one photo sees are half a sphere.
fn directions(mean: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let vertex = |k: usize| {
        let a = if k & 1 == 0 { 1.0 } else { -1.0 };
        let b = if k & 2 == 0 { golden } else { -golden };
        match k / 4 {
            0 => Vector3::new(0.0, a, b),
            1 => Vector3::new(a, b, 0.0),
            _ => Vector3::new(b, 0.0, a),
        }
        .normalize()
    };
    let mut directions: Vec<Vector3<f64>> = (0..NUM_VERTICES).map(vertex).collect();
    let helper = if mean.x.abs() < 0.7 * mean.norm() {
        Vector3::x()
    } else {
        Vector3::y()
    };
    if let Some(e1) = mean.cross(&helper).try_normalize(1e-6) {
        let e2 = mean.normalize().cross(&e1);
        directions.extend((0..8).map(|k| {
            let (s, c) = (std::f64::consts::FRAC_PI_4 * f64::from(k)).sin_cos();
            e1 * c + e2 * s
        }));
    }
    directions
}

/// Steps of least trimmed squares; they settle within a few.
const NUM_TRIMS: usize = 12;

/// Refits the share of the samples that agree best, again and again; returns the trimmed cost too.
fn trim<const N: usize>(
    samples: &[Sample],
    stride: usize,
    start: SVector<N>,
    noise: Noise,
) -> Option<(f64, SVector<N>)> {
    let mut l = start;
    let mut residuals = vec![f64::INFINITY; samples.len()];
    let mut scales = vec![1.0; samples.len()];
    let mut best = None;
    for step in 0..=NUM_TRIMS {
        let mut sorted = Vec::with_capacity(samples.len() / stride + 1);
        for k in (0..samples.len()).step_by(stride) {
            let predicted = predict(&l, &samples[k]);
            scales[k] = noise.scale(predicted);
            residuals[k] = (predicted - samples[k].value).abs() / scales[k];
            sorted.push(residuals[k]);
        }
        let limit = quantile(&mut sorted, START_QUANTILE)?;
        let cost = sorted.iter().filter(|r| **r <= limit).map(|r| r * r).sum();
        best = Some((cost, l));
        if step < NUM_TRIMS {
            (_, l) = solve::<N>(samples, |k| {
                if k % stride == 0 && residuals[k] <= limit {
                    samples[k].weight / (scales[k] * scales[k])
                } else {
                    0.0
                }
            })?;
        }
    }
    best
}

/// Partial starts that are followed to the end.
const NUM_STARTS: usize = 4;

/// The best starts that leave out the samples around one direction.
pub(super) fn partial_starts<const N: usize>(
    samples: &[Sample],
    noise: Noise,
    options: &FitOptions,
) -> Option<Vec<SVector<N>>> {
    if !options.seeks_shadows || samples.len() < 20 * N {
        return Some(Vec::new());
    }
    // Two thousand samples rank the starts as well as a million.
    let stride = samples.len().div_ceil(2000);
    let few = || samples.iter().step_by(stride);
    let mean: Vector3<f64> = few().map(|s| s.normal).sum::<Vector3<f64>>() / few().count() as f64;
    let mut starts = Vec::new();
    // A shadow shaped as a wedge reaches the middle: around the mean normal, more than half of the
    // samples is left out as well.
    let wide = (1.6 * START_LEFT_OUT).min(0.6);
    let cuts = directions(&mean)
        .into_iter()
        .enumerate()
        .flat_map(|(k, direction)| {
            let also = (k >= NUM_VERTICES).then_some((direction, wide));
            std::iter::once((direction, START_LEFT_OUT)).chain(also)
        });
    for (direction, left_out) in cuts {
        let side = |s: &Sample| (s.normal - mean).dot(&direction);
        let mut sides: Vec<f64> = few().map(side).collect();
        let limit = quantile(&mut sides, 1.0 - left_out)?;
        let kept = |s: &Sample| side(s) <= limit;
        let partial = solve::<N>(samples, |k| {
            let sample = &samples[k];
            if k % stride == 0 && kept(sample) {
                sample.weight
            } else {
                0.0
            }
        });
        if let Some((_, l)) = partial {
            starts.extend(trim(samples, stride, l, noise));
        }
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    starts.truncate(NUM_STARTS);
    Some(starts.into_iter().map(|(_, l)| l).collect())
}
