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
use super::pixels::{Pixels, Slopes};
use super::solution::{IterationRecord, StepSeconds};
use super::theta::{Candidates, ThetaProblem, ThetaTerms, theta_step};
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::corner_grid::CornerGrid;
use rilievo_numerics::corner_poisson::{CornerPoisson, PointConstraint};
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::{Event, Observer, StageId};
use std::time::Instant;

/// Weight of the hourglass mode: small enough not to flatten mixed curvature, large enough to
/// couple the two parities (measured: 0.1 costs a quarter of the accuracy, 0.01 two per cent).
pub(crate) const HOURGLASS: f32 = 0.01;
/// Relative residual at which a z-step ends: the next iteration starts from its result.
const Z_TOLERANCE: f64 = 0.1;
/// Conjugate-gradient steps per z-step.
const MAX_Z_STEPS: usize = 3;

/// Penalties and iterations on one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LevelSchedule {
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
    /// One schedule per level, coarsest first.
    pub(crate) schedules: &'a [LevelSchedule],
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
    pub(crate) theta: Slopes,
    pub(crate) seconds: StepSeconds,
}

/// Slopes of node values in the units of the model.
pub(crate) fn slopes(grid: &CornerGrid, aspect: [f32; 2], y: &[f32], [p, q]: &mut Slopes) {
    grid.gradient(y, p, q);
    for (slopes, aspect) in [(p, aspect[0]), (q, aspect[1])] {
        if aspect != 1.0 {
            slopes.iter_mut().for_each(|slope| *slope *= aspect);
        }
    }
}

/// The same as new arrays.
pub(crate) fn slopes_of(level: &Level, aspect: [f32; 2], y: &[f32]) -> Slopes {
    let mut out = [(); 2].map(|()| vec![0.0; level.pixels.padded]);
    slopes(&level.grid, aspect, y, &mut out);
    out
}

