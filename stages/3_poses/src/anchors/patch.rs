//! Patch alignment over several views: depth and slope of a small plane.
//!
//! Unknowns of a patch centred at reference pixel `x₀`: inverse depth `q` and its slopes `q_x`,
//! `q_y` per pixel. With `T(d)` the reference's log image at offset `d` (mean removed), `I_s` that
//! of source `s` and `u_s(d)` the pixel of [`super::pair`], the residual is
//! `e_s(d) = I_s(u_s(d)) − T(d) − o_s − γ_s T(d)`: an offset (a gain of the linear intensity) and a
//! gain (contrast) per patch and source. The cost `Σ_s Σ_d w e² + (γ/σ_γ)²` + slope prior is
//! minimised by Gauss-Newton; offset and gain are eliminated exactly (variable projection with the
//! projected Jacobian), so that the step solves 3×3.
//!
//! Derivative: `∂u/∂q = (b₁ − u b₃)/h₃` (and `v` alike), times the gradient of `I_s`; by the slopes
//! the same times `d_x`, `d_y`.
//!
//! Samples lie on every second pixel like the dark squares of a chessboard: with the blur and the
//! noise of real photos residuals of neighbours correlate by 0.6 to 0.7, and half of them tell as
//! much as all (measured: the same depth errors at 0.7 of the time). They are weighed by a Gaussian
//! window, which follows curved surfaces better than a disc of the same precision, and by
//! 1/(1 + (e/c)²), `c` a multiple of the source's RMS of the iteration before: speckle
//! of the sensor and an edge that comes into view lose their pull, the bulk of a patch keeps it.
//!
//! Sums run over eight lanes (they vectorise) in f32 around the patch's own mean; elimination and
//! solution in f64. Nothing is allocated inside: all buffers are in [`Workspace`].

use super::pair::PairGeometry;
use super::working::{Texel, WorkingView};
use nalgebra::{Matrix3, Vector3};

/// Sources used for one patch at most.
pub(super) const MAX_SOURCES: usize = 4;
/// Lanes of the sums.
const LANES: usize = 8;
/// Deviation of the Gaussian window in units of the radius.
const WINDOW_SHARE: f32 = 3.0 / 7.0;
/// Smallest share of the patch's samples that must be usable in the reference.
const MIN_TEMPLATE_SHARE: f64 = 0.6;
/// Smallest share of the template's samples that must be usable in a source.
const MIN_SOURCE_SHARE: f64 = 0.8;
/// Flags are interpolated: below this a clipped or foreign pixel has touched the sample.
const USABLE: f32 = 0.999;
/// Largest stretch of a patch in a source: more is a grazing view.
const MAX_REACH_PX: f64 = 60.0;
/// Added to coordinates inside a patch so that truncation is flooring.
const COORDINATE_SHIFT: f32 = 64.0;

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

/// Buffers of the alignment.
#[derive(Clone, Debug, Default)]
pub(super) struct Workspace {
    disc: Vec<(i32, i32)>,
    window: Vec<f32>,
    radius: usize,
    /// Samples in use, without padding.
    pub len: usize,
    /// Offsets of the samples.
    pub dx: Vec<f32>,
    /// Offsets of the samples.
    pub dy: Vec<f32>,
    template: Vec<f32>,
    base_weight: Vec<f32>,
    /// Residuals `I_s − T` (before offset and gain) per source.
    pub residual: [Vec<f32>; MAX_SOURCES],
    slope: Vec<f32>,
    weight: Vec<f32>,
    /// Sum of the window over the samples.
    total_weight: f64,
    /// Offset and gain per source after the last evaluation.
    pub brightness: [(f64, f64); MAX_SOURCES],
}

impl Workspace {
    /// Sets the radius; allocates only when it changes.
    pub fn prepare(&mut self, radius: usize) {
        if self.radius == radius && !self.disc.is_empty() {
            return;
        }
        self.radius = radius;
        self.disc.clear();
        self.window.clear();
        let r = radius as i32;
        let sigma = WINDOW_SHARE * radius as f32;
        for y in -r..=r {
            for x in -r..=r {
                if x * x + y * y <= r * r + 1 && (x + y) % 2 == 0 {
                    self.disc.push((x, y));
                    let distance2 = (x * x + y * y) as f32;
                    self.window.push((-0.5 * distance2 / (sigma * sigma)).exp());
                }
            }
        }
        let padded = self.disc.len().next_multiple_of(LANES);
        for buffer in [
            &mut self.dx,
            &mut self.dy,
            &mut self.template,
            &mut self.base_weight,
            &mut self.slope,
            &mut self.weight,
        ]
        .into_iter()
        .chain(&mut self.residual)
        {
            buffer.clear();
            buffer.resize(padded, 0.0);
        }
    }

