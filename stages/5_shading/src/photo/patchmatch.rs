//! Dense depth by PatchMatch with slanted planes, one view against its sources.
//!
//! Around a pixel the surface is a plane, whose inverse depth is
//! `w(dx, dy) = w₀ (1 − sx dx − sy dy)`: exact for a plane in space. The cost of a hypothesis
//! `(w₀, sx, sy)` compares a bell-weighted patch with its image in each source:
//! bounded squared differences `2 s/(1+s)`, `s = mean (I_i − I_j)² / (σ Ī)²`, where brightness is
//! constant, or `1 − correlation` where it is not; plus the share of the patch that leaves the
//! source's mask. Hypotheses spread from neighbours in alternating raster sweeps and are perturbed
//! with shrinking normal steps (Bleyer, Rhemann, Rother, BMVC 2011).

use super::hull::InverseDepthRange;
use super::level::{Level, LevelView};
use super::plate;
use rilievo_numerics::plate_system::OUTSIDE;
use rilievo_scene::{Mask, Raster};

/// How patches are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PatchCost {
    /// One minus the zero-mean normalised correlation.
    Correlation,
    /// Bounded squared differences, with the relative standard deviation of intensities.
    SquaredDifferences {
        /// Relative to the patch's mean.
        sigma: f32,
    },
}

/// Size of the search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatchMatchOptions {
    pub cost: PatchCost,
    /// Half-width of a patch, pixels.
    pub radius_px: i32,
    /// Distance between samples of a patch, pixels.
    pub stride_px: i32,
    pub num_sweeps: usize,
    /// Random trials per pixel and sweep.
    pub num_trials: usize,
    /// Sources that count: the best ones.
    pub num_best: usize,
    pub seed: u64,
}

/// Inverse depth and plane slopes of every masked pixel.
#[derive(Clone, Debug)]
pub(crate) struct Planes {
    pub inverse_depth: Vec<f32>,
    pub slope_x: Vec<f32>,
    pub slope_y: Vec<f32>,
}

impl Planes {
    /// Tangent planes of a surface of log depths.
    pub fn tangent(view: &LevelView, depth: &[f64]) -> Self {
        let slopes = |p: usize| {
            let (x, y) = plate::slopes(view, p);
            (
                (x.of(depth) / view.camera.fx) as f32,
                (y.of(depth) / view.camera.fy) as f32,
            )
        };
        let (slope_x, slope_y) = (0..depth.len()).map(slopes).unzip();
        Self {
            inverse_depth: depth.iter().map(|&zeta| (-zeta).exp() as f32).collect(),
            slope_x,
            slope_y,
        }
    }
}

/// A reproducible stream of random numbers (SplitMix64), one per view, sweep and pixel.
struct Stream(u64);

impl Stream {
    fn new(seed: u64, view: usize, sweep: usize, pixel: usize) -> Self {
        let mut stream = Self(
            seed ^ (view as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                ^ (sweep as u64).wrapping_mul(0xd1b5_4a32_d192_ed03)
                ^ (pixel as u64).wrapping_mul(0xa24b_aed4_963e_e407),
        );
        stream.next();
        stream
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn uniform(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Sum of four uniforms, scaled to variance 1: close enough to normal for a search.
    fn normal(&mut self) -> f32 {
        let sum: f32 = (0..4).map(|_| self.uniform()).sum();
        (sum - 2.0) * 1.732_050_8
    }
}

struct Source<'a> {
    grey: &'a Raster<f32>,
    mask: &'a Mask,
    a: [[f32; 3]; 3],
    b: [f32; 3],
}

struct Search<'a> {
    view: &'a LevelView,
    sources: Vec<Source<'a>>,
    bell: Vec<f32>,
    options: PatchMatchOptions,
    /// Variance below which a patch counts as flat.
    noise_variance: f32,
}

impl Search<'_> {
    /// Cost of a hypothesis at pixel `(x, y)`; gives up once it exceeds `limit`.
    fn cost(&self, x: i32, y: i32, w: f32, sx: f32, sy: f32, limit: f32) -> f32 {
        let num_best = self.options.num_best.min(self.sources.len());
        let all = num_best == self.sources.len();
        let mut costs = [2.0_f32; MAX_SOURCES];
        let mut sum = 0.0;
        for (k, source) in self.sources.iter().enumerate() {
            let cost = self.cost_in(source, x, y, w, sx, sy);
            costs[k] = cost;
            sum += cost;
            if all && sum > limit * num_best as f32 {
                return f32::INFINITY;
            }
        }
        let costs = &mut costs[..self.sources.len()];
        if !all {
            costs.sort_unstable_by(f32::total_cmp);
            sum = costs[..num_best].iter().sum();
        }
        sum / num_best as f32
    }

