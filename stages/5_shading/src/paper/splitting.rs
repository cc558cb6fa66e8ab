//! Full splitting of one view: shading on the slopes θ, integration in the unknown y.
//!
//! **Problem.** With `E(θ) = Σ w Σ_c (S_c(θ) − I_c)² + ν Σ d(θ)` over the mask,
//!
//! ```text
//! min_{y,θ}  E(θ) + C(y)   subject to  θ = ∇y,
//! θ ← argmin E(θ) + β s/2 |θ − (∇y + u)|²             θ-step, per pixel, super::theta
//! y ← argmin β s/2 |∇y − θ + u|² + C(y)               z-step, crate's corner Poisson
//! u ← u + ∇y − θ,   then  β ← γ β,  u ← u/γ           scaled dual, continuation
//! ```
//!
//! `C` holds anchors and prior with their weights in units of intensity²; as β grows it fades
//! against the integration term, since `C` does not change. `y` is in pixels, `θ` and `u` without
//! unit, `β` in intensity².
//!
//! Where the surface breaks ([`super::breaks`]), the stiffness `s` of a pixel is low, else 1.
//!
//! The first iterations run on coarse levels; the change of a level is interpolated to the next.
//!
//! Source: Quéau et al., ICCV 2017 (`queau2017`), eq. 9–12, with the whole shading term in the
//! θ-step; continuation instead of an adapted penalty: see [`super::schedule`].

use super::breaks::{break_search, soften_breaks};
use super::levels::{Level, add_change, place_constraint, restrict_nodes};
use super::model::Facet;
use super::pixels::Pixels;
use super::solution::{IterationRecord, StepSeconds};
use super::theta::{Candidates, ThetaProblem, ThetaTerms, theta_step};
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::corner_grid::CornerGrid;
use rilievo_numerics::corner_poisson::{CornerPoisson, PointConstraint};
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::{Event, Flow, Observer, StageId};
use std::time::Instant;

/// Weight of the hourglass mode: small enough not to flatten mixed curvature, large enough to
/// couple the two parities (measured: 0.1 costs a quarter of the accuracy, 0.01 two per cent).
pub(crate) const HOURGLASS: f32 = 0.01;
/// Relative residual at which a z-step ends: the next iteration starts from its result.
const Z_TOLERANCE: f64 = 0.1;
/// Conjugate-gradient steps per z-step.
const MAX_Z_STEPS: usize = 3;

/// The course of an iteration on one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Course {
    /// First penalty.
    pub(crate) beta_start: f64,
    /// Its factor per iteration.
    pub(crate) growth: f64,
    pub(crate) num_iterations: usize,
    pub(crate) num_search_iterations: usize,
}

/// What ties the unknown down, at the finest level.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ties {
    /// Pixel, weight (intensity² per squared pixel of the unknown) and wanted unknown.
    pub(crate) points: Vec<([f64; 2], f32, f32)>,
    /// Nodal masses (same unit) and wanted unknowns, padded rasters; empty for none.
    pub(crate) mass: Vec<f32>,
    pub(crate) wanted: Vec<f32>,
}

impl Ties {
    /// Whether nothing holds the low frequencies.
    pub(crate) fn is_empty(&self) -> bool {
        self.points.is_empty() && self.mass.is_empty()
    }
}

/// Everything that the iteration needs beside the levels.
pub(crate) struct Setting<'a> {
    pub(crate) ties: &'a Ties,
    pub(crate) area: f32,
    /// Loss on intensity residuals, in units of `white`.
    pub(crate) loss: RobustLoss,
    pub(crate) white: f32,
    pub(crate) aspect: [f32; 2],
    /// Penalty at which slopes are freed to find where the surface breaks; `None` does not look.
    pub(crate) edge_beta: Option<f32>,
    /// One course per level, coarsest first.
    pub(crate) courses: &'a [Course],
    pub(crate) observer: &'a dyn Observer,
}

/// Records of a finished iteration.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outcome {
    pub(crate) records: Vec<IterationRecord>,
    /// Pixels at which the surface was found to break.
    pub(crate) num_breaks: usize,
    /// Stiffness of the finest level's pixels at the end, of padded length.
    pub(crate) stiffness: Vec<f32>,
    /// Their slopes θ.
    pub(crate) theta: [Vec<f32>; 2],
    pub(crate) seconds: StepSeconds,
}

/// Slopes of node values in the units of the model.
pub(crate) fn slopes(grid: &CornerGrid, aspect: [f32; 2], y: &[f32], p: &mut [f32], q: &mut [f32]) {
    grid.gradient(y, p, q);
    if aspect != [1.0, 1.0] {
        p.iter_mut().for_each(|p| *p *= aspect[0]);
        q.iter_mut().for_each(|q| *q *= aspect[1]);
    }
}

fn rms(values: impl Iterator<Item = f32>, count: usize) -> f64 {
    (values.map(f64::from).sum::<f64>() / count.max(1) as f64).sqrt()
}

