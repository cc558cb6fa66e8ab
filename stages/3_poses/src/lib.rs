//! Stage 3: verified matches to camera poses, sparse points and depth anchors.
//!
//! Matches become tracks; a first pair and then one photo after the other get poses
//! (incremental structure from motion), with bundle adjustment throughout; the world is scaled by
//! the reference sphere or by given poses; anchors on the object follow. Intrinsics from a camera
//! file stay bit-identical.

mod adjustment;
pub mod anchors;
mod consistency;
mod error;
mod findings;
mod given;
mod incremental;
mod initial_pair;
mod known_distance;
mod lens;
mod level;
mod matched;
mod model;
mod narrow;
mod options;
mod own_center;
mod own_focal;
mod p3p;
mod projection;
mod ranking;
mod reference;
mod refinement;
mod relative_pose;
mod report;
mod resection;
mod result;
mod scale;
mod tracks;
mod triangulation;
mod vertical;

pub use error::PosesError;
pub use known_distance::{KnownDistance, MarkedPoints};
pub use options::{GivenPoses, PosesOptions, RETIRED_KEYS, ReferenceFrame, RefineIntrinsics};
pub use report::{AdjustmentReport, ContradictedFocal, LensReport, PosesReport, ViewReport};
pub use vertical::{Vertical, VerticalSource};

use adjustment::BundleOptions;
use incremental::Reconstruction;
use matched::MatchedPhotos;
use model::{AdjustmentScope, IntrinsicsScope};
use projection::FOCAL;
use rilievo_scene::{
    FeatureMatches, FocalSource, Observer, PhotoSet, PosedViews, SphereRequest, motion_in_frame,
};
use std::cmp::Reverse;

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 18;