    fn cost_in(&self, s: &Source, x: i32, y: i32, w: f32, sx: f32, sy: f32) -> f32 {
        let o = &self.options;
        let (grey, mask) = (&self.view.grey, &self.view.mask);
        let (xf, yf) = (x as f32, y as f32);
        let centre = [0, 1, 2].map(|r| s.a[r][0] * xf + s.a[r][1] * yf + s.a[r][2] + w * s.b[r]);
        let along_x = [0, 1, 2].map(|r| s.a[r][0] - w * sx * s.b[r]);
        let along_y = [0, 1, 2].map(|r| s.a[r][1] - w * sy * s.b[r]);
        let (max_u, max_v) = ((s.grey.width - 1) as f32, (s.grey.height - 1) as f32);
        let (mut total, mut out, mut sw) = (0.0_f32, 0.0_f32, 0.0_f32);
        let (mut s1, mut s2, mut s11, mut s22, mut s12) = (0.0_f32, 0.0_f32, 0.0, 0.0, 0.0);
        let mut k = 0;
        let mut dy = -o.radius_px;
        while dy <= o.radius_px {
            let yy = y + dy;
            let row_ok = yy >= 0 && yy < grey.height as i32;
            let row = yy.max(0) as usize * grey.width;
            let dyf = dy as f32;
            let start = [0, 1, 2].map(|r| centre[r] + dyf * along_y[r]);
            let mut dx = -o.radius_px;
            while dx <= o.radius_px {
                let g = self.bell[k];
                k += 1;
                let xx = x + dx;
                if row_ok && xx >= 0 && xx < grey.width as i32 && mask.data[row + xx as usize] {
                    total += g;
                    let dxf = dx as f32;
                    let pz = start[2] + dxf * along_x[2];
                    let inv = 1.0 / pz;
                    let u = (start[0] + dxf * along_x[0]) * inv;
                    let v = (start[1] + dxf * along_x[1]) * inv;
                    let within = pz > 0.0 && u >= 0.0 && v >= 0.0 && u < max_u && v < max_v;
                    if within && s.mask.data[(v + 0.5) as usize * s.grey.width + (u + 0.5) as usize]
                    {
                        let (u0, v0) = (u as usize, v as usize);
                        let (a, b) = (u - u0 as f32, v - v0 as f32);
                        let base = v0 * s.grey.width + u0;
                        let d = &s.grey.data;
                        let top = d[base] + a * (d[base + 1] - d[base]);
                        let below = base + s.grey.width;
                        let bottom = d[below] + a * (d[below + 1] - d[below]);
                        let q = top + b * (bottom - top);
                        let p = grey.data[row + xx as usize];
                        sw += g;
                        s1 += g * p;
                        s2 += g * q;
                        s11 += g * p * p;
                        s22 += g * q * q;
                        s12 += g * p * q;
                    } else {
                        out += g;
                    }
                }
                dx += o.stride_px;
            }
            dy += o.stride_px;
        }
        if total <= 0.0 || sw < 0.3 * total {
            return 2.0;
        }
        let (m1, m2) = (s1 / sw, s2 / sw);
        match o.cost {
            PatchCost::SquaredDifferences { sigma } => {
                let scale = (sigma * 0.5 * (m1 + m2)).max(1e-9);
                let ssd = ((s11 + s22 - 2.0 * s12) / sw).max(0.0) / (scale * scale);
                2.0 * ssd / (1.0 + ssd) + out / total
            }
            PatchCost::Correlation => {
                let v1 = (s11 / sw - m1 * m1).max(0.0) + self.noise_variance;
                let v2 = (s22 / sw - m2 * m2).max(0.0) + self.noise_variance;
                let correlation = (s12 / sw - m1 * m2) / (v1 * v2).sqrt();
                (1.0 - correlation).min(1.0) + out / total
            }
        }
    }
}