    /// Fills the template around a pixel; `None` where too little is usable.
    fn load_template(&mut self, view: &WorkingView, x: usize, y: usize) -> Option<()> {
        let (width, height) = (view.width as i32, view.height as i32);
        let mut n = 0;
        let mut mean = 0.0_f64;
        for (k, &(dx, dy)) in self.disc.iter().enumerate() {
            let (px, py) = (x as i32 + dx, y as i32 + dy);
            if px < 0 || py < 0 || px >= width || py >= height {
                continue;
            }
            let texel = view.texel(px as usize, py as usize);
            if texel[3] < USABLE {
                continue;
            }
            self.dx[n] = dx as f32;
            self.dy[n] = dy as f32;
            self.template[n] = texel[0];
            self.base_weight[n] = self.window[k];
            mean += f64::from(texel[0]);
            n += 1;
        }
        if (n as f64) < MIN_TEMPLATE_SHARE * self.disc.len() as f64 {
            return None;
        }
        self.len = n;
        self.total_weight = self.base_weight[..n].iter().map(|&w| f64::from(w)).sum();
        mean /= n as f64;
        for value in &mut self.template[..n] {
            *value -= mean as f32;
        }
        // Padding: samples at the centre that weigh nothing.
        for k in n..n.next_multiple_of(LANES) {
            self.dx[k] = 0.0;
            self.dy[k] = 0.0;
            self.template[k] = 0.0;
            self.base_weight[k] = 0.0;
        }
        Some(())
    }
}

/// The homography of a patch relative to the image of its centre, in f32 without loss:
/// offsets of a few pixels around `(u0, v0)`.
struct LocalWarp {
    u0: f64,
    v0: f64,
    u_by: [f32; 2],
    v_by: [f32; 2],
    w_by: [f32; 2],
    b: [f32; 3],
}

impl LocalWarp {
    fn new(pair: &PairGeometry, plane: &PatchPlane) -> Option<Self> {
        let center = Vector3::new(plane.x as f64, plane.y as f64, 1.0);
        let h0 = pair.a * center + pair.b * plane.q;
        if h0.z.is_nan() || h0.z <= 0.0 {
            return None;
        }
        let h1 = pair.a.column(0) + pair.b * plane.qx;
        let h2 = pair.a.column(1) + pair.b * plane.qy;
        let (u0, v0) = (h0.x / h0.z, h0.y / h0.z);
        let z = 1.0 / h0.z;
        Some(Self {
            u0,
            v0,
            u_by: [
                ((h1.x - u0 * h1.z) * z) as f32,
                ((h2.x - u0 * h2.z) * z) as f32,
            ],
            v_by: [
                ((h1.y - v0 * h1.z) * z) as f32,
                ((h2.y - v0 * h2.z) * z) as f32,
            ],
            w_by: [(h1.z * z) as f32, (h2.z * z) as f32],
            b: [
                ((pair.b.x - u0 * pair.b.z) * z) as f32,
                ((pair.b.y - v0 * pair.b.z) * z) as f32,
                (pair.b.z * z) as f32,
            ],
        })
    }

    /// Whether the whole disc lands inside the source; its image is convex.
    fn fits(&self, radius: usize, width: usize, height: usize) -> bool {
        let r = radius as f64 + 0.5;
        for (dx, dy) in [(-r, -r), (r, -r), (-r, r), (r, r)] {
            let w = 1.0 + f64::from(self.w_by[0]) * dx + f64::from(self.w_by[1]) * dy;
            if w.is_nan() || w < 0.2 {
                return false;
            }
            let du = (f64::from(self.u_by[0]) * dx + f64::from(self.u_by[1]) * dy) / w;
            let dv = (f64::from(self.v_by[0]) * dx + f64::from(self.v_by[1]) * dy) / w;
            let (u, v) = (self.u0 + du, self.v0 + dv);
            let inside = u >= 0.0
                && v >= 0.0
                && u < (width - 2) as f64
                && v < (height - 2) as f64
                && du.abs() < MAX_REACH_PX
                && dv.abs() < MAX_REACH_PX;
            if !inside {
                return false;
            }
        }
        true
    }
}

