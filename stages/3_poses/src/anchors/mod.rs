//! Depth anchors: points on the object whose depth the photos determine without shading.
//!
//! They hold the low frequencies of the shape; shading holds the fine ones. A plain object has few
//! keypoints, but under one static light the shading pattern of a matte surface is itself texture,
//! only weak, and it lies still on the object while the camera moves.
//!
//! # Steps
//! 1. Photos to log images without distortion, cropped to the mask ([`working`]).
//! 2. Range of depth per cell from the other masks ([`hull`]).
//! 3. Seeds by epipolar search in all sources at once ([`sweep`]), and the sparse points.
//! 4. Alignment of patches over inverse depth and slopes ([`patch`]), what exposure did between the
//!    photos ([`exposure`]), growing over the surface from the seeds ([`grow`]). Views are independent: they run in parallel.
//! 5. What other views say of each patch ([`check`]); noise factor, combination and belief
//!    ([`judge`]).
//! 6. One anchor per surface point with all its views ([`merge`]).
//!
//! `sift` mode takes the sparse points as they are ([`sift`]); `guided` mode leaves out growing.
//!
//! # Why here
//! Anchors need photos and poses and give tracks with covariance, as stage 3 does; a stage of its
//! own would only add a copy of the poses. Keypoints are not needed: at a plain spot nothing is
//! detected, but it can be compared along the epipolar line all the same.
//!
//! # Sources
//! Patches with slopes over several views: Furukawa and Ponce 2010; variable projection of gain and
//! offset: Evangelidis and Psarakis 2008. Departure: seeds come from a search over all sources, not
//! from keypoint matches (measured: three to ten times as many on plain objects).

mod check;
mod elimination;
mod exposure;
mod filter;
mod grow;
mod hull;
mod judge;
mod merge;
mod options;
mod pair;
mod patch;
mod report;
mod sampling;
mod sift;
mod sweep;
#[cfg(test)]
mod tests;
mod working;

pub use options::{AnchorMode, AnchorOptions};
pub use report::{AnchorReport, ViewAnchors};

use crate::error::PosesError;
use exposure::learn_offsets;
use grow::{GrowOptions, Node, Reference, Seed, grow, plant};
use hull::{Grid, bounding_ball, depth_ranges, grid_spacing, widened_masks};
use judge::{JudgeOptions, all_supports, judge, noise_factor};
use merge::merge;
use nalgebra::Point3;
use pair::PairGeometry;
use patch::PatchOptions;
use rayon::prelude::*;
use report::Facts;
use rilievo_scene::{
    Anchor, AnchorOrigin, Event, FeatureMatches, Flow, Mask, Observer, PhotoSet, PosedViews,
    StageId, ViewIdx,
};
use sampling::Workspace;
use std::sync::atomic::{AtomicUsize, Ordering};
use sweep::{DetailImage, SweepOptions, SweepScratch, search, search_cells};
use working::WorkingView;

/// Finds the depth anchors of posed views. Too few views, no overlap or no contrast give an empty
/// result with a warning in the report.
///
/// # Errors
/// When an option is out of range, a photo cannot be read, or the observer asked to stop.
pub fn find(
    photos: &PhotoSet,
    _matches: &FeatureMatches,
    posed: &PosedViews,
    options: &AnchorOptions,
    observer: &dyn Observer,
) -> Result<(Vec<Anchor>, AnchorReport), PosesError> {
    options.validate()?;
    if observer.flow() == Flow::Stop {
        return Err(PosesError::Interrupted);
    }
    let (anchors, facts) = match options.mode {
        AnchorMode::Sift => {
            let anchors = posed
                .points
                .iter()
                .filter_map(|point| sift::sift_anchor(photos, posed, point, options))
                .collect();
            (anchors, Facts::default())
        }
        AnchorMode::Guided | AnchorMode::Grown => aligned(photos, posed, options, observer)?,
    };
    let report = report::report(photos, posed, options.mode, &anchors, facts);
    for message in &report.warnings {
        let warning = Event::Warning {
            stage: StageId::Poses,
            message: message.clone(),
        };
        if observer.event(warning) == Flow::Stop {
            return Err(PosesError::Interrupted);
        }
    }
    Ok((anchors, report))
}

