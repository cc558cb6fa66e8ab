//! Patch alignment over several views: depth and slope of a small plane.
//!
//! Unknowns of a patch centred at reference pixel `x₀`: inverse depth `q` and its slopes `q_x`,
//! `q_y` per pixel. With `T(d)` the reference's log image at offset `d` (mean removed), `I_s` that
//! of source `s` and `u_s(d)` the pixel of [`super::pair`], the residual is
//! `e_s(d) = I_s(u_s(d)) − T(d) − o_s − γ_s T(d)`: an offset (a gain of the linear intensity) and a
//! gain (contrast) per patch and source. The cost `Σ_s Σ_d w e² + (γ/σ_γ)²` + slope prior is
//! minimised by Gauss-Newton; offset and gain are eliminated exactly (variable projection with the
//! projected Jacobian), so that the step solves 3×3. Where exposure is known to vary little between
//! two photos the offset has a prior (see [`super::exposure`]): absolute brightness then tells depth
//! where shading changes too slowly for the texture to.
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

/// Residuals are correlated: a patch's samples tell as little as this many times fewer independent
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

/// How patches are aligned.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchOptions {
    /// Radius of the disc, working pixels.
    pub radius_px: usize,
    /// Gauss-Newton steps at most.
    pub max_num_iterations: usize,
    /// Prior deviation of the contrast between views.
    pub gain_sigma: f64,
    /// Prior deviation of the change of slope, tangent of the tilt.
    pub slope_sigma: f64,
    /// Smallest zero-mean correlation of a source that is kept.
    pub min_correlation: f64,
    /// Scale of the weights in units of a source's RMS residual.
    pub robust_scale: f64,
    /// Sources that must agree.
    pub min_num_sources: usize,
    /// A patch that strays this far from its start is given up, pixels of disparity.
    pub max_move_px: f64,
}

/// An aligned patch.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Alignment {
    /// The plane found.
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

