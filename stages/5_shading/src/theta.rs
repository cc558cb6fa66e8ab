//! θ-step: the shading term, pixel by pixel.
//!
//! **Problem.** At every pixel, for the slopes `θ = (p, q)`,
//!
//! ```text
//! min_θ  w Σ_c (S_c(θ) − I_c)² + ν d(θ) + β/2 |θ − t|²,      t = ∇y + u,
//! ```
//!
//! `S` the model of [`crate::model`], `d` the facet's area, `u` the scaled dual. Two unknowns, a few
//! damped Gauss-Newton steps from the current `θ`; a step that does not lower the term is undone
//! and the damping raised. A far start is first replaced by the best of a fixed set of normals.
//!
//! [`scalar_step`] is the readable version and the oracle of the tests. [`theta_step`] treats
//! [`LANES`] pixels at once without branches, so that the compiler emits vector code, and is chosen
//! for the processor at run time.
//!
//! Source: METHOD 4; eq. 11 of the paper with the shading term whole instead of linearised.

// Arrays of lanes are indexed in parallel: zipped iterators would hide the lane.
#![allow(clippy::needless_range_loop)]

use crate::model::Facet;
use crate::pixels::{Coefficients, LANES, Pixels};
use rayon::prelude::*;

/// Damping of the first Gauss-Newton step, in squared intensity units of the Jacobian.
const FIRST_DAMPING: f32 = 1e-4;
/// Pixels per parallel task.
const TASK_LEN: usize = 256 * LANES;

/// What the θ-step minimises, beside the pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThetaTerms {
    /// Penalty β.
    pub(crate) beta: f32,
    /// Weight ν of the area.
    pub(crate) area: f32,
    /// Gauss-Newton steps.
    pub(crate) num_steps: usize,
}

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
                .flat_map(|&n| rows.iter().map(move |l| crate::model::harmonics(l, n).0))
                .collect(),
            Coefficients::PerPixel(_) => Vec::new(),
        };
        Self { normals, shading }
    }
}

/// Value and Gauss-Newton model of a pixel's term.
#[derive(Clone, Copy)]
struct Quadratic {
    value: f32,
    gradient: [f32; 2],
    // Upper triangle.
    hessian: [f32; 3],
}

#[inline(always)]
fn quadratic<const C: usize>(
    light: &[[f32; 9]; C],
    intensity: &[f32; C],
    weight: f32,
    ray: [f32; 2],
    target: [f32; 2],
    terms: &ThetaTerms,
    slopes: [f32; 2],
) -> Quadratic {
    let half = 0.5 * terms.beta;
    let facet = Facet::new(ray, slopes);
    let away = [slopes[0] - target[0], slopes[1] - target[1]];
    let mut value = half * (away[0] * away[0] + away[1] * away[1]);
    let mut g = [half * away[0], half * away[1]];
    let mut h = [half, 0.0, half];
    let mut c = 0;
    while c < C {
        let (shade, j) = facet.shade(&light[c]);
        let r = shade - intensity[c];
        value += weight * r * r;
        g[0] += weight * j[0] * r;
        g[1] += weight * j[1] * r;
        h[0] += weight * j[0] * j[0];
        h[1] += weight * j[0] * j[1];
        h[2] += weight * j[1] * j[1];
        c += 1;
    }
    if terms.area > 0.0 {
        // ∇²d = (I + ray rayᵀ − ∇d ∇dᵀ)/d is positive semi-definite.
        let (d, e) = (facet.length(), facet.length_gradient());
        let scale = 0.5 * terms.area;
        value += terms.area * d;
        g[0] += scale * e[0];
        g[1] += scale * e[1];
        let by = scale / d;
        h[0] += by * (1.0 + ray[0] * ray[0] - e[0] * e[0]);
        h[1] += by * (ray[0] * ray[1] - e[0] * e[1]);
        h[2] += by * (1.0 + ray[1] * ray[1] - e[1] * e[1]);
    }
    Quadratic {
        value,
        gradient: g,
        hessian: h,
    }
}