/// Largest number of sources of a view.
pub(crate) const MAX_SOURCES: usize = 8;

/// Searches one view. `ranges` bounds every masked pixel, `masks` are the (grown) masks of all
/// views, `start` an earlier result.
pub(crate) fn search(
    level: &Level,
    index: usize,
    masks: &[Mask],
    ranges: &[InverseDepthRange],
    start: Option<&Planes>,
    options: &PatchMatchOptions,
) -> Planes {
    let view = &level.views[index];
    let pixels = &view.pixels;
    let n = pixels.len();
    let r = options.radius_px;
    let spread = 2.0 * (0.6 * r as f32).powi(2);
    let mut bell = Vec::new();
    for dy in (-r..=r).step_by(options.stride_px as usize) {
        for dx in (-r..=r).step_by(options.stride_px as usize) {
            bell.push((-((dx * dx + dy * dy) as f32) / spread).exp());
        }
    }
    let sources = level.sources[index]
        .iter()
        .take(MAX_SOURCES)
        .map(|(j, warp)| Source {
            grey: &level.views[*j].grey,
            mask: &masks[*j],
            a: [0, 1, 2].map(|r| [0, 1, 2].map(|c| warp.a[(r, c)] as f32)),
            b: [0, 1, 2].map(|r| warp.b[r] as f32),
        })
        .collect();
    let mean = (0..n)
        .map(|i| f64::from(*view.grey.at(pixels.xs[i] as usize, pixels.ys[i] as usize)))
        .sum::<f64>()
        / n.max(1) as f64;
    let search = Search {
        view,
        sources,
        bell,
        options: *options,
        // Contrast of a third of a per cent is noise.
        noise_variance: (0.003 * mean).powi(2) as f32,
    };
    let focal = view.camera.focal() as f32;
    let mut planes = match start {
        Some(planes) => planes.clone(),
        None => {
            let mut planes = Planes {
                inverse_depth: Vec::with_capacity(n),
                slope_x: Vec::with_capacity(n),
                slope_y: Vec::with_capacity(n),
            };
            for (i, range) in ranges.iter().enumerate() {
                let mut random = Stream::new(options.seed, index, usize::MAX, i);
                planes
                    .inverse_depth
                    .push(range.low + (range.high - range.low) * random.uniform());
                planes.slope_x.push(0.5 * random.normal() / focal);
                planes.slope_y.push(0.5 * random.normal() / focal);
            }
            planes
        }
    };
    let mut costs: Vec<f32> = (0..n)
        .map(|i| {
            search.cost(
                pixels.xs[i] as i32,
                pixels.ys[i] as i32,
                planes.inverse_depth[i],
                planes.slope_x[i],
                planes.slope_y[i],
                f32::INFINITY,
            )
        })
        .collect();
    // First steps: four per cent of depth (less after a start), 0.6 in slope.
    let mut depth_step = if start.is_some() { 0.01 } else { 0.04_f32 };
    let mut slope_step = 0.6 / focal;
    let max_slope = 4.0 / focal;
    for sweep in 0..options.num_sweeps {
        let forward = sweep % 2 == 0;
        for k in 0..n {
            let i = if forward { k } else { n - 1 - k };
            let (x, y) = (pixels.xs[i] as i32, pixels.ys[i] as i32);
            let range = ranges[i];
            let mut best = (
                costs[i],
                planes.inverse_depth[i],
                planes.slope_x[i],
                planes.slope_y[i],
            );
            let back = if forward { -1 } else { 1 };
            for (dx, dy) in [(back, 0), (0, back), (4 * back, 0), (0, 4 * back)] {
                let (ax, ay) = (x + dx, y + dy);
                if ax < 0 || ay < 0 || ax >= pixels.width as i32 || ay >= pixels.height as i32 {
                    continue;
                }
                let a = pixels.number[ay as usize * pixels.width + ax as usize];
                if a == OUTSIDE {
                    continue;
                }
                let a = a as usize;
                let (sx, sy) = (planes.slope_x[a], planes.slope_y[a]);
                // The neighbour's plane, written about this pixel.
                let shrink = 1.0 + sx * dx as f32 + sy * dy as f32;
                if shrink <= 0.2 {
                    continue;
                }
                let w = planes.inverse_depth[a] * shrink;
                if w < range.low || w > range.high {
                    continue;
                }
                let (sx, sy) = (sx / shrink, sy / shrink);
                let cost = search.cost(x, y, w, sx, sy, best.0);
                if cost < best.0 {
                    best = (cost, w, sx, sy);
                }
            }
            let mut random = Stream::new(options.seed, index, sweep, i);
            let (mut a, mut b) = (depth_step, slope_step);
            for trial in 0..options.num_trials {
                let mut w = best.1 * (1.0 + a * random.normal());
                let mut sx = best.2 + b * random.normal();
                let mut sy = best.3 + b * random.normal();
                if trial % 3 == 1 {
                    (sx, sy) = (best.2, best.3);
                } else if trial % 3 == 2 {
                    w = best.1;
                }
                a *= 0.5;
                b *= 0.6;
                w = w.clamp(range.low, range.high);
                if sx * sx + sy * sy > max_slope * max_slope {
                    continue;
                }
                let cost = search.cost(x, y, w, sx, sy, best.0);
                if cost < best.0 {
                    best = (cost, w, sx, sy);
                }
            }
            costs[i] = best.0;
            planes.inverse_depth[i] = best.1;
            planes.slope_x[i] = best.2;
            planes.slope_y[i] = best.3;
        }
        depth_step *= 0.35;
        slope_step *= 0.7;
    }
    planes
}

