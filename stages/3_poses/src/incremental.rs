//! Incremental reconstruction.
//!
//! Start from a pair; then, while photos can be added: take the photo whose visible points are
//! most and best spread (Schönberger and Frahm, CVPR 2016, section 4.2), resect it, triangulate
//! what it adds, adjust. Small models are adjusted as a whole after every photo; large ones
//! locally, and as a whole whenever they have grown by a quarter: then the cost of a photo does not
//! depend on how many there are, and that of all adjustments of the whole is a few times the last's.

use crate::adjustment::{AdjustedCamera, BundleOptions};
use crate::consistency;
use crate::error::PosesError;
use crate::initial_pair::{self, InitialPair};
use crate::matched::{CameraPrior, MatchedPhotos};
use crate::model::{AdjustmentScope, IntrinsicsScope, Model};
use crate::options::PosesOptions;
use crate::projection::{CenteredPose, K1};
use crate::ranking::{MIN_NUM_VISIBLE_POINTS, Ranking};
use crate::report::{AdjustmentReport, ContradictedFocal, LensReport};
use crate::resection::resect;
use crate::triangulation::{MIN_TRIANGULATION_ANGLE_DEG, TriangulationLimits};
use rilievo_scene::{Observer, RigidTransform, StageId};

/// Up to this many views every adjustment covers all of them.
const MAX_NUM_VIEWS_ALWAYS_GLOBAL: usize = 20;
/// Growth after which a larger model is adjusted as a whole again; less costs time, more lets errors
/// add up that the next adjustment has farther to go for.
const GLOBAL_AFTER_GROWTH: f64 = 1.25;
/// An adjustment of a whole large model takes sightings with errors up to this many times the
/// allowed one.
const DRIFT: f64 = 5.0;
/// Views of a local adjustment besides the new one.
const NUM_LOCAL_VIEWS: usize = 6;
/// Initial pairs that are tried before a model is given up.
const MAX_NUM_INITIAL_PAIRS: usize = 6;
/// Views that distinguish a focal length from a motion along the axis.
pub(crate) const MIN_NUM_VIEWS_FOR_INTRINSICS: usize = 3;
/// Views from which lens distortion can be told from the shape of the scene.
pub(crate) const MIN_NUM_VIEWS_FOR_DISTORTION: usize = 4;
/// Least relative drop of the cost for which distortion is adopted: noise alone lowers it by the
/// number of its coefficients over that of the observations, far less.
const MIN_COST_DROP_FOR_DISTORTION: f64 = 0.03;

/// Limits of a triangulated point under the options.
pub(crate) fn limits(options: &PosesOptions) -> TriangulationLimits {
    TriangulationLimits {
        max_error_px: options.max_reprojection_error_px,
        min_angle_rad: MIN_TRIANGULATION_ANGLE_DEG.to_radians(),
    }
}

/// A model with what led to it.
pub(crate) struct Reconstruction {
    pub model: Model,
    pub initial_pair: Option<(usize, usize)>,
    pub adjustments: Vec<AdjustmentReport>,
    /// Photos that failed, with the number of known points that they see and of those that agreed.
    pub failed: Vec<(usize, usize, usize)>,
    /// Photos whose poses contradicted their matches, in the order found.
    pub contradicting: Vec<usize>,
    /// Distortion that given intrinsics leave, where the poses allow for it.
    pub lens: Option<LensReport>,
    /// The given focal length, where the photos contradict it.
    pub contradicted_focal: Option<ContradictedFocal>,
}

impl From<Model> for Reconstruction {
    fn from(model: Model) -> Self {
        Self {
            model,
            initial_pair: None,
            adjustments: Vec::new(),
            failed: Vec::new(),
            contradicting: Vec::new(),
            lens: None,
            contradicted_focal: None,
        }
    }
}

