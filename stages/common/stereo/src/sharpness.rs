//! How sharp photos are against each other at one level: a photo out of focus says less of fine detail.
//!
//! At points that two views see, `d = I − mean(I two pixels away)` over `I` is their finest detail. The medians of `|d|`
//! over the same points stand for `s_i` and `s_j`; all pairs together determine the sharpness `s` of every view (least
//! squares on the logarithms, the sharpest 1). Depth that is matched errs with one over the detail's gradient, so that a
//! view's surface weighs `s²`.

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

/// Sharpness of every view, 0 to 1, at log depths `depths`; 1 for views without a pair.
pub fn measure(level: &Level, depths: &[Vec<f64>]) -> Vec<f64> {
    let rasters = depth_rasters(level, depths);
    let tolerance = VISIBLE_PX / level.focal();
    let pairs: Vec<LogRatio> = (0..level.views.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let (view, rasters) = (&level.views[i], &rasters);
            level.sources[i].iter().filter_map(move |(j, warp)| {
                let other = &level.views[*j];
                let (mut here, mut there) = (Vec::new(), Vec::new());
                for p in (0..view.pixels.len()).step_by(STEP) {
                    let (x, y) = view.xy(p);
                    let Some(at) = warp.land(x, y, depths[i][p]) else {
                        continue;
                    };
                    let seen = other.unclipped_depth_at(&rasters[*j], at.u, at.v);
                    if seen.is_none_or(|zeta| (zeta - at.zeta).abs() > tolerance) {
                        continue;
                    }
                    // The nearest pixel: between pixels interpolation would blur.
                    let own = detail(view, x as usize, y as usize);
                    let others = detail(other, at.u.round() as usize, at.v.round() as usize);
                    if let (Some(a), Some(b)) = (own, others) {
                        here.push(a);
                        there.push(b);
                    }
                }
                let enough = here.len() >= MIN_POINTS;
                let (a, b) = (median(&mut here)?, median(&mut there)?);
                (enough && a > 0.0 && b > 0.0).then(|| LogRatio {
                    from: i,
                    to: *j,
                    ratio: (b / a).ln(),
                    weight: 1.0,
                })
            })
        })
        .collect();
    joined(level.views.len(), pairs)
}

/// Relative difference of a pixel from the mean two pixels away, where all are of the object and unclipped.
fn detail(view: &LevelView, x: usize, y: usize) -> Option<f64> {
    const AWAY: [(i32, i32); 4] = [(2, 0), (-2, 0), (0, 2), (0, -2)];
    let value = |x: usize, y: usize| -> Option<f64> {
        let inside = x < view.mask.width && y < view.mask.height;
        (inside && *view.mask.at(x, y) && *view.usable.at(x, y) > 0.5)
            .then(|| f64::from(*view.grey.at(x, y)))
    };
    let own = value(x, y)?;
    let mut mean = 0.0;
    for (dx, dy) in AWAY {
        mean += 0.25
            * value(
                x.checked_add_signed(dx as isize)?,
                y.checked_add_signed(dy as isize)?,
            )?;
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
}