/// Starts a finer level from a coarser result: the nearest parent's plane.
pub(crate) fn refine_start(coarse: &LevelView, fine: &LevelView, planes: &Planes) -> Planes {
    let n = fine.pixels.len();
    let mut out = Planes {
        inverse_depth: Vec::with_capacity(n),
        slope_x: Vec::with_capacity(n),
        slope_y: Vec::with_capacity(n),
    };
    let fallback = {
        let mut values: Vec<f64> = planes.inverse_depth.iter().map(|&w| f64::from(w)).collect();
        rilievo_numerics::robust::median(&mut values).unwrap_or(1.0) as f32
    };
    for i in 0..n {
        let (x, y) = (fine.pixels.xs[i] as i64 / 2, fine.pixels.ys[i] as i64 / 2);
        // The rim has no parent of its own: the nearest within two pixels serves.
        let mut found: Option<(i64, usize)> = None;
        for dy in -2..=2_i64 {
            for dx in -2..=2_i64 {
                let (px, py) = (x + dx, y + dy);
                if px < 0
                    || py < 0
                    || px >= coarse.mask.width as i64
                    || py >= coarse.mask.height as i64
                {
                    continue;
                }
                let number = coarse.pixels.number[py as usize * coarse.mask.width + px as usize];
                let distance = dx * dx + dy * dy;
                if number != OUTSIDE && found.is_none_or(|(d, _)| distance < d) {
                    found = Some((distance, number as usize));
                }
            }
        }
        match found {
            Some((_, a)) => {
                let (ax, ay) = coarse.xy(a);
                let (fx, fy) = fine.xy(i);
                let dx = (0.5 * (fx + 0.5) - 0.5 - ax) as f32;
                let dy = (0.5 * (fy + 0.5) - 0.5 - ay) as f32;
                let shrink = (1.0 - planes.slope_x[a] * dx - planes.slope_y[a] * dy).max(0.2);
                out.inverse_depth.push(planes.inverse_depth[a] * shrink);
                out.slope_x.push(0.5 * planes.slope_x[a] / shrink);
                out.slope_y.push(0.5 * planes.slope_y[a] / shrink);
            }
            None => {
                out.inverse_depth.push(fallback);
                out.slope_x.push(0.0);
                out.slope_y.push(0.0);
            }
        }
    }
    out
}
