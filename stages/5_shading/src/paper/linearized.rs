//! The paper's own solver, and the fixed point that it is compared with.
//!
//! **Problem.** With the normal's length and the second-order harmonics frozen at slopes `θ`, the
//! model is linear in the slopes `g = ∇y` (eq. 6–8):
//!
//! ```text
//! S(g; θ) = a(θ)·g − b̃(θ),   a = [l₁ − X l₃, l₂ − Y l₃]/d(θ),   b̃ = l₃/d(θ) − l₄ − second(n(θ)).
//! ```
//!
//! * the splitting (eq. 9–12), scaled dual `u`: `y ← argmin Σ (S(∇y; θ) − I)² + β/2 |∇y − θ + u|²`,
//!   whose matrix changes with θ; `θ ← argmin Σ (S(∇y; θ) − I)² + β/2 |∇y − θ + u|²` per pixel; `u
//!   ← u + ∇y − θ`; β doubles when the primal residual exceeds ten times the dual one and halves in
//!   the other case (He et al. 2000).
//! * the fixed point: `y ← argmin Σ (S(∇y; ∇y_before) − I)²`, nothing else. The paper shows
//!   that it fails; it stands here for comparison only.
//!
//! Both stop when the energy changes by less than a relative tolerance. The z-step is solved by
//! conjugate gradients with the isotropic multigrid of the same mean weight as preconditioner.
//!
//! Source: Quéau et al., ICCV 2017 (`queau2017`); He, Yang, Wang 2000 (`he2000`).

use super::levels::Level;
use super::model::Facet;
use super::pixels::{Pixels, Slopes};
use super::solution::{IterationRecord, Termination};
use super::splitting::{HOURGLASS, Ties, constraints_of, report, slopes, slopes_of};
use super::theta::{Quadratic, descend};
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::corner_poisson::CornerPoisson;
use rilievo_scene::Observer;

/// First penalty of the paper's splitting, for intensities with white at 1.
const BETA_START: f64 = 1.0;
/// Imbalance of residuals at which the penalty is changed, and by how much.
const BALANCE: f64 = 10.0;
const BETA_FACTOR: f64 = 2.0;
/// Fewest iterations before the energy may stop the iteration.
const MIN_ITERATIONS: usize = 6;
/// Iterations at most, where the energy never settles.
const MAX_ITERATIONS: usize = 100;
/// Relative change of the energy at which the iteration stops.
const RELATIVE_TOLERANCE: f64 = 1e-3;
/// Regularisation of the fixed point, against pixels whose `a` vanishes.
const FIXED_POINT_DAMPING: f64 = 1e-4;

/// What the iteration needs beside the level.
pub(crate) struct Setting<'a> {
    /// The paper's splitting, else the fixed point.
    pub(crate) splits: bool,
    pub(crate) ties: &'a Ties,
    pub(crate) aspect: [f32; 2],
    /// Unit of intensities: penalties scale with its square.
    pub(crate) white: f64,
    pub(crate) observer: &'a dyn Observer,
}

/// The linear model of one channel at frozen slopes: `S(g) = a·g + constant`.
fn linear_model(facet: &Facet, ray: [f32; 2], l: &[f32; 9]) -> ([f32; 2], f32) {
    let i = 1.0 / facet.length();
    let mut second = *l;
    second[..3].fill(0.0);
    (
        [i * (l[0] - ray[0] * l[2]), i * (l[1] - ray[1] * l[2])],
        -l[2] * i + facet.shade(&second).0,
    )
}

