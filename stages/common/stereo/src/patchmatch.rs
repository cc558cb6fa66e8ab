//! Dense depth by PatchMatch with slanted planes, one view against its sources.
//!
//! Around a pixel the surface is a plane, whose inverse depth is `w(dx, dy) = w₀ (1 − sx dx − sy
//! dy)`: exact for a plane in space. Hypotheses `(w₀, sx, sy)` are compared by
//! [`crate::patch_cost`], spread from neighbours in alternating raster sweeps, and are perturbed
//! with shrinking normal steps (Bleyer, Rhemann, Rother, BMVC 2011).

use crate::hull::InverseDepthRange;
use crate::level::{Level, LevelView};
use crate::patch_cost::{Matcher, NOISE, Patch, Plane};
use crate::plate;
use rilievo_numerics::plate_system::OUTSIDE;
use rilievo_numerics::robust::median;
use rilievo_scene::{Mask, Raster};

/// Size of a search.
#[derive(Clone, Copy, Debug)]
pub struct SearchOptions {
    /// Relative standard deviation of the patches' means between photos whose exposures are divided out;
    /// `None`: means are not compared.
    pub mean_deviation: Option<f32>,
    /// Raster sweeps, to and fro in turn.
    pub num_sweeps: usize,
    /// Sources that count: the best ones.
    pub num_best: usize,
    /// Seed of the random trials.
    pub seed: u64,
}