/// Aligns a patch of the reference with its sources, from a starting plane.
///
/// `None` where the patch or its images are not usable, too few sources agree, or the patch has no
/// contrast along the epipolar lines.
pub(super) fn align(
    views: &[WorkingView],
    reference: usize,
    sources: &[&PairGeometry],
    start: &PatchPlane,
    options: &PatchOptions,
    ws: &mut Workspace,
) -> Option<Alignment> {
    let num_sources = sources.len().min(MAX_SOURCES);
    if num_sources < options.min_num_sources {
        return None;
    }
    ws.prepare(options.radius_px);
    let view = &views[reference];
    ws.load_template(view, start.x, start.y)?;
    // Unknowns (q, w q_x, w q_y) with the radius w: all three in units of q.
    let w = options.radius_px as f64;
    let mut plane = *start;
    let mut active = [false; MAX_SOURCES];
    active[..num_sources].fill(true);
    let mut reduced = [Reduced::default(); MAX_SOURCES];
    let mut inv_c2 = [0.0_f64; MAX_SOURCES];
    // Mean of the source at the patch's centre above the template's: sums leave it out.
    let mut shift = [0.0_f64; MAX_SOURCES];
    let mut last_step_px = f64::INFINITY;
    let px_per_q = |plane: &PatchPlane, active: &[bool; MAX_SOURCES]| {
        (0..num_sources)
            .filter(|&s| active[s])
            .map(|s| sources[s].px_per_inverse_depth(plane.x as f64, plane.y as f64, plane.q))
            .fold(0.0, f64::max)
    };
    let mut residual_variance = 1e-4;
    let mut all_samples = false;
    for iteration in 0..=options.max_num_iterations {
        all_samples |= iteration >= JUDGE_AT || last_step_px < COARSE_STEP_PX;
        ws.use_samples(all_samples);
        for s in 0..num_sources {
            if !active[s] {
                continue;
            }
            active[s] = false;
            let source_view = &views[sources[s].source];
            let Some(warp) = LocalWarp::new(sources[s], &plane) else {
                continue;
            };
            if !warp.fits(
                options.radius_px,
                source_view.camera.width,
                source_view.camera.height,
            ) || sample_source(source_view, &warp, ws, s) < MIN_SOURCE_SHARE
            {
                continue;
            }
            let mut sums = accumulate(ws, s, inv_c2[s] as f32);
            let (center_x, center_y) = warp.center();
            shift[s] = f64::from(source_view.texel(center_x, center_y)[0]) - ws.mean;
            if let Some(prior) = sources[s].offset {
                let precision = CORRELATED * residual_variance / prior.sigma.powi(2);
                sums.expect_offset(prior.mean - shift[s], precision);
            }
            let gain_precision = residual_variance / options.gain_sigma.powi(2);
            let Some(scaled) = sums.eliminate(gain_precision) else {
                continue;
            };
            reduced[s] = scaled;
            ws.brightness[s] = (scaled.offset, scaled.gain);
            let variance_s = scaled.squares / scaled.weight + 1e-12;
            inv_c2[s] = 1.0 / (options.robust_scale.powi(2) * variance_s);
            active[s] = true;
        }
        // A source is judged once the others have had time to agree.
        if iteration == JUDGE_AT {
            drop_disagreeing(&reduced, &mut active, options.min_correlation);
        }
        let mut normal = Normal::sum(&reduced, &active, options)?;
        residual_variance = normal.residual_variance();
        let slopes = SlopePrior {
            start,
            sigma: options.slope_sigma * plane.q / view.camera.focal(),
            radius: w,
        };
        let mut solved = slopes.solve(&normal, &plane)?;
        let px = px_per_q(&plane, &active);
        last_step_px = solved.step.x.abs() * px;
        let settled = all_samples && iteration >= MIN_NUM_ITERATIONS && last_step_px < LAST_STEP_PX;
        if settled || iteration == options.max_num_iterations {
            let before = active;
            drop_disagreeing(&reduced, &mut active, options.min_correlation);
            if active != before {
                normal = Normal::sum(&reduced, &active, options)?;
                residual_variance = normal.residual_variance();
                solved = slopes.solve(&normal, &plane)?;
            }
            let px = px_per_q(&plane, &active);
            last_step_px = solved.step.x.abs() * px;
            if last_step_px < LAST_STEP_PX {
                plane = moved(&plane, &solved.step, w);
            }
            return finish(Finished {
                plane: &plane,
                sources,
                shift: &shift,
                active: &active,
                reduced: &reduced,
                variance_q: solved.inverse[(0, 0)] * residual_variance,
                px_per_q: px,
                residual_variance,
                last_step_px,
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
        if plane.q <= 0.0 || moved_px.is_nan() || moved_px > options.max_move_px {
            return None;
        }
    }
    None
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
struct Normal {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    squares: f64,
    weight: f64,
}

impl Normal {
    /// Sums the sources in use; `None` when they are too few.
    fn sum(
        reduced: &[Reduced; MAX_SOURCES],
        active: &[bool; MAX_SOURCES],
        options: &PatchOptions,
    ) -> Option<Self> {
        let count = active.iter().filter(|&&a| a).count();
        if count < options.min_num_sources.max(1) {
            return None;
        }
        let mut normal = Self {
            hessian: Matrix3::zeros(),
            gradient: Vector3::zeros(),
            squares: 0.0,
            weight: 0.0,
        };
        for (source, _) in reduced.iter().zip(active).filter(|&(_, &a)| a) {
            normal.hessian += source.hessian;
            normal.gradient += source.gradient;
            normal.squares += source.squares;
            normal.weight += source.weight;
        }
        Some(normal)
    }

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

/// Drops sources that correlate too little or err by more than twice the median.
fn drop_disagreeing(
    reduced: &[Reduced; MAX_SOURCES],
    active: &mut [bool; MAX_SOURCES],
    min_correlation: f64,
) {
    let mut rms = [0.0; MAX_SOURCES];
    let mut count = 0;
    for s in 0..MAX_SOURCES {
        if active[s] {
            rms[count] = (reduced[s].squares / reduced[s].weight).sqrt();
            count += 1;
        }
    }
    let sorted = &mut rms[..count];
    sorted.sort_unstable_by(f64::total_cmp);
    let median = match count {
        0 => return,
        n if n % 2 == 1 => sorted[n / 2],
        n => 0.5 * (sorted[n / 2] + sorted[n / 2 - 1]),
    };
    for s in 0..MAX_SOURCES {
        let own = (reduced[s].squares / reduced[s].weight).sqrt();
        if active[s] && (reduced[s].correlation < min_correlation || own > 2.0 * median) {
            active[s] = false;
        }
    }
}

/// What an alignment ends with.
struct Finished<'a> {
    plane: &'a PatchPlane,
    sources: &'a [&'a PairGeometry],
    shift: &'a [f64; MAX_SOURCES],
    active: &'a [bool; MAX_SOURCES],
    reduced: &'a [Reduced; MAX_SOURCES],
    variance_q: f64,
    px_per_q: f64,
    residual_variance: f64,
    last_step_px: f64,
}

/// The result, with the spread of the sources' own depth estimates at the common slopes.
fn finish(end: Finished<'_>) -> Option<Alignment> {
    let (mut deviations, mut information) = (0.0, 0.0);
    let mut correlation = 0.0;
    let mut offsets = [(usize::MAX, 0.0); MAX_SOURCES];
    let mut count = 0;
    for s in (0..MAX_SOURCES).filter(|&s| end.active[s]) {
        let h = end.reduced[s].hessian[(0, 0)];
        if h > 0.0 {
            deviations += end.reduced[s].gradient[0].powi(2) / h;
            information += h;
        }
        correlation += end.reduced[s].correlation;
        offsets[count] = (end.sources[s].source, end.reduced[s].offset + end.shift[s]);
        count += 1;
    }
    if information <= 0.0 || end.variance_q.is_nan() || end.variance_q <= 0.0 {
        return None;
    }
    let degrees = (count as f64 - 1.0).max(1.0);
    Some(Alignment {
        plane: *end.plane,
        num_sources: count,
        offsets,
        correlation: correlation / count as f64,
        rms: end.residual_variance.sqrt(),
        sigma_q: end.variance_q.sqrt(),
        spread_q: if count > 1 {
            (deviations / information / degrees).sqrt()
        } else {
            0.0
        },
        px_per_q: end.px_per_q,
        last_step_px: end.last_step_px,
    })
}
