//! Whether poses agree with the verified matches of their photos.
//!
//! Of a pair, a match `x₁, x₂` agrees when its Sampson distance from the essential matrix of the two
//! poses is within a limit and its point lies before both cameras. A photo registered on repeated
//! texture, or on the far side of a symmetric object, agrees with the points that deceived it and
//! contradicts most of its other neighbours; its own reprojection errors do not show that.

use crate::adjustment::BundleOptions;
use crate::matched::MatchedPhotos;
use crate::model::{AdjustmentScope, IntrinsicsScope, Model};
use crate::relative_pose::depths;
use crate::triangulation::TriangulationLimits;
use rilievo_scene::{Intrinsics, PairMatches, RigidTransform};

/// Least share of a photo's matches, over all its pairs, that its pose must explain.
pub(crate) const MIN_CONSISTENT_SHARE: f64 = 0.5;
/// Photos with fewer matches cannot be judged.
const MIN_NUM_MATCHES: usize = 20;

/// Number of matches of a pair that two poses explain; `None` without a baseline, where every match
/// of one point does.
pub(crate) fn num_agreeing(
    matched: &MatchedPhotos<'_>,
    pair: &PairMatches,
    [ci, cj]: [&Intrinsics; 2],
    [first, second]: [&RigidTransform; 2],
    max_error_px: f64,
) -> Option<usize> {
    let (i, j) = (pair.first.0, pair.second.0);
    let relative = second.compose(&first.inverse());
    let baseline = relative.translation.norm();
    if baseline <= 1e-12 {
        return None;
    }
    let essential = (relative.translation / baseline).cross_matrix() * relative.rotation_matrix();
    let limit = max_error_px / (0.5 * (ci.focal_px() + cj.focal_px()));
    let agrees = |m: &&[u32; 2]| {
        let x1 = ci.ray(&matched.pixels[i][m[0] as usize]);
        let x2 = cj.ray(&matched.pixels[j][m[1] as usize]);
        let (l2, l1) = (essential * x1, essential.tr_mul(&x2));
        let g = l2.xy().norm_squared() + l1.xy().norm_squared();
        // The epipolar constraint alone also holds for a scene behind the cameras.
        let (depth1, depth2, _) = depths(&relative, &x1.xy().into(), &x2.xy().into());
        x2.dot(&l2).powi(2) <= limit * limit * g && depth1 > 0.0 && depth2 > 0.0
    };
    Some(pair.matches.iter().filter(agrees).count())
}

/// The posed photo that contradicts most of its matches with other posed photos, if any does.
pub(crate) fn contradicting(
    matched: &MatchedPhotos<'_>,
    model: &Model,
    max_error_px: f64,
) -> Option<usize> {
    let cameras = model.intrinsics();
    let mut counts = vec![(0_usize, 0_usize); matched.num_photos()];
    for pair in &matched.matches.pairs {
        let (i, j) = (pair.first.0, pair.second.0);
        let (Some(first), Some(second)) = (model.poses[i], model.poses[j]) else {
            continue;
        };
        let seen_by = [i, j].map(|photo| &cameras[matched.camera_of[photo]]);
        let poses = [&first.into(), &second.into()];
        let agreeing = num_agreeing(matched, pair, seen_by, poses, max_error_px);
        for photo in [i, j] {
            counts[photo].0 += agreeing.unwrap_or(pair.matches.len());
            counts[photo].1 += pair.matches.len();
        }
    }
    let share = |&(agreeing, total): &(usize, usize)| agreeing as f64 / total.max(1) as f64;
    let (photo, worst) = counts
        .iter()
        .enumerate()
        .filter(|(_, c)| c.1 >= MIN_NUM_MATCHES)
        .min_by(|a, b| share(a.1).total_cmp(&share(b.1)))?;
    (share(worst) < MIN_CONSISTENT_SHARE).then_some(photo)
}

/// Takes a photo out of a model and settles the rest; `false` when nothing is left to settle.
pub(crate) fn expel(
    matched: &MatchedPhotos<'_>,
    model: &mut Model,
    photo: usize,
    limits: &TriangulationLimits,
) -> bool {
    model.poses[photo] = None;
    // Points that hung on it are found anew.
    for &(track, _) in &matched.tracks_of[photo] {
        model.points[track] = None;
    }
    let step = "without a photo that contradicts the others";
    let scope = AdjustmentScope::all(step, IntrinsicsScope::Fixed);
    model.triangulate_all(matched, limits);
    model.num_points() > 0
        && model
            .adjust(matched, &scope, &BundleOptions::growing())
            .is_ok()
}