/// Tangent planes of a surface of log depths.
pub fn tangent_planes(view: &LevelView, depth: &[f64]) -> Vec<Plane> {
    (0..depth.len())
        .map(|p| {
            let (x, y) = plate::slopes(view, p, depth);
            Plane {
                inverse_depth: (-depth[p]).exp() as f32,
                slope_x: (x.of(depth) / view.camera.fx) as f32,
                slope_y: (y.of(depth) / view.camera.fy) as f32,
            }
        })
        .collect()
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

/// Random trials per pixel and sweep.
const NUM_TRIALS: usize = 6;
/// First random steps of the inverse depth, relative: of a search without and with a start.
const DEPTH_STEPS: [f32; 2] = [0.04, 0.01];
/// First random step, and largest value, of a slope times the focal length.
const SLOPE_STEP: f32 = 0.6;
const MAX_SLOPE: f32 = 4.0;

/// Searches one view. `ranges` bounds every masked pixel, `masks` are the (grown) masks of all
/// views, `start` an earlier result.
pub fn search(
    level: &Level,
    index: usize,
    masks: &[Mask],
    ranges: &[InverseDepthRange],
    start: Option<&[Plane]>,
    found: Option<&[Raster<f32>]>,
    options: &SearchOptions,
) -> Vec<Plane> {
    let view = &level.views[index];
    let pixels = &view.pixels;
    let matcher = Matcher::new(
        level,
        index,
        masks,
        found,
        (options.mean_deviation, options.num_best),
    );
    let focal = view.camera.focal() as f32;
    let mut planes = match start {
        Some(planes) => planes.to_vec(),
        None => ranges
            .iter()
            .enumerate()
            .map(|(i, range)| {
                let mut random = Stream::new(options.seed, index, usize::MAX, i);
                Plane {
                    inverse_depth: range.low + (range.high - range.low) * random.uniform(),
                    slope_x: 0.5 * random.normal() / focal,
                    slope_y: 0.5 * random.normal() / focal,
                }
            })
            .collect(),
    };
    let mut patch = Patch::default();
    let mut costs: Vec<f32> = (0..planes.len())
        .map(|i| {
            matcher.take(pixels.xs[i] as i32, pixels.ys[i] as i32, &mut patch);
            matcher.cost_of(&patch, planes[i], f32::INFINITY)
        })
        .collect();
    let mut steps = Steps {
        depth: DEPTH_STEPS[usize::from(start.is_some())],
        slope: SLOPE_STEP / focal,
        max_slope: MAX_SLOPE / focal,
    };
    for sweep in 0..options.num_sweeps {
        let forward = sweep % 2 == 0;
        for k in 0..planes.len() {
            let i = if forward { k } else { planes.len() - 1 - k };
            matcher.take(pixels.xs[i] as i32, pixels.ys[i] as i32, &mut patch);
            let mut best = (costs[i], planes[i]);
            let back = if forward { -1 } else { 1 };
            matcher.spread(&patch, &planes, i, ranges[i], back, &mut best);
            let mut random = Stream::new(options.seed, index, sweep, i);
            matcher.perturb(&patch, ranges[i], &steps, &mut random, &mut best);
            (costs[i], planes[i]) = best;
        }
        steps.depth *= 0.35;
        steps.slope *= 0.7;
    }
    planes
}

/// Variance of the patches about a view's pixels over their squared mean intensity, split into what the sources' photos
/// share under the pixels' planes, and the rest; `num_best`: sources that count, the best ones.
pub fn variances(
    level: &Level,
    index: usize,
    masks: &[Mask],
    planes: &[Plane],
    num_best: usize,
) -> Vec<[f32; 2]> {
    let pixels = &level.views[index].pixels;
    let matcher = Matcher::new(level, index, masks, None, (None, num_best));
    let mut patch = Patch::default();
    let split = |(i, &plane)| {
        matcher.take(pixels.xs[i] as i32, pixels.ys[i] as i32, &mut patch);
        let unlike = matcher.cost_of(&patch, plane, f32::INFINITY).min(1.0);
        [1.0 - unlike, unlike].map(|share| share * patch.contrast())
    };
    planes.iter().enumerate().map(split).collect()
}

/// Whether the patch about each pixel of a view is clipped all over: its contrast is no more than noise, so that it matches
/// equally well at any depth.
pub fn clipped_all_over(level: &Level, index: usize, masks: &[Mask]) -> Vec<bool> {
    let view = &level.views[index];
    let count = view.pixels.len();
    if (0..count).all(|p| view.is_usable(p)) {
        return vec![false; count];
    }
    let matcher = Matcher::new(level, index, masks, None, (None, 1));
    let mut patch = Patch::default();
    let is_blank = |p: usize| {
        let (x, y) = (view.pixels.xs[p] as i32, view.pixels.ys[p] as i32);
        !view.is_usable(p) && {
            matcher.take(x, y, &mut patch);
            patch.contrast() <= NOISE * NOISE
        }
    };
    (0..count).map(is_blank).collect()
}

/// Size of random steps.
struct Steps {
    /// Of the inverse depth, relative.
    depth: f32,
    /// Of a slope, per pixel.
    slope: f32,
    /// Largest slope, per pixel.
    max_slope: f32,
}

impl Matcher<'_> {
    /// Takes over a plane of pixels visited before, `back` along row and column, where it costs
    /// less.
    #[inline]
    fn spread(
        &self,
        patch: &Patch,
        planes: &[Plane],
        pixel: usize,
        range: InverseDepthRange,
        back: i32,
        best: &mut (f32, Plane),
    ) {
        for (dx, dy) in [(back, 0), (0, back), (4 * back, 0), (0, 4 * back)] {
            let Some(a) = self.view.pixels.neighbour(pixel, dx, dy) else {
                continue;
            };
            let neighbour = planes[a];
            let shrink = 1.0 + neighbour.slope_x * dx as f32 + neighbour.slope_y * dy as f32;
            if shrink <= 0.2 {
                continue;
            }
            let plane = neighbour.moved(shrink);
            if plane.inverse_depth < range.low || plane.inverse_depth > range.high {
                continue;
            }
            let cost = self.cost_of(patch, plane, best.0);
            if cost < best.0 {
                *best = (cost, plane);
            }
        }
    }

    /// Tries random planes near the best one, ever nearer: in depth and slope, in depth alone, in
    /// slope alone.
    #[inline]
    fn perturb(
        &self,
        patch: &Patch,
        range: InverseDepthRange,
        steps: &Steps,
        random: &mut Stream,
        best: &mut (f32, Plane),
    ) {
        let (mut a, mut b) = (steps.depth, steps.slope);
        for trial in 0..NUM_TRIALS {
            let from = best.1;
            let mut plane = Plane {
                inverse_depth: from.inverse_depth * (1.0 + a * random.normal()),
                slope_x: from.slope_x + b * random.normal(),
                slope_y: from.slope_y + b * random.normal(),
            };
            if trial % 3 == 1 {
                (plane.slope_x, plane.slope_y) = (from.slope_x, from.slope_y);
            } else if trial % 3 == 2 {
                plane.inverse_depth = from.inverse_depth;
            }
            a *= 0.5;
            b *= 0.6;
            plane.inverse_depth = plane.inverse_depth.clamp(range.low, range.high);
            if plane.slope_x.powi(2) + plane.slope_y.powi(2) > steps.max_slope.powi(2) {
                continue;
            }
            let cost = self.cost_of(patch, plane, best.0);
            if cost < best.0 {
                *best = (cost, plane);
            }
        }
    }
}

