//! How sharp photos are against each other at one level: a photo out of focus shows less fine
//! detail.
//!
//! At points that two views see, `d = I − mean(I two pixels away)` over `I` is their finest detail. The medians of `|d|`
//! over the same points stand for `s_i` and `s_j`; all pairs together determine the sharpness `s` of every view (least
//! squares on the logarithms, the sharpest 1). Depth that is matched errs with one over the detail's gradient, so that a
//! view's surface weighs `s²`.
//!
//! A photo from nearer, or of a longer lens, spreads the same detail over more pixels, and is no less sharp: of two photos
//! the one with the smaller footprints is averaged to the pixels of the other, and what it shows beyond that is not asked
//! for. Between powers of two `ln |d|` is interpolated. Averaging takes noise away, which the other photo keeps and counts as
//! detail: a photo whose detail at its own pixels is as strong as the other's is no less sharp.

use crate::gains::{self, LogRatio};
use crate::level::{Level, LevelView, depth_rasters};
use rayon::prelude::*;
use rilievo_numerics::robust::median;

/// Fewest common points of a pair.
const MIN_POINTS: usize = 300;
/// Depth difference to a view that sees a point, pixel footprints.
const VISIBLE_PX: f64 = 3.5;
/// Pixels of a row that are looked at.
const STEP: usize = 3;
/// Part of an octave that makes no difference.
const MIN_TO_NEXT: f64 = 0.05;
/// Octaves of footprint that photos are averaged over at most.
const MAX_OCTAVES: f64 = 4.0;

/// Sharpness of every view, 0 to 1, at log depths `depths`; 1 for views without a pair.
pub fn measure(level: &Level, depths: &[Vec<f64>]) -> Vec<f64> {
    let rasters = depth_rasters(level, depths);
    let tolerance = VISIBLE_PX / level.focal();
    let pairs: Vec<LogRatio> = (0..level.views.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let (view, rasters) = (&level.views[i], &rasters);
            (0..level.sources[i].len()).filter_map(move |k| {
                let j = level.sources[i][k].0;
                let other = &level.views[j];
                let (mut here, mut there) = (Vec::new(), Vec::new());
                let mut pixels_of_other = Vec::new();
                for p in (0..view.pixels.len()).step_by(STEP) {
                    let seen = level.sighting(rasters, i, k, (p, depths[i][p]));
                    let seen = seen.filter(|s| s.is_within(tolerance) && s.is_unclipped());
                    let Some(at) = seen.map(|s| s.at) else {
                        continue;
                    };
                    let (x, y) = view.xy(p);
                    here.push([x as usize, y as usize]);
                    // The nearest pixel: between pixels interpolation would blur.
                    there.push([at.u.round() as usize, at.v.round() as usize]);
                    let own = view.camera.footprint(depths[i][p]);
                    pixels_of_other.push(other.camera.footprint(at.zeta) / own);
                }
                let ratio = median(&mut pixels_of_other).filter(|ratio| ratio.is_finite())?;
                let (a, b) = detail_of_pair([view, other], [&here, &there], ratio)?;
                Some(LogRatio {
                    from: i,
                    to: j,
                    ratio: b - a,
                    weight: 1.0,
                })
            })
        })
        .collect();
    joined(level.views.len(), pairs)
}

/// Side of the blocks that a photo is averaged to: a power of two, and how far on the way to the next one.
#[derive(Clone, Copy)]
struct Blocks {
    side: usize,
    to_next: f64,
}

impl Blocks {
    fn new(side: f64) -> Self {
        let octaves = side.log2().clamp(0.0, MAX_OCTAVES);
        let to_next = octaves.fract();
        Self {
            side: 1 << octaves as usize,
            to_next: if to_next < MIN_TO_NEXT { 0.0 } else { to_next },
        }
    }

