//! The slow part of a surface's error, which searches of single views show together.
//!
//! A solved surface has finer detail than searched depths, but a light that lacks something bends it slowly, and
//! searched depths, noisy as they are, do not follow that. Let `e_i` be the distance of the depths that view i found by
//! itself from the surface, footprints, and `e_j` that of another view at the same point. What they share is
//! the surface's error and such noise as has the same cause in both searches, which use the same photos; the rest is noise.
//! The likeness `q = ⟨e_i e_j⟩ / ½ ⟨e_i² + e_j²⟩` is taken in two bands. In detail, `q₀`, a solved surface errs far less than
//! a search, so that what is alike is noise; with that share of shared noise in the slow band as well, the share of
//! the slow distance that is the surface's error is `(q − q₀)/(1 − q₀)`, as in a Wiener filter. Where detail of
//! the surface is missing it comes out too small. The surface moves by this share of the distance of the depths that all
//! views found together, which are less noisy. Errors that all searches make alike, as beside a highlight, stay.
//! Means reach over edges of depth.

use crate::level::{self, Level};
use crate::sampling;
use crate::start::AGREEMENT_PX;
use rayon::prelude::*;
use rilievo_scene::Raster;
use serde::{Deserialize, Serialize};

/// Standard deviation of the Gaussian that leaves detail out, pixels: below it searched depths err more than a solved surface.
const SLOW_PX: f64 = 6.0;
/// The same for the finest detail, which is not at the same pixels of two views.
const DETAIL_PX: f64 = 2.0;
/// Standard deviation of the Gaussian of the means `⟨⟩`, pixels: about seven areas of the one for slow distances, so that
/// several independent values take part.
const NEIGHBOURHOOD_PX: f64 = 16.0;
/// Larger distances from the surface count as this, footprints: false matches shall not decide.
const MAX_DISTANCE_PX: f32 = 6.0;
/// Share of shared noise beyond which searches tell nothing.
const MAX_NOISE_SHARE: f32 = 0.9;

/// Log depths that were searched in all views of a level.
#[derive(Debug, Serialize, Deserialize)]
pub struct SearchedDepths {
    /// Found in every view by itself.
    alone: Vec<Vec<f32>>,
    /// Found in every view against what the others found.
    together: Vec<Vec<f32>>,
    /// Where other views confirm the latter.
    confirmed: Vec<Vec<bool>>,
}

impl SearchedDepths {
    /// Of views searched by themselves and then together, where the sources in the bits of `agreement` confirm the latter.
    pub fn new(alone: &[Vec<f64>], together: &[Vec<f64>], agreement: &[Vec<u8>]) -> Self {
        let narrowed = |depths: &[Vec<f64>]| {
            let of_view = |depths: &Vec<f64>| depths.iter().map(|&d| d as f32).collect();
            depths.iter().map(of_view).collect()
        };
        let confirmed = |bits: &Vec<u8>| bits.iter().map(|&bits| bits != 0).collect();
        Self {
            alone: narrowed(alone),
            together: narrowed(together),
            confirmed: agreement.iter().map(confirmed).collect(),
        }
    }

    /// Whether they are of these views.
    pub fn fits(&self, level: &Level) -> bool {
        let sizes = || level.views.iter().map(|view| view.pixels.len());
        sizes().eq(self.alone.iter().map(Vec::len))
            && sizes().eq(self.together.iter().map(Vec::len))
            && sizes().eq(self.confirmed.iter().map(Vec::len))
    }