/// Starts a finer level from a coarser result: the nearest parent's plane.
pub fn refine_start(coarse: &LevelView, fine: &LevelView, planes: &[Plane]) -> Vec<Plane> {
    let mut depths: Vec<f64> = planes.iter().map(|p| f64::from(p.inverse_depth)).collect();
    let fallback = Plane {
        inverse_depth: median(&mut depths).unwrap_or(1.0) as f32,
        slope_x: 0.0,
        slope_y: 0.0,
    };
    let (width, height) = (coarse.mask.width as i64, coarse.mask.height as i64);
    (0..fine.pixels.len())
        .map(|i| {
            let (x, y) = (fine.pixels.xs[i] as i64 / 2, fine.pixels.ys[i] as i64 / 2);
            // The rim has no parent of its own: the nearest within two pixels serves.
            let mut found: Option<(i64, usize)> = None;
            for (dx, dy) in (-2..=2_i64).flat_map(|dy| (-2..=2_i64).map(move |dx| (dx, dy))) {
                let (px, py) = (x + dx, y + dy);
                if px < 0 || py < 0 || px >= width || py >= height {
                    continue;
                }
                let number = coarse.pixels.number[(py * width + px) as usize];
                let distance = dx * dx + dy * dy;
                if number != OUTSIDE && found.is_none_or(|(d, _)| distance < d) {
                    found = Some((distance, number as usize));
                }
            }
            found.map_or(fallback, |(_, a)| {
                let ((ax, ay), (fx, fy)) = (coarse.xy(a), fine.xy(i));
                let dx = (0.5 * (fx + 0.5) - 0.5 - ax) as f32;
                let dy = (0.5 * (fy + 0.5) - 0.5 - ay) as f32;
                let parent = planes[a];
                let shrink = (1.0 - parent.slope_x * dx - parent.slope_y * dy).max(0.2);
                Plane {
                    inverse_depth: parent.inverse_depth * shrink,
                    slope_x: 0.5 * parent.slope_x / shrink,
                    slope_y: 0.5 * parent.slope_y / shrink,
                }
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use nalgebra::Vector3;
    use rilievo_scene::{Intrinsics, LinearImage, Raster, RigidTransform};

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

    #[test]
    fn patches_are_clipped_all_over_where_no_neighbour_is_darker() {
        let camera = camera(0.0);
        let mask = Raster::filled(SIZE.0, SIZE.1, true);
        // White up to the middle, then darker by steps; all of it clipped below a limit of .6.
        let mut image = LinearImage::filled(SIZE.0, SIZE.1, 3, 1.0);
        for y in 0..SIZE.1 {
            for x in 56..SIZE.0 {
                image.pixel_mut(x, y).fill(1.0 - 0.005 * (x - 55) as f32);
            }
        }
        let clipped = |clip_level: f32| {
            let (view, _) = LevelView::from_photo(&camera, &image, &mask, clip_level);
            let places: Vec<usize> = view.pixels.xs.iter().map(|&x| x as usize).collect();
            let level = Level::new(vec![view], &[vec![]]);
            let found = clipped_all_over(&level, 0, std::slice::from_ref(&level.views[0].mask));
            (found, places)
        };
        let (found, places) = clipped(0.6);
        let first = places[0];
        for (found, x) in found.iter().zip(&places) {
            let x = x - first;
            assert!(x > 50 || *found, "{x} is white");
            assert!(x < 56 || !*found, "{x} is darker than its neighbours");
        }
        // Unclipped, what has no contrast is what the photo shows.
        assert!(!clipped(2.0).0.contains(&true));
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

    /// What three cameras side by side see, each compared with its neighbours.
    fn level_of(view: impl Fn(&Camera) -> LevelView) -> Level {
        let views = [-0.1, 0.0, 0.1].map(|x| view(&camera(x))).into();
        Level::new(views, &[vec![1], vec![0, 2], vec![1]])
    }

    fn masks(level: &Level) -> Vec<Mask> {
        level.views.iter().map(|v| v.mask.clone()).collect()
    }

    /// The planes that are found in the middle one of three views.
    fn planes_of_middle(level: &Level, mean_deviation: Option<f32>) -> Vec<Plane> {
        let range = InverseDepthRange {
            low: 0.7,
            high: 1.1,
        };
        let options = SearchOptions {
            mean_deviation,
            num_sweeps: 4,
            num_best: 1,
            seed: 0,
        };
        let ranges = vec![range; level.views[1].pixels.len()];
        search(level, 1, &masks(level), &ranges, None, None, &options)
    }

    #[test]
    fn photos_share_the_variance_of_patches_under_the_true_planes() {
        let level = level_of(view);
        let (middle, masks) = (&level.views[1], masks(&level));
        // Under planes that lie nearer by `factor`: the median variance, and the share of it that photos share.
        let found = |factor: f64| {
            let at = |p| {
                let (x, y) = middle.xy(p);
                Plane {
                    inverse_depth: (factor / hit(&middle.camera, x, y)) as f32,
                    slope_x: 0.0,
                    slope_y: 0.0,
                }
            };
            let planes: Vec<Plane> = (0..middle.pixels.len()).map(at).collect();
            let (mut whole, mut shares): (Vec<f64>, Vec<f64>) =
                variances(&level, 1, &masks, &planes, 1)
                    .into_iter()
                    .map(|parts| parts.map(f64::from))
                    .map(|[shared, rest]| (shared + rest, shared / (shared + rest)))
                    .unzip();
            [&mut whole, &mut shares].map(|values| median(values).unwrap_or(f64::NAN))
        };
        let ([contrast, right], [_, wrong]) = (found(1.0), found(1.1));
        assert!(right > 0.98, "under the true planes {right}");
        assert!(wrong < 0.8, "under planes a tenth too near {wrong}");
        // Three waves of a twentieth of the mean each: 3 · .05² / 2, less what is slower than a patch.
        assert!((0.0005..0.005).contains(&contrast), "{contrast}");
    }

    #[test]
    fn depth_breaks_where_brightness_does() {
        let level = level_of(view);
        let middle = &level.views[1];
        let planes = planes_of_middle(&level, None);
        // Pixels within four of the edge, and away from the frame.
        let (mut right, mut all) = (0, 0);
        for (p, plane) in planes.iter().enumerate() {
            let (x, y) = middle.xy(p);
            let from_edge = (x - 55.5).abs();
            if (0.6..4.0).contains(&from_edge) && (6.0..34.0).contains(&y) {
                let truth = hit(&middle.camera, x, y);
                all += 1;
                right += usize::from((plane.inverse_depth * truth as f32 - 1.0).abs() < 0.02);
            }
        }
        let share = f64::from(right as u32) / f64::from(all);
        assert!(
            share > 0.9,
            "{share} of {all} pixels beside the edge are right"
        );
    }

    /// A plane whose brightness rises evenly looks alike to a correlation wherever it is compared.
    #[test]
    fn an_even_rise_of_brightness_is_found_by_its_means() {
        const DEPTH: f64 = 1.15;
        let even = |camera: &Camera| {
            let mut image = LinearImage::filled(SIZE.0, SIZE.1, 3, 0.0);
            for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
                let along = camera.center.x + DEPTH * camera.ray(x as f64, y as f64).x;
                image.pixel_mut(x, y).fill((0.3 + 0.24 * along) as f32);
            }
            LevelView::from_photo(camera, &image, &Raster::filled(SIZE.0, SIZE.1, true), 1.0).0
        };
        let level = level_of(even);
        let error = |mean_deviation| {
            let planes = planes_of_middle(&level, mean_deviation);
            let errors = planes
                .iter()
                .map(|plane| (f64::from(plane.inverse_depth) * DEPTH - 1.0).abs());
            median(&mut errors.collect::<Vec<f64>>()).unwrap_or(1.0)
        };
        let (with, without) = (error(Some(0.012)), error(None));
        assert!(with < 0.01, "by means {with}");
        assert!(without > 3.0 * with, "without {without}, by means {with}");
    }
}
