//! Dense depth by PatchMatch with slanted planes, one view against its sources.
//!
//! Around a pixel the surface is a plane, whose inverse depth is
//! `w(dx, dy) = w₀ (1 − sx dx − sy dy)`: exact for a plane in space. The cost of a hypothesis
//! `(w₀, sx, sy)` compares a Gaussian-weighted patch with its image in each source:
//! bounded squared differences `2 s/(1+s)`, `s = mean (I_i − I_j)² / (σ Ī)²`, where brightness is
//! constant, or `1 − correlation` where it is not; plus the share of the patch that leaves the
//! source's mask. Samples that differ from the pixel in brightness may lie beyond an edge of the object, on
//! another plane, and count less: `gaussian · exp(−|ln (I/I₀)| / γ)` (Yoon, Kweon, PAMI 28(4), 2006).
//! Hypotheses spread from neighbours in alternating raster sweeps and are perturbed
//! with shrinking normal steps (Bleyer, Rhemann, Rother, BMVC 2011).

use crate::camera::Warp;
use crate::hull::InverseDepthRange;
use crate::level::{Level, LevelView};
use crate::plate;
use rilievo_numerics::plate_system::OUTSIDE;
use rilievo_scene::{Mask, Raster};
use serde::{Deserialize, Serialize};

/// How patches are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PatchCost {
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
pub struct PatchMatchOptions {
    /// How patches are compared.
    pub cost: PatchCost,
    /// Raster sweeps, to and fro in turn.
    pub num_sweeps: usize,
    /// Random trials per pixel and sweep.
    pub num_trials: usize,
    /// Sources that count: the best ones.
    pub num_best: usize,
    /// Seed of the random trials.
    pub seed: u64,
}

/// Inverse depth and plane slopes of every masked pixel.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Planes {
    /// `w₀`, one over the world's unit.
    pub inverse_depth: Vec<f32>,
    /// `sx`, per pixel.
    pub slope_x: Vec<f32>,
    /// `sy`, per pixel.
    pub slope_y: Vec<f32>,
}

/// A plane about a pixel.
#[derive(Clone, Copy, Debug)]
struct Plane {
    inverse_depth: f32,
    slope_x: f32,
    slope_y: f32,
}

impl Planes {
    fn at(&self, pixel: usize) -> Plane {
        Plane {
            inverse_depth: self.inverse_depth[pixel],
            slope_x: self.slope_x[pixel],
            slope_y: self.slope_y[pixel],
        }
    }

    fn set(&mut self, pixel: usize, plane: Plane) {
        self.inverse_depth[pixel] = plane.inverse_depth;
        self.slope_x[pixel] = plane.slope_x;
        self.slope_y[pixel] = plane.slope_y;
    }