/// Slopes after one damped Gauss-Newton step.
#[inline(always)]
fn trial_step(slopes: [f32; 2], model: &Quadratic, damping: f32) -> [f32; 2] {
    let (a, b, d) = (
        model.hessian[0] + damping,
        model.hessian[1],
        model.hessian[2] + damping,
    );
    let inverse = 1.0 / (a * d - b * b);
    let [g0, g1] = model.gradient;
    [
        slopes[0] - (d * g0 - b * g1) * inverse,
        slopes[1] - (a * g1 - b * g0) * inverse,
    ]
}

/// `new` where a step is accepted, else `old`.
#[inline(always)]
fn pick(accept: bool, new: f32, old: f32) -> f32 {
    if accept { new } else { old }
}

/// Damping after a step.
#[inline(always)]
fn next_damping(accept: bool, damping: f32) -> f32 {
    pick(accept, 0.3 * damping, 10.0 * damping + FIRST_DAMPING)
}

/// One pixel: the version to read.
#[cfg(test)]
pub(crate) fn scalar_step(
    pixels: &Pixels,
    k: usize,
    target: [f32; 2],
    start: [f32; 2],
    terms: &ThetaTerms,
) -> [f32; 2] {
    fn solve<const C: usize>(
        pixels: &Pixels,
        k: usize,
        target: [f32; 2],
        start: [f32; 2],
        terms: &ThetaTerms,
    ) -> [f32; 2] {
        let light: [[f32; 9]; C] = std::array::from_fn(|c| pixels.light(c, k));
        let intensity: [f32; C] = std::array::from_fn(|c| pixels.intensity[c * pixels.padded + k]);
        let ray = [pixels.ray_x[k], pixels.ray_y[k]];
        let evaluate = |slopes| {
            quadratic(
                &light,
                &intensity,
                pixels.weight[k],
                ray,
                target,
                terms,
                slopes,
            )
        };
        let (mut slopes, mut damping) = (start, FIRST_DAMPING);
        let mut model = evaluate(slopes);
        for _ in 0..terms.num_steps {
            let trial = trial_step(slopes, &model, damping);
            let at_trial = evaluate(trial);
            let accept = at_trial.value <= model.value;
            if accept {
                (slopes, model) = (trial, at_trial);
            }
            damping = next_damping(accept, damping);
        }
        slopes
    }
    if pixels.channels == 1 {
        solve::<1>(pixels, k, target, start, terms)
    } else {
        solve::<3>(pixels, k, target, start, terms)
    }
}

/// Minimises the term of every pixel, starting at and writing to `(p, q)`.
///
/// # Shapes
/// All arrays have the padded length of `pixels`. Returns `Σ w |S(θ) − I|²`.
pub(crate) fn theta_step(
    pixels: &Pixels,
    target: (&[f32], &[f32]),
    terms: &ThetaTerms,
    candidates: Option<&Candidates>,
    p: &mut [f32],
    q: &mut [f32],
) -> f64 {
    let task = |(task, (p, q)): (usize, (&mut [f32], &mut [f32]))| {
        let first = task * TASK_LEN;
        if pixels.channels == 1 {
            dispatch::<1>(pixels, first, target, terms, candidates, p, q)
        } else {
            dispatch::<3>(pixels, first, target, terms, candidates, p, q)
        }
    };
    let sums: Vec<f64> = if pixels.padded <= 2 * TASK_LEN {
        p.chunks_mut(TASK_LEN)
            .zip(q.chunks_mut(TASK_LEN))
            .enumerate()
            .map(task)
            .collect()
    } else {
        p.par_chunks_mut(TASK_LEN)
            .zip(q.par_chunks_mut(TASK_LEN))
            .enumerate()
            .map(task)
            .collect()
    };
    sums.iter().sum()
}

