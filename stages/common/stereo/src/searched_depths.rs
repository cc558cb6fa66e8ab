//! The slow part of a surface's error, which searches of single views show together.
//!
//! A solved surface has finer detail than searched depths, but light that the model lacks bends it slowly, and searched
//! depths, noisy as they are, do not follow that. Let `e_i` be how far the depths searched in view i lie beyond the surface,
//! smoothed so that detail is left out. What two views share of it is the surface's error, the rest is their noise: with means
//! over a neighbourhood the gain of a Wiener filter is `q = ⟨e_i e_j⟩ / ½ ⟨e_i² + e_j²⟩`. Of the `n` sources that count in a
//! search one may be the other view, and that pair of photos has the same noise both ways, so that noise alone reaches `q = 1/n`: the surface
//! moves by `(q − 1/n) / (1 − 1/n)` of what was found.

use crate::level::{self, Level};
use crate::sampling;
use crate::start::{self, AGREEMENT_PX};
use rayon::prelude::*;
use rilievo_scene::Raster;
use serde::{Deserialize, Serialize};

/// Standard deviation of the Gaussian that leaves detail out, pixels: below it searched depths err more than a solved surface.
const SLOW_PX: f64 = 6.0;
/// Standard deviation of the Gaussian over products of two views, pixels: a few areas that are alike by themselves.
const NEIGHBOURHOOD_PX: f64 = 16.0;
/// Distances from the surface beyond this count as this, footprints: false matches shall not decide.
const MAX_APART_PX: f32 = 6.0;

/// Log depths that were searched in all views of a level.
#[derive(Debug, Serialize, Deserialize)]
pub struct SearchedDepths {
    /// Every view by itself: noise is its own but for pairs of photos.
    alone: Vec<Vec<f32>>,
    /// Every view against what the others found: less noise, and the same in all.
    together: Vec<Vec<f32>>,
    /// Weights of the latter.
    weights: Vec<Vec<f32>>,
    /// Sources that counted in the former, at most.
    num_best: usize,
}

impl SearchedDepths {
    /// Of views searched by themselves, with `num_best` sources that count, and then together, where the sources in the bits of
    /// `agreement` confirm the depths.
    pub fn new(
        alone: &[Vec<f64>],
        together: &[Vec<f64>],
        agreement: &[Vec<u8>],
        num_best: usize,
    ) -> Self {
        let narrowed = |depths: &[Vec<f64>]| {
            let of_view = |depths: &Vec<f64>| depths.iter().map(|&d| d as f32).collect();
            depths.iter().map(of_view).collect()
        };
        let weight = |&bits: &u8| start::confirmed_weight(bits) as f32;
        let weights = agreement
            .iter()
            .map(|bits| bits.iter().map(weight).collect());
        Self {
            alone: narrowed(alone),
            together: narrowed(together),
            weights: weights.collect(),
            num_best,
        }
    }

    /// The surface of log depths `depths` without the slow error that the views' searches share.
    pub fn corrected(&self, level: &Level, depths: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let focal = level.focal() as f32;
        let slow = |i: usize, searched: &[f32], weights: &[f32]| {
            let apart = |(&searched, &depth): (&f32, &f64)| {
                let apart = (searched - depth as f32) * focal;
                [apart.clamp(-MAX_APART_PX, MAX_APART_PX)]
            };
            let apart: Vec<[f32; 1]> = searched.iter().zip(&depths[i]).map(apart).collect();
            sampling::smooth(&level.views[i].pixels, &apart, weights, SLOW_PX)
        };
        let views = (0..level.views.len()).into_par_iter();
        let alone: Vec<Raster<f32>> = views
            .map(|i| {
                let all = vec![1.0; depths[i].len()];
                let slow = slow(i, &self.alone[i], &all);
                let values: Vec<f64> = slow.iter().map(|&[e]| f64::from(e)).collect();
                level.views[i].spread(&values, 0.0)
            })
            .collect();
        let rasters = level::depth_rasters(level, depths);
        let corrected = |i: usize| {
            let gain = self.gains(level, (&rasters, &alone), i, &depths[i]);
            let slow = slow(i, &self.together[i], &self.weights[i]);
            let moved = depths[i].iter().zip(slow).zip(gain);
            moved
                .map(|((depth, [e]), gain)| depth + f64::from(gain * e / focal))
                .collect()
        };
        (0..depths.len()).map(corrected).collect()
    }