/// Finds the poses of a photo set, its sparse points, its scale and its anchors.
///
/// # Errors
/// When the photos do not determine poses, given poses contradict them, or the observer asked to
/// stop.
pub fn run(
    photos: &PhotoSet,
    matches: &FeatureMatches,
    sphere: Option<&SphereRequest>,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<(PosedViews, PosesReport), PosesError> {
    options.validate()?;
    photos.check()?;
    matches.check(photos)?;
    let num_photos = photos.photos.len();
    if num_photos < 2 {
        return Err(PosesError::TooFewPhotos { num_photos });
    }
    let mut matched = MatchedPhotos::new(photos, matches, options);
    let given = given::poses(photos, options);
    let keeps_given = given.is_some() && options.given_poses == GivenPoses::Keep;
    let (mut reconstruction, other_models) = match &given {
        Some(poses) => {
            let model = given::reconstruct(&mut matched, poses, options, observer)?;
            (model, Vec::new())
        }
        None => {
            let first = largest_model(&matched, options, observer)?;
            let found = larger_from_found_focal(&mut matched, first, options, observer)?;
            let found = with_own_focals(&mut matched, found, options, observer)?;
            with_own_centers(&mut matched, found, options, observer)?
        }
    };
    if !keeps_given {
        finish(&matched, &mut reconstruction, options)?;
    }
    if options.given_poses != GivenPoses::Ignore
        && let Some(message) = given::incomplete(photos, given.is_some())
    {
        error::warn(observer, message)?;
    }
    if !options.matches_only {
        finish_on_patches(
            &matched,
            &mut reconstruction,
            keeps_given,
            options,
            observer,
        )?;
    }
    if !keeps_given {
        lens::check_given_intrinsics(&matched, &mut reconstruction, options)?;
    }
    let (mut posed, mut report) =
        result::assemble(&matched, &reconstruction, &other_models, keeps_given);
    scale::apply(
        photos,
        sphere,
        given.is_some(),
        options,
        &mut posed,
        &mut report,
        observer,
    )?;
    let (object, rest) = vertical::object_and_rest(photos, &posed);
    let vertical = vertical::find(photos, &posed, &rest);
    let ground = vertical.and_then(|(_, ground)| ground);
    report.vertical = vertical.map(|(vertical, _)| vertical);
    if given.is_none() {
        level::apply(
            &object,
            ground.as_ref(),
            &mut posed,
            report.vertical.as_mut(),
        );
    } else {
        posed.frame = options.given_world.frame;
    }
    report.knows_object = object.len() >= level::MIN_OBJECT_POINTS;
    let frame = match &options.reference {
        Some(reference) if given.is_none() => {
            reference::apply(reference, report.knows_object, &mut posed, &mut report)
        }
        Some(reference) if reference.is_asked => {
            let message =
                "the frame of --frame-of is not taken over: the given cameras have their own";
            Some(message.to_owned())
        }
        _ => None,
    };
    for message in warnings(&matched, &reconstruction, &posed, &report, frame) {
        error::warn(observer, message)?;
    }
    if !options.matches_only {
        let (anchors, anchor_report) =
            anchors::find(photos, &posed, &options.anchors, options.memory, observer)?;
        posed.anchors = anchors;
        report.anchors = Some(anchor_report);
    }
    Ok((posed, report))
}

/// What the user should know of the poses, with what became of an earlier `frame`.
fn warnings(
    matched: &MatchedPhotos<'_>,
    reconstruction: &Reconstruction,
    posed: &PosedViews,
    report: &PosesReport,
    frame: Option<String>,
) -> Vec<String> {
    let left_out = posed.unregistered.iter();
    let left_out = left_out.map(|u| format!("{}: {}", u.file_name, u.reason));
    let focal = report.contradicted_focal.iter();
    let focal = focal.map(|focal| focal.finding().sentence());
    let lens = report.lens.iter().map(LensReport::advice);
    lens.chain(focal)
        .chain(contradicted_exif(matched, reconstruction))
        .chain(own_focal::warnings(matched, &reconstruction.model))
        .chain(own_center::warning(matched, &reconstruction.model))
        .chain(narrow::warning(posed))
        .chain(report.same_place_warning())
        .chain(frame)
        .chain(left_out)
        .collect()
}

/// A model with the photos of the others.
type Found = (Reconstruction, Vec<Vec<usize>>);

/// Reconstructs once more where the focal length turned out far from the first guess and photos were
/// left out, which the wrong one may have kept from being posed; the larger model.
fn larger_from_found_focal(
    matched: &mut MatchedPhotos<'_>,
    first: Found,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Found, PosesError> {
    let model = &first.0.model;
    let mut far = false;
    for (camera, adjusted) in matched.cameras.iter_mut().zip(&model.cameras) {
        if is_far(adjusted.deviation[FOCAL]) {
            camera.start_ln_focal = adjusted.deviation[FOCAL];
            far = true;
        }
    }
    if !far || model.num_views() == matched.num_photos() {
        return Ok(first);
    }
    let better = |second: &Found| second.0.model.num_views() > model.num_views();
    Ok(again(matched, better, options, observer)?.unwrap_or(first))
}

/// A model that is reconstructed once more; `None` where that fails or is no better.
fn again(
    matched: &MatchedPhotos<'_>,
    is_better: impl Fn(&Found) -> bool,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Option<Found>, PosesError> {
    match largest_model(matched, options, observer) {
        Ok(second) if is_better(&second) => Ok(Some(second)),
        Err(PosesError::Interrupted) => Err(PosesError::Interrupted),
        _ => Ok(None),
    }
}

/// Reconstructs once more with cameras of their own for photos that were zoomed or cropped, where there are any; the
/// better model.
fn with_own_focals(
    matched: &mut MatchedPhotos<'_>,
    first: Found,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Found, PosesError> {
    // The model stands without what this looks for.
    let own = own_focal::find(matched, &first.0.model, options).unwrap_or_default();
    if own.is_empty() {
        return Ok(first);
    }
    let (num_cameras, camera_of) = (matched.cameras.len(), matched.camera_of.clone());
    own_focal::give_cameras(matched, &first.0.model, &own, options.refine_intrinsics);
    let better = |second: &Found| {
        let num_views = [&first, second].map(|found| found.0.model.num_views());
        let [before, after] = [&first, second].map(|found| {
            let photos = own.iter().map(|own| own.photo);
            photos
                .map(|photo| found.0.model.num_sightings(matched, photo))
                .sum::<usize>()
        });
        num_views[1] >= num_views[0] && after as f64 >= own_focal::MIN_GROWTH * before as f64
    };
    if let Some(second) = again(matched, better, options, observer)? {
        return Ok(second);
    }
    matched.cameras.truncate(num_cameras);
    matched.camera_of = camera_of;
    Ok(first)
}

/// Goes on with principal points beside the middle of the photos, where these explain them clearly better.
fn with_own_centers(
    matched: &mut MatchedPhotos<'_>,
    mut found: Found,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Found, PosesError> {
    // The model stands without what this looks for.
    let own = match own_center::find(matched, &found.0.model, options, observer) {
        Err(PosesError::Interrupted) => return Err(PosesError::Interrupted),
        own => own.unwrap_or_default(),
    };
    let Some(mut own) = own else {
        return Ok(found);
    };
    own.swap(matched);
    std::mem::swap(&mut found.0.model, &mut own.model);
    let num_adjustments = found.0.adjustments.len();
    match incremental::go_on(matched, &mut found.0, options, observer) {
        Ok(()) => {
            let poses = &found.0.model.poses;
            for photos in &mut found.1 {
                photos.retain(|&photo| poses[photo].is_none());
            }
            found.1.retain(|photos| !photos.is_empty());
        }
        Err(PosesError::Interrupted) => return Err(PosesError::Interrupted),
        Err(_) => {
            own.swap(matched);
            found.0.model = own.model;
            found.0.adjustments.truncate(num_adjustments);
        }
    }
    Ok(found)
}

/// Whether a focal length is farther from its start than EXIF's may be when it is right.
fn is_far(ln_focal: f64) -> bool {
    ln_focal.abs() > WRONG_EXIF_SIGMAS * matched::EXIF_FOCAL_SIGMA
}

/// Deviations of a focal length from EXIF's beyond which EXIF must be wrong.
const WRONG_EXIF_SIGMAS: f64 = 4.0;

/// A warning for each camera whose photos contradict the focal length in EXIF.
fn contradicted_exif(matched: &MatchedPhotos<'_>, reconstruction: &Reconstruction) -> Vec<String> {
    let model = &reconstruction.model;
    (0..matched.cameras.len())
        .filter_map(|k| {
            let photo = (0..matched.num_photos())
                .find(|&p| matched.lens_of(p) == k && model.poses[p].is_some())?;
            let photo = &matched.photos.photos[photo];
            let deviation = model.cameras[k].deviation[FOCAL];
            let from_exif = !matched.cameras[k].is_own
                && matches!(
                    photo.focal_source,
                    FocalSource::Exif35mm | FocalSource::ExifSensor
                );
            (from_exif && is_far(deviation)).then(|| {
                format!(
                    "{} and others of its camera: the photos say a focal length of {:.0} px, EXIF {:.0} px ({:+.0} %): cropped photos or another sensor; the photos were believed",
                    photo.file_name,
                    model.cameras[k].current().focal_px(),
                    photo.intrinsics.focal_px(),
                    100.0 * deviation.exp_m1(),
                )
            })
        })
        .collect()
}

/// Reconstructs models until no photo is left that can start one; the largest, and the photos of
/// the others.
fn largest_model(
    matched: &MatchedPhotos<'_>,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Found, PosesError> {
    let mut available = vec![true; matched.num_photos()];
    let mut models: Vec<Reconstruction> = Vec::new();
    loop {
        match incremental::reconstruct(matched, &available, options, observer) {
            Ok(found) => {
                for (free, pose) in available.iter_mut().zip(&found.model.poses) {
                    *free &= pose.is_none();
                }
                models.push(found);
            }
            Err(PosesError::Interrupted) => return Err(PosesError::Interrupted),
            Err(error) if models.is_empty() => return Err(standing_still(matched).unwrap_or(error)),
            Err(_) => break,
        }
        if available.iter().filter(|&&a| a).count() < 2 {
            break;
        }
    }
    // The first of the largest: ties go to the better first pair.
    models.sort_by_key(|found| Reverse(found.model.num_views()));
    let kept = models.remove(0);
    let posed = |found: &Reconstruction| {
        let photos = 0..matched.num_photos();
        photos.filter(|&p| found.model.poses[p].is_some()).collect()
    };
    Ok((kept, models.iter().map(posed).collect()))
}

/// Why there is no model where most matches do not move in the frame: neither narrow angles nor flatness say it.
fn standing_still(matched: &MatchedPhotos<'_>) -> Option<PosesError> {
    let (mut num_still, mut num_matches) = (0_usize, 0_usize);
    for pair in &matched.matches.pairs {
        let photos = [pair.first.0, pair.second.0];
        let cameras = photos.map(|photo| &matched.photos.photos[photo].intrinsics);
        let stands = |&&[i, j]: &&[u32; 2]| {
            let [first, second] = photos.map(|photo| &matched.matches.photos[photo].keypoints);
            motion_in_frame([&first[i as usize], &second[j as usize]], cameras) < 1.0
        };
        num_still += pair.matches.iter().filter(stands).count();
        num_matches += pair.matches.len();
    }
    let percent = 100.0 * num_still as f64 / num_matches.max(1) as f64;
    (percent > 50.0).then_some(PosesError::StandsStill { percent })
}

/// Rounds of adjustment and outlier removal with ever tighter limits, the last ones converged.
fn finish(
    matched: &MatchedPhotos<'_>,
    reconstruction: &mut Reconstruction,
    options: &PosesOptions,
) -> Result<(), PosesError> {
    let Reconstruction {
        model, adjustments, ..
    } = reconstruction;
    let mut limits = incremental::limits(options);
    for round in 0..3 {
        let scope = AdjustmentScope::all("final", incremental::intrinsics_scope(model));
        let last = round == 2;
        let bundle_options = BundleOptions::complete(if last { 1e-7 } else { 1e-4 });
        adjustments.push(model.adjust(matched, &scope, &bundle_options)?);
        if !last {
            adjustments.extend(incremental::try_full_intrinsics(model, matched)?);
            limits.max_error_px = options.max_reprojection_error_px * 0.7;
            model.triangulate_all(matched, &limits);
        }
    }
    Ok(())
}

/// Moves the tracks to where patches align, and adjusts all to that; the points alone where the
/// poses are kept.
fn finish_on_patches(
    matched: &MatchedPhotos<'_>,
    reconstruction: &mut Reconstruction,
    keeps_poses: bool,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<(), PosesError> {
    let model = &mut reconstruction.model;
    let at_once = rilievo_scene::loading::num_at_once(matched.photos, options.memory);
    model.refined = Some(refinement::refine_tracks(
        matched, model, at_once, observer,
    )?);
    let has_no_given = |&p: &usize| {
        model.poses[p].is_some() && matched.photos.photos[p].given_cam_from_world.is_none()
    };
    let found: Vec<usize> = (0..matched.num_photos()).filter(has_no_given).collect();
    for round in 0..2 {
        let step = "on aligned patches";
        let bundle_options = BundleOptions::complete(if round == 0 { 1e-5 } else { 1e-8 });
        if keeps_poses && !found.is_empty() {
            let scope = AdjustmentScope {
                step,
                photos: Some(&found),
                intrinsics: IntrinsicsScope::Focal,
            };
            let adjusted = model.adjust(matched, &scope, &bundle_options)?;
            reconstruction.adjustments.push(adjusted);
        }
        let scope = match keeps_poses {
            true => AdjustmentScope::points(step),
            false => AdjustmentScope::all(step, incremental::intrinsics_scope(model)),
        };
        let adjusted = model.adjust(matched, &scope, &bundle_options)?;
        reconstruction.adjustments.push(adjusted);
        if round == 0 {
            model.drop_outliers(matched, &incremental::limits(options));
        }
    }
    Ok(())
}
