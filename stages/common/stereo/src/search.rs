//! Dense search over all views of a level, inside their visual hull.

use crate::hull::{self, InverseDepthRange, Outline};
use crate::level::Level;
use crate::patch_cost::Plane;
use crate::patchmatch::{self, SearchOptions};
use nalgebra::Point3;
use rilievo_scene::{Mask, Raster};

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