    /// Share of the slow distances that is the surface's error, for every pixel of view `index`; `rasters` are all views' log
    /// depths and their distances from depths that were searched alone.
    fn gains(
        &self,
        level: &Level,
        (depths, apart): (&[Raster<f32>], &[Raster<f32>]),
        index: usize,
        zeta: &[f64],
    ) -> Vec<f32> {
        let view = &level.views[index];
        let tolerance = AGREEMENT_PX / level.focal();
        // Product and mean square of both views' distances, means over those that see a pixel; and their number.
        let compared = |p: usize| {
            let (x, y) = view.place(p);
            let own = *apart[index].at(x, y);
            let mut sums = ([0.0_f32; 2], 0.0_f32);
            for sighting in level.sightings(depths, index, (p, zeta[p])) {
                let raster = &apart[level.sources[index][sighting.source].0];
                if sighting.is_within(tolerance) {
                    let (u, v) = (sighting.at.u.round(), sighting.at.v.round());
                    let other = *raster.at(u as usize, v as usize);
                    sums.0[0] += own * other;
                    sums.0[1] += 0.5 * (own * own + other * other);
                    sums.1 += 1.0;
                }
            }
            (sums.0.map(|sum| sum / sums.1.max(1.0)), sums.1)
        };
        let (products, weights): (Vec<[f32; 2]>, Vec<f32>) = (0..zeta.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(compared)
            .unzip();
        let products = sampling::smooth(&view.pixels, &products, &weights, NEIGHBOURHOOD_PX);
        let num_counting = self.num_best.min(level.sources[index].len()).max(1);
        let same = 1.0 / num_counting as f32;
        let gain = |[product, square]: [f32; 2]| {
            let q = product / square.max(f32::MIN_POSITIVE);
            ((q - same) / (1.0 - same).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0)
        };
        products.into_iter().map(gain).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;

    const FOCAL: f64 = 400.0;
    const SIZE: usize = 120;
    const NUM_VIEWS: usize = 4;

    /// Views at one place, so that each pixel is seen at the same one of all others.
    fn level() -> Level {
        let views = (0..NUM_VIEWS).map(|_| flat_view(SIZE, SIZE, FOCAL));
        let others = |i: usize| (0..NUM_VIEWS).filter(move |&j| j != i).collect();
        let sources: Vec<Vec<usize>> = (0..NUM_VIEWS).map(others).collect();
        Level::new(views.collect(), &sources)
    }

    /// A value of variance 1 for a place.
    fn noise(seed: usize, p: usize) -> f64 {
        let mixed = (seed * 7919 + p + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((mixed >> 40) as f64 / (1_u64 << 24) as f64 - 0.5) * 12.0_f64.sqrt()
    }

    /// Values of all views, footprints.
    fn of_views(value: impl Fn(usize, usize) -> f64) -> Vec<Vec<f64>> {
        (0..NUM_VIEWS)
            .map(|i| (0..SIZE * SIZE).map(|p| value(i, p) / FOCAL).collect())
            .collect()
    }

    /// Root of the mean square, footprints.
    fn error(depths: &[Vec<f64>]) -> f64 {
        let squares = depths.iter().flatten().map(|d| (d * FOCAL).powi(2));
        (squares.sum::<f64>() / (NUM_VIEWS * SIZE * SIZE) as f64).sqrt()
    }

    /// A slow bend of a surface that is flat.
    fn bend(_: usize, p: usize) -> f64 {
        1.5 * (0.05 * (p % SIZE) as f64).sin()
    }

    fn corrected(surface: &[Vec<f64>], searched: &[Vec<f64>], num_best: usize) -> Vec<Vec<f64>> {
        let confirmed = vec![vec![3; SIZE * SIZE]; NUM_VIEWS];
        let searched = SearchedDepths::new(searched, searched, &confirmed, num_best);
        searched.corrected(&level(), surface)
    }

    #[test]
    fn a_slow_error_is_mended_by_noisy_searches() {
        let (surface, searched) = (of_views(bend), of_views(|i, p| 2.0 * noise(i, p)));
        let before = error(&surface);
        let after = error(&corrected(&surface, &searched, 3));
        assert!(after < 0.25 * before, "{before} px to {after} px");
    }

    #[test]
    fn noise_alone_moves_nothing() {
        let surface = of_views(|_, _| 0.0);
        // A part of the noise is that of pairs of photos, of which a search consists by a third.
        let pair = |i: usize, j: usize| 10 + i.min(j) + 4 * i.max(j);
        let noisy = |i: usize, p: usize| -> f64 {
            let others = (0..NUM_VIEWS).filter(|&j| j != i);
            others.map(|j| 2.0 * noise(pair(i, j), p)).sum()
        };
        let searched = of_views(noisy);
        let after = corrected(&surface, &searched, 3);
        // Believed as it is, it would move the surface by this.
        let believed = error(&corrected(&surface, &of_views(|_, p| noisy(0, p)), 3));
        assert!(
            error(&after) < 0.12 * believed,
            "{} of {believed} px",
            error(&after)
        );
    }

    #[test]
    fn two_photos_cannot_tell_error_from_noise() {
        let surface = of_views(bend);
        assert_eq!(corrected(&surface, &of_views(|_, _| 0.0), 1), surface);
    }

    #[test]
    fn unconfirmed_and_hidden_depths_move_nothing() {
        let (surface, level) = (of_views(bend), level());
        let flat = of_views(|_, _| 0.0);
        let none = vec![vec![0; SIZE * SIZE]; NUM_VIEWS];
        let unconfirmed = SearchedDepths::new(&flat, &flat, &none, 3);
        assert_eq!(unconfirmed.corrected(&level, &surface), surface);
        // Every view's surface lies far from the others'.
        let apart = of_views(|i, p| 20.0 * i as f64 + bend(i, p));
        let confirmed = vec![vec![3; SIZE * SIZE]; NUM_VIEWS];
        let searched = SearchedDepths::new(&flat, &flat, &confirmed, 3);
        assert_eq!(searched.corrected(&level, &apart), apart);
    }
}
