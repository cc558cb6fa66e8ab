//! Patch alignment over several views: depth and slope of a small plane.
//!
//! Unknowns of a patch centred at reference pixel `x₀`: inverse depth `q` and its slopes `q_x`,
//! `q_y` per pixel. With `T(d)` the reference's log image at offset `d` (mean removed), `I_s` that
//! of source `s` and `u_s(d)` the pixel of [`super::pair`], the residual is
//! `e_s(d) = I_s(u_s(d)) − T(d) − o_s − γ_s T(d)`: an offset (a gain of the linear intensity) and a
//! gain (contrast) per patch and source. The cost `Σ_s Σ_d w e² + (γ/σ_γ)²` + slope prior is
//! minimised by Gauss-Newton; offset and gain are eliminated exactly (variable projection with the
//! projected Jacobian), so that the step solves 3×3. Where exposure is known to vary little between
//! two photos the offset has a prior (see [`super::exposure`]): absolute brightness then shows
//! depth where shading changes too slowly for the texture to.
//!
//! Derivative: `∂u/∂q = (b₁ − u b₃)/h₃` (and `v` alike), times the gradient of `I_s`; by the slopes
//! the same times `d_x`, `d_y`.
//!
//! Samples and their weights are described in [`super::sampling`], the sums and the elimination in
//! [`super::elimination`].

use super::elimination::{Reduced, accumulate};
use super::pair::{MAX_SOURCES, PairGeometry};
use super::plane::PatchPlane;
use super::sampling::{LocalWarp, Workspace, sample_source};
use super::working::WorkingView;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Smallest share of the template's samples that must be usable in a source.
const MIN_SOURCE_SHARE: f64 = 0.8;

/// Deviation of the log intensity that no photo stays below: a quarter of an 8-bit step at mid grey.
/// Without it a blank patch would claim any precision.
const LEAST_NOISE: f64 = 1e-3;

/// Residuals are correlated: a patch's samples weigh as little as this many times fewer independent
/// ones, so that a prior must weigh this much more against them (the square of a noise factor of 7).
const CORRELATED: f64 = 50.0;
/// Iteration at which sources that disagree are dropped.
const JUDGE_AT: usize = 3;
/// Up to a step of this length every second sample is enough, pixels of disparity: the patch will
/// move on from there anyway (measured: four fifths of the time, the same errors).
const COARSE_STEP_PX: f64 = 0.1;
/// A step of this length ends the alignment, pixels of disparity; it is taken, and everything else
/// is as it was before it.
const LAST_STEP_PX: f64 = 0.02;
/// Evaluations before the end: the first has no weights yet.
const MIN_NUM_ITERATIONS: usize = 2;

/// Gauss-Newton steps at most.
const MAX_NUM_ITERATIONS: usize = 8;
/// Prior deviation of the contrast between views: larger lets patches of another texture pass,
/// smaller fails where photos are tone-mapped differently.
const GAIN_SIGMA: f64 = 0.02;
/// Prior deviation of the change of slope, tangent of the tilt.
const SLOPE_SIGMA: f64 = 0.5;
/// Smallest zero-mean correlation of a source that is kept.
pub(super) const MIN_CORRELATION: f64 = 0.7;
/// Scale of the weights in units of a source's RMS residual.
const ROBUST_SCALE: f64 = 2.5;
/// A patch that strays this far from its start is given up, pixels of disparity.
const MAX_MOVE_PX: f64 = 4.0;

#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Alignment {
    pub plane: PatchPlane,
    /// Sources that agree.
    pub num_sources: usize,
    /// Those sources (working-view indices) with the offset of their log image.
    pub offsets: [(usize, f64); MAX_SOURCES],
    /// Mean zero-mean correlation with them.
    pub correlation: f64,
    /// Weighted RMS residual, log intensity.
    pub rms: f64,
    /// Standard deviation of `q` by least squares with independent residuals.
    pub sigma_q: f64,
    /// Standard error of the mean of the sources' own estimates of `q`; 0 with one source.
    pub spread_q: f64,
    /// Largest disparity per unit of `q`, working pixels.
    pub px_per_q: f64,
    /// Length of the last step, pixels of disparity.
    pub last_step_px: f64,
}