/// Improves `y` (nodes of the finest level).
pub(crate) fn solve(
    levels: &[Level],
    y: &mut Vec<f32>,
    setting: &Setting,
) -> Result<Outcome, ShadingError> {
    // The start on every level, finest first.
    let mut starts = vec![std::mem::take(y)];
    for (fine, coarse) in levels.iter().zip(&levels[1..]) {
        let restricted = restrict_nodes(&fine.grid, &starts[starts.len() - 1], &coarse.grid);
        starts.push(restricted);
    }
    let mut ties = vec![setting.ties.clone()];
    for (fine, coarse) in levels.iter().zip(&levels[1..]) {
        let coarser = restrict_ties(&ties[ties.len() - 1], &fine.grid, &coarse.grid);
        ties.push(coarser);
    }
    let mut outcome = Outcome::default();
    let mut coarse_result: Option<(Vec<f32>, Vec<f32>)> = None;
    for (step, course) in setting.courses.iter().enumerate() {
        let at = setting.courses.len() - 1 - step;
        let Some(level) = levels.get(at) else {
            continue;
        };
        let mut nodes = std::mem::take(&mut starts[at]);
        if let Some((before, after)) = &coarse_result {
            let coarse = &levels[at + 1].grid;
            add_change(coarse, before, after, &level.grid, &mut nodes);
        }
        solve_level(
            at,
            level,
            &mut nodes,
            course,
            &ties[at],
            setting,
            &mut outcome,
        )?;
        if at == 0 {
            *y = nodes;
        } else {
            // Changes count against what the next finer level's start restricts to.
            let finer = &levels[at - 1].grid;
            let before = restrict_nodes(finer, &starts[at - 1], &level.grid);
            coarse_result = Some((before, nodes));
        }
    }
    Ok(outcome)
}

/// Multiplies slopes by the cells' stiffness, where that is not one.
fn weigh(stiffness: &[f32], p: &mut [f32], q: &mut [f32]) {
    for ((p, q), w) in p.iter_mut().zip(q).zip(stiffness) {
        *p *= w;
        *q *= w;
    }
}

/// Weights of iteratively re-weighted least squares at the present slopes: one per pixel, of the
/// RMS residual over its channels.
fn reweight(base: &Pixels, out: &mut Pixels, (p, q): (&[f32], &[f32]), setting: &Setting) {
    out.weight
        .par_iter_mut()
        .enumerate()
        .with_min_len(4096)
        .for_each(|(k, weight)| {
            let facet = Facet::new([base.ray_x[k], base.ray_y[k]], [p[k], q[k]]);
            let mut squared = 0.0;
            for c in 0..base.channels {
                let shade = facet.shade(&base.light(c, k)).0;
                squared += (shade - base.intensity[c * base.padded + k]).powi(2);
            }
            let r = (squared / base.channels as f32).sqrt() / setting.white;
            *weight = base.weight[k] * setting.loss.weight(f64::from(r)) as f32;
        });
}