/// RMS difference of two fields of slopes over the first `num` pixels.
fn rms_difference(a: &Slopes, b: &Slopes, num: usize) -> f64 {
    let squared = |k: usize| (a[0][k] - b[0][k]).powi(2) + (a[1][k] - b[1][k]).powi(2);
    let sum: f64 = (0..num).map(|k| f64::from(squared(k))).sum();
    (sum / num.max(1) as f64).sqrt()
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
    for (step, schedule) in setting.schedules.iter().enumerate() {
        let at = setting.schedules.len() - 1 - step;
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
            schedule,
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

/// Weights of iteratively re-weighted least squares at the present slopes: one per pixel, of the
/// RMS residual over its channels.
fn reweight(base: &Pixels, out: &mut Pixels, [p, q]: &Slopes, setting: &Setting) {
    out.weight
        .par_iter_mut()
        .enumerate()
        .with_min_len(4096)
        .for_each(|(k, weight)| {
            let squared: f32 = base.residuals(k, [p[k], q[k]]).map(|r| r.powi(2)).sum();
            let r = (squared / base.channels as f32).sqrt() / setting.white;
            *weight = base.weight[k] * setting.loss.weight(f64::from(r)) as f32;
        });
}

/// The arrays of one level's iteration.
struct State<'a> {
    level: &'a Level,
    ties: &'a Ties,
    setting: &'a Setting<'a>,
    system: CornerPoisson,
    stiffness: Vec<f32>,
    /// Pixels with the weights of a robust loss; the squared one borrows those of the level.
    reweighted: Option<Pixels>,
    theta: Slopes,
    /// ∇y.
    gradient: Slopes,
    /// ∇y + u before the θ-step, u after it.
    target: Slopes,
    /// Wanted slopes of the z-step; ∇y before it, when it is done.
    wanted: Slopes,
    rhs: Vec<f32>,
}

impl<'a> State<'a> {
    fn new(level: &'a Level, y: &[f32], ties: &'a Ties, setting: &'a Setting) -> Self {
        let gradient = slopes_of(level, setting.aspect, y);
        let stiffness = vec![1.0; level.pixels.padded];
        let is_robust = setting.loss != RobustLoss::Squared;
        Self {
            level,
            ties,
            setting,
            system: CornerPoisson::new(&level.grid, &stiffness[..level.pixels.len], HOURGLASS),
            stiffness,
            reweighted: is_robust.then(|| level.pixels.clone()),
            theta: gradient.clone(),
            target: gradient.clone(),
            wanted: gradient.clone(),
            gradient,
            rhs: vec![0.0; level.grid.padded_len()],
        }
    }

    /// Looks for breaks; returns their number.
    fn soften(&mut self, beta: f32, share: f32) -> usize {
        let (level, stiffness) = (self.level, &mut self.stiffness);
        let theta = &mut self.theta;
        let num_breaks = soften_breaks(level, &self.gradient, theta, beta, share, stiffness);
        let cells = &stiffness[..level.pixels.len];
        self.system = CornerPoisson::new(&level.grid, cells, HOURGLASS);
        num_breaks
    }

    /// θ-step; returns the energy of shading.
    fn theta_step(&mut self, beta: f32, candidates: Option<&Candidates>) -> f64 {
        if let Some(reweighted) = &mut self.reweighted {
            reweight(&self.level.pixels, reweighted, &self.theta, self.setting);
        }
        let problem = ThetaProblem {
            pixels: self.reweighted.as_ref().unwrap_or(&self.level.pixels),
            target: &self.target,
            terms: ThetaTerms {
                beta,
                stiffness: &self.stiffness,
                area: self.setting.area,
                num_steps: 3,
            },
            candidates,
        };
        theta_step(&problem, &mut self.theta)
    }

    /// z-step: `u = (∇y + u) − ∇y`, and `∇y = θ − u` is wanted.
    fn z_step(&mut self, beta: f32, y: &mut [f32]) {
        let (grid, aspect) = (&self.level.grid, self.setting.aspect);
        for (axis, aspect) in aspect.into_iter().enumerate() {
            let (theta, gradient) = (&self.theta[axis], &self.gradient[axis]);
            let (target, wanted) = (&mut self.target[axis], &mut self.wanted[axis]);
            for k in 0..wanted.len() {
                target[k] -= gradient[k];
                wanted[k] = (theta[k] - target[k]) / aspect * self.stiffness[k];
            }
        }
        self.rhs.fill(0.0);
        grid.add_divergence(1.0, &self.wanted[0], &self.wanted[1], &mut self.rhs);
        if !self.ties.is_empty() {
            apply_ties(&mut self.system, self.level, self.ties, beta, &mut self.rhs);
        }
        self.system.solve(&self.rhs, y, Z_TOLERANCE, MAX_Z_STEPS);
        slopes(grid, aspect, y, &mut self.wanted);
        std::mem::swap(&mut self.gradient, &mut self.wanted);
    }

    /// `u ← u + ∇y − θ`, scaled to the next penalty, and with it the target `∇y + u`.
    fn update_dual(&mut self, growth: f32) {
        for axis in 0..2 {
            let (theta, gradient) = (&self.theta[axis], &self.gradient[axis]);
            for ((t, g), theta) in self.target[axis].iter_mut().zip(gradient).zip(theta) {
                *t = (*t + g - theta) / growth + g;
            }
        }
    }
}

/// One level's iterations.
fn solve_level(
    at: usize,
    level: &Level,
    y: &mut [f32],
    schedule: &LevelSchedule,
    ties: &Ties,
    setting: &Setting,
    outcome: &mut Outcome,
) -> Result<(), ShadingError> {
    let num_pixels = level.pixels.len;
    let started = Instant::now();
    let mut state = State::new(level, y, ties, setting);
    let searches = schedule.num_search_iterations;
    let candidates = (searches > 0).then(|| Candidates::new(&level.pixels, 8, 3.0));
    outcome.seconds.z += started.elapsed().as_secs_f64();
    let growth = schedule.growth as f32;
    let mut beta = schedule.beta_start;
    for iteration in 0..schedule.num_iterations {
        if let Some(beta) = setting.edge_beta
            && let Some(share) = break_search(iteration, schedule.num_iterations)
        {
            outcome.num_breaks = state.soften(beta, share);
        }
        let started = Instant::now();
        let search = candidates.as_ref().filter(|_| iteration < searches);
        let energy = state.theta_step(beta as f32, search);
        outcome.seconds.theta += started.elapsed().as_secs_f64();

        let started = Instant::now();
        state.z_step(beta as f32, y);
        outcome.seconds.z += started.elapsed().as_secs_f64();

        let primal_residual = rms_difference(&state.gradient, &state.theta, num_pixels);
        let dual_residual = rms_difference(&state.gradient, &state.wanted, num_pixels);
        state.update_dual(growth);
        outcome.records.push(IterationRecord {
            level: at,
            beta,
            energy: energy * f64::from(level.scale * level.scale),
            primal_residual,
            dual_residual,
        });
        let max_num_iterations = setting.schedules.iter().map(|c| c.num_iterations).sum();
        report(&outcome.records, max_num_iterations, setting.observer)?;
        beta *= f64::from(growth);
    }
    if at == 0 {
        outcome.stiffness = state.stiffness;
        outcome.theta = state.theta;
    }
    Ok(())
}

/// Reports the last iteration to the observer.
///
/// # Errors
/// [`ShadingError::Interrupted`] where it asks to stop.
pub(crate) fn report(
    records: &[IterationRecord],
    max_num_iterations: usize,
    observer: &dyn Observer,
) -> Result<(), ShadingError> {
    let Some(last) = records.last() else {
        return Ok(());
    };
    let flow = observer.event(Event::Iteration {
        stage: StageId::Shading,
        iteration: records.len() - 1,
        max_num_iterations,
        energy: last.energy,
        primal_residual: Some(last.primal_residual),
        dual_residual: Some(last.dual_residual),
        beta: Some(last.beta),
    });
    flow.ok_or(ShadingError::Interrupted)
}

/// Ties of a coarser level: points are placed by position, masses by node. In the coarse unknown,
/// half as large, a squared difference counts four times; so do the four fine nodes of a coarse
/// one, which the coarse pixel's fourfold area cancels.
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