/// Residuals, derivatives by `q` and weights of all samples in one source; the share of usable
/// samples.
fn sample_source(view: &WorkingView, warp: &LocalWarp, ws: &mut Workspace, source: usize) -> f64 {
    let (bx, by) = (warp.u0.floor(), warp.v0.floor());
    let fx = (warp.u0 - bx) as f32 + COORDINATE_SHIFT;
    let fy = (warp.v0 - by) as f32 + COORDINATE_SHIFT;
    let shift = COORDINATE_SHIFT as isize;
    let (ox, oy) = (bx as isize - shift, by as isize - shift);
    let width = view.width;
    let texels: &[Texel] = &view.texels;
    let center = view.texel(bx as usize, by as usize)[0];
    let padded = ws.len.next_multiple_of(LANES);
    let (dx, dy) = (&ws.dx[..padded], &ws.dy[..padded]);
    let (template, base) = (&ws.template[..padded], &ws.base_weight[..padded]);
    let residual = &mut ws.residual[source][..padded];
    let slope = &mut ws.slope[..padded];
    let weight = &mut ws.weight[..padded];
    let mut usable = 0.0_f32;
    for k in 0..padded {
        let (x, y) = (dx[k], dy[k]);
        let inv = 1.0 / (1.0 + warp.w_by[0] * x + warp.w_by[1] * y);
        let du = (warp.u_by[0] * x + warp.u_by[1] * y) * inv;
        let dv = (warp.v_by[0] * x + warp.v_by[1] * y) * inv;
        let (px, py) = (fx + du, fy + dv);
        let (ix, iy) = (px as i32, py as i32);
        let (tx, ty) = (px - ix as f32, py - iy as f32);
        let at = ((iy as isize + oy) * width as isize + ix as isize + ox) as usize;
        let (top, bottom) = (&texels[at..at + 2], &texels[at + width..at + width + 2]);
        let mut value = [0.0_f32; 4];
        for c in 0..4 {
            let a = top[0][c] + (top[1][c] - top[0][c]) * tx;
            let b = bottom[0][c] + (bottom[1][c] - bottom[0][c]) * tx;
            value[c] = a + (b - a) * ty;
        }
        // The centre's value keeps the sums small; the offset absorbs it.
        residual[k] = value[0] - center - template[k];
        slope[k] = (value[1] * (warp.b[0] - du * warp.b[2])
            + value[2] * (warp.b[1] - dv * warp.b[2]))
            * inv;
        weight[k] = if value[3] >= USABLE { base[k] } else { 0.0 };
        usable += weight[k];
    }
    f64::from(usable) / ws.total_weight
}

/// Weighted sums of products of `1, T, R, J, J dx, J dy`.
#[derive(Clone, Copy, Default)]
struct Sums {
    one: f64,
    t: f64,
    r: f64,
    j: [f64; 3],
    tt: f64,
    tr: f64,
    rr: f64,
    tj: [f64; 3],
    rj: [f64; 3],
    jj: [f64; 6],
}

/// Accumulates the sums of one source; `inv_c2` is 1/c² of the weights, 0 for none.
fn accumulate(ws: &Workspace, source: usize, inv_c2: f32) -> Sums {
    let padded = ws.len.next_multiple_of(LANES);
    let (offset, gain) = ws.brightness[source];
    let (offset, gain) = (offset as f32, gain as f32);
    let mut acc = [[0.0_f32; LANES]; 21];
    let lanes = |buffer: &[f32], at: usize| -> [f32; LANES] {
        let mut out = [0.0; LANES];
        out.copy_from_slice(&buffer[at..at + LANES]);
        out
    };
    for at in (0..padded).step_by(LANES) {
        let dx = lanes(&ws.dx, at);
        let dy = lanes(&ws.dy, at);
        let t = lanes(&ws.template, at);
        let r = lanes(&ws.residual[source], at);
        let j = lanes(&ws.slope, at);
        let w = lanes(&ws.weight, at);
        for l in 0..LANES {
            let e = r[l] - offset - gain * t[l];
            let w = w[l] / (1.0 + e * e * inv_c2);
            let (j1, j2) = (j[l] * dx[l], j[l] * dy[l]);
            let (wt, wr, wj, wj1, wj2) = (w * t[l], w * r[l], w * j[l], w * j1, w * j2);
            acc[0][l] += w;
            acc[1][l] += wt;
            acc[2][l] += wr;
            acc[3][l] += wj;
            acc[4][l] += wj1;
            acc[5][l] += wj2;
            acc[6][l] += wt * t[l];
            acc[7][l] += wt * r[l];
            acc[8][l] += wr * r[l];
            acc[9][l] += wt * j[l];
            acc[10][l] += wt * j1;
            acc[11][l] += wt * j2;
            acc[12][l] += wr * j[l];
            acc[13][l] += wr * j1;
            acc[14][l] += wr * j2;
            acc[15][l] += wj * j[l];
            acc[16][l] += wj * j1;
            acc[17][l] += wj * j2;
            acc[18][l] += wj1 * j1;
            acc[19][l] += wj1 * j2;
            acc[20][l] += wj2 * j2;
        }
    }
    let s = acc.map(|lanes| lanes.iter().map(|&v| f64::from(v)).sum::<f64>());
    Sums {
        one: s[0],
        t: s[1],
        r: s[2],
        j: [s[3], s[4], s[5]],
        tt: s[6],
        tr: s[7],
        rr: s[8],
        tj: [s[9], s[10], s[11]],
        rj: [s[12], s[13], s[14]],
        jj: [s[15], s[16], s[17], s[18], s[19], s[20]],
    }
}