/// Aligns a patch of the reference with its sources, from a starting plane; `radius_px` of the disc
/// in working pixels.
///
/// `None` where the patch or its images are not usable, fewer than two sources agree (one of two
/// views), or the patch has no contrast along the epipolar lines.
pub(super) fn align(
    views: &[WorkingView],
    reference: usize,
    sources: &[&PairGeometry],
    start: &PatchPlane,
    radius_px: usize,
    ws: &mut Workspace,
) -> Option<Alignment> {
    let sources = &sources[..sources.len().min(MAX_SOURCES)];
    let min_num_sources = 2.min(views.len() - 1);
    if sources.len() < min_num_sources {
        return None;
    }
    ws.prepare(radius_px);
    let view = &views[reference];
    ws.load_template(view, start.x, start.y)?;
    let mut state = SourceStates::of(sources);
    // Unknowns (q, w q_x, w q_y) with the radius w: all three in units of q.
    let w = radius_px as f64;
    let mut plane = *start;
    let mut last_step_px = f64::INFINITY;
    let mut residual_variance = 1e-4;
    let mut all_samples = false;
    for iteration in 0..=MAX_NUM_ITERATIONS {
        all_samples |= iteration >= JUDGE_AT || last_step_px < COARSE_STEP_PX;
        ws.use_samples(all_samples);
        state.evaluate(views, &plane, radius_px, residual_variance, ws);
        // A source is judged once the others have had time to agree.
        if iteration == JUDGE_AT {
            state.drop_disagreeing();
        }
        let mut normal = state.normal(min_num_sources)?;
        residual_variance = normal.residual_variance();
        let slopes = SlopePrior {
            start,
            sigma: SLOPE_SIGMA * plane.q / view.camera.focal(),
            radius: w,
        };
        let mut solved = slopes.solve(&normal, &plane)?;
        let px = state.px_per_q(&plane);
        last_step_px = solved.step.x.abs() * px;
        let settled = all_samples && iteration >= MIN_NUM_ITERATIONS && last_step_px < LAST_STEP_PX;
        if settled || iteration == MAX_NUM_ITERATIONS {
            if state.drop_disagreeing() {
                normal = state.normal(min_num_sources)?;
                residual_variance = normal.residual_variance();
                solved = slopes.solve(&normal, &plane)?;
            }
            let px_per_q = state.px_per_q(&plane);
            last_step_px = solved.step.x.abs() * px_per_q;
            if last_step_px < LAST_STEP_PX {
                plane = moved(&plane, &solved.step, w);
            }
            let variance_q = solved.inverse[(0, 0)] * residual_variance;
            return state.alignment(Alignment {
                plane,
                rms: residual_variance.sqrt(),
                sigma_q: variance_q.sqrt(),
                px_per_q,
                last_step_px,
                ..Alignment::default()
            });
        }
        // Linearisation holds for about two pixels.
        let mut step = solved.step;
        let excess = last_step_px / 2.0;
        if excess > 1.0 {
            step /= excess;
            last_step_px = 2.0;
        }
        plane = moved(&plane, &step, w);
        let moved_px = (plane.q - start.q).abs() * px;
        if plane.q <= 0.0 || moved_px.is_nan() || moved_px > MAX_MOVE_PX {
            return None;
        }
    }
    None
}

/// What is known of each source while a patch is aligned.
struct SourceStates<'a> {
    sources: &'a [&'a PairGeometry],
    /// Whether it still agrees.
    active: [bool; MAX_SOURCES],
    /// Its share of the normal equations at the last plane.
    reduced: [Reduced; MAX_SOURCES],
    /// 1/c² of the weights.
    inv_c2: [f64; MAX_SOURCES],
    /// Mean of the source at the patch's centre above the template's: sums leave it out.
    shift: [f64; MAX_SOURCES],
}