/// Criteria of the epipolar search; the ratio is that of keypoint matching.
const SWEEP: SweepOptions = SweepOptions {
    min_score: 0.5,
    ratio: 0.8,
};

/// What every view needs of the whole scene.
struct Scene<'a> {
    options: &'a AnchorOptions,
    views: Vec<WorkingView>,
    /// Index among the posed views, per working view.
    ids: Vec<ViewIdx>,
    details: Vec<DetailImage>,
    grids: Vec<Grid>,
    /// Range of inverse depth per view and cell.
    ranges: Vec<Vec<Option<(f64, f64)>>>,
    /// Sparse points in the world with the posed views that see them.
    points: Vec<(Point3<f64>, Vec<ViewIdx>)>,
    grow: GrowOptions,
}

/// Anchors by patch alignment.
fn aligned(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &AnchorOptions,
    observer: &dyn Observer,
) -> Result<(Vec<Anchor>, Facts), PosesError> {
    let mut facts = Facts::default();
    let Some(scene) = prepare(photos, posed, options, &mut facts)? else {
        return Ok((Vec::new(), facts));
    };
    let num_views = scene.views.len();
    let done = AtomicUsize::new(0);
    let nodes: Vec<Vec<Option<Node>>> = (0..num_views)
        .into_par_iter()
        .map(|reference| {
            if observer.flow() == Flow::Stop {
                return Err(PosesError::Interrupted);
            }
            let nodes = cover(&scene, reference);
            let progress = Event::Progress {
                stage: StageId::Poses,
                step: "growing anchors".into(),
                done: done.fetch_add(1, Ordering::Relaxed) + 1,
                total: num_views,
            };
            match observer.event(progress) {
                Flow::Continue => Ok(nodes),
                Flow::Stop => Err(PosesError::Interrupted),
            }
        })
        .collect::<Result<_, _>>()?;
    let spacing = scene.grids[0].spacing as f64;
    let judge_options = JudgeOptions {
        radius_px: 1.5 * spacing,
        max_doubt_px: options.max_doubt_px,
        dense: options.mode == AnchorMode::Grown,
    };
    let lists = all_supports(&scene.views, &scene.grids, &nodes, judge_options.radius_px);
    let factor = noise_factor(&nodes, &lists);
    let estimates: Vec<_> = (0..num_views)
        .into_par_iter()
        .map(|view| {
            judge(
                view,
                scene.views[view].focal(),
                &scene.grids[view],
                &nodes,
                &lists,
                factor,
                &judge_options,
            )
        })
        .collect::<Vec<_>>()
        .into_iter()
        .flatten()
        .collect();
    facts.noise_factor = factor;
    facts.add_patches(&nodes);
    let anchors = merge(&scene.views, &scene.ids, &scene.grids, &nodes, estimates);
    Ok((anchors, facts))
}

/// Working views with cells and ranges; `None`, with the reason among the facts, where anchors
/// cannot be had.
fn prepare<'a>(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &'a AnchorOptions,
    facts: &mut Facts,
) -> Result<Option<Scene<'a>>, PosesError> {
    let loaded: Vec<Option<WorkingView>> = posed
        .views
        .par_iter()
        .map(|view| {
            let photo = &photos.photos[view.photo.0];
            let image = photo.pixels.load()?;
            Ok(WorkingView::new(
                photo,
                view,
                &image,
                options.max_working_mpx,
            ))
        })
        .collect::<Result<_, PosesError>>()?;
    let (mut ids, mut views) = (Vec::new(), Vec::new());
    for (idx, view) in loaded.into_iter().enumerate() {
        if let Some(view) = view {
            ids.push(ViewIdx(idx));
            views.push(view);
        }
    }
    if views.len() < 2 {
        facts.warn(format!(
            "no depth anchors: {} view(s) with a pose and the object in it, at least 2 are needed",
            views.len()
        ));
        return Ok(None);
    }
    let without_mask = views.iter().filter(|view| !view.has_mask).count();
    if without_mask > 0 {
        facts.unmasked_views = without_mask;
        facts.warn(format!(
            "{without_mask} of {} views have no mask: anchors cover everything that they show, background too",
            views.len()
        ));
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
    let Some(ball) = bounding_ball(&views, &positions) else {
        facts.warn(
            "no depth anchors: neither masks nor sparse points tell where the object is; give masks"
                .into(),
        );
        return Ok(None);
    };
    let spacing = grid_spacing(&views, options.spacing_px);
    let grids: Vec<Grid> = views.iter().map(|view| Grid::new(view, spacing)).collect();
    let masks: Vec<Option<Mask>> = widened_masks(&views);
    let ranges = (0..views.len())
        .into_par_iter()
        .map(|view| depth_ranges(&views, view, &grids[view], &ball, &masks))
        .collect();
    let details = views
        .par_iter()
        .map(|view| DetailImage::new(view, if spacing < 12 { 2 } else { 4 }))
        .collect();
    Ok(Some(Scene {
        options,
        grow: grow_options(options, views.len()),
        views,
        ids,
        details,
        grids,
        ranges,
        points,
    }))
}