    /// Tangent planes of a surface of log depths.
    pub fn tangent(view: &LevelView, depth: &[f64]) -> Self {
        let slopes = |p: usize| {
            let (x, y) = plate::slopes(view, p, depth);
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

/// Half-width of a patch, pixels. A wider one reaches over edges and rounds them off, a narrower one
/// holds too little of a plain surface.
const RADIUS_PX: i32 = 4;
/// `γ` of the module's text.
const CONTRAST: f32 = 0.15;
/// Samples below this weight tell nothing; the centre has 1.
const MIN_WEIGHT: f32 = 0.01;

/// Samples that are worked on together.
const LANES: usize = 8;
type Lanes = [f32; LANES];

struct Source {
    width: usize,
    height: usize,
    /// Intensities at `(x, y)`, `(x + 1, y)`, `(x, y + 1)`, `(x + 1, y + 1)` side by side, so that one
    /// access serves an interpolation; not a number where one of them lies outside the mask.
    quads: Vec<[f32; 4]>,
    a: [[f32; 3]; 3],
    b: [f32; 3],
}

impl Source {
    fn new(grey: &Raster<f32>, mask: &Mask, warp: &Warp) -> Self {
        let (width, height) = (grey.width, grey.height);
        let mut quads = vec![[f32::NAN; 4]; width * height];
        for y in 0..height.saturating_sub(1) {
            for x in 0..width.saturating_sub(1) {
                let corners = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
                if corners.iter().all(|&(x, y)| *mask.at(x, y)) {
                    quads[y * width + x] = corners.map(|(x, y)| *grey.at(x, y));
                }
            }
        }
        Self {
            width,
            height,
            quads,
            a: [0, 1, 2].map(|r| [0, 1, 2].map(|c| warp.a[(r, c)] as f32)),
            b: [0, 1, 2].map(|r| warp.b[r] as f32),
        }
    }
}

/// Pixels of a patch; the last ones may be padding of weight 0.
#[derive(Clone, Copy, Default)]
struct Samples {
    dx: Lanes,
    dy: Lanes,
    weight: Lanes,
    intensity: Lanes,
}

/// The masked pixels about one.
#[derive(Default)]
struct Patch {
    x: f32,
    y: f32,
    samples: Vec<Samples>,
    /// Sum of the weights.
    total: f32,
}

/// A patch's pixels about its centre, row by row.
fn offsets() -> impl Iterator<Item = (i32, i32)> {
    (-RADIUS_PX..=RADIUS_PX).flat_map(|dy| (-RADIUS_PX..=RADIUS_PX).map(move |dx| (dx, dy)))
}

struct Search<'a> {
    view: &'a LevelView,
    sources: Vec<Source>,
    gaussian: Vec<f32>,
    /// Log brightness of the view.
    log_grey: Raster<f32>,
    options: PatchMatchOptions,
    /// Variance below which a patch counts as flat.
    noise_variance: f32,
}

impl Search<'_> {
    /// Takes the patch about `(x, y)`, in place of an earlier one.
    fn take(&self, x: i32, y: i32, patch: &mut Patch) {
        let (grey, mask) = (&self.view.grey, &self.view.mask);
        let here = *self.log_grey.at(x as usize, y as usize);
        (patch.x, patch.y) = (x as f32, y as f32);
        patch.samples.clear();
        patch.total = 0.0;
        let mut count = 0;
        for ((dx, dy), gaussian) in offsets().zip(&self.gaussian) {
            let (x, y) = (x + dx, y + dy);
            if x < 0 || y < 0 || x >= grey.width as i32 || y >= grey.height as i32 {
                continue;
            }
            let (x, y) = (x as usize, y as usize);
            let weight = gaussian * (-(self.log_grey.at(x, y) - here).abs() / CONTRAST).exp();
            if !*mask.at(x, y) || weight <= MIN_WEIGHT {
                continue;
            }
            let lane = count % LANES;
            if lane == 0 {
                patch.samples.push(Samples::default());
            }
            if let Some(samples) = patch.samples.last_mut() {
                samples.dx[lane] = dx as f32;
                samples.dy[lane] = dy as f32;
                samples.weight[lane] = weight;
                samples.intensity[lane] = *grey.at(x, y);
            }
            patch.total += weight;
            count += 1;
        }
    }

    /// Cost of a hypothesis; gives up once it exceeds `limit`.
    fn cost(&self, patch: &Patch, plane: Plane, limit: f32) -> f32 {
        let num_sources = self.sources.len();
        let num_best = self.options.num_best.min(num_sources);
        let mut costs = [2.0_f32; MAX_SOURCES];
        for (k, source) in self.sources.iter().enumerate() {
            costs[k] = self.cost_in(source, patch, plane);
            // At least `certain` of these costs are among the best `num_best`, whatever the others
            // are: a lower bound.
            let certain = (k + 1 + num_best).saturating_sub(num_sources);
            let known = &mut costs[..=k];
            known.sort_unstable_by(f32::total_cmp);
            if known[..certain].iter().sum::<f32>() > limit * num_best as f32 {
                return f32::INFINITY;
            }
        }
        costs[..num_best].iter().sum::<f32>() / num_best as f32
    }

    fn cost_in(&self, s: &Source, patch: &Patch, plane: Plane) -> f32 {
        let (w, sx, sy) = (plane.inverse_depth, plane.slope_x, plane.slope_y);
        let centre =
            [0, 1, 2].map(|r| s.a[r][0] * patch.x + s.a[r][1] * patch.y + s.a[r][2] + w * s.b[r]);
        let along_x = [0, 1, 2].map(|r| s.a[r][0] - w * sx * s.b[r]);
        let along_y = [0, 1, 2].map(|r| s.a[r][1] - w * sy * s.b[r]);
        let map = Map {
            centre,
            along_x,
            along_y,
        };
        // Seen whole by the source, as nearly every patch is, it needs no checks.
        let unchecked = map
            .is_inside(s)
            .then(|| map.sums::<false>(s, patch))
            .filter(|sums| !sums[2].is_nan());
        let [sw, s1, s2, s11, s22, s12] = unchecked.unwrap_or_else(|| map.sums::<true>(s, patch));
        if sw < 0.3 * patch.total {
            return 2.0;
        }
        let out = 1.0 - sw / patch.total;
        let (m1, m2) = (s1 / sw, s2 / sw);
        match self.options.cost {
            PatchCost::SquaredDifferences { sigma } => {
                let scale = (sigma * 0.5 * (m1 + m2)).max(1e-9);
                let ssd = ((s11 + s22 - 2.0 * s12) / sw).max(0.0) / (scale * scale);
                2.0 * ssd / (1.0 + ssd) + out
            }
            PatchCost::Correlation => {
                let v1 = (s11 / sw - m1 * m1).max(0.0) + self.noise_variance;
                let v2 = (s22 / sw - m2 * m2).max(0.0) + self.noise_variance;
                let correlation = (s12 / sw - m1 * m2) / (v1 * v2).sqrt();
                (1.0 - correlation).min(1.0) + out
            }
        }
    }
}

/// Image of a patch under a plane, homogeneous pixels of the source.
struct Map {
    centre: [f32; 3],
    /// Its change per column and per row of the patch.
    along_x: [f32; 3],
    along_y: [f32; 3],
}

impl Map {
    #[inline]
    fn at(&self, dx: f32, dy: f32) -> [f32; 3] {
        [0, 1, 2].map(|r| self.centre[r] + dx * self.along_x[r] + dy * self.along_y[r])
    }