    /// The surface of log depths `depths` without the slow error that the searches share.
    pub fn corrected(&self, level: &Level, depths: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let focal = level.focal() as f32;
        let distance = |searched: f32, depth: f64| {
            let distance = (searched - depth as f32) * focal;
            distance.clamp(-MAX_DISTANCE_PX, MAX_DISTANCE_PX)
        };
        let smooth = |i: usize, distances: &[[f32; 1]], sigma_px: f64| {
            let all = vec![1.0; distances.len()];
            sampling::smooth(&level.views[i].pixels, distances, &all, sigma_px)
        };
        let bands: Vec<[Raster<f32>; 2]> = (0..depths.len())
            .into_par_iter()
            .map(|i| {
                let distances = self.alone[i].iter().zip(&depths[i]);
                let distances: Vec<_> = distances.map(|(&s, &d)| [distance(s, d)]).collect();
                let slow = smooth(i, &distances, SLOW_PX);
                let detail = smooth(i, &distances, DETAIL_PX);
                let detail = detail.iter().zip(&slow).map(|([d], [s])| f64::from(d - s));
                let slow = slow.iter().map(|&[s]| f64::from(s));
                [slow.collect(), detail.collect()]
                    .map(|band: Vec<f64>| level.views[i].spread(&band, 0.0))
            })
            .collect();
        let rasters = level::depth_rasters(level, depths);
        let corrected = |i: usize| {
            let shares = error_shares(level, &rasters, &bands, i, &depths[i]);
            // What is unconfirmed shows no error.
            let found = self.together[i].iter().zip(&self.confirmed[i]);
            let found = found
                .zip(&depths[i])
                .map(|((&s, &confirmed), &d)| [if confirmed { distance(s, d) } else { 0.0 }]);
            let slow = smooth(i, &found.collect::<Vec<_>>(), SLOW_PX);
            let moved = depths[i].iter().zip(slow).zip(shares);
            moved
                .map(|((depth, [distance]), share)| depth + f64::from(share * distance / focal))
                .collect()
        };
        (0..depths.len()).map(corrected).collect()
    }
}