/// A source's share of the normal equations after offset and gain are eliminated.
#[derive(Clone, Copy, Default)]
struct Reduced {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    squares: f64,
    weight: f64,
    correlation: f64,
    offset: f64,
    gain: f64,
}

impl Sums {
    /// Eliminates the offset, then the gain with its prior `gain_precision` (in units of squared
    /// residuals). `None` for a template or image without contrast.
    fn eliminate(&self, gain_precision: f64) -> Option<Reduced> {
        if self.one <= 0.0 {
            return None;
        }
        let inv = 1.0 / self.one;
        let tt = self.tt - self.t * self.t * inv;
        let tr = self.tr - self.t * self.r * inv;
        let rr = self.rr - self.r * self.r * inv;
        let j = self.j;
        let tj: [f64; 3] = std::array::from_fn(|k| self.tj[k] - self.t * j[k] * inv);
        let rj: [f64; 3] = std::array::from_fn(|k| self.rj[k] - self.r * j[k] * inv);
        // Source image I = T + R up to its offset.
        let variance_source = tt + 2.0 * tr + rr;
        let product = tt * variance_source;
        if product.is_nan() || product <= 0.0 {
            return None;
        }
        let correlation = (tt + tr) / product.sqrt();
        let denominator = tt + gain_precision;
        let gain = tr / denominator;
        let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let mut hessian = Matrix3::zeros();
        for (k, &(a, b)) in pairs.iter().enumerate() {
            let value = self.jj[k] - j[a] * j[b] * inv - tj[a] * tj[b] / denominator;
            hessian[(a, b)] = value;
            hessian[(b, a)] = value;
        }
        Some(Reduced {
            hessian,
            gradient: Vector3::from_fn(|k, _| rj[k] - tj[k] * gain),
            squares: (rr - tr * gain).max(0.0),
            weight: self.one,
            correlation,
            offset: (self.r - gain * self.t) * inv,
            gain,
        })
    }
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
            let sums = accumulate(ws, s, inv_c2[s] as f32);
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
        if last || iteration == options.max_num_iterations / 2 {
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
        residual_variance = squares / (weight - 3.0).max(1.0) + 1e-10;
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
        if plane.q.is_nan() || plane.q <= 0.0 {
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
fn finish(
    plane: &PatchPlane,
    active: &[bool; MAX_SOURCES],
    reduced: &[Reduced; MAX_SOURCES],
    variance_q: f64,
    px_per_q: f64,
    residual_variance: f64,
    last_step_px: f64,
) -> Option<Alignment> {
    let (mut deviations, mut information) = (0.0, 0.0);
    let mut correlation = 0.0;
    let mut count = 0;
    for s in (0..MAX_SOURCES).filter(|&s| active[s]) {
        let h = reduced[s].hessian[(0, 0)];
        if h > 0.0 {
            deviations += reduced[s].gradient[0].powi(2) / h;
            information += h;
        }
        correlation += reduced[s].correlation;
        count += 1;
    }
    if information <= 0.0 || variance_q.is_nan() || variance_q <= 0.0 {
        return None;
    }
    let degrees = (count as f64 - 1.0).max(1.0);
    Some(Alignment {
        plane: *plane,
        num_sources: count,
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