/// The kernel compiled for the widest vectors of this processor.
fn dispatch<const C: usize>(
    pixels: &Pixels,
    first: usize,
    target: (&[f32], &[f32]),
    terms: &ThetaTerms,
    candidates: Option<&Candidates>,
    p: &mut [f32],
    q: &mut [f32],
) -> f64 {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn wide<const C: usize>(
            pixels: &Pixels,
            first: usize,
            target: (&[f32], &[f32]),
            terms: &ThetaTerms,
            candidates: Option<&Candidates>,
            p: &mut [f32],
            q: &mut [f32],
        ) -> f64 {
            blocks::<C>(pixels, first, target, terms, candidates, p, q)
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the processor has the features that the function is compiled for.
            #[allow(unsafe_code)]
            return unsafe { wide::<C>(pixels, first, target, terms, candidates, p, q) };
        }
    }
    blocks::<C>(pixels, first, target, terms, candidates, p, q)
}

/// Lanes of one block.
struct Block<const C: usize> {
    light: [[[f32; LANES]; 9]; C],
    intensity: [[f32; LANES]; C],
    weight: [f32; LANES],
    ray: [[f32; LANES]; 2],
    target: [[f32; LANES]; 2],
}

#[inline(always)]
fn lanes(values: &[f32], at: usize) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    out.copy_from_slice(&values[at..at + LANES]);
    out
}

impl<const C: usize> Block<C> {
    #[inline(always)]
    fn evaluate(&self, k: usize, terms: &ThetaTerms, slopes: [f32; 2]) -> Quadratic {
        // Loops instead of closures: a closure would not inherit the wide vectors.
        let mut light = [[0.0; 9]; C];
        let mut intensity = [0.0; C];
        for c in 0..C {
            for j in 0..9 {
                light[c][j] = self.light[c][j][k];
            }
            intensity[c] = self.intensity[c][k];
        }
        quadratic(
            &light,
            &intensity,
            self.weight[k],
            [self.ray[0][k], self.ray[1][k]],
            [self.target[0][k], self.target[1][k]],
            terms,
            slopes,
        )
    }
}