    /// Detail of the photo around a pixel: at its own pixels, in blocks of the smaller and of the larger side.
    fn detail(self, view: &LevelView, at: [usize; 2]) -> Option<[f64; 3]> {
        let own = detail(view, at, 1)?;
        let smaller = if self.side > 1 {
            detail(view, at, self.side)?
        } else {
            own
        };
        let larger = if self.to_next > 0.0 {
            detail(view, at, 2 * self.side)?
        } else {
            smaller
        };
        Some([own, smaller, larger])
    }
}

/// Logarithms of both photos' median detail at places that both show, in pixels of the coarser one; `ratio` is the footprint
/// of the second over that of the first.
fn detail_of_pair(
    views: [&LevelView; 2],
    places: [&[[usize; 2]]; 2],
    ratio: f64,
) -> Option<(f64, f64)> {
    let blocks = [Blocks::new(ratio), Blocks::new(1.0 / ratio)];
    let mut found = [const { [const { Vec::new() }; 3] }; 2];
    for (&here, &there) in places[0].iter().zip(places[1]) {
        let own = blocks[0].detail(views[0], here);
        let others = blocks[1].detail(views[1], there);
        if let (Some(own), Some(others)) = (own, others) {
            for (found, values) in found.iter_mut().zip([own, others]) {
                found.iter_mut().zip(values).for_each(|(f, v)| f.push(v));
            }
        }
    }
    if found[0][0].len() < MIN_POINTS {
        return None;
    }
    let [mut a, mut b] = found;
    let logs = |found: &mut [Vec<f64>; 3], blocks: Blocks| -> Option<(f64, f64)> {
        let [own, smaller, larger] = found;
        let [own, smaller, larger] = [median(own)?, median(smaller)?, median(larger)?];
        let is_seen = own > 0.0 && smaller > 0.0 && larger > 0.0;
        let averaged = (1.0 - blocks.to_next) * smaller.ln() + blocks.to_next * larger.ln();
        is_seen.then(|| (own.ln(), averaged))
    };
    let ((own_a, a), (own_b, b)) = (logs(&mut a, blocks[0])?, logs(&mut b, blocks[1])?);
    Some((a.max(own_a.min(b)), b.max(own_b.min(a))))
}

/// Relative difference of the block around a pixel from the mean of those two sides away, where all are of the object and
/// unclipped.
fn detail(view: &LevelView, at: [usize; 2], side: usize) -> Option<f64> {
    const AWAY: [[isize; 2]; 4] = [[2, 0], [-2, 0], [0, 2], [0, -2]];
    let block = |away: [isize; 2]| -> Option<f64> {
        let corner = |c: usize| {
            let middle = at[c].checked_add_signed(away[c] * side as isize)?;
            middle.checked_sub(side / 2)
        };
        let (x0, y0) = (corner(0)?, corner(1)?);
        if x0 + side > view.mask.width || y0 + side > view.mask.height {
            return None;
        }
        let mut sum = 0.0;
        for y in y0..y0 + side {
            for x in x0..x0 + side {
                if !*view.mask.at(x, y) || *view.usable.at(x, y) <= 0.5 {
                    return None;
                }
                sum += f64::from(*view.grey.at(x, y));
            }
        }
        Some(sum / (side * side) as f64)
    };
    let own = block([0, 0])?;
    let mut mean = 0.0;
    for away in AWAY {
        mean += 0.25 * block(away)?;
    }
    (own > f64::from(view.dark)).then(|| ((own - mean) / own).abs())
}