impl<'a> SourceStates<'a> {
    fn of(sources: &'a [&'a PairGeometry]) -> Self {
        Self {
            sources,
            active: std::array::from_fn(|s| s < sources.len()),
            reduced: Default::default(),
            inv_c2: Default::default(),
            shift: Default::default(),
        }
    }

    /// Those that agree.
    fn agreeing(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.sources.len()).filter(|&s| self.active[s])
    }

    /// Samples the sources under a plane; those that cannot be are active no longer.
    fn evaluate(
        &mut self,
        views: &[WorkingView],
        plane: &PatchPlane,
        radius_px: usize,
        residual_variance: f64,
        ws: &mut Workspace,
    ) {
        for s in 0..self.sources.len() {
            if self.active[s] {
                let sampled = self.sample(s, views, plane, radius_px, residual_variance, ws);
                self.active[s] = sampled.is_some();
            }
        }
    }

    fn sample(
        &mut self,
        s: usize,
        views: &[WorkingView],
        plane: &PatchPlane,
        radius_px: usize,
        residual_variance: f64,
        ws: &mut Workspace,
    ) -> Option<()> {
        let source = self.sources[s];
        let view = &views[source.source];
        let warp = LocalWarp::new(source, plane)?;
        if !warp.fits(radius_px, view.camera.width, view.camera.height)
            || sample_source(view, &warp, ws, s) < MIN_SOURCE_SHARE
        {
            return None;
        }
        let mut sums = accumulate(ws, s, self.inv_c2[s] as f32);
        let (center_x, center_y) = warp.center();
        self.shift[s] = f64::from(view.texel(center_x, center_y)[0]) - ws.mean;
        if let Some(prior) = source.offset {
            let precision = CORRELATED * residual_variance / prior.sigma.powi(2);
            sums.expect_offset(prior.mean - self.shift[s], precision);
        }
        let reduced = sums.eliminate(residual_variance / GAIN_SIGMA.powi(2))?;
        ws.brightness[s] = (reduced.offset, reduced.gain);
        let variance = reduced.squares / reduced.weight + 1e-12;
        self.inv_c2[s] = 1.0 / (ROBUST_SCALE.powi(2) * variance);
        self.reduced[s] = reduced;
        Some(())
    }

    /// Largest disparity per unit of `q`, working pixels.
    fn px_per_q(&self, plane: &PatchPlane) -> f64 {
        let (x, y) = (plane.x as f64, plane.y as f64);
        self.agreeing()
            .map(|s| self.sources[s].px_per_inverse_depth(x, y, plane.q))
            .fold(0.0, f64::max)
    }

    /// Sums the sources that agree; `None` when they are too few.
    fn normal(&self, min_num_sources: usize) -> Option<Normal> {
        if self.agreeing().count() < min_num_sources.max(1) {
            return None;
        }
        let mut normal = Normal::default();
        for source in self.agreeing().map(|s| &self.reduced[s]) {
            normal.hessian += source.hessian;
            normal.gradient += source.gradient;
            normal.squares += source.squares;
            normal.weight += source.weight;
        }
        Some(normal)
    }

    /// Drops sources that correlate too little or err by more than twice the median; whether there
    /// were any.
    fn drop_disagreeing(&mut self) -> bool {
        let rms = |source: &Reduced| (source.squares / source.weight).sqrt();
        let mut sorted = [0.0; MAX_SOURCES];
        let count = self.agreeing().count();
        for (value, s) in sorted.iter_mut().zip(self.agreeing()) {
            *value = rms(&self.reduced[s]);
        }
        sorted[..count].sort_unstable_by(f64::total_cmp);
        let median = match count {
            0 => return false,
            n if n % 2 == 1 => sorted[n / 2],
            n => 0.5 * (sorted[n / 2] + sorted[n / 2 - 1]),
        };
        let before = self.active;
        for (active, source) in self.active.iter_mut().zip(&self.reduced) {
            *active &= source.correlation >= MIN_CORRELATION && rms(source) <= 2.0 * median;
        }
        self.active != before
    }

    /// The result, with the spread of the sources' own depth estimates at the common slopes; `None`
    /// without information.
    fn alignment(&self, found: Alignment) -> Option<Alignment> {
        let (mut deviations, mut information) = (0.0, 0.0);
        let mut correlation = 0.0;
        let mut offsets = [(usize::MAX, 0.0); MAX_SOURCES];
        let mut count = 0;
        for s in self.agreeing() {
            let source = &self.reduced[s];
            let h = source.hessian[(0, 0)];
            if h > 0.0 {
                deviations += source.gradient[0].powi(2) / h;
                information += h;
            }
            correlation += source.correlation;
            offsets[count] = (self.sources[s].source, source.offset + self.shift[s]);
            count += 1;
        }
        if information <= 0.0 || found.sigma_q.is_nan() || found.sigma_q <= 0.0 {
            return None;
        }
        let degrees = (count as f64 - 1.0).max(1.0);
        Some(Alignment {
            num_sources: count,
            offsets,
            correlation: correlation / count as f64,
            spread_q: if count > 1 {
                (deviations / information / degrees).sqrt()
            } else {
                0.0
            },
            ..found
        })
    }
}

/// The plane less a step of `(q, w q_x, w q_y)`.
fn moved(plane: &PatchPlane, step: &Vector3<f64>, w: f64) -> PatchPlane {
    PatchPlane {
        q: plane.q - step.x,
        qx: plane.qx - step.y / w,
        qy: plane.qy - step.z / w,
        ..*plane
    }
}

/// Normal equations of all sources that agree.
#[derive(Default)]
struct Normal {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    squares: f64,
    weight: f64,
}

impl Normal {
    fn residual_variance(&self) -> f64 {
        self.squares / (self.weight - 3.0).max(1.0) + LEAST_NOISE.powi(2)
    }
}

/// Holds slopes near their start.
struct SlopePrior<'a> {
    start: &'a PatchPlane,
    /// Deviation, inverse depth per pixel.
    sigma: f64,
    /// Radius of the patch: columns scaled by it make the matrix well conditioned in any unit.
    radius: f64,
}

/// A Gauss-Newton step of `(q, w q_x, w q_y)` and the inverse of its matrix.
struct Solved {
    step: Vector3<f64>,
    inverse: Matrix3<f64>,
}

impl SlopePrior<'_> {
    fn solve(&self, normal: &Normal, plane: &PatchPlane) -> Option<Solved> {
        let (mut hessian, mut gradient) = (normal.hessian, normal.gradient);
        let precision = normal.residual_variance() / self.sigma.powi(2);
        gradient.y += precision * (plane.qx - self.start.qx);
        gradient.z += precision * (plane.qy - self.start.qy);
        hessian[(1, 1)] += precision;
        hessian[(2, 2)] += precision;
        let inv = 1.0 / self.radius;
        let scale = Matrix3::from_diagonal(&Vector3::new(1.0, inv, inv));
        let scaled = scale * hessian * scale;
        let inverse =
            (scaled + Matrix3::from_diagonal(&(scaled.diagonal() * 1e-6))).try_inverse()?;
        Some(Solved {
            step: inverse * (scale * gradient),
            inverse,
        })
    }
}
