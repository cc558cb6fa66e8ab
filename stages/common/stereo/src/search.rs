//! Dense search over all views of a level, inside their visual hull.

use crate::hull::{self, InverseDepthRange, Outline};
use crate::level::Level;
use crate::patch_cost::Plane;
use crate::patchmatch::{self, SearchOptions};
use crate::sampling;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::{Mask, Raster};

/// Standard deviation of the Gaussian over the variances from which certainty follows, pixels: about a patch's own.
const CERTAINTY_PX: f64 = 3.0;
/// Structure over noise from which a depth is certain: patches then correlate by .8.
const CERTAIN: f32 = 4.0;
/// Least certainty: three times the standard deviation of a certain depth.
const MIN_CERTAINTY: f32 = 1.0 / 9.0;

/// A search of the views of a level, which work it out one by one.
pub struct Search<'a> {
    level: &'a Level,
    outlines: Vec<Outline<'a>>,
    /// A pixel wider than the object: masks of different views never meet exactly.
    masks: Vec<Mask>,
    /// Where each view may find the object.
    ranges: Vec<InverseDepthRange>,
    options: SearchOptions,
    /// Log depths that were found in every view before, not a number outside its mask.
    found: Option<Vec<Raster<f32>>>,
}

impl<'a> Search<'a> {
    /// The object lies where the masks meet if all views are `masked`, else about `points` in the world. `None`
    /// where neither is known.
    pub fn new(
        level: &'a Level,
        masked: bool,
        points: &[Point3<f64>],
        options: &SearchOptions,
    ) -> Option<Self> {
        let outlines: Vec<Outline> = level.views.iter().map(|v| v.outline(masked)).collect();
        let ranges = hull::object_ranges(&outlines, points)
            .into_iter()
            .collect::<Option<_>>()?;
        let masks = level
            .views
            .iter()
            .map(|v| hull::dilate(&v.mask, 1))
            .collect();
        Some(Self {
            level,
            outlines,
            masks,
            ranges,
            options: *options,
            found: None,
        })
    }

    /// The level that is searched.
    pub fn level(&self) -> &Level {
        self.level
    }

    /// With the log depths that were found in every view before, which planes are held against.
    #[must_use]
    pub fn against(self, depths: &[Vec<f64>]) -> Self {
        let views = self.level.views.iter().zip(depths);
        let found = views.map(|(view, depths)| view.spread(depths, f32::NAN));
        Self {
            found: Some(found.collect()),
            ..self
        }
    }

    /// Variances of the patches of view `index`, shared and not ([`patchmatch::variances`]).
    pub fn variances(&self, index: usize, planes: &[Plane]) -> Vec<[f32; 2]> {
        patchmatch::variances(self.level, index, &self.masks, planes, self.better_half())
    }

    /// Whether the patch about each pixel of view `index` is clipped all over ([`patchmatch::clipped_all_over`]).
    pub fn clipped_all_over(&self, index: usize) -> Vec<bool> {
        patchmatch::clipped_all_over(self.level, index, &self.masks)
    }

    /// Sources that count around planes that are about right: beside an edge some see another surface, and the better
    /// half shows depth (Kang, Szeliski, Chai, CVPR 2001). A search without a start needs more.
    fn better_half(&self) -> usize {
        let num_sources = self.level.sources.iter().map(Vec::len).max();
        num_sources.unwrap_or(1).div_ceil(2)
    }

    /// Planes of view `index`, from earlier ones where there are any.
    pub fn view(&self, index: usize, start: Option<&[Plane]>) -> Vec<Plane> {
        let view = &self.level.views[index];
        let positions: Vec<_> = (0..view.pixels.len()).map(|p| view.xy(p)).collect();
        let outlines = self.outlines.iter().zip(&self.masks);
        let outlines: Vec<Outline> = outlines
            .map(|(outline, mask)| Outline { mask, ..*outline })
            .collect();
        // The whole range where the masks contradict each other.
        let whole = self.ranges[index];
        let ranges: Vec<_> = hull::ranges_inside(&outlines, index, &positions, whole)
            .into_iter()
            .map(|range| range.unwrap_or(whole))
            .collect();
        let mut options = self.options;
        if start.is_some() {
            // Planes need to be spread and polished only.
            options.num_sweeps = options.num_sweeps.div_ceil(2);
            options.num_best = self.better_half();
        }
        patchmatch::search(
            self.level,
            index,
            &self.masks,
            &ranges,
            start,
            self.found.as_deref(),
            &options,
        )
    }
}

/// How certain searched depths are, per view and pixel, from 1/9 to 1: the inverse of their variance over that of a certain
/// one's; from the patches' variances, shared by the photos and not ([`Search::variances`]).
///
/// The variance of a depth grows with noise over structure. Structure is what photos share of a patch's variance; noise is
/// the rest of the median pixel: where a surface bends or ends the rest is larger, and yet no noise.
pub fn certainties(level: &Level, variances: &[Vec<[f32; 2]>]) -> Vec<Vec<f32>> {
    let smooth: Vec<Vec<[f32; 2]>> = level
        .views
        .par_iter()
        .zip(variances)
        .map(|(view, variances)| {
            let all = vec![1.0; variances.len()];
            sampling::smooth(&view.pixels, variances, &all, CERTAINTY_PX)
        })
        .collect();
    let rests = smooth.iter().flatten().map(|&[_, rest]| f64::from(rest));
    let noise = median(&mut rests.collect::<Vec<_>>()).unwrap_or(0.0) as f32;
    let certain = (CERTAIN * noise).max(f32::MIN_POSITIVE);
    let certainty = |[structure, _]: [f32; 2]| (structure / certain).clamp(MIN_CERTAINTY, 1.0);
    smooth
        .into_iter()
        .map(|of_view| of_view.into_iter().map(certainty).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;

    #[test]
    fn certainty_falls_with_noise_over_structure() {
        const NOISE: f32 = 1e-4;
        let view = flat_view(120, 30, 100.0);
        let column: Vec<u32> = view.pixels.xs.clone();
        let level = Level::new(vec![view], &[vec![]]);
        // Structure, a bend with as much of it, half of what is certain, nothing.
        let variances = |x: &u32| {
            [
                [9.0 * NOISE, NOISE],
                [9.0 * NOISE, 9.0 * NOISE],
                [2.0 * NOISE, NOISE],
                [0.0, NOISE],
            ][(*x / 30) as usize]
        };
        let found = certainties(&level, &[column.iter().map(variances).collect()]);
        let at = |x: u32| {
            let p = column.iter().position(|&c| c == x);
            p.map_or(f32::NAN, |p| found[0][p])
        };
        assert_eq!([at(5), at(45)], [1.0, 1.0]);
        assert!((at(75) - 0.5).abs() < 0.02, "{}", at(75));
        assert_eq!(at(115), MIN_CERTAINTY);
        assert!(at(88) > at(91));
        // No photo shows anything.
        let black = certainties(&level, &[vec![[0.0; 2]; column.len()]]);
        assert!(black[0].iter().all(|&c| c == MIN_CERTAINTY));
    }
}