/// Criteria of seeds and growing.
fn grow_options(options: &AnchorOptions, num_views: usize) -> GrowOptions {
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
            options.min_source_angle_deg.to_radians(),
            options.max_source_angle_deg.to_radians(),
        ),
    }
}

/// Seeds and, in `grown` mode, growing in one view.
fn cover(scene: &Scene<'_>, index: usize) -> Vec<Option<Node>> {
    let (view, grid) = (&scene.views[index], &scene.grids[index]);
    let ranges = &scene.ranges[index];
    let mut pairs: Vec<PairGeometry> = (0..scene.views.len())
        .filter(|&source| source != index)
        .map(|source| PairGeometry::new(view, source, &scene.views[source]))
        .collect();
    let mut nodes = vec![None; grid.len()];
    let mut ws = Workspace::default();
    let mut scratch = SweepScratch::default();
    let mut seeds = seeds_of_points(scene, index);
    // Searching costs most: what growing has covered from few seeds need not be searched.
    for stride in [4, 2] {
        let reference = Reference {
            views: &scene.views,
            index,
            pairs: &pairs,
            grid,
            ranges,
        };
        for cell in search_cells(grid, stride) {
            if nodes[cell].is_none() {
                seeds.extend(seed_of_search(&reference, scene, cell, &mut scratch));
            }
        }
        plant(
            &reference,
            &seeds,
            AnchorOrigin::Guided,
            &scene.grow,
            &mut nodes,
            &mut ws,
        );
        seeds.clear();
        if scene.options.mode == AnchorMode::Grown {
            // Later patches have been held to the prior: they would only confirm it.
            if pairs.iter().all(|pair| pair.offset.is_none()) {
                learn_offsets(&mut pairs, &nodes);
            }
            let reference = Reference {
                views: &scene.views,
                index,
                pairs: &pairs,
                grid,
                ranges,
            };
            grow(&reference, &scene.grow, &mut nodes, &mut ws);
        }
    }
    nodes
}

/// The depth of a cell by epipolar search.
fn seed_of_search(
    reference: &Reference<'_>,
    scene: &Scene<'_>,
    cell: usize,
    scratch: &mut SweepScratch,
) -> Option<Seed> {
    let range = reference.ranges[cell]?;
    let (x, y) = reference.grid.pixel(cell);
    let view = &reference.views[reference.index];
    let middle = view.point(x as f64, y as f64, 0.5 * (range.0 + range.1));
    let (sources, count) = reference.sources(&middle, scene.grow.angles_rad);
    let q = search(
        &scene.details,
        reference.index,
        &sources[..count],
        (x, y),
        range,
        &SWEEP,
        scratch,
    )?;
    Some(Seed {
        cell,
        q,
        qx: 0.0,
        qy: 0.0,
    })
}

/// Sparse points on the object that a view sees, as seeds of their cells.
fn seeds_of_points(scene: &Scene<'_>, index: usize) -> Vec<Seed> {
    let (view, grid, id) = (&scene.views[index], &scene.grids[index], scene.ids[index]);
    scene
        .points
        .iter()
        .filter(|(_, seen)| seen.contains(&id))
        .filter_map(|(point, _)| {
            let (x, y, depth) = view.project(point)?;
            let cell = grid.cell(x, y).filter(|_| view.on_object(x, y))?;
            scene.ranges[index][cell]?;
            Some(Seed {
                cell,
                q: 1.0 / depth,
                qx: 0.0,
                qy: 0.0,
            })
        })
        .collect()
}
