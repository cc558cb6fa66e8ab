//! Many pixels at once, without branches, so that the compiler emits vector code.

// Arrays of lanes are indexed in parallel: zipped iterators would hide the lane.
#![allow(clippy::needless_range_loop)]

use super::block::Block;
use super::pixel::{FIRST_DAMPING, Quadratic, next_damping, pick, trial_step};
use super::problem::ThetaProblem;
use super::search::search;
use crate::paper::model::Facet;
use crate::paper::pixels::{Coefficients, LANES};

#[inline(always)]
fn lanes(values: &[f32], at: usize) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    out.copy_from_slice(&values[at..at + LANES]);
    out
}

impl<const C: usize> Block<C> {
    /// Reads the lanes from pixel `k0` on.
    #[inline(always)]
    fn load(&mut self, problem: &ThetaProblem<'_>, k0: usize) {
        let ThetaProblem { pixels, terms, .. } = problem;
        self.weight = lanes(&pixels.weight, k0);
        self.ray = [lanes(&pixels.ray_x, k0), lanes(&pixels.ray_y, k0)];
        self.target = [lanes(&problem.target[0], k0), lanes(&problem.target[1], k0)];
        if !terms.stiffness.is_empty() {
            let stiffness = lanes(terms.stiffness, k0);
            for k in 0..LANES {
                self.beta[k] = terms.beta * stiffness[k];
            }
        }
        for c in 0..C {
            self.intensity[c] = lanes(&pixels.intensity, c * pixels.padded + k0);
        }
        if let Coefficients::PerPixel(values) = &pixels.light {
            for c in 0..C {
                for j in 0..9 {
                    self.light[c][j] = lanes(values, (c * 9 + j) * pixels.padded + k0);
                }
            }
        }
    }

    /// Damped Gauss-Newton steps; returns the terms' values at the slopes found.
    #[inline(always)]
    fn descend(&self, num_steps: usize, slopes: &mut [[f32; LANES]; 2]) -> [f32; LANES] {
        let mut value = [0.0; LANES];
        let mut damping = [FIRST_DAMPING; LANES];
        let mut gradient = [[0.0; LANES]; 2];
        let mut hessian = [[0.0; LANES]; 3];
        for k in 0..LANES {
            let model = self.evaluate(k, [slopes[0][k], slopes[1][k]]);
            value[k] = model.value;
            gradient[0][k] = model.gradient[0];
            gradient[1][k] = model.gradient[1];
            hessian[0][k] = model.hessian[0];
            hessian[1][k] = model.hessian[1];
            hessian[2][k] = model.hessian[2];
        }
        for _ in 0..num_steps {
            for k in 0..LANES {
                let model = Quadratic {
                    value: value[k],
                    gradient: [gradient[0][k], gradient[1][k]],
                    hessian: [hessian[0][k], hessian[1][k], hessian[2][k]],
                };
                let trial = trial_step([slopes[0][k], slopes[1][k]], &model, damping[k]);
                let at_trial = self.evaluate(k, trial);
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
        value
    }

    /// `w |S(θ) − I|²`: the terms' values without penalty and area.
    #[inline(always)]
    fn shading(&self, value: &[f32; LANES], slopes: &[[f32; LANES]; 2]) -> [f32; LANES] {
        let mut energy = [0.0; LANES];
        for k in 0..LANES {
            let away = [
                slopes[0][k] - self.target[0][k],
                slopes[1][k] - self.target[1][k],
            ];
            energy[k] = value[k] - 0.5 * self.beta[k] * (away[0] * away[0] + away[1] * away[1]);
        }
        if self.area > 0.0 {
            for k in 0..LANES {
                let ray = [self.ray[0][k], self.ray[1][k]];
                energy[k] -= self.area * Facet::new(ray, [slopes[0][k], slopes[1][k]]).length();
            }
        }
        energy
    }
}

/// The θ-step of the pixels from `first` on, as many as `p` has.
#[inline(always)]
pub(super) fn blocks<const C: usize>(
    problem: &ThetaProblem<'_>,
    first: usize,
    p: &mut [f32],
    q: &mut [f32],
) -> f64 {
    let ThetaProblem { pixels, terms, .. } = problem;
    let mut block = Block::<C> {
        light: [[[0.0; LANES]; 9]; C],
        intensity: [[0.0; LANES]; C],
        weight: [0.0; LANES],
        ray: [[0.0; LANES]; 2],
        target: [[0.0; LANES]; 2],
        beta: [terms.beta; LANES],
        area: terms.area,
    };
    if let Coefficients::Uniform(rows) = &pixels.light {
        for c in 0..C {
            for j in 0..9 {
                block.light[c][j] = [rows[c][j]; LANES];
            }
        }
    }
    let mut total = 0.0;
    for at in (0..p.len()).step_by(LANES) {
        let k0 = first + at;
        block.load(problem, k0);
        let mut slopes = [lanes(p, at), lanes(q, at)];
        if let Some(candidates) = problem.candidates {
            search(&block, candidates, &mut slopes);
        }
        let value = block.descend(terms.num_steps, &mut slopes);
        let energy = block.shading(&value, &slopes);
        for k in 0..LANES.min(pixels.len.saturating_sub(k0)) {
            total += f64::from(energy[k].max(0.0));
        }
        p[at..at + LANES].copy_from_slice(&slopes[0]);
        q[at..at + LANES].copy_from_slice(&slopes[1]);
    }
    total
}