fn solve_level(
    at: usize,
    level: &Level,
    y: &mut [f32],
    course: &Course,
    ties: &Ties,
    setting: &Setting,
    outcome: &mut Outcome,
) -> Result<(), ShadingError> {
    let grid = &level.grid;
    // Only a robust loss changes weights; the squared one borrows the pixels as they are.
    let mut reweighted: Option<Pixels> =
        (setting.loss != RobustLoss::Squared).then(|| level.pixels.clone());
    let pixels = &level.pixels;
    let padded = pixels.padded;
    let zeros = || vec![0.0_f32; padded];
    let started = Instant::now();
    let mut stiffness = level.stiffness.clone();
    let mut system = CornerPoisson::new(grid, &stiffness[..pixels.len], HOURGLASS);
    let tied = !ties.is_empty();
    let (mut gp, mut gq) = (zeros(), zeros());
    slopes(grid, setting.aspect, y, &mut gp, &mut gq);
    let (mut p, mut q) = (gp.clone(), gq.clone());
    let (mut tp, mut tq) = (gp.clone(), gq.clone());
    let (mut wp, mut wq) = (zeros(), zeros());
    let mut rhs = vec![0.0_f32; grid.padded_len()];
    let candidates = (course.num_search_iterations > 0).then(|| Candidates::new(pixels, 8, 3.0));
    outcome.seconds.z += started.elapsed().as_secs_f64();
    let growth = course.growth as f32;
    let mut beta = course.beta_start;
    for iteration in 0..course.num_iterations {
        if let Some(beta) = setting.edge_beta
            && let Some(share) = break_search(iteration, course.num_iterations)
        {
            outcome.num_breaks = soften_breaks(
                level,
                (&gp, &gq),
                (&mut p, &mut q),
                beta,
                share,
                &mut stiffness,
            );
            system = CornerPoisson::new(grid, &stiffness[..pixels.len], HOURGLASS);
        }
        // Here (tp, tq) = ∇y + u.
        let started = Instant::now();
        let terms = ThetaTerms {
            beta: beta as f32,
            stiffness: &stiffness,
            area: setting.area,
            num_steps: 3,
        };
        let search = candidates
            .as_ref()
            .filter(|_| iteration < course.num_search_iterations);
        if let Some(reweighted) = &mut reweighted {
            reweight(&level.pixels, reweighted, (&p, &q), setting);
        }
        let problem = ThetaProblem {
            pixels: reweighted.as_ref().unwrap_or(pixels),
            target: (&tp, &tq),
            terms,
            candidates: search,
        };
        let energy = theta_step(&problem, &mut p, &mut q);
        outcome.seconds.theta += started.elapsed().as_secs_f64();

        let started = Instant::now();
        // u = (∇y + u) − ∇y; the z-step wants ∇y = θ − u.
        for k in 0..padded {
            tp[k] -= gp[k];
            tq[k] -= gq[k];
            wp[k] = (p[k] - tp[k]) / setting.aspect[0];
            wq[k] = (q[k] - tq[k]) / setting.aspect[1];
        }
        weigh(&stiffness, &mut wp, &mut wq);
        rhs.fill(0.0);
        grid.add_divergence(1.0, &wp, &wq, &mut rhs);
        if tied {
            apply_ties(&mut system, level, ties, beta as f32, &mut rhs);
        }
        system.solve(&rhs, y, Z_TOLERANCE, MAX_Z_STEPS);
        slopes(grid, setting.aspect, y, &mut wp, &mut wq);
        std::mem::swap(&mut gp, &mut wp);
        std::mem::swap(&mut gq, &mut wq);
        outcome.seconds.z += started.elapsed().as_secs_f64();

        let n = pixels.len;
        let squared = |a: &[f32], b: &[f32], k: usize| (a[k] - b[k]).powi(2);
        let primal = rms((0..n).map(|k| squared(&gp, &p, k) + squared(&gq, &q, k)), n);
        let dual = rms(
            (0..n).map(|k| squared(&gp, &wp, k) + squared(&gq, &wq, k)),
            n,
        );
        for k in 0..padded {
            tp[k] = (tp[k] + gp[k] - p[k]) / growth + gp[k];
            tq[k] = (tq[k] + gq[k] - q[k]) / growth + gq[k];
        }
        let scale = f64::from(level.scale * level.scale);
        outcome.records.push(IterationRecord {
            level: at,
            beta,
            energy: energy * scale,
            primal_residual: primal,
            dual_residual: dual,
        });
        let flow = setting.observer.event(Event::Iteration {
            stage: StageId::Shading,
            iteration: outcome.records.len() - 1,
            max_num_iterations: setting.courses.iter().map(|c| c.num_iterations).sum(),
            energy: energy * scale,
            primal_residual: Some(primal),
            dual_residual: Some(dual),
            beta: Some(beta),
        });
        if flow == Flow::Stop {
            return Err(ShadingError::Interrupted);
        }
        beta *= f64::from(growth);
    }
    if at == 0 {
        outcome.stiffness = stiffness;
        outcome.theta = [p, q];
    }
    Ok(())
}

/// Ties of a coarser level: points are placed by position, masses by node. In the coarse unknown,
/// half as large, a squared difference counts four times; so do the four fine nodes of a coarse one,
/// which the coarse pixel's fourfold area cancels.
fn restrict_ties(ties: &Ties, fine: &CornerGrid, coarse: &CornerGrid) -> Ties {
    if ties.mass.is_empty() {
        return ties.clone();
    }
    let mut mass = restrict_nodes(fine, &ties.mass, coarse);
    mass.iter_mut().for_each(|m| *m = (8.0 * *m).max(0.0));
    Ties {
        points: ties.points.clone(),
        mass,
        wanted: restrict_nodes(fine, &ties.wanted, coarse),
    }
}

/// Point constraints of a level, their weights multiplied by `by`.
pub(crate) fn constraints_of(level: &Level, ties: &Ties, by: f32) -> Vec<PointConstraint> {
    ties.points
        .iter()
        .filter_map(|&(pixel, weight, value)| {
            place_constraint(&level.grid, level.scale, pixel, by * weight, value)
        })
        .collect()
}

/// Anchors and prior in units of β/2, and their part of the right-hand side.
fn apply_ties(system: &mut CornerPoisson, level: &Level, ties: &Ties, beta: f32, rhs: &mut [f32]) {
    let by = 2.0 / beta;
    let constraints = constraints_of(level, ties, by);
    if !ties.mass.is_empty() {
        let mass: Vec<f32> = ties.mass.iter().map(|m| by * m).collect();
        for (rhs, (mass, wanted)) in rhs.iter_mut().zip(mass.iter().zip(&ties.wanted)) {
            *rhs += mass * wanted;
        }
        system.set_constraints(Some(&mass), &constraints);
    } else {
        system.set_constraints(None, &constraints);
    }
    system.add_constraints_to(rhs);
}