/// θ-step of one pixel: damped Gauss-Newton over the slopes that freeze the model.
fn freeze(
    pixels: &Pixels,
    k: usize,
    g: [f32; 2],
    target: [f32; 2],
    beta: f32,
    start: [f32; 2],
) -> [f32; 2] {
    let ray = [pixels.ray_x[k], pixels.ray_y[k]];
    let half = 0.5 * beta;
    let evaluate = |theta: [f32; 2]| {
        let facet = Facet::new(ray, theta);
        let i = 1.0 / facet.length();
        // ∂(1/d) = −(∂ ln d)/d.
        let [dp, dq] = facet.length_gradient().map(|e| -e * i * i);
        let away = [theta[0] - target[0], theta[1] - target[1]];
        let mut value = half * (away[0] * away[0] + away[1] * away[1]);
        let mut gradient = [half * away[0], half * away[1]];
        let mut hessian = [half, 0.0, half];
        for c in 0..pixels.channels {
            let l = pixels.light(c, k);
            let numerator = (l[0] - ray[0] * l[2]) * g[0] + (l[1] - ray[1] * l[2]) * g[1] - l[2];
            let mut second = l;
            second[..3].fill(0.0);
            let (rest, [sp, sq]) = facet.shade(&second);
            let r = numerator * i + rest - pixels.intensity[c * pixels.padded + k];
            let j = [numerator * dp + sp, numerator * dq + sq];
            let w = pixels.weight[k];
            value += w * r * r;
            gradient[0] += w * j[0] * r;
            gradient[1] += w * j[1] * r;
            hessian[0] += w * j[0] * j[0];
            hessian[1] += w * j[0] * j[1];
            hessian[2] += w * j[1] * j[1];
        }
        Quadratic {
            value,
            gradient,
            hessian,
        }
    };
    descend(start, 5, evaluate)
}

/// Per-pixel tensors `T = Σ w a aᵀ + β/2` and vectors `v` of the z-step `min gᵀTg − 2 v·g`.
struct Quadratics {
    tensor: [Vec<f32>; 3],
    vector: [Vec<f32>; 2],
}

fn assemble(pixels: &Pixels, theta: &Slopes, wanted: &Slopes, beta: f32) -> Quadratics {
    let zeros = || vec![0.0_f32; pixels.padded];
    let mut out = Quadratics {
        tensor: [zeros(), zeros(), zeros()],
        vector: [zeros(), zeros()],
    };
    let half = 0.5 * beta;
    for k in 0..pixels.len {
        let ray = [pixels.ray_x[k], pixels.ray_y[k]];
        let facet = Facet::new(ray, [theta[0][k], theta[1][k]]);
        let (mut t, mut v) = (
            [half, 0.0, half],
            [half * wanted[0][k], half * wanted[1][k]],
        );
        for c in 0..pixels.channels {
            let (a, constant) = linear_model(&facet, ray, &pixels.light(c, k));
            let b = pixels.intensity[c * pixels.padded + k] - constant;
            let w = pixels.weight[k];
            t[0] += w * a[0] * a[0];
            t[1] += w * a[0] * a[1];
            t[2] += w * a[1] * a[1];
            v[0] += w * a[0] * b;
            v[1] += w * a[1] * b;
        }
        for (tensor, t) in out.tensor.iter_mut().zip(t) {
            tensor[k] = t;
        }
        out.vector[0][k] = v[0];
        out.vector[1][k] = v[1];
    }
    out
}

/// Solves the z-step from the present `y`.
fn integrate(level: &Level, quadratics: &Quadratics, setting: &Setting, y: &mut [f32]) {
    let (grid, pixels) = (&level.grid, &level.pixels);
    let t = &quadratics.tensor;
    let mean: Vec<f32> = (0..pixels.len).map(|k| 0.5 * (t[0][k] + t[2][k])).collect();
    let mut system = CornerPoisson::new(grid, &mean, HOURGLASS);
    // Ties count against the whole term here, not against β/2.
    let constraints = constraints_of(level, setting.ties, 1.0);
    let mass = (!setting.ties.mass.is_empty()).then_some(setting.ties.mass.as_slice());
    system.set_constraints(mass, &constraints);
    let (mut p, mut q) = (vec![0.0; pixels.padded], vec![0.0; pixels.padded]);
    let mut rhs = vec![0.0; grid.padded_len()];
    grid.add_divergence(1.0, &quadratics.vector[0], &quadratics.vector[1], &mut rhs);
    if let Some(mass) = mass {
        for (rhs, (mass, wanted)) in rhs.iter_mut().zip(mass.iter().zip(&setting.ties.wanted)) {
            *rhs += mass * wanted;
        }
    }
    system.add_constraints_to(&mut rhs);
    // A = isotropic operator with hourglass and ties, plus Gᵀ (T − mean I) G.
    let mut anisotropic = |x: &[f32], out: &mut [f32]| {
        grid.gradient(x, &mut p, &mut q);
        for k in 0..pixels.len {
            let (gp, gq) = (p[k], q[k]);
            p[k] = (t[0][k] - mean[k]) * gp + t[1][k] * gq;
            q[k] = t[1][k] * gp + (t[2][k] - mean[k]) * gq;
        }
        grid.add_divergence(1.0, &p, &q, out);
    };
    system.solve_with(&rhs, y, 1e-2, 30, &mut anisotropic);
}

