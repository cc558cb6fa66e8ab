//! θ-step: the shading term, pixel by pixel.
//!
//! **Problem.** At every pixel, for the slopes `θ = (p, q)`,
//!
//! ```text
//! min_θ  w Σ_c (S_c(θ) − I_c)² + ν d(θ) + β s/2 |θ − t|²,      t = ∇y + u,
//! ```
//!
//! `S` the model of [`crate::paper::model`], `d` the facet's area, `s` the pixel's stiffness, `u`
//! the scaled dual. Two unknowns, a few damped Gauss-Newton steps from the current `θ`; a step that
//! does not lower the term is undone and the damping raised. A far start is first replaced by the
//! best of a fixed set of normals.
//!
//! `pixel` holds the term and a damped step in readable form, the oracle of the tests; `lanes`
//! treats [`LANES`] pixels at once with the same functions, compiled for the processor that runs
//! it; `search` holds the fixed set of normals.
//!
//! Source: Quéau et al., ICCV 2017 (`queau2017`), eq. 11, with the shading term whole instead of
//! linearised.

mod block;
mod lanes;
mod pixel;
mod problem;
mod search;

pub(crate) use pixel::{Quadratic, descend};
pub(crate) use problem::{ThetaProblem, ThetaTerms};
pub(crate) use search::Candidates;

use crate::paper::pixels::{LANES, Slopes};
use lanes::blocks;
use rayon::prelude::*;

/// Pixels per parallel task.
const TASK_LEN: usize = 256 * LANES;

/// Minimises the term of every pixel, starting at and writing to the slopes.
/// Returns `Σ w |S(θ) − I|²`.
pub(crate) fn theta_step(problem: &ThetaProblem<'_>, [p, q]: &mut Slopes) -> f64 {
    let task = |(task, (p, q)): (usize, (&mut [f32], &mut [f32]))| {
        let first = task * TASK_LEN;
        if problem.pixels.channels == 1 {
            dispatch::<1>(problem, first, p, q)
        } else {
            dispatch::<3>(problem, first, p, q)
        }
    };
    // Small images stay in one task.
    let num_tasks = problem.pixels.padded.div_ceil(TASK_LEN);
    let sums: Vec<f64> = p
        .par_chunks_mut(TASK_LEN)
        .zip(q.par_chunks_mut(TASK_LEN))
        .enumerate()
        .with_min_len(if num_tasks <= 2 { 2 } else { 1 })
        .map(task)
        .collect();
    sums.iter().sum()
}

/// The kernel compiled for the widest vectors of this processor.
fn dispatch<const C: usize>(
    problem: &ThetaProblem<'_>,
    first: usize,
    p: &mut [f32],
    q: &mut [f32],
) -> f64 {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn wide<const C: usize>(
            problem: &ThetaProblem<'_>,
            first: usize,
            p: &mut [f32],
            q: &mut [f32],
        ) -> f64 {
            blocks::<C>(problem, first, p, q)
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the processor has the features that the function is compiled for.
            #[allow(unsafe_code)]
            return unsafe { wide::<C>(problem, first, p, q) };
        }
    }
    blocks::<C>(problem, first, p, q)
}

#[cfg(test)]
mod tests {
    use super::pixel::scalar_step;
    use super::*;
    use crate::paper::model::Facet;
    use crate::paper::pixels::Coefficients;
    use crate::paper::pixels::Pixels;

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
                let stiffness: Vec<f32> = (0..pixels.padded)
                    .map(|k| if k % 5 == 3 { 0.1 } else { 1.0 })
                    .collect();
                let terms = ThetaTerms {
                    beta: 0.05,
                    stiffness: &stiffness,
                    area: 0.01,
                    num_steps: 4,
                };
                let mut theta = [vec![0.1; pixels.padded], vec![-0.1; pixels.padded]];
                theta_step(
                    &ThetaProblem {
                        pixels: &pixels,
                        target: &[target.clone(), target.clone()],
                        terms,
                        candidates: None,
                    },
                    &mut theta,
                );
                for k in 0..pixels.len {
                    let expected = scalar_step(&pixels, k, [target[k]; 2], [0.1, -0.1], &terms);
                    let apart = |axis: usize| (theta[axis][k] - expected[axis]).abs();
                    let away = apart(0).max(apart(1));
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
            stiffness: &[],
            area: 0.0,
            num_steps: 8,
        };
        let mut theta = [vec![0.0; pixels.padded], vec![0.0; pixels.padded]];
        theta_step(
            &ThetaProblem {
                pixels: &pixels,
                target: &[target.clone(), target],
                terms,
                candidates: None,
            },
            &mut theta,
        );
        assert!(
            theta.iter().all(|slope| (slope[7] - 0.4).abs() < 1e-3),
            "{} {}",
            theta[0][7],
            theta[1][7]
        );
    }

    #[test]
    fn the_search_finds_exact_slopes_from_far() {
        let pixels = pixels(3, false);
        let target = vec![0.0; pixels.padded];
        let terms = ThetaTerms {
            beta: 1e-4,
            stiffness: &[],
            area: 0.0,
            num_steps: 10,
        };
        let candidates = Candidates::new(&pixels, 8, 3.0);
        let mut theta = [vec![2.5; pixels.padded], vec![-2.5; pixels.padded]];
        let energy = theta_step(
            &ThetaProblem {
                pixels: &pixels,
                target: &[target.clone(), target],
                terms,
                candidates: Some(&candidates),
            },
            &mut theta,
        );
        assert!(energy < 1e-4, "{energy}");
    }
}