/// Share of the slow distances that is the surface's error, for every pixel of view `index` at log depths `depths`.
/// `rasters` are all views' log depths, `bands` the slow and the detailed distances of what each view found by itself.
fn error_shares(
    level: &Level,
    rasters: &[Raster<f32>],
    bands: &[[Raster<f32>; 2]],
    index: usize,
    depths: &[f64],
) -> Vec<f32> {
    let view = &level.views[index];
    let tolerance = AGREEMENT_PX / level.focal();
    // Products and mean squares in both bands, means over the sources that see a pixel; and their number.
    let compared = |p: usize| {
        let (x, y) = view.place(p);
        let (mut sums, mut count) = ([0.0_f32; 4], 0.0_f32);
        for sighting in level.sightings(rasters, index, (p, depths[p])) {
            if !sighting.is_within(tolerance) {
                continue;
            }
            let other = &bands[level.sources[index][sighting.source].0];
            let (u, v) = (sighting.at.u.round(), sighting.at.v.round());
            for (band, other) in other.iter().enumerate() {
                let own = *bands[index][band].at(x, y);
                let other = *other.at(u as usize, v as usize);
                sums[2 * band] += own * other;
                sums[2 * band + 1] += 0.5 * (own * own + other * other);
            }
            count += 1.0;
        }
        (sums.map(|sum| sum / count.max(1.0)), count)
    };
    let (products, counts): (Vec<[f32; 4]>, Vec<f32>) = (0..depths.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(compared)
        .unzip();
    let products = sampling::smooth(&view.pixels, &products, &counts, NEIGHBOURHOOD_PX);
    let share = |[slow, slow_square, detail, detail_square]: [f32; 4]| {
        let likeness = |product: f32, square: f32| product / square.max(f32::MIN_POSITIVE);
        let noise = likeness(detail, detail_square).max(0.0);
        if noise > MAX_NOISE_SHARE {
            return 0.0;
        }
        ((likeness(slow, slow_square) - noise) / (1.0 - noise)).clamp(0.0, 1.0)
    };
    products.into_iter().map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;

    const FOCAL: f64 = 400.0;
    const SIZE: usize = 120;

    /// Views at one place, so that each pixel is seen at the same one of all others.
    fn level(num_views: usize) -> Level {
        let views = (0..num_views).map(|_| flat_view(SIZE, SIZE, FOCAL));
        let others = |i: usize| (0..num_views).filter(move |&j| j != i).collect();
        let sources: Vec<Vec<usize>> = (0..num_views).map(others).collect();
        Level::new(views.collect(), &sources)
    }

    /// A value of variance 1 for a place.
    fn noise(seed: usize, p: usize) -> f64 {
        let mixed = (seed * 7919 + p + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((mixed >> 40) as f64 / (1_u64 << 24) as f64 - 0.5) * 12.0_f64.sqrt()
    }

    /// Log depths of all views from footprints.
    fn of_views(num_views: usize, value: impl Fn(usize, usize) -> f64) -> Vec<Vec<f64>> {
        (0..num_views)
            .map(|i| (0..SIZE * SIZE).map(|p| value(i, p) / FOCAL).collect())
            .collect()
    }

    /// Root of the mean square difference, footprints.
    fn apart(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        let squares: Vec<f64> = pairs.map(|(a, b)| ((a - b) * FOCAL).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    /// A slow bend of a surface that is flat.
    fn bend(_: usize, p: usize) -> f64 {
        1.5 * (0.05 * (p % SIZE) as f64).sin()
    }

    fn corrected(surface: &[Vec<f64>], alone: &[Vec<f64>], together: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let confirmed = vec![vec![1; SIZE * SIZE]; surface.len()];
        let searched = SearchedDepths::new(alone, together, &confirmed);
        let level = level(surface.len());
        assert!(searched.fits(&level));
        searched.corrected(&level, surface)
    }

    #[test]
    fn a_slow_error_is_mended_by_noisy_searches_and_detail_stays() {
        let detail = |p: usize| if p % 7 < 3 { 0.1 } else { -0.1 };
        let truth = of_views(4, |_, p| detail(p));
        let surface = of_views(4, |i, p| bend(i, p) + detail(p));
        let alone = of_views(4, |i, p| detail(p) + 2.0 * noise(i, p));
        let together = of_views(4, |i, p| detail(p) + noise(10 + i, p));
        let (before, after) = (
            apart(&surface, &truth),
            apart(&corrected(&surface, &alone, &together), &truth),
        );
        assert!(after < 0.25 * before, "{before} px to {after} px");
        // By what they found together, and by nothing else.
        let wrong = corrected(&surface, &alone, &surface);
        assert!(apart(&wrong, &surface) < 1e-3);
    }

    #[test]
    fn noise_alone_moves_little() {
        let surface = of_views(4, |_, _| 0.0);
        // Each photo's noise enters all searches, that of the view itself most.
        let noisy = |i: usize, p: usize| -> f64 {
            let weight = |j: usize| if i == j { 2.0 } else { 0.5 };
            (0..4).map(|j| weight(j) * noise(j, p)).sum()
        };
        let searched = of_views(4, noisy);
        let moved = apart(&corrected(&surface, &searched, &searched), &surface);
        let pixels = &level(1).views[0].pixels;
        let all = vec![1.0; SIZE * SIZE];
        let values: Vec<[f32; 1]> = (0..SIZE * SIZE).map(|p| [noisy(0, p) as f32]).collect();
        let slow = sampling::smooth(pixels, &values, &all, SLOW_PX);
        let slow = vec![slow.iter().map(|&[e]| f64::from(e) / FOCAL).collect()];
        let believed = apart(&slow, &of_views(1, |_, _| 0.0));
        assert!(moved < 0.45 * believed, "{moved} of {believed} px");
    }

    #[test]
    fn two_searches_of_one_pair_of_photos_tell_nothing() {
        let surface = of_views(2, bend);
        let noisy = of_views(2, |_, p| 2.0 * noise(0, p));
        assert_eq!(corrected(&surface, &noisy, &noisy), surface);
    }

    #[test]
    fn unconfirmed_and_hidden_depths_move_nothing() {
        let (surface, level) = (of_views(4, bend), level(4));
        let flat = of_views(4, |_, _| 0.0);
        let none = vec![vec![0; SIZE * SIZE]; 4];
        let unconfirmed = SearchedDepths::new(&flat, &flat, &none);
        assert_eq!(unconfirmed.corrected(&level, &surface), surface);
        // Every view's surface lies far from the others'.
        let scattered = of_views(4, |i, p| 20.0 * i as f64 + bend(i, p));
        assert_eq!(corrected(&scattered, &flat, &flat), scattered);
        assert!(!unconfirmed.fits(&Level::new(vec![flat_view(3, 3, FOCAL)], &[vec![]])));
    }
}