/// Sharpness of the views from log ratios of pairs.
fn joined(num_views: usize, pairs: Vec<LogRatio>) -> Vec<f64> {
    let logs = gains::joined(num_views, pairs.into_iter());
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    logs.iter().map(|s| (s - most).exp()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;
    use rilievo_scene::Raster;

    #[test]
    fn ratios_of_pairs_are_joined() {
        let truth = [0.5_f64, 1.0, 0.8];
        let pair = |from: usize, to: usize| LogRatio {
            from,
            to,
            ratio: (truth[to] / truth[from]).ln(),
            weight: 1.0,
        };
        let found = joined(3, vec![pair(0, 1), pair(1, 2), pair(2, 1)]);
        for (found, truth) in found.iter().zip(truth) {
            assert!((found - truth).abs() < 1e-4, "{found} {truth}");
        }
        assert_eq!(joined(2, Vec::new()), [1.0, 1.0]);
    }

    /// The same camera twice, once with means over 3×3 pixels; and both alike.
    #[test]
    fn a_blurred_photo_is_told_from_a_sharp_one() {
        let mut sharp = flat_view(120, 90, 200.0);
        for (k, value) in sharp.image.data.iter_mut().enumerate() {
            let (x, y) = ((k / 3) % 120, (k / 3) / 120);
            *value = 0.5 + 0.2 * ((1.7 * x as f32).sin() * (1.3 * y as f32).cos());
        }
        sharp.grey = sharp.image.to_grey();
        let mut soft = sharp.clone();
        for y in 1..89 {
            for x in 1..119 {
                let around = |dx: usize, dy: usize| *sharp.grey.at(x + dx - 1, y + dy - 1);
                let sum: f32 = (0..9).map(|k| around(k % 3, k / 3)).sum();
                *soft.grey.at_mut(x, y) = sum / 9.0;
            }
        }
        let of = |second: LevelView| {
            let level = Level::new(vec![sharp.clone(), second], &[vec![1], vec![0]]);
            let depths: Vec<Vec<f64>> = level
                .views
                .iter()
                .map(|v| vec![0.0; v.pixels.len()])
                .collect();
            measure(&level, &depths)
        };
        let alike = of(sharp.clone());
        assert!(alike.iter().all(|s| (s - 1.0).abs() < 1e-6), "{alike:?}");
        let found = of(soft);
        assert!(found[0] > 0.999 && found[1] < 0.6, "{found:?}");
    }

    /// A wall, and its photo of half as many pixels a side; then the larger one with means over 5×5 pixels.
    #[test]
    fn a_photo_from_nearer_is_no_blurred_one() {
        let mut near = flat_view(240, 180, 400.0);
        let mut far = flat_view(120, 90, 200.0);
        let paint = |x: usize, y: usize| {
            let waves = [(0.31, 0.17), (0.83, -0.49), (1.7, 1.3), (-0.6, 1.1)];
            let (x, y) = (x as f32, y as f32);
            0.5 + 0.05
                * waves
                    .iter()
                    .map(|(a, b)| (a * x + b * y).sin())
                    .sum::<f32>()
        };
        near.grey = Raster::from_fn(240, 180, paint);
        let mean = |grey: &Raster<f32>, x: usize, y: usize, side: usize| {
            let block = (0..side * side).map(|k| *grey.at(x + k % side, y + k / side));
            block.sum::<f32>() / (side * side) as f32
        };
        far.grey = Raster::from_fn(120, 90, |x, y| mean(&near.grey, 2 * x, 2 * y, 2));
        let of = |near: LevelView, far: LevelView| {
            let level = Level::new(vec![near, far], &[vec![1], vec![0]]);
            let views = level.views.iter();
            let depths: Vec<_> = views.map(|v| vec![0.0; v.pixels.len()]).collect();
            measure(&level, &depths)
        };
        let found = of(near.clone(), far.clone());
        assert!(found.iter().all(|&s| s > 0.93), "{found:?}");
        // Noise alone, of which averages over blocks would have half.
        let noisy = |view: &LevelView| {
            let mut state = view.pixels.len() as u64;
            let mut noisy = view.clone();
            for value in &mut noisy.grey.data {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                *value = 0.5 + 0.01 * (state >> 40) as f32 / (1 << 24) as f32;
            }
            noisy
        };
        let found = of(noisy(&near), noisy(&far));
        assert!(found.iter().all(|&s| s > 0.93), "{found:?}");
        let sharp = near.grey.clone();
        near.grey = Raster::from_fn(240, 180, |x, y| {
            mean(&sharp, x.clamp(2, 237) - 2, y.clamp(2, 177) - 2, 5)
        });
        let found = of(near, far);
        assert!(found[1] > 0.999 && found[0] < 0.8, "{found:?}");
    }
}