    #[inline]
    fn is_within([u, v, z]: [f32; 3], source: &Source) -> bool {
        let (max_u, max_v) = ((source.width - 1) as f32, (source.height - 1) as f32);
        z > 0.0 && u >= 0.0 && v >= 0.0 && u < max_u * z && v < max_v * z
    }

    /// Whether a patch's corners, and so all of it, lie in the source.
    fn is_inside(&self, source: &Source) -> bool {
        let r = RADIUS_PX as f32;
        [(-r, -r), (r, -r), (-r, r), (r, r)]
            .iter()
            .all(|&(dx, dy)| Self::is_within(self.at(dx, dy), source))
    }

    /// Sums of the weights, of both intensities, of their squares and of their product; `CHECKED` leaves
    /// out what lies outside the source or its mask, else such samples make the sums not a number.
    #[inline]
    fn sums<const CHECKED: bool>(&self, source: &Source, patch: &Patch) -> [f32; 6] {
        let mut sums = [[0.0_f32; LANES]; 6];
        for samples in &patch.samples {
            let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
            let mut weight = samples.weight;
            for k in 0..LANES {
                let [x, y, z] = self.at(samples.dx[k], samples.dy[k]);
                let inverse = 1.0 / z;
                (u[k], v[k]) = (x * inverse, y * inverse);
                if CHECKED && !Self::is_within([x, y, z], source) {
                    (u[k], v[k], weight[k]) = (0.0, 0.0, 0.0);
                }
            }
            let mut seen = [0.0; LANES];
            for k in 0..LANES {
                // Conversions of 32 bits are a single instruction each.
                let (u0, v0) = (u[k] as i32, v[k] as i32);
                let (a, b) = (u[k] - u0 as f32, v[k] - v0 as f32);
                let quad = source.quads[(v0 * source.width as i32 + u0) as usize];
                let top = quad[0] + a * (quad[1] - quad[0]);
                let bottom = quad[2] + a * (quad[3] - quad[2]);
                seen[k] = top + b * (bottom - top);
                if CHECKED && seen[k].is_nan() {
                    (seen[k], weight[k]) = (0.0, 0.0);
                }
            }
            for k in 0..LANES {
                let (g, p, q) = (weight[k], samples.intensity[k], seen[k]);
                sums[0][k] += g;
                sums[1][k] += g * p;
                sums[2][k] += g * q;
                sums[3][k] += g * p * p;
                sums[4][k] += g * q * q;
                sums[5][k] += g * p * q;
            }
        }
        sums.map(|lanes| lanes.iter().sum::<f32>())
    }
}

/// Largest number of sources of a view.
pub const MAX_SOURCES: usize = 8;

/// Searches one view. `ranges` bounds every masked pixel, `masks` are the (grown) masks of all
/// views, `start` an earlier result.
pub fn search(
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
    let spread = 2.0 * (0.6 * RADIUS_PX as f32).powi(2);
    let gaussian = offsets()
        .map(|(dx, dy)| (-((dx * dx + dy * dy) as f32) / spread).exp())
        .collect();
    let sources = level.sources[index]
        .iter()
        .take(MAX_SOURCES)
        .map(|(j, warp)| Source::new(&level.views[*j].grey, &masks[*j], warp))
        .collect();
    let mean = (0..n)
        .map(|i| f64::from(*view.grey.at(pixels.xs[i] as usize, pixels.ys[i] as usize)))
        .sum::<f64>()
        / n.max(1) as f64;
    // Contrast of a third of a per cent is noise.
    let noise = 0.003 * mean;
    let search = Search {
        view,
        sources,
        gaussian,
        log_grey: Raster::from_fn(view.grey.width, view.grey.height, |x, y| {
            view.grey.at(x, y).max(noise as f32).ln()
        }),
        options: *options,
        noise_variance: noise.powi(2) as f32,
    };
    let mut patch = Patch::default();
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
            search.take(pixels.xs[i] as i32, pixels.ys[i] as i32, &mut patch);
            search.cost(&patch, planes.at(i), f32::INFINITY)
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
            search.take(x, y, &mut patch);
            let mut best = (costs[i], planes.at(i));
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
                let neighbour = planes.at(a);
                // The neighbour's plane, written about this pixel.
                let shrink = 1.0 + neighbour.slope_x * dx as f32 + neighbour.slope_y * dy as f32;
                if shrink <= 0.2 {
                    continue;
                }
                let plane = Plane {
                    inverse_depth: neighbour.inverse_depth * shrink,
                    slope_x: neighbour.slope_x / shrink,
                    slope_y: neighbour.slope_y / shrink,
                };
                if plane.inverse_depth < range.low || plane.inverse_depth > range.high {
                    continue;
                }
                let cost = search.cost(&patch, plane, best.0);
                if cost < best.0 {
                    best = (cost, plane);
                }
            }
            let mut random = Stream::new(options.seed, index, sweep, i);
            let (mut a, mut b) = (depth_step, slope_step);
            for trial in 0..options.num_trials {
                let from = best.1;
                let mut normal = || random.normal();
                let mut plane = Plane {
                    inverse_depth: from.inverse_depth * (1.0 + a * normal()),
                    slope_x: from.slope_x + b * normal(),
                    slope_y: from.slope_y + b * normal(),
                };
                if trial % 3 == 1 {
                    (plane.slope_x, plane.slope_y) = (from.slope_x, from.slope_y);
                } else if trial % 3 == 2 {
                    plane.inverse_depth = from.inverse_depth;
                }
                a *= 0.5;
                b *= 0.6;
                plane.inverse_depth = plane.inverse_depth.clamp(range.low, range.high);
                if plane.slope_x.powi(2) + plane.slope_y.powi(2) > max_slope * max_slope {
                    continue;
                }
                let cost = search.cost(&patch, plane, best.0);
                if cost < best.0 {
                    best = (cost, plane);
                }
            }
            costs[i] = best.0;
            planes.set(i, best.1);
        }
        depth_step *= 0.35;
        slope_step *= 0.7;
    }
    planes
}

