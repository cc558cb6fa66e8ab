//! What a plane about a pixel costs: its patch compared with the patch's image in each source.
//!
//! `1 − ρ + 0.3 r²/(1+r²)`, plus the share of the patch that leaves the source's mask. The zero-mean
//! normalised correlation `ρ` sees structure, whatever gain and offset lie between the photos; where a patch holds
//! nothing but noise it tells nothing, and `r = (Ī_i − Ī_j) / (σ ½ (Ī_i + Ī_j))`, the difference of the patches' means in
//! units of how far the photos disagree about brightness, decides. The patch is weighted by a Gaussian; samples that
//! differ from the pixel in brightness may lie beyond an edge of the object, on another plane, and count less:
//! `gaussian · exp(−|ln (I/I₀)| / γ)` (Yoon, Kweon, PAMI 28(4), 2006).
//!
//! Where the sources' depths were searched before, a plane also costs what it contradicts them by, `0.15 min(|ζ − ζ_j| f,
//! 2)` of log depths in source `j` (geometric consistency as of Schönberger, Zheng, Frahm, Pollefeys, ECCV 2016): a
//! plane that looks right by chance in one view is not what the others found.

use crate::camera::Warp;
use crate::level::{Level, LevelView};
use crate::sightings::MAX_SOURCES;
use rilievo_scene::{Mask, Raster};
use serde::{Deserialize, Serialize};

/// A plane about a pixel.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Plane {
    /// `w₀`, one over the world's unit.
    pub inverse_depth: f32,
    /// `sx`, per pixel.
    pub slope_x: f32,
    /// `sy`, per pixel.
    pub slope_y: f32,
}

impl Plane {
    /// The same plane about another pixel, where its inverse depth is `shrink` times that at its
    /// own.
    #[inline]
    pub(crate) fn moved(self, shrink: f32) -> Self {
        Self {
            inverse_depth: self.inverse_depth * shrink,
            slope_x: self.slope_x / shrink,
            slope_y: self.slope_y / shrink,
        }
    }

    /// Log depth.
    pub fn log_depth(&self) -> f64 {
        -f64::from(self.inverse_depth.max(1e-9)).ln()
    }
}

/// Half-width of a patch, pixels. A wider one reaches over edges and rounds them off, a narrower
/// one holds too little of a plain surface.
const RADIUS_PX: i32 = 4;
/// Standard deviation of a patch's Gaussian, pixels.
pub const PATCH_SIGMA_PX: f64 = 0.6 * RADIUS_PX as f64;
/// `γ` of the module's text.
const CONTRAST: f32 = 0.15;
/// Largest cost of unlike means.
const MEAN_COST: f32 = 0.3;
/// Contrast that is noise: standard deviation over the mean of a patch.
pub(crate) const NOISE: f32 = 0.003;
/// Share of a view's mean brightness below which all is equally dark.
const DARKEST: f32 = 0.003;
/// Samples below this weight are left out; the centre has 1.
const MIN_WEIGHT: f32 = 0.01;

/// Cost of a pixel footprint between a plane and the depth that was found in a source.
const APART_COST: f32 = 0.15;
/// Footprints beyond which it costs no more: what a source does not see, or saw wrongly, decides nothing alone.
const MAX_APART_PX: f32 = 2.0;

/// Samples that are worked on together.
const LANES: usize = 8;
type Lanes = [f32; LANES];

struct Source<'a> {
    width: usize,
    height: usize,
    /// Intensities at `(x, y)`, `(x + 1, y)`, `(x, y + 1)`, `(x + 1, y + 1)` side by side, so that
    /// one access serves an interpolation; not a number where one of them lies outside the mask.
    quads: Vec<[f32; 4]>,
    a: [[f32; 3]; 3],
    b: [f32; 3],
    /// Log depths that were found here, not a number outside the mask; and the focal length, pixels.
    found: Option<(&'a Raster<f32>, f32)>,
}

impl<'a> Source<'a> {
    fn new(
        grey: &Raster<f32>,
        mask: &Mask,
        warp: &Warp,
        found: Option<(&'a Raster<f32>, f32)>,
    ) -> Self {
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
            found,
        }
    }