/// Reconstructs as many of the available photos as possible in one model.
///
/// # Errors
/// When there is no pair to start from, an adjustment breaks down, or the observer asked to stop.
pub(crate) fn reconstruct(
    matched: &MatchedPhotos<'_>,
    available: &[bool],
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Reconstruction, PosesError> {
    let pairs = initial_pair::candidates(matched, available)?;
    let wanted = available.iter().filter(|&&a| a).count();
    let mut best: Option<Reconstruction> = None;
    let (mut num_tried, mut most_points) = (0, 0);
    for pair in pairs.iter().take(MAX_NUM_INITIAL_PAIRS) {
        // A pair that is part of a good model already would lead to the same one.
        let covered = |m: &Reconstruction| {
            m.model.poses[pair.first].is_some() && m.model.poses[pair.second].is_some()
        };
        if best.as_ref().is_some_and(covered) {
            continue;
        }
        num_tried += 1;
        let grown = match grow(matched, pair, available, options, observer)? {
            Grown::Model(grown) => *grown,
            Grown::Collapsed { num_points } => {
                most_points = most_points.max(num_points);
                continue;
            }
        };
        let size = grown.model.num_views();
        if best.as_ref().is_none_or(|b| b.model.num_views() < size) {
            best = Some(grown);
        }
        if 2 * size >= wanted {
            break;
        }
    }
    best.ok_or(PosesError::NoStableStart {
        num_pairs: num_tried,
        best_points: most_points,
        needed_points: MIN_NUM_VISIBLE_POINTS,
    })
}

/// What became of a pair.
enum Grown {
    Model(Box<Reconstruction>),
    /// Too few points stayed.
    Collapsed {
        num_points: usize,
    },
}

/// Grows a model from a pair, where the pair itself holds.
fn grow(
    matched: &MatchedPhotos<'_>,
    pair: &InitialPair,
    available: &[bool],
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Grown, PosesError> {
    let limits = limits(options);
    let mut model = Model::empty(matched);
    model.poses[pair.first] = Some(CenteredPose::from(RigidTransform::identity()));
    model.poses[pair.second] = Some(CenteredPose::from(pair.pose.second_from_first));
    let mut adjustments = Vec::new();
    model.triangulate_all(matched, &limits);
    let num_points = model.num_points();
    if num_points < MIN_NUM_VISIBLE_POINTS {
        return Ok(Grown::Collapsed { num_points });
    }
    for _ in 0..2 {
        adjustments.push(adjust_all(&mut model, matched)?);
        model.triangulate_all(matched, &limits);
    }
    let num_points = model.num_points();
    if num_points < MIN_NUM_VISIBLE_POINTS {
        return Ok(Grown::Collapsed { num_points });
    }
    let mut grown = Reconstruction {
        initial_pair: Some((pair.first, pair.second)),
        adjustments,
        ..model.into()
    };
    extend(matched, &mut grown, available, options, observer)?;
    // A photo that was deceived by repeated texture gets a second chance among the others.
    let max_error_px = 3.0 * options.max_reprojection_error_px;
    let mut available = available.to_vec();
    while grown.model.num_views() > 3
        && let Some(photo) = consistency::contradicting(matched, &grown.model, max_error_px)
    {
        if !consistency::expel(matched, &mut grown.model, photo, &limits) {
            return Ok(Grown::Collapsed { num_points: 0 });
        }
        available[photo] = !grown.contradicting.contains(&photo);
        grown.contradicting.push(photo);
        extend(matched, &mut grown, &available, options, observer)?;
    }
    Ok(Grown::Model(Box::new(grown)))
}

/// Registers photos one after the other, the best seen first, until none is left that can be.
fn extend(
    matched: &MatchedPhotos<'_>,
    grown: &mut Reconstruction,
    available: &[bool],
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<(), PosesError> {
    let limits = limits(options);
    let Reconstruction {
        model,
        adjustments,
        failed,
        ..
    } = grown;
    let mut num_at_last_global = model.num_views();
    let mut ranking = Ranking::new(matched.num_photos());
    let all_photos: Vec<usize> = (0..matched.num_photos()).collect();
    // Where a large model meets itself again, errors that added up on the way part it: let both sides of the seam
    // pull at each other.
    let drifted = TriangulationLimits {
        max_error_px: DRIFT * limits.max_error_px,
        ..limits
    };
    loop {
        let flow = observer.progress(
            StageId::Poses,
            "registering photos",
            (model.num_views(), available.iter().filter(|&&a| a).count()),
        );
        flow.ok_or(PosesError::Interrupted)?;
        // A photo that failed is tried again once the model has grown.
        let candidates = ranking.next_views(matched, model, available, failed);
        let mut registered = None;
        for photo in candidates {
            match register(matched, model, photo, options) {
                Ok(pose) => {
                    model.poses[photo] = Some(pose);
                    registered = Some(photo);
                    break;
                }
                Err((num_visible, num_inliers)) => {
                    failed.retain(|f| f.0 != photo);
                    failed.push((photo, num_visible, num_inliers));
                }
            }
        }
        let Some(photo) = registered else { break };
        failed.retain(|f| f.0 != photo);
        // What does not hang on a pose that changed stays as it is.
        let mut renew = |model: &mut Model, photos: &[usize], limits: &TriangulationLimits| {
            let changed = model.triangulate(matched, &matched.tracks_of_any(photos), limits);
            ranking.renew(matched, &changed);
        };
        renew(model, &[photo], &limits);
        let num_views = model.num_views();
        let is_due = num_views as f64 >= GLOBAL_AFTER_GROWTH * num_at_last_global as f64;
        if num_views <= MAX_NUM_VIEWS_ALWAYS_GLOBAL || is_due {
            if num_views > MAX_NUM_VIEWS_ALWAYS_GLOBAL {
                renew(model, &all_photos, &drifted);
            }
            adjustments.push(adjust_all(model, matched)?);
            adjustments.extend(try_full_intrinsics(model, matched)?);
            num_at_last_global = num_views;
            renew(model, &all_photos, &limits);
        } else {
            let mut local = neighbors(matched, model, photo);
            local.push(photo);
            let scope = AdjustmentScope {
                step: "local",
                photos: Some(&local),
                intrinsics: IntrinsicsScope::Fixed,
            };
            adjustments.push(model.adjust(matched, &scope, &BundleOptions::growing())?);
            renew(model, &local, &limits);
        }
    }
    Ok(())
}

/// Goes on with a model whose cameras have become better: its points anew, and photos that have no pose yet.
pub(crate) fn go_on(
    matched: &MatchedPhotos<'_>,
    reconstruction: &mut Reconstruction,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<(), PosesError> {
    let settled = settle(&mut reconstruction.model, matched, options)?;
    reconstruction.adjustments.extend(settled);
    // They failed with the cameras before.
    reconstruction.failed.clear();
    let mut available = vec![true; matched.num_photos()];
    for &photo in &reconstruction.contradicting {
        available[photo] = reconstruction.model.poses[photo].is_some();
    }
    extend(matched, reconstruction, &available, options, observer)
}

/// Registers photos that have no pose yet, the best seen first, while all others stay where they are: only the new
/// photo, its camera where that is not given, and its points are adjusted.
pub(crate) fn extend_around(
    matched: &MatchedPhotos<'_>,
    around: &mut Reconstruction,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<(), PosesError> {
    let limits = limits(options);
    let available = vec![true; matched.num_photos()];
    let mut ranking = Ranking::new(matched.num_photos());
    loop {
        let Reconstruction {
            model,
            adjustments,
            failed,
            ..
        } = around;
        let done = (model.num_views(), matched.num_photos());
        let flow = observer.progress(StageId::Poses, "registering photos", done);
        flow.ok_or(PosesError::Interrupted)?;
        let candidates = ranking.next_views(matched, model, &available, failed);
        let Some(&photo) = candidates.first() else {
            return Ok(());
        };
        failed.retain(|f| f.0 != photo);
        match register(matched, model, photo, options) {
            Ok(pose) => model.poses[photo] = Some(pose),
            Err((num_visible, num_inliers)) => {
                failed.push((photo, num_visible, num_inliers));
                continue;
            }
        }
        let tracks = matched.tracks_of_any(&[photo]);
        let mut changed = model.triangulate(matched, &tracks, &limits);
        for _ in 0..2 {
            let scope = AdjustmentScope {
                step: "a photo among given ones",
                photos: Some(&[photo]),
                intrinsics: IntrinsicsScope::Focal,
            };
            adjustments.push(model.adjust(matched, &scope, &BundleOptions::complete(1e-6))?);
            changed.extend(model.triangulate(matched, &tracks, &limits));
        }
        ranking.renew(matched, &changed);
    }
}

/// What may change: the focal length once enough views hold it, distortion once it was adopted.
pub(crate) fn intrinsics_scope(model: &Model) -> IntrinsicsScope {
    let bent = |c: &AdjustedCamera| c.deviation[K1..].iter().any(|&d| d != 0.0);
    if model.num_views() < MIN_NUM_VIEWS_FOR_INTRINSICS {
        IntrinsicsScope::Fixed
    } else if model.cameras.iter().any(bent) {
        IntrinsicsScope::All
    } else {
        IntrinsicsScope::Focal
    }
}

/// Tries a model with all intrinsics free, and adopts it where the residuals fall clearly.
///
/// A lens without distortion keeps exactly none: free coefficients would only fit noise.
pub(crate) fn try_full_intrinsics(
    model: &mut Model,
    matched: &MatchedPhotos<'_>,
) -> Result<Option<AdjustmentReport>, PosesError> {
    let more = |c: &CameraPrior| c.prior_sigma[K1..].iter().any(Option::is_some);
    if intrinsics_scope(model) != IntrinsicsScope::Focal
        || model.num_views() < MIN_NUM_VIEWS_FOR_DISTORTION
        || !matched.cameras.iter().any(more)
    {
        return Ok(None);
    }
    let scope = |intrinsics| AdjustmentScope::all("with distortion", intrinsics);
    let mut plain = model.clone();
    let before = plain.adjust(
        matched,
        &scope(IntrinsicsScope::Focal),
        &BundleOptions::growing(),
    )?;
    let mut full = model.clone();
    let after = full.adjust(
        matched,
        &scope(IntrinsicsScope::All),
        &BundleOptions::growing(),
    )?;
    let clearly_better =
        after.solve.final_cost < (1.0 - MIN_COST_DROP_FOR_DISTORTION) * before.solve.final_cost;
    Ok(clearly_better.then(|| {
        *model = full;
        after
    }))
}

/// Points anew and an adjustment of the whole model, twice: each follows the other.
pub(crate) fn settle(
    model: &mut Model,
    matched: &MatchedPhotos<'_>,
    options: &PosesOptions,
) -> Result<[AdjustmentReport; 2], PosesError> {
    let mut once = || {
        model.triangulate_all(matched, &limits(options));
        adjust_all(model, matched)
    };
    Ok([once()?, once()?])
}

/// Robust adjustment of the whole model.
pub(crate) fn adjust_all(
    model: &mut Model,
    matched: &MatchedPhotos<'_>,
) -> Result<AdjustmentReport, PosesError> {
    let scope = AdjustmentScope::all("global", intrinsics_scope(model));
    model.adjust(matched, &scope, &BundleOptions::growing())
}

/// Pose of a photo, or the numbers of points that it sees and that agreed.
fn register(
    matched: &MatchedPhotos<'_>,
    model: &Model,
    photo: usize,
    options: &PosesOptions,
) -> Result<CenteredPose, (usize, usize)> {
    let (pixels, points) = model.visible_points(matched, photo);
    let camera = model.cameras[matched.camera_of[photo]].current();
    // Points come from few views yet and intrinsics may be off: be generous here, strict later.
    let max_error_px = 2.0 * options.max_reprojection_error_px;
    let found = resect(
        &camera,
        &pixels,
        &points,
        max_error_px,
        [options.seed, photo as u64],
    );
    let num_inliers = found.as_ref().map_or(0, |f| f.inliers.len());
    let needed = MIN_NUM_VISIBLE_POINTS.max(pixels.len() / 5);
    match found {
        Some(found) if num_inliers >= needed => Ok(found.pose),
        _ => Err((pixels.len(), num_inliers)),
    }
}

/// Posed photos that share most points with a photo.
fn neighbors(matched: &MatchedPhotos<'_>, model: &Model, photo: usize) -> Vec<usize> {
    let mut shared = vec![0_usize; matched.num_photos()];
    for &(track, _) in &matched.tracks_of[photo] {
        if let Some(point) = &model.points[track] {
            for &place in &point.support {
                shared[matched.tracks[track][place].photo] += 1;
            }
        }
    }
    let mut order: Vec<usize> = (0..matched.num_photos())
        .filter(|&p| p != photo && model.poses[p].is_some() && shared[p] > 0)
        .collect();
    order.sort_by(|&a, &b| shared[b].cmp(&shared[a]).then(a.cmp(&b)));
    order.truncate(NUM_LOCAL_VIEWS);
    order
}