/// Iterates from `y`; returns records and why it ended.
pub(crate) fn solve(
    level: &Level,
    y: &mut [f32],
    setting: &Setting,
) -> Result<(Vec<IterationRecord>, Termination), ShadingError> {
    let pixels = &level.pixels;
    let mut gradient = slopes_of(level, setting.aspect, y);
    let mut theta = gradient.clone();
    let mut dual = [(); 2].map(|()| vec![0.0_f32; pixels.padded]);
    let unit = setting.white * setting.white;
    let splitting = setting.splits;
    let mut beta = unit
        * if splitting {
            BETA_START
        } else {
            FIXED_POINT_DAMPING
        };
    let mut records: Vec<IterationRecord> = Vec::new();
    for _ in 0..MAX_ITERATIONS {
        let wanted = [0, 1].map(|axis: usize| {
            let pairs = theta[axis].iter().zip(&dual[axis]);
            pairs.map(|(theta, u)| theta - u).collect()
        });
        let quadratics = assemble(pixels, &theta, &wanted, beta as f32);
        integrate(level, &quadratics, setting, y);
        let before = theta.clone();
        slopes(&level.grid, setting.aspect, y, &mut gradient);
        if splitting {
            let frozen: Vec<[f32; 2]> = (0..pixels.len)
                .into_par_iter()
                .with_min_len(4096)
                .map(|k| {
                    let at = |slopes: &Slopes| [slopes[0][k], slopes[1][k]];
                    let (g, u) = (at(&gradient), at(&dual));
                    let target = [g[0] + u[0], g[1] + u[1]];
                    freeze(pixels, k, g, target, beta as f32, at(&theta))
                })
                .collect();
            for (k, slopes) in frozen.into_iter().enumerate() {
                for (axis, slope) in slopes.into_iter().enumerate() {
                    theta[axis][k] = slope;
                    dual[axis][k] += gradient[axis][k] - slope;
                }
            }
        } else {
            theta.clone_from(&gradient);
        }
        let n = pixels.len as f64;
        let squared = |a: &Slopes, b: &Slopes| -> f64 {
            let axis = |k: usize| -> f64 {
                let pairs = a[k].iter().zip(&b[k]);
                pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum()
            };
            ((axis(0) + axis(1)) / n).sqrt()
        };
        let (primal_residual, dual_residual) =
            (squared(&gradient, &theta), squared(&theta, &before));
        let rms = super::result::rms_residual(pixels, &gradient);
        let energy = rms * rms * n * pixels.channels as f64;
        let last = records.last().map(|record| record.energy);
        records.push(IterationRecord {
            level: 0,
            beta,
            energy,
            primal_residual,
            dual_residual,
        });
        report(&records, MAX_ITERATIONS, setting.observer)?;
        let settled = last.is_some_and(|before| {
            (before - energy).abs() <= RELATIVE_TOLERANCE * before.max(f64::MIN_POSITIVE)
        });
        if settled && records.len() >= MIN_ITERATIONS {
            return Ok((records, Termination::Converged));
        }
        if splitting {
            let factor = if primal_residual > BALANCE * dual_residual {
                BETA_FACTOR
            } else if dual_residual > BALANCE * primal_residual {
                1.0 / BETA_FACTOR
            } else {
                1.0
            };
            beta *= factor;
            let scale = (1.0 / factor) as f32;
            dual.iter_mut().flatten().for_each(|u| *u *= scale);
        }
    }
    Ok((records, Termination::MaxIterations))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frozen_model_is_the_model_where_it_is_frozen() {
        let l = [-0.2, 0.3, -1.0, 0.4, 0.1, -0.1, -0.2, 0.15, 0.05];
        let (ray, slopes) = ([0.2, -0.1], [0.7, -0.4]);
        let facet = Facet::new(ray, slopes);
        let (a, constant) = linear_model(&facet, ray, &l);
        let frozen = a[0] * slopes[0] + a[1] * slopes[1] + constant;
        assert!((frozen - facet.shade(&l).0).abs() < 1e-6, "{frozen}");
    }
}
