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
use super::pair::PairGeometry;
use super::sampling::{LocalWarp, Workspace, sample_source};
use super::working::WorkingView;
use nalgebra::{Matrix3, Vector3};

/// Sources used for one patch at most.
pub(super) const MAX_SOURCES: usize = 4;
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

/// A plane through a reference pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PatchPlane {
    /// Column of the centre.
    pub x: usize,
    /// Row of the centre.
    pub y: usize,
    /// Inverse depth at the centre.
    pub q: f64,
    /// Change of the inverse depth per column.
    pub qx: f64,
    /// Change of the inverse depth per row.
    pub qy: f64,
}

/// An aligned patch.
#[derive(Clone, Copy, Debug)]
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
    for iteration in 0..=options.max_num_iterations {
        for s in 0..num_sources {
            if !active[s] {
                continue;
            }
            active[s] = false;
            let source_view = &views[sources[s].source];
            let Some(warp) = LocalWarp::new(sources[s], &plane) else {
                continue;
            };
            if !warp.fits(options.radius_px, source_view.width, source_view.height)
                || sample_source(source_view, &warp, ws, s) < MIN_SOURCE_SHARE
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
        let settled = last_step_px < 0.02;
        let last = iteration == options.max_num_iterations || settled;
        // A source is judged once the others have had time to agree.
        if last || iteration == JUDGE_AT {
            drop_disagreeing(&reduced, &mut active, options.min_correlation);
        }
        let count = active.iter().filter(|&&a| a).count();
        if count < options.min_num_sources.max(1) {
            return None;
        }
        let (mut hessian, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
        let (mut squares, mut weight) = (0.0, 0.0);
        for s in (0..num_sources).filter(|&s| active[s]) {
            hessian += reduced[s].hessian;
            gradient += reduced[s].gradient;
            squares += reduced[s].squares;
            weight += reduced[s].weight;
        }
        residual_variance = squares / (weight - 3.0).max(1.0) + LEAST_NOISE.powi(2);
        // Slopes are held near their start; one unit of the tangent is q / f per pixel.
        let precision = residual_variance / (options.slope_sigma * plane.q / view.focal()).powi(2);
        for (k, (now, before)) in [(plane.qx, start.qx), (plane.qy, start.qy)]
            .into_iter()
            .enumerate()
        {
            hessian[(k + 1, k + 1)] += precision;
            gradient[k + 1] += precision * (now - before);
        }
        // Columns scaled by the radius: the matrix is well conditioned whatever the unit.
        let scale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0 / w, 1.0 / w));
        let scaled_hessian = scale * hessian * scale;
        let inverse = (scaled_hessian
            + Matrix3::from_diagonal(&(scaled_hessian.diagonal() * 1e-6)))
        .try_inverse()?;
        if last {
            let covariance = inverse * residual_variance;
            return finish(
                &plane,
                sources,
                &shift,
                &active,
                &reduced,
                covariance[(0, 0)],
                px_per_q(&plane, &active),
                residual_variance,
                last_step_px,
            );
        }
        let mut step = inverse * (scale * gradient);
        let px = px_per_q(&plane, &active);
        // Linearisation holds for about two pixels.
        let excess = step.x.abs() * px / 2.0;
        if excess > 1.0 {
            step /= excess;
        }
        plane.q -= step.x;
        plane.qx -= step.y / w;
        plane.qy -= step.z / w;
        let moved_px = (plane.q - start.q).abs() * px;
        if plane.q <= 0.0 || moved_px.is_nan() || moved_px > options.max_move_px {
            return None;
        }
        last_step_px = step.x.abs() * px;
    }
    None
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

/// The result, with the spread of the sources' own depth estimates at the common slopes.
#[allow(clippy::too_many_arguments)]
fn finish(
    plane: &PatchPlane,
    sources: &[&PairGeometry],
    shift: &[f64; MAX_SOURCES],
    active: &[bool; MAX_SOURCES],
    reduced: &[Reduced; MAX_SOURCES],
    variance_q: f64,
    px_per_q: f64,
    residual_variance: f64,
    last_step_px: f64,
) -> Option<Alignment> {
    let (mut deviations, mut information) = (0.0, 0.0);
    let mut correlation = 0.0;
    let mut offsets = [(usize::MAX, 0.0); MAX_SOURCES];
    let mut count = 0;
    for s in (0..MAX_SOURCES).filter(|&s| active[s]) {
        let h = reduced[s].hessian[(0, 0)];
        if h > 0.0 {
            deviations += reduced[s].gradient[0].powi(2) / h;
            information += h;
        }
        correlation += reduced[s].correlation;
        offsets[count] = (sources[s].source, reduced[s].offset + shift[s]);
        count += 1;
    }
    if information <= 0.0 || variance_q.is_nan() || variance_q <= 0.0 {
        return None;
    }
    let degrees = (count as f64 - 1.0).max(1.0);
    Some(Alignment {
        plane: *plane,
        num_sources: count,
        offsets,
        correlation: correlation / count as f64,
        rms: residual_variance.sqrt(),
        sigma_q: variance_q.sqrt(),
        spread_q: if count > 1 {
            (deviations / information / degrees).sqrt()
        } else {
            0.0
        },
        px_per_q,
        last_step_px,
    })
}
