//! What all views share before any patch is aligned: working images, cells, ranges of depth, neighbours.
//!
//! The images of all views are held where they fit into memory; else those of a few views at a time with their
//! neighbours', loaded again when their turn comes.

use super::grid::{CellRanges, Grid, depth_ranges, grid_spacing};
use super::grow::Reference;
use super::neighbours::neighbours;
use super::options::AnchorOptions;
use super::pair::PairGeometry;
use super::sweep::DetailImage;
use super::working::WorkingView;
use crate::error::PosesError;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::loading::{map_few_at_once, num_at_once};
use rilievo_scene::{Observer, PhotoSet, PosedView, PosedViews, ViewIdx};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Smallest angle between the rays of a patch and a source, degrees: below it a pixel of noise
/// moves the depth too far. Where the widest rays of most points meet at less than four times this,
/// a quarter of their angle takes its place.
const MIN_SOURCE_ANGLE_DEG: f64 = 5.0;
/// Largest such angle, degrees: beyond it patches look too different.
const MAX_SOURCE_ANGLE_DEG: f64 = 60.0;
/// Bytes that working images may take where no memory is given.
const IMAGE_BYTES: usize = 1 << 30;

/// Sizes of images and patches.
#[derive(Clone, Copy)]
pub(super) struct Working {
    /// Photos with more megapixels are reduced by a whole factor: bounds memory and time.
    pub max_mpx: f64,
    /// Radius of a patch, pixels; samples are weighed by a Gaussian of 3/7 of it. Smaller follows
    /// curvature, larger averages noise.
    pub patch_radius_px: usize,
}

impl Default for Working {
    fn default() -> Self {
        Self {
            max_mpx: 4.0,
            patch_radius_px: 14,
        }
    }
}

/// What every view needs of the whole scene.
pub(super) struct AnchorScene<'a> {
    photos: &'a PhotoSet,
    posed: &'a PosedViews,
    /// Photos that may be loaded at once, and bytes that working images may take.
    at_once: usize,
    bytes: usize,
    working: Working,
    /// Angles between the rays of reference and source, radians.
    angles_rad: (f64, f64),
    /// Views with the object in them; of many, only some have their images at a time.
    pub views: Vec<WorkingView>,
    /// Index among the posed views, per working view.
    pub ids: Vec<ViewIdx>,
    /// Normalised images of the epipolar search.
    pub details: Vec<DetailImage>,
    pub grids: Vec<Grid>,
    /// Range of inverse depth per view and cell.
    pub ranges: Vec<CellRanges>,
    /// Views that each view is compared with, ascending.
    pub neighbours: Vec<Vec<usize>>,
    /// Sparse points in the world that each view sees.
    pub points: Vec<Vec<Point3<f64>>>,
}

/// What anchors start from.
#[derive(Default)]
pub(super) struct Prepared<'a> {
    /// Working views with cells and ranges; `None`, after a warning, where there can be no anchors.
    pub scene: Option<AnchorScene<'a>>,
    /// Views without a mask.
    pub unmasked_views: usize,
    /// Whether a warning was given of something that may leave no anchors.
    pub warned: bool,
}

/// Loads the views and finds where the object can be in them.
pub(super) fn prepare<'a>(
    photos: &'a PhotoSet,
    posed: &'a PosedViews,
    options: &AnchorOptions,
    working: Working,
    memory: Option<u64>,
    observer: &dyn Observer,
) -> Result<Prepared<'a>, PosesError> {
    let mut prepared = Prepared::default();
    let mut warn = |message: String| {
        prepared.warned = true;
        crate::error::warn(observer, message)
    };
    let at_once = num_at_once(photos, memory);
    let bytes = memory.map_or(IMAGE_BYTES, |memory| (memory / 3) as usize);
    let held = AtomicUsize::new(0);
    let loaded = map_few_at_once(&posed.views, at_once, |view| {
        let mut loaded = load(photos, view, working)?;
        if let Some(loaded) = &mut loaded {
            // What does not fit is loaded again when its turn comes.
            let size = loaded.image_bytes();
            if held.fetch_add(size, Ordering::Relaxed) + size > bytes {
                loaded.texels = Vec::new();
            }
        }
        Ok::<_, PosesError>(loaded)
    })?;
    let (mut ids, mut views) = (Vec::new(), Vec::new());
    for (idx, view) in loaded.into_iter().enumerate() {
        if let Some(view) = view {
            ids.push(ViewIdx(idx));
            views.push(view);
        }
    }
    if views.len() < 2 {
        let message = format!(
            "no depth anchors: {} view(s) with a pose and the object in it, at least 2 are needed",
            views.len()
        );
        warn(message)?;
        return Ok(prepared);
    }
    let without_mask = views.iter().filter(|view| !view.has_mask).count();
    if without_mask > 0 {
        let message = format!(
            "{without_mask} of {} views have no mask: anchors cover everything that they show, background too",
            views.len()
        );
        warn(message)?;
        prepared.unmasked_views = without_mask;
    }
    let mut working_of = vec![None; posed.views.len()];
    for (working, id) in ids.iter().enumerate() {
        working_of[id.0] = Some(working);
    }
    let mut points = vec![Vec::new(); views.len()];
    let mut positions = Vec::with_capacity(posed.points.len());
    for point in &posed.points {
        let position = Point3::from(point.position);
        positions.push(position);
        let mut seen: Vec<usize> = (point.track.iter())
            .filter_map(|sighting| working_of[sighting.view.0])
            .collect();
        seen.dedup();
        for working in seen {
            points[working].push(position);
        }
    }
    let spacing = grid_spacing(&views, options.spacing_px);
    let grids: Vec<Grid> = views.iter().map(|view| Grid::new(view, spacing)).collect();
    let Some(ranges) = depth_ranges(&views, &grids, &positions) else {
        let message = "no depth anchors: neither masks nor sparse points tell where the object is; give masks";
        warn(message.to_owned())?;
        return Ok(prepared);
    };
    let angles_rad = source_angles_rad(crate::narrow::widest_angle(posed));
    prepared.scene = Some(AnchorScene {
        photos,
        posed,
        at_once,
        bytes,
        working,
        neighbours: neighbours(&views, &grids, &ranges, angles_rad),
        details: vec![DetailImage::default(); views.len()],
        angles_rad,
        views,
        ids,
        grids,
        ranges,
        points,
    });
    Ok(prepared)
}

