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
//! `sift` mode takes the sparse points as they are; `guided` mode leaves out growing.
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
mod sift;
mod sweep;
#[cfg(test)]
mod tests;
mod working;

pub use options::{AnchorMode, AnchorOptions};
pub use report::{AnchorReport, ViewAnchors};

use crate::error::PosesError;
use cover::cover;
use grow::Node;
use judge::{JudgeOptions, all_supports, judge, noise_factor};
use merge::merge;
use prepare::prepare;
use rayon::prelude::*;
use report::Facts;
use rilievo_scene::{
    Anchor, DividedStep, FeatureMatches, Flow, Observer, PhotoSet, PosedViews, StageId,
};

/// Finds the depth anchors of posed views; images take `memory` bytes at most, about, which changes no result. Too few views, no overlap or no contrast give an empty
/// result with a warning.
///
/// # Errors
/// When an option is out of range, a photo cannot be read, or the observer asked to stop.
pub fn find(
    photos: &PhotoSet,
    _matches: &FeatureMatches,
    posed: &PosedViews,
    options: &AnchorOptions,
    memory: Option<u64>,
    observer: &dyn Observer,
) -> Result<(Vec<Anchor>, AnchorReport), PosesError> {
    options.validate()?;
    posed.check_with(photos)?;
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
        AnchorMode::Guided | AnchorMode::Grown => {
            aligned(photos, posed, options, memory, observer)?
        }
    };
    if anchors.is_empty() && !facts.warned {
        let message = "no depth anchors: nothing on the object matches between the views; take photos closer together, or light it so that its shading shows";
        crate::error::warn(observer, message.to_owned())?;
    }
    let report = report::report(photos, posed, options.mode, &anchors, facts);
    Ok((anchors, report))
}

/// Anchors by patch alignment.
fn aligned(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &AnchorOptions,
    memory: Option<u64>,
    observer: &dyn Observer,
) -> Result<(Vec<Anchor>, Facts), PosesError> {
    let mut facts = Facts::default();
    let Some(mut scene) = prepare(photos, posed, options, memory, &mut facts, observer)? else {
        return Ok((Vec::new(), facts));
    };
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
    let spacing = scene.grids[0].spacing as f64;
    let judge_options = JudgeOptions {
        radius_px: 1.5 * spacing,
        max_doubt_px: options.max_doubt_px,
        dense: options.mode == AnchorMode::Grown,
    };
    let lists = all_supports(
        &scene.views,
        &scene.neighbours,
        &scene.grids,
        &nodes,
        judge_options.radius_px,
    );
    let factor = noise_factor(&nodes, &lists);
    let estimates: Vec<_> = (0..num_views)
        .into_par_iter()
        .map(|view| {
            judge(
                view,
                scene.views[view].camera.focal(),
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