    /// Cost of a point's distance from the depth that was found where it lands, `at` its homogeneous pixel for a depth of
    /// one where it is seen from.
    fn apart(&self, at: [f32; 3], inverse_depth: f32) -> f32 {
        let Some((depths, focal)) = self.found else {
            return 0.0;
        };
        let is_seen = Map::is_within(at, self);
        let (u, v) = ((at[0] / at[2]).round(), (at[1] / at[2]).round());
        let depth = is_seen.then(|| *depths.at(u as usize, v as usize));
        let apart = depth.map(|depth| ((at[2] / inverse_depth).ln() - depth).abs() * focal);
        // Not a number where nothing was found.
        let apart = apart.filter(|apart| *apart < MAX_APART_PX);
        APART_COST * apart.unwrap_or(MAX_APART_PX)
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
pub(crate) struct Patch {
    x: f32,
    y: f32,
    samples: Vec<Samples>,
    /// Sum of the weights.
    total: f32,
}

impl Patch {
    /// Variance of the intensities over their squared mean.
    pub fn contrast(&self) -> f32 {
        let (mut s1, mut s2) = (0.0_f32, 0.0_f32);
        for samples in &self.samples {
            for (weight, intensity) in samples.weight.iter().zip(&samples.intensity) {
                s1 += weight * intensity;
                s2 += weight * intensity * intensity;
            }
        }
        let mean = s1 / self.total;
        let variance = (s2 / self.total - mean * mean).max(0.0);
        variance / (mean * mean).max(f32::MIN_POSITIVE)
    }
}

/// A patch's pixels about its centre, row by row.
fn offsets() -> impl Iterator<Item = (i32, i32)> {
    (-RADIUS_PX..=RADIUS_PX).flat_map(|dy| (-RADIUS_PX..=RADIUS_PX).map(move |dx| (dx, dy)))
}

/// Compares patches of a view with its sources.
pub(crate) struct Matcher<'a> {
    pub view: &'a LevelView,
    sources: Vec<Source<'a>>,
    gaussian: Vec<f32>,
    /// Log brightness of the view.
    log_grey: Raster<f32>,
    /// `σ` of the module's text, if means are compared.
    mean_deviation: Option<f32>,
    /// Sources that count: the best ones.
    num_best: usize,
}

impl<'a> Matcher<'a> {
    pub fn new(
        level: &'a Level,
        index: usize,
        masks: &[Mask],
        found: Option<&'a [Raster<f32>]>,
        (mean_deviation, num_best): (Option<f32>, usize),
    ) -> Self {
        let view = &level.views[index];
        let (pixels, grey) = (&view.pixels, &view.grey);
        let spread = 2.0 * (PATCH_SIGMA_PX as f32).powi(2);
        let gaussian = offsets()
            .map(|(dx, dy)| (-((dx * dx + dy * dy) as f32) / spread).exp())
            .collect();
        let sources = level.sources[index]
            .iter()
            .take(MAX_SOURCES)
            .map(|(j, warp)| {
                let found = found.map(|depths| (&depths[*j], level.focal() as f32));
                Source::new(&level.views[*j].grey, &masks[*j], warp, found)
            })
            .collect();
        let n = pixels.len();
        let mean = (0..n)
            .map(|i| f64::from(*grey.at(pixels.xs[i] as usize, pixels.ys[i] as usize)))
            .sum::<f64>()
            / n.max(1) as f64;
        let darkest = DARKEST * mean as f32;
        Self {
            view,
            sources,
            gaussian,
            log_grey: Raster::from_fn(grey.width, grey.height, |x, y| {
                grey.at(x, y).max(darkest).ln()
            }),
            mean_deviation,
            num_best,
        }
    }

    /// Takes the patch about `(x, y)`, in place of an earlier one.
    pub fn take(&self, x: i32, y: i32, patch: &mut Patch) {
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

    /// Cost of a plane; infinite as soon as it exceeds `limit`.
    pub fn cost_of(&self, patch: &Patch, plane: Plane, limit: f32) -> f32 {
        let num_sources = self.sources.len();
        let num_best = self.num_best.min(num_sources);
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
        let apart = s.apart(centre, w);
        // Seen whole by the source, as nearly every patch is, it needs no checks.
        let unchecked = map
            .is_inside(s)
            .then(|| map.sums::<false>(s, patch))
            .filter(|sums| !sums[2].is_nan());
        let [sw, s1, s2, s11, s22, s12] = unchecked.unwrap_or_else(|| map.sums::<true>(s, patch));
        if sw < 0.3 * patch.total {
            return 2.0 + apart;
        }
        let out = 1.0 - sw / patch.total + apart;
        let (m1, m2) = (s1 / sw, s2 / sw);
        let unlike = self.mean_deviation.map_or(0.0, |deviation| {
            let r = (m1 - m2) / (deviation * 0.5 * (m1 + m2)).max(1e-9);
            MEAN_COST * r * r / (1.0 + r * r)
        });
        let v1 = (s11 / sw - m1 * m1).max(0.0) + (NOISE * m1).powi(2);
        let v2 = (s22 / sw - m2 * m2).max(0.0) + (NOISE * m2).powi(2);
        let spread = (v1 * v2).sqrt();
        if spread == 0.0 {
            // All black: nothing to compare.
            return 1.0 + unlike + out;
        }
        let correlation = (s12 / sw - m1 * m2) / spread;
        (1.0 - correlation).min(1.0) + unlike + out
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

    /// Sums of the weights, of both intensities, of their squares and of their product; `CHECKED`
    /// leaves out what lies outside the source or its mask, else such samples make the sums not a
    /// number.
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
