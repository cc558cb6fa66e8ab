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

/// Standard deviation of the Gaussian over the costs from which certainty follows, pixels: about a patch's own.
const CERTAINTY_PX: f64 = 3.0;
/// Least certainty: three times the standard deviation of a usual depth.
const MIN_CERTAINTY: f32 = 1.0 / 9.0;
/// Cost of a patch that shows next to nothing but noise.
const NOTHING_SEEN: f32 = 0.99;

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
    /// Views are compared with their sources; `is_started`: there are earlier planes to start from.
    ///
    /// The object lies where the masks meet if all views are `masked`, else about `points` in the world. `None`
    /// where neither is known.
    pub fn new(
        level: &'a Level,
        masked: bool,
        points: &[Point3<f64>],
        is_started: bool,
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
        let num_sources = level.sources.iter().map(Vec::len).max().unwrap_or(1);
        let mut options = *options;
        if is_started {
            // Planes need to be spread and polished only.
            options.num_sweeps = options.num_sweeps.div_ceil(2);
            // Beside an edge some sources see another surface: the better half shows depth (Kang,
            // Szeliski, Chai, CVPR 2001). A search without a start needs more.
            options.num_best = num_sources.div_ceil(2);
        }
        Some(Self {
            level,
            outlines,
            masks,
            ranges,
            options,
            found: None,
        })
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

    /// What planes of view `index` cost in its sources' photos alone.
    pub fn costs(&self, index: usize, planes: &[Plane]) -> Vec<f32> {
        patchmatch::costs(self.level, index, &self.masks, planes, &self.options)
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
        patchmatch::search(
            self.level,
            index,
            &self.masks,
            &ranges,
            start,
            self.found.as_deref(),
            &self.options,
        )
    }
}

/// How certain searched depths are, per view and pixel: the inverse of their variance over that of the median pixel's, from
/// 1/9 to 1; from what their planes cost ([`Search::costs`]).
///
/// A patch whose structure has the variance `v` beside a noise of variance `s²` correlates by `v / (v + s²)` with its
/// image. So its cost `c` tells the noise over the structure, `s²/v = c / (1 − c)`, with which the variance of a depth
/// grows. Where it is the median pixel's or less, certainty is 1.
pub fn certainties(level: &Level, costs: &[Vec<f32>]) -> Vec<Vec<f32>> {
    let noise: Vec<Vec<f32>> = level
        .views
        .par_iter()
        .zip(costs)
        .map(|(view, costs)| {
            let capped: Vec<[f32; 1]> = costs.iter().map(|c| [c.min(NOTHING_SEEN)]).collect();
            let all = vec![1.0; costs.len()];
            let smooth = sampling::smooth(&view.pixels, &capped, &all, CERTAINTY_PX);
            smooth.iter().map(|[c]| c / (1.0 - c)).collect()
        })
        .collect();
    let mut pooled: Vec<f64> = noise.iter().flatten().map(|&v| f64::from(v)).collect();
    let usual = median(&mut pooled).unwrap_or(1.0) as f32;
    let certainty = |noise: f32| (usual / noise.max(f32::MIN_POSITIVE)).clamp(MIN_CERTAINTY, 1.0);
    noise
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
        let view = flat_view(90, 30, 100.0);
        let column: Vec<u32> = view.pixels.xs.clone();
        let level = Level::new(vec![view], &[vec![]]);
        // Noise over structure: 1/9 at the left, 1 in the middle, 9 at the right.
        let cost = |x: &u32| [0.1, 0.5, 0.9][(*x / 30) as usize];
        let found = certainties(&level, &[column.iter().map(cost).collect()]);
        let at = |x: u32| {
            let p = column.iter().position(|&c| c == x);
            p.map_or(f32::NAN, |p| found[0][p])
        };
        assert!((at(5) - 1.0).abs() < 1e-3, "{}", at(5));
        assert!((at(45) - 1.0).abs() < 0.05, "{}", at(45));
        assert!((at(85) - MIN_CERTAINTY).abs() < 1e-3, "{}", at(85));
        assert!(at(60) < at(57) && at(60) > at(63));
        // A patch that no source sees.
        let unseen = certainties(&level, &[vec![2.0; column.len()]]);
        assert!(unseen[0].iter().all(|c| (c - 1.0).abs() < 1e-3));
    }
}