/// Starts a finer level from a coarser result: the nearest parent's plane.
pub fn refine_start(coarse: &LevelView, fine: &LevelView, planes: &Planes) -> Planes {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use nalgebra::Vector3;
    use rilievo_scene::{Intrinsics, LinearImage, RigidTransform};

    const SIZE: (usize, usize) = (112, 40);
    const FOCAL: f64 = 200.0;
    const NEAR: f64 = 1.0;
    const FAR: f64 = 1.3;

    fn camera(x: f64) -> Camera {
        let intrinsics = Intrinsics::pinhole(SIZE.0, SIZE.1, FOCAL, 55.5, 19.5);
        let pose = RigidTransform {
            translation: Vector3::new(-x, 0.0, 0.0),
            ..RigidTransform::identity()
        };
        Camera::new(&intrinsics, &pose)
    }

    /// Depth that a ray meets: a bright near plate on the left, a darker far one behind it.
    fn hit(camera: &Camera, x: f64, y: f64) -> f64 {
        let near = camera.center.x + NEAR * camera.ray(x, y).x;
        if near < 0.0 { NEAR } else { FAR }
    }

    /// A view of both plates, whose pattern is a tenth of their brightness; 4×4 rays a pixel.
    fn view(camera: &Camera) -> LevelView {
        let mut image = LinearImage::filled(SIZE.0, SIZE.1, 3, 0.0);
        for py in 0..SIZE.1 {
            for px in 0..SIZE.0 {
                let sum: f64 = (0..16)
                    .map(|k| {
                        let x = px as f64 + 0.25 * f64::from(k % 4) - 0.375;
                        let y = py as f64 + 0.25 * f64::from(k / 4) - 0.375;
                        let z = hit(camera, x, y);
                        let ray = z * camera.ray(x, y);
                        let (u, v) = (FOCAL * (camera.center.x + ray.x), FOCAL * ray.y);
                        let pattern = (0.9 * u + 0.4 * v).sin()
                            + (0.53 * u - 1.1 * v + z).cos()
                            + (0.31 * u + 0.7 * v).sin();
                        let albedo = if z < FAR { 0.6 } else { 0.3 };
                        albedo * (1.0 + 0.05 * pattern)
                    })
                    .sum();
                image.pixel_mut(px, py).fill((sum / 16.0) as f32);
            }
        }
        LevelView::from_photo(camera, &image, &Raster::filled(SIZE.0, SIZE.1, true), 1.0).0
    }

    #[test]
    fn depth_breaks_where_brightness_does() {
        let cameras = [-0.1, 0.0, 0.1].map(camera);
        let level = Level::new(
            cameras.iter().map(view).collect(),
            &[vec![1], vec![0, 2], vec![1]],
        );
        let middle = &level.views[1];
        let masks: Vec<Mask> = level.views.iter().map(|v| v.mask.clone()).collect();
        let range = InverseDepthRange {
            low: 0.7,
            high: 1.1,
        };
        let options = PatchMatchOptions {
            cost: PatchCost::Correlation,
            num_sweeps: 4,
            num_trials: 6,
            num_best: 1,
            seed: 0,
        };
        let ranges = vec![range; middle.pixels.len()];
        let planes = search(&level, 1, &masks, &ranges, None, &options);
        // Pixels within four of the edge, and away from the frame.
        let (mut right, mut all) = (0, 0);
        for p in 0..middle.pixels.len() {
            let (x, y) = middle.xy(p);
            let from_edge = (x - 55.5).abs();
            if (0.6..4.0).contains(&from_edge) && (6.0..34.0).contains(&y) {
                let truth = hit(&cameras[1], x, y);
                all += 1;
                right += usize::from((planes.inverse_depth[p] * truth as f32 - 1.0).abs() < 0.02);
            }
        }
        let share = f64::from(right as u32) / f64::from(all);
        assert!(
            share > 0.9,
            "{share} of {all} pixels beside the edge are right"
        );
    }
}
