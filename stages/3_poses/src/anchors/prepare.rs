//! What all views share before any patch is aligned: working images, cells, ranges of depth.

use super::grid::{CellRanges, Grid, depth_ranges, grid_spacing};
use super::grow::GrowOptions;
use super::options::AnchorOptions;
use super::patch::PatchOptions;
use super::report::Facts;
use super::sweep::DetailImage;
use super::working::WorkingView;
use crate::error::PosesError;
use crate::loading::map_few_at_once;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::{Observer, PhotoSet, PosedViews, ViewIdx};

/// What every view needs of the whole scene.
pub(super) struct Scene<'a> {
    /// Options as given.
    pub options: &'a AnchorOptions,
    /// Views with the object in them.
    pub views: Vec<WorkingView>,
    /// Index among the posed views, per working view.
    pub ids: Vec<ViewIdx>,
    /// Normalised images of the epipolar search.
    pub details: Vec<DetailImage>,
    /// Cells per view.
    pub grids: Vec<Grid>,
    /// Range of inverse depth per view and cell.
    pub ranges: Vec<CellRanges>,
    /// Sparse points in the world with the posed views that see them.
    pub points: Vec<(Point3<f64>, Vec<ViewIdx>)>,
    /// Criteria of growing.
    pub grow: GrowOptions,
}

/// Working views with cells and ranges; `None`, with the reason among the facts, where anchors
/// cannot be had.
pub(super) fn prepare<'a>(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &'a AnchorOptions,
    facts: &mut Facts,
    observer: &dyn Observer,
) -> Result<Option<Scene<'a>>, PosesError> {
    let loaded = map_few_at_once(&posed.views, |view| {
        let photo = &photos.photos[view.photo.0];
        let image = photo.linear()?;
        Ok::<_, PosesError>(WorkingView::new(
            photo,
            view,
            &image,
            options.max_working_mpx,
        ))
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
    let points: Vec<(Point3<f64>, Vec<ViewIdx>)> = posed
        .points
        .iter()
        .map(|point| {
            let seen = point.track.iter().map(|sighting| sighting.view).collect();
            (Point3::from(point.position), seen)
        })
        .collect();
    let positions: Vec<Point3<f64>> = points.iter().map(|p| p.0).collect();
    let spacing = grid_spacing(&views, options.spacing_px);
    let grids: Vec<Grid> = views.iter().map(|view| Grid::new(view, spacing)).collect();
    let Some(ranges) = depth_ranges(&views, &grids, &positions) else {
        let message = "no depth anchors: neither masks nor sparse points tell where the object is; give masks";
        facts.warn(observer, message.to_owned())?;
        return Ok(None);
    };
    let details = views
        .par_iter()
        .map(|view| DetailImage::new(view, if spacing < 12 { 2 } else { 4 }))
        .collect();
    Ok(Some(Scene {
        options,
        grow: grow_options(options, views.len(), crate::narrow::widest_angle(posed)),
        views,
        ids,
        details,
        grids,
        ranges,
        points,
    }))
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
