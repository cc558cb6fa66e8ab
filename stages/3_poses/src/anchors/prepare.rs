//! What all views share before any patch is aligned: working images, cells, ranges of depth, neighbours.
//!
//! The images of all views are held where they fit into memory; else those of a few views at a time with their
//! neighbours', loaded again when their turn comes.

use super::grid::{CellRanges, Grid, depth_ranges, grid_spacing};
use super::grow::GrowOptions;
use super::neighbours::neighbours;
use super::options::AnchorOptions;
use super::patch::PatchOptions;
use super::report::Facts;
use super::sweep::DetailImage;
use super::working::WorkingView;
use crate::error::PosesError;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::loading::{map_few_at_once, num_at_once};
use rilievo_scene::{Observer, PhotoSet, PosedView, PosedViews, ViewIdx};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What every view needs of the whole scene.
pub(super) struct Scene<'a> {
    photos: &'a PhotoSet,
    posed: &'a PosedViews,
    /// Photos that may be loaded at once, and bytes that working images may take.
    at_once: usize,
    bytes: usize,
    /// Options as given.
    pub options: &'a AnchorOptions,
    /// Views with the object in them; of many, only some have their images at a time.
    pub views: Vec<WorkingView>,
    /// Index among the posed views, per working view.
    pub ids: Vec<ViewIdx>,
    /// Normalised images of the epipolar search.
    pub details: Vec<DetailImage>,
    /// Cells per view.
    pub grids: Vec<Grid>,
    /// Range of inverse depth per view and cell.
    pub ranges: Vec<CellRanges>,
    /// Views that each view is compared with, ascending.
    pub neighbours: Vec<Vec<usize>>,
    /// Sparse points in the world that each view sees.
    pub points: Vec<Vec<Point3<f64>>>,
    /// Criteria of growing.
    pub grow: GrowOptions,
}

/// Working views with cells and ranges; `None`, with the reason among the facts, where anchors
/// cannot be had.
pub(super) fn prepare<'a>(
    photos: &'a PhotoSet,
    posed: &'a PosedViews,
    options: &'a AnchorOptions,
    memory: Option<u64>,
    facts: &mut Facts,
    observer: &dyn Observer,
) -> Result<Option<Scene<'a>>, PosesError> {
    let at_once = num_at_once(photos, memory);
    let bytes = memory.map_or(IMAGE_BYTES, |memory| (memory / 3) as usize);
    let held = AtomicUsize::new(0);
    let loaded = map_few_at_once(&posed.views, at_once, |view| {
        let mut working = load(photos, view, options)?;
        if let Some(working) = &mut working {
            // What does not fit is loaded again when its turn comes.
            let size = working.image_bytes();
            if held.fetch_add(size, Ordering::Relaxed) + size > bytes {
                working.texels = Vec::new();
            }
        }
        Ok::<_, PosesError>(working)
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
        facts.warn(observer, message)?;
        return Ok(None);
    }
    let without_mask = views.iter().filter(|view| !view.has_mask).count();
    if without_mask > 0 {
        facts.unmasked_views = without_mask;
        let message = format!(
            "{without_mask} of {} views have no mask: anchors cover everything that they show, background too",
            views.len()
        );
        facts.warn(observer, message)?;
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
        facts.warn(observer, message.to_owned())?;
        return Ok(None);
    };
    let grow = grow_options(options, views.len(), crate::narrow::widest_angle(posed));
    Ok(Some(Scene {
        photos,
        posed,
        at_once,
        bytes,
        options,
        neighbours: neighbours(&views, &grids, &ranges, grow.angles_rad),
        details: vec![DetailImage::default(); views.len()],
        grow,
        views,
        ids,
        grids,
        ranges,
        points,
    }))
}

/// Bytes that working images may take where no memory is given.
const IMAGE_BYTES: usize = 1 << 30;

/// A view made ready; `None` when nothing of the object is in it.
fn load(
    photos: &PhotoSet,
    view: &PosedView,
    options: &AnchorOptions,
) -> Result<Option<WorkingView>, PosesError> {
    let photo = &photos.photos[view.photo.0];
    let image = photo.linear()?;
    Ok(WorkingView::new(
        photo,
        view,
        &image,
        options.max_working_mpx,
    ))
}

impl Scene<'_> {
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
            load(self.photos, &self.posed.views[self.ids[v].0], self.options)
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

/// Criteria of seeds and growing.
fn grow_options(
    options: &AnchorOptions,
    num_views: usize,
    widest_angle_rad: Option<f64>,
) -> GrowOptions {
    let smallest = options.min_source_angle_deg.to_radians();
    GrowOptions {
        patch: PatchOptions {
            radius_px: options.patch_radius_px,
            max_num_iterations: 8,
            gain_sigma: options.gain_sigma,
            slope_sigma: 0.5,
            min_correlation: options.min_correlation,
            robust_scale: 2.5,
            min_num_sources: 2.min(num_views - 1),
            max_move_px: 4.0,
        },
        seed_correlation: options.seed_correlation,
        lone_correlation: 0.9,
        max_jump_px: 2.0,
        max_seed_jump_px: 4.0,
        max_spread_px: 0.7,
        max_sigma_px: 0.3,
        max_tilt: 4.0,
        angles_rad: (
            widest_angle_rad.map_or(smallest, |widest| smallest.min(0.25 * widest)),
            options.max_source_angle_deg.to_radians(),
        ),
    }
}
