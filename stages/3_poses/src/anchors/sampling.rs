//! Samples of a patch: template, warp into a source, interpolation.
//!
//! Samples lie on every second pixel like the dark squares of a chessboard: with the blur and the
//! noise of real photos residuals of neighbours correlate by 0.6 to 0.7, and half of them weigh as
//! much as all (measured: the same depth errors at 0.7 of the time). They are weighed by a Gaussian
//! window, which follows curved surfaces better than a disc of the same precision. Those in even
//! columns come first: they alone serve while a patch is still far from its place.
//!
//! The plane of the patch maps by the homography `H` of [`super::pair`]. Relative to the image
//! `(u₀, v₀)` of the centre it is `du = (a_x d_x + a_y d_y)/(1 + w_x d_x + w_y d_y)`, `dv` alike, exactly
//! and with small numbers, so that f32 suffices. The derivative by inverse depth there is
//! `∂u/∂q = (b₁ − u₀ b₃ − du b₃)/(h₃ (1 + w·d))`.

use super::pair::{MAX_SOURCES, PairGeometry};
use super::plane::PatchPlane;
use super::working::{Texel, WorkingView};

/// Lanes of the sums.
pub(super) const LANES: usize = 8;
/// Deviation of the Gaussian window in units of the radius.
const WINDOW_SHARE: f32 = 3.0 / 7.0;
/// Smallest share of the patch's samples that must be usable in the reference.
const MIN_TEMPLATE_SHARE: f64 = 0.6;
/// Flags are interpolated: below this a clipped or foreign pixel has touched the sample.
const USABLE: f32 = 0.999;
/// Largest stretch of a patch in a source: more is a grazing view.
const MAX_REACH_PX: f64 = 60.0;
/// Added to coordinates inside a patch so that truncation is flooring.
const COORDINATE_SHIFT: f32 = 64.0;