#[inline(always)]
fn blocks<const C: usize>(
    pixels: &Pixels,
    first: usize,
    target: (&[f32], &[f32]),
    terms: &ThetaTerms,
    candidates: Option<&Candidates>,
    p: &mut [f32],
    q: &mut [f32],
) -> f64 {
    let mut block = Block::<C> {
        light: [[[0.0; LANES]; 9]; C],
        intensity: [[0.0; LANES]; C],
        weight: [0.0; LANES],
        ray: [[0.0; LANES]; 2],
        target: [[0.0; LANES]; 2],
    };
    if let Coefficients::Uniform(rows) = &pixels.light {
        for c in 0..C {
            for j in 0..9 {
                block.light[c][j] = [rows[c][j]; LANES];
            }
        }
    }
    let mut total = 0.0;
    let mut at = 0;
    while at < p.len() {
        let k0 = first + at;
        block.weight = lanes(&pixels.weight, k0);
        block.ray = [lanes(&pixels.ray_x, k0), lanes(&pixels.ray_y, k0)];
        block.target = [lanes(target.0, k0), lanes(target.1, k0)];
        for c in 0..C {
            block.intensity[c] = lanes(&pixels.intensity, c * pixels.padded + k0);
        }
        if let Coefficients::PerPixel(values) = &pixels.light {
            for c in 0..C {
                for j in 0..9 {
                    block.light[c][j] = lanes(values, (c * 9 + j) * pixels.padded + k0);
                }
            }
        }
        let mut slopes = [lanes(p, at), lanes(q, at)];
        if let Some(candidates) = candidates {
            search(&block, terms, candidates, &mut slopes);
        }
        let mut value = [0.0; LANES];
        let mut damping = [FIRST_DAMPING; LANES];
        let mut gradient = [[0.0; LANES]; 2];
        let mut hessian = [[0.0; LANES]; 3];
        for k in 0..LANES {
            let model = block.evaluate(k, terms, [slopes[0][k], slopes[1][k]]);
            value[k] = model.value;
            gradient[0][k] = model.gradient[0];
            gradient[1][k] = model.gradient[1];
            hessian[0][k] = model.hessian[0];
            hessian[1][k] = model.hessian[1];
            hessian[2][k] = model.hessian[2];
        }
        for _ in 0..terms.num_steps {
            for k in 0..LANES {
                let model = Quadratic {
                    value: value[k],
                    gradient: [gradient[0][k], gradient[1][k]],
                    hessian: [hessian[0][k], hessian[1][k], hessian[2][k]],
                };
                let trial = trial_step([slopes[0][k], slopes[1][k]], &model, damping[k]);
                let at_trial = block.evaluate(k, terms, trial);
                let accept = at_trial.value <= model.value;
                slopes[0][k] = pick(accept, trial[0], slopes[0][k]);
                slopes[1][k] = pick(accept, trial[1], slopes[1][k]);
                value[k] = pick(accept, at_trial.value, model.value);
                gradient[0][k] = pick(accept, at_trial.gradient[0], model.gradient[0]);
                gradient[1][k] = pick(accept, at_trial.gradient[1], model.gradient[1]);
                hessian[0][k] = pick(accept, at_trial.hessian[0], model.hessian[0]);
                hessian[1][k] = pick(accept, at_trial.hessian[1], model.hessian[1]);
                hessian[2][k] = pick(accept, at_trial.hessian[2], model.hessian[2]);
                damping[k] = next_damping(accept, damping[k]);
            }
        }
        let mut energy = [0.0; LANES];
        for k in 0..LANES {
            let away = [
                slopes[0][k] - block.target[0][k],
                slopes[1][k] - block.target[1][k],
            ];
            energy[k] = value[k] - 0.5 * terms.beta * (away[0] * away[0] + away[1] * away[1]);
        }
        if terms.area > 0.0 {
            for k in 0..LANES {
                let ray = [block.ray[0][k], block.ray[1][k]];
                energy[k] -= terms.area * Facet::new(ray, [slopes[0][k], slopes[1][k]]).length();
            }
        }
        for k in 0..LANES.min(pixels.len.saturating_sub(k0)) {
            total += f64::from(energy[k].max(0.0));
        }
        p[at..at + LANES].copy_from_slice(&slopes[0]);
        q[at..at + LANES].copy_from_slice(&slopes[1]);
        at += LANES;
    }
    total
}

