//! Depth anchors: points on the object whose depth the photos determine without shading.
//!
//! They hold the low frequencies of the shape; shading holds the fine ones. A plain object has few
//! keypoints, but under one static light the shading pattern of a matte surface is itself texture,
//! only weak, and it lies still on the object while the camera moves.
//!
//! # Steps
//! 1. Photos to log images without distortion, cropped to the mask (`working`).
//! 2. Range of depth per cell from the other masks (`grid`).
//! 3. Seeds by epipolar search in all sources at once (`sweep`), and the sparse points.
//! 4. Alignment of patches over inverse depth and slopes (`patch`, `sampling`, `elimination`), what
//!    exposure did between the photos (`exposure`), growing over the surface from the seeds (`grow`).
//!    Views are independent: they run in parallel, each with its neighbours (`neighbours`) only, in groups whose
//!    images fit into memory together (`prepare`).
//! 5. What other views say of each patch (`check`); noise factor, combination and belief (`judge`).
//! 6. One anchor per surface point with all its views (`merge`).
//!
//! # Why here
//! Anchors need photos and poses and give tracks with covariance, as stage 3 does; a stage of its
//! own would only add a copy of the poses. Keypoints are not needed: at a plain spot nothing is
//! detected, but it can be compared along the epipolar line all the same.
//!
//! # Sources
//! Patches with slopes over several views, grown best first: Furukawa and Ponce 2010. Elimination of
//! gain and offset: variable projection, Golub and Pereyra 1973. Departure: seeds come from a search
//! over all sources, not from keypoint matches; it needs no detector and no pairwise links.

mod check;
mod cover;
mod elimination;
mod exposure;
mod filter;
mod grid;
mod grow;
mod judge;
mod merge;
mod neighbours;
pub(crate) mod options;
mod pair;
mod patch;
mod plane;
mod prepare;
pub(crate) mod report;
mod sampling;
mod sweep;
#[cfg(test)]
mod tests;
mod working;

pub use options::AnchorOptions;
pub use report::{AnchorReport, ViewAnchors};

use crate::error::PosesError;
use cover::cover;
use grow::Node;
use judge::{all_supports, judge, noise_factor};
use merge::merge;
use prepare::{Working, prepare};
use rayon::prelude::*;
use rilievo_scene::{Anchor, DividedStep, Flow, Observer, PhotoSet, PosedViews, StageId};

/// Distance within which another view's patch predicts, in units of the grid's spacing.
const SUPPORT_RADIUS: f64 = 1.5;

/// Finds the depth anchors of posed views. Images take about `memory` bytes at most, which changes
/// no result. Too few views, no overlap or no contrast give an empty result with a warning.
///
/// # Errors
/// When an option is out of range, a photo cannot be read, or the observer asked to stop.
pub fn find(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &AnchorOptions,
    memory: Option<u64>,
    observer: &dyn Observer,
) -> Result<(Vec<Anchor>, AnchorReport), PosesError> {
    find_at(photos, posed, options, Working::default(), memory, observer)
}

/// The same at another size of images and patches.
fn find_at(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &AnchorOptions,
    working: Working,
    memory: Option<u64>,
    observer: &dyn Observer,
) -> Result<(Vec<Anchor>, AnchorReport), PosesError> {
    options.validate()?;
    posed.check_with(photos)?;
    if observer.flow() == Flow::Stop {
        return Err(PosesError::Interrupted);
    }
    let mut report = AnchorReport::default();
    let prepared = prepare(photos, posed, options, working, memory, observer)?;
    report.unmasked_views = prepared.unmasked_views;
    let anchors = match prepared.scene {
        Some(scene) => aligned(scene, &mut report, observer)?,
        None => Vec::new(),
    };
    if anchors.is_empty() && !prepared.warned {
        let message = "no depth anchors: nothing on the object matches between the views; take photos closer together, or light it so that its shading shows";
        crate::error::warn(observer, message.to_owned())?;
    }
    report.count(photos, posed, &anchors);
    Ok((anchors, report))
}

/// Anchors by patch alignment.
fn aligned(
    mut scene: prepare::AnchorScene<'_>,
    report: &mut AnchorReport,
    observer: &dyn Observer,
) -> Result<Vec<Anchor>, PosesError> {
    let num_views = scene.views.len();
    let step = DividedStep::new(observer, StageId::Poses, "growing anchors");
    let mut nodes: Vec<Vec<Option<Node>>> = Vec::with_capacity(num_views);
    for group in scene.groups() {
        scene.hold(group.clone())?;
        let interrupted = || PosesError::Interrupted;
        let step = step.after(group.start).of(num_views);
        nodes.extend(step.run(group.len(), usize::MAX, interrupted, |k| {
            Ok(cover(&scene, group.start + k))
        })?);
    }
    scene.hold(0..0)?;
    let (views, grids) = (&scene.views, &scene.grids);
    let radius_px = SUPPORT_RADIUS * grids[0].spacing as f64;
    let lists = all_supports(views, &scene.neighbours, grids, &nodes, radius_px);
    report.noise_factor = noise_factor(&nodes, &lists);
    report.add_patches(&nodes);
    let estimates: Vec<Vec<_>> = (0..num_views)
        .into_par_iter()
        .map(|view| {
            let focal_px = views[view].camera.focal();
            judge(
                view,
                focal_px,
                &grids[view],
                &nodes,
                &lists,
                report.noise_factor,
            )
        })
        .collect();
    let estimates = estimates.into_iter().flatten().collect();
    Ok(merge(views, &scene.ids, grids, &nodes, estimates))
}