#[derive(Clone, Debug, Default)]
pub(super) struct Workspace {
    disc: Vec<(i32, i32)>,
    window: Vec<f32>,
    radius: usize,
    /// Samples in use, without padding.
    pub len: usize,
    /// Samples that the template has: of the coarse lattice, and all.
    lens: [usize; 2],
    /// Offsets of the samples.
    pub dx: Vec<f32>,
    /// Offsets of the samples.
    pub dy: Vec<f32>,
    /// Template, mean removed.
    pub template: Vec<f32>,
    base_weight: Vec<f32>,
    /// Residuals `I_s − T` (before offset and gain) per source.
    pub residual: [Vec<f32>; MAX_SOURCES],
    /// Derivatives of the source's value by `q`, of the source sampled last.
    pub slope: Vec<f32>,
    /// Weights of its samples, 0 where not usable.
    pub weight: Vec<f32>,
    /// Sum of the window over the samples in use.
    total_weight: f64,
    /// Mean that was taken off the template.
    pub mean: f64,
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
        for odd in [0, 1] {
            for y in -r..=r {
                for x in -r..=r {
                    let distance2 = x * x + y * y;
                    if distance2 <= r * r + 1 && (x + y) % 2 == 0 && x.rem_euclid(2) == odd {
                        self.disc.push((x, y));
                        let window = (-0.5 * distance2 as f32 / (sigma * sigma)).exp();
                        self.window.push(window);
                    }
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
    pub fn load_template(&mut self, view: &WorkingView, x: usize, y: usize) -> Option<()> {
        let (width, height) = (view.camera.width as i32, view.camera.height as i32);
        let mut n = 0;
        let mut mean = 0.0_f64;
        let mut num_even = 0;
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
            if dx % 2 == 0 {
                num_even = n;
            }
        }
        if (n as f64) < MIN_TEMPLATE_SHARE * self.disc.len() as f64 {
            return None;
        }
        // Whole lanes, so that none of the other lattice's samples slip in.
        self.lens = [(num_even / LANES * LANES).max(LANES).min(n), n];
        mean /= n as f64;
        self.mean = mean;
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
        self.use_samples(true);
        Some(())
    }

    /// Takes all samples into use, or those of the coarse lattice alone.
    pub fn use_samples(&mut self, all: bool) {
        self.len = self.lens[usize::from(all)];
        self.total_weight = self.base_weight[..self.len]
            .iter()
            .map(|&w| f64::from(w))
            .sum();
    }
}

/// The homography of a patch relative to the image of its centre, in f32 without loss:
/// offsets of a few pixels around `(u0, v0)`.
pub(super) struct LocalWarp {
    u0: f64,
    v0: f64,
    u_by: [f32; 2],
    v_by: [f32; 2],
    w_by: [f32; 2],
    b: [f32; 3],
}

impl LocalWarp {
    /// The warp of a plane; `None` behind the source.
    pub fn new(pair: &PairGeometry, plane: &PatchPlane) -> Option<Self> {
        let warp = &pair.warp;
        let h0 = warp.at(plane.x as f64, plane.y as f64, plane.q);
        if h0.z.is_nan() || h0.z <= 0.0 {
            return None;
        }
        let h1 = warp.a.column(0) + warp.b * plane.qx;
        let h2 = warp.a.column(1) + warp.b * plane.qy;
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
                ((warp.b.x - u0 * warp.b.z) * z) as f32,
                ((warp.b.y - v0 * warp.b.z) * z) as f32,
                (warp.b.z * z) as f32,
            ],
        })
    }

    /// Whole pixel at the image of the centre, whose value is taken off all samples.
    pub fn center(&self) -> (usize, usize) {
        (self.u0.floor() as usize, self.v0.floor() as usize)
    }

    /// Whether the whole disc lands inside the source; its image is convex.
    pub fn fits(&self, radius: usize, width: usize, height: usize) -> bool {
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
pub(super) fn sample_source(
    view: &WorkingView,
    warp: &LocalWarp,
    ws: &mut Workspace,
    source: usize,
) -> f64 {
    let (bx, by) = (warp.u0.floor(), warp.v0.floor());
    let fx = (warp.u0 - bx) as f32 + COORDINATE_SHIFT;
    let fy = (warp.v0 - by) as f32 + COORDINATE_SHIFT;
    let shift = COORDINATE_SHIFT as isize;
    let (ox, oy) = (bx as isize - shift, by as isize - shift);
    let width = view.camera.width;
    let texels: &[Texel] = &view.texels;
    let (center_x, center_y) = warp.center();
    let center = view.texel(center_x, center_y)[0];
    let padded = ws.len.next_multiple_of(LANES);
    let (dx, dy) = (&ws.dx[..padded], &ws.dy[..padded]);
    let (template, base) = (&ws.template[..padded], &ws.base_weight[..padded]);
    let residual = &mut ws.residual[source][..padded];
    let slope = &mut ws.slope[..padded];
    let weight = &mut ws.weight[..padded];
    let mut usable = 0.0_f32;
    let (mut du, mut dv, mut inv) = ([0.0_f32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
    let mut values = [[0.0_f32; 4]; LANES];
    // Positions, gathering and derivatives in turn: the first and the last vectorise.
    for from in (0..padded).step_by(LANES) {
        let (x, y) = (&dx[from..from + LANES], &dy[from..from + LANES]);
        for l in 0..LANES {
            inv[l] = 1.0 / (1.0 + warp.w_by[0] * x[l] + warp.w_by[1] * y[l]);
            du[l] = (warp.u_by[0] * x[l] + warp.u_by[1] * y[l]) * inv[l];
            dv[l] = (warp.v_by[0] * x[l] + warp.v_by[1] * y[l]) * inv[l];
        }
        for l in 0..LANES {
            let (px, py) = (fx + du[l], fy + dv[l]);
            let (ix, iy) = (px as i32, py as i32);
            let (tx, ty) = (px - ix as f32, py - iy as f32);
            let at = ((iy as isize + oy) * width as isize + ix as isize + ox) as usize;
            let rows = &texels[at..at + width + 2];
            let (top, bottom) = ((rows[0], rows[1]), (rows[width], rows[width + 1]));
            values[l] = std::array::from_fn(|c| {
                let a = top.0[c] + (top.1[c] - top.0[c]) * tx;
                let b = bottom.0[c] + (bottom.1[c] - bottom.0[c]) * tx;
                a + (b - a) * ty
            });
        }
        let to = from + LANES;
        let (template, base) = (&template[from..to], &base[from..to]);
        let (residual, slope) = (&mut residual[from..to], &mut slope[from..to]);
        let weight = &mut weight[from..to];
        for l in 0..LANES {
            // The centre's value keeps the sums small; the offset absorbs it.
            residual[l] = values[l][0] - center - template[l];
            slope[l] = (values[l][1] * (warp.b[0] - du[l] * warp.b[2])
                + values[l][2] * (warp.b[1] - dv[l] * warp.b[2]))
                * inv[l];
            weight[l] = if values[l][3] >= USABLE { base[l] } else { 0.0 };
            usable += weight[l];
        }
    }
    f64::from(usable) / ws.total_weight
}