/// Replaces slopes by those of the best candidate normal, where that is better.
#[inline(always)]
fn search<const C: usize>(
    block: &Block<C>,
    terms: &ThetaTerms,
    candidates: &Candidates,
    slopes: &mut [[f32; LANES]; 2],
) {
    let half = 0.5 * terms.beta;
    let mut best = [0.0; LANES];
    for k in 0..LANES {
        best[k] = block.evaluate(k, terms, [slopes[0][k], slopes[1][k]]).value;
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
                    crate::model::harmonics(&l, *n).0
                } else {
                    candidates.shading[index * C + c]
                };
                let r = shade - block.intensity[c][k];
                squared += r * r;
            }
            let w = 1.0 + block.ray[0][k] * p + block.ray[1][k] * q;
            let value = block.weight[k] * squared
                + half * (dp * dp + dq * dq)
                + terms.area * (p * p + q * q + w * w).sqrt();
            let better = value < best[k];
            best[k] = if better { value } else { best[k] };
            slopes[0][k] = if better { p } else { slopes[0][k] };
            slopes[1][k] = if better { q } else { slopes[1][k] };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Facet;

    fn pixels(channels: usize, per_pixel: bool) -> Pixels {
        let len = 53;
        let padded = Pixels::padded_len(len);
        let rows: Vec<[f32; 9]> = (0..channels)
            .map(|c| {
                let s = c as f32 - 1.0;
                [
                    0.2 * s,
                    0.3 - 0.2 * s,
                    -1.0,
                    0.3,
                    0.1,
                    -0.1 * s,
                    0.05,
                    0.1 * s,
                    0.04,
                ]
            })
            .collect();
        let mut pixels = Pixels {
            channels,
            padded,
            len,
            ray_x: (0..padded).map(|k| 0.01 * k as f32 - 0.2).collect(),
            ray_y: (0..padded).map(|k| 0.2 - 0.007 * k as f32).collect(),
            intensity: vec![0.0; padded * channels],
            weight: (0..padded)
                .map(|k| if k % 11 == 7 { 0.0 } else { 1.0 })
                .collect(),
            light: Coefficients::Uniform(rows.clone()),
        };
        for k in 0..len {
            let slopes = [0.8 * (0.3 * k as f32).sin(), 0.6 * (0.2 * k as f32).cos()];
            let facet = Facet::new([pixels.ray_x[k], pixels.ray_y[k]], slopes);
            for (c, row) in rows.iter().enumerate() {
                pixels.intensity[c * padded + k] = facet.shade(row).0;
            }
        }
        if per_pixel {
            let mut values = vec![0.0; padded * channels * 9];
            for (c, row) in rows.iter().enumerate() {
                for (j, l) in row.iter().enumerate() {
                    values[(c * 9 + j) * padded..(c * 9 + j + 1) * padded].fill(*l);
                }
            }
            pixels.light = Coefficients::PerPixel(values);
        }
        pixels
    }

    #[test]
    fn lanes_give_what_the_readable_version_gives() {
        for channels in [1, 3] {
            for per_pixel in [false, true] {
                let pixels = pixels(channels, per_pixel);
                let target: Vec<f32> = (0..pixels.padded).map(|k| 0.01 * k as f32).collect();
                let terms = ThetaTerms {
                    beta: 0.05,
                    area: 0.01,
                    num_steps: 4,
                };
                let (mut p, mut q) = (vec![0.1; pixels.padded], vec![-0.1; pixels.padded]);
                theta_step(&pixels, (&target, &target), &terms, None, &mut p, &mut q);
                for k in 0..pixels.len {
                    let expected = scalar_step(&pixels, k, [target[k]; 2], [0.1, -0.1], &terms);
                    let away = (p[k] - expected[0]).abs().max((q[k] - expected[1]).abs());
                    assert!(away < 1e-4, "pixel {k}: {away}, {channels} channels");
                }
            }
        }
    }

    #[test]
    fn a_pixel_without_weight_goes_to_its_target() {
        let pixels = pixels(3, false);
        let target = vec![0.4; pixels.padded];
        let terms = ThetaTerms {
            beta: 0.5,
            area: 0.0,
            num_steps: 8,
        };
        let (mut p, mut q) = (vec![0.0; pixels.padded], vec![0.0; pixels.padded]);
        theta_step(&pixels, (&target, &target), &terms, None, &mut p, &mut q);
        assert!(
            (p[7] - 0.4).abs() < 1e-3 && (q[7] - 0.4).abs() < 1e-3,
            "{} {}",
            p[7],
            q[7]
        );
    }

    #[test]
    fn the_search_finds_exact_slopes_from_far() {
        let pixels = pixels(3, false);
        let target = vec![0.0; pixels.padded];
        let terms = ThetaTerms {
            beta: 1e-4,
            area: 0.0,
            num_steps: 10,
        };
        let candidates = Candidates::new(&pixels, 8, 3.0);
        let (mut p, mut q) = (vec![2.5; pixels.padded], vec![-2.5; pixels.padded]);
        let energy = theta_step(
            &pixels,
            (&target, &target),
            &terms,
            Some(&candidates),
            &mut p,
            &mut q,
        );
        assert!(energy < 1e-4, "{energy}");
    }
}