fn source_angles_rad(widest_rad: Option<f64>) -> (f64, f64) {
    let smallest = MIN_SOURCE_ANGLE_DEG.to_radians();
    (
        widest_rad.map_or(smallest, |widest| smallest.min(0.25 * widest)),
        MAX_SOURCE_ANGLE_DEG.to_radians(),
    )
}

/// A view made ready; `None` when nothing of the object is in it.
fn load(
    photos: &PhotoSet,
    view: &PosedView,
    working: Working,
) -> Result<Option<WorkingView>, PosesError> {
    let photo = &photos.photos[view.photo.0];
    let image = photo.linear()?;
    Ok(WorkingView::new(photo, view, &image, working.max_mpx))
}

impl AnchorScene<'_> {
    /// A view as the reference of its patches.
    pub fn reference<'a>(&'a self, index: usize, pairs: &'a [PairGeometry]) -> Reference<'a> {
        Reference {
            views: &self.views,
            index,
            pairs,
            grid: &self.grids[index],
            ranges: &self.ranges[index],
            radius_px: self.working.patch_radius_px,
            angles_rad: self.angles_rad,
        }
    }

    /// Ranges of views, in order, whose images and those of their neighbours fit into memory together.
    pub fn groups(&self) -> Vec<Range<usize>> {
        let mut groups = Vec::new();
        let mut first = 0;
        let (mut needed, mut bytes) = (vec![false; self.views.len()], 0);
        for index in 0..self.views.len() {
            for attempt in 0..2 {
                let more: Vec<usize> = self
                    .with_neighbours(index)
                    .filter(|&v| !needed[v])
                    .collect();
                let size: usize = more.iter().map(|&v| self.views[v].image_bytes()).sum();
                if attempt == 0 && index > first && bytes + size > self.bytes {
                    groups.push(first..index);
                    (first, bytes) = (index, 0);
                    needed.fill(false);
                    continue;
                }
                bytes += size;
                more.into_iter().for_each(|v| needed[v] = true);
                break;
            }
        }
        groups.push(first..self.views.len());
        groups
    }

    fn with_neighbours(&self, index: usize) -> impl Iterator<Item = usize> + '_ {
        self.neighbours[index].iter().copied().chain([index])
    }

    /// Holds the images of a group's views and their neighbours, and no others.
    pub fn hold(&mut self, group: Range<usize>) -> Result<(), PosesError> {
        let mut needed = vec![false; self.views.len()];
        for index in group {
            self.with_neighbours(index).for_each(|v| needed[v] = true);
        }
        let mut missing = Vec::new();
        for (v, needed) in needed.iter().enumerate() {
            if !needed {
                self.views[v].texels = Vec::new();
                self.details[v] = DetailImage::default();
            } else if self.views[v].texels.is_empty() {
                missing.push(v);
            }
        }
        let loaded = map_few_at_once(&missing, self.at_once, |&v| {
            load(self.photos, &self.posed.views[self.ids[v].0], self.working)
        })?;
        for (v, view) in missing.into_iter().zip(loaded) {
            self.views[v].texels = view.map(|view| view.texels).unwrap_or_default();
        }
        let reduction = if self.grids.iter().any(|grid| grid.spacing < 12) {
            2
        } else {
            4
        };
        let views = &self.views;
        self.details
            .par_iter_mut()
            .enumerate()
            .for_each(|(v, detail)| {
                if needed[v] && detail.data.is_empty() {
                    *detail = DetailImage::new(&views[v], reduction);
                }
            });
        Ok(())
    }
}
