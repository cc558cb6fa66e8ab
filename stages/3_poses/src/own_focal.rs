//! Photos with a focal length of their own: zoomed, or cropped and enlarged.
//!
//! Photos of one camera share their focal length. One that was zoomed or cropped then agrees with few of its matches, at a
//! wrong distance. Its pose is sought anew (see [`crate::resection`]) with other focal lengths among the points that the
//! others determine; where far more of them agree, the photo is given a camera of its own, which later adjustments refine.

use crate::error::PosesError;
use crate::incremental::settle;
use crate::matched::{CameraPrior, GUESS_FOCAL_SIGMA, MatchedPhotos};
use crate::model::Model;
use crate::options::{PosesOptions, RefineIntrinsics};
use crate::own_center::CROP_OFFSET;
use crate::projection::{FOCAL, PRINCIPAL_POINT};
use crate::ranking::MIN_NUM_VISIBLE_POINTS;
use crate::resection::resect;
use nalgebra::{Point2, Point3};
use rayon::prelude::*;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{Intrinsics, first_and_more};

/// A photo keeps its camera's focal length where its inlier ratio is at least this share of the
/// photos' upper quartile.
const ENOUGH: f64 = 0.75;
const UPPER_QUARTILE: f64 = 0.75;
/// Another focal length must have this many times as many inliers, and this inlier ratio.
const MIN_GAIN: f64 = 1.5;
const MIN_SHARE: f64 = 0.4;
/// With cameras of their own the photos must see this many times as many points of the model.
pub(crate) const MIN_GROWTH: f64 = 1.1;
/// Largest error of an inlier, over `max_reprojection_error_px`: another distance makes up for most
/// of a wrong focal length, so that only small errors show it.
const TIGHT: f64 = 1.0 / 3.0;
/// Logarithms of the focal lengths that are tried, over the camera's: up to 2.5 times longer and
/// shorter, in steps at which neighbours still share half of the inliers, then in fine steps around
/// the best.
const STEP: f64 = 0.06;
const NUM_STEPS: i32 = 15;
const FINE_STEP: f64 = 0.015;
const NUM_FINE_STEPS: i32 = 3;
/// Least such logarithm that counts as another focal length: focusing changes less.
const MIN_LN_FOCAL: f64 = 0.06;
/// Other photos that must determine the points.
const MIN_NUM_OTHERS: usize = 2;
/// Points that the search uses, evenly taken.
const MAX_NUM_POINTS: usize = 400;
/// Largest difference of logarithms between photos of one zoom.
const SAME_ZOOM: f64 = 0.06;

/// A photo with another focal length than its camera's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OwnFocal {
    pub photo: usize,
    /// Logarithm of its focal length over its camera's.
    pub ln_focal: f64,
}

/// Photos with far more inliers at another focal length, in order.
pub(crate) fn find(
    matched: &MatchedPhotos<'_>,
    model: &Model,
    options: &PosesOptions,
) -> Result<Vec<OwnFocal>, PosesError> {
    let is_refined =
        |photo: usize| matched.cameras[matched.camera_of[photo]].prior_sigma[FOCAL].is_some();
    let shares: Vec<Option<f64>> = (0..matched.num_photos())
        .into_par_iter()
        .map(|photo| {
            let (num_agreeing, num) = PointsInSight::of(matched, model, photo, options)?.at(0.0);
            Some(num_agreeing as f64 / num as f64)
        })
        .collect();
    let mut known: Vec<f64> = shares.iter().flatten().copied().collect();
    let Some(good) = quantile(&mut known, UPPER_QUARTILE) else {
        return Ok(Vec::new());
    };
    let is_suspect = |photo: &usize| {
        is_refined(*photo) && shares[*photo].is_some_and(|share| share < ENOUGH * good)
    };
    let suspects: Vec<usize> = (0..matched.num_photos()).filter(is_suspect).collect();
    let num_left = (0..matched.num_photos())
        .filter(|photo| model.poses[*photo].is_some() && !suspects.contains(photo))
        .count();
    if suspects.is_empty() || num_left < MIN_NUM_OTHERS {
        return Ok(Vec::new());
    }
    // A wrong focal length bends what hangs on it: points and poses of the others alone.
    let mut others = model.clone();
    for &photo in &suspects {
        others.poses[photo] = None;
    }
    settle(&mut others, matched, options)?;
    let found = suspects.into_par_iter().filter_map(|photo| {
        let in_sight = PointsInSight::of(matched, &others, photo, options)?;
        // The first of equals: the order is fixed.
        let best_around = |middle: f64, step: f64, num: i32| {
            let ln_focals = (-num..=num).map(|k| middle + step * f64::from(k));
            let counted = ln_focals.map(|ln_focal| (in_sight.at(ln_focal).0, ln_focal));
            counted.fold(
                (0, 0.0),
                |best, next| if next.0 > best.0 { next } else { best },
            )
        };
        let (_, coarse) = best_around(0.0, STEP, NUM_STEPS);
        let (most, ln_focal) = best_around(coarse, FINE_STEP, NUM_FINE_STEPS);
        let (shared, num) = in_sight.at(0.0);
        let gains = most as f64 >= (MIN_GAIN * shared as f64).max(MIN_SHARE * num as f64);
        (gains && ln_focal.abs() >= MIN_LN_FOCAL).then_some(OwnFocal { photo, ln_focal })
    });
    Ok(found.collect())
}

/// Points in sight of a photo.
struct PointsInSight {
    camera: Intrinsics,
    pixels: Vec<Point2<f64>>,
    points: Vec<Point3<f64>>,
    max_error_px: f64,
    seed: [u64; 2],
}

impl PointsInSight {
    /// `None` where too few points are in sight.
    fn of(
        matched: &MatchedPhotos<'_>,
        model: &Model,
        photo: usize,
        options: &PosesOptions,
    ) -> Option<Self> {
        let visible = model.visible_points(matched, photo);
        if visible.0.len() < MIN_NUM_VISIBLE_POINTS {
            return None;
        }
        let (pixels, points) = some(visible);
        Some(Self {
            camera: model.cameras[matched.camera_of[photo]].current(),
            pixels,
            points,
            max_error_px: TIGHT * options.max_reprojection_error_px,
            seed: [options.seed, photo as u64],
        })
    }

    /// Inliers of the best pose at a focal length, and the number of points.
    fn at(&self, ln_focal: f64) -> (usize, usize) {
        let camera = scaled(&self.camera, ln_focal);
        let found = resect(
            &camera,
            &self.pixels,
            &self.points,
            self.max_error_px,
            self.seed,
        );
        (
            found.map_or(0, |found| found.inliers.len()),
            self.points.len(),
        )
    }
}

/// At most so many of the correspondences, evenly taken.
fn some(
    (pixels, points): (Vec<Point2<f64>>, Vec<Point3<f64>>),
) -> (Vec<Point2<f64>>, Vec<Point3<f64>>) {
    let step = points.len().div_ceil(MAX_NUM_POINTS).max(1);
    let every = pixels.into_iter().zip(points).step_by(step);
    every.unzip()
}

fn scaled(camera: &Intrinsics, ln_focal: f64) -> Intrinsics {
    let factor = ln_focal.exp();
    Intrinsics {
        fx: camera.fx * factor,
        fy: camera.fy * factor,
        ..*camera
    }
}

/// Gives photos cameras of their own; those of one zoom share theirs. The principal point of a photo that is alone is free:
/// it may be a crop beside the middle.
pub(crate) fn give_cameras(
    matched: &mut MatchedPhotos<'_>,
    model: &Model,
    own: &[OwnFocal],
    refine: RefineIntrinsics,
) {
    let mut order = own.to_vec();
    order.sort_by(|a, b| {
        let camera = |own: &OwnFocal| matched.camera_of[own.photo];
        let by_camera = camera(a).cmp(&camera(b));
        by_camera.then(a.ln_focal.total_cmp(&b.ln_focal))
    });
    let mut zooms: Vec<Vec<OwnFocal>> = Vec::new();
    for own in order {
        let is_of = |zoom: &[OwnFocal]| {
            let first = zoom[0];
            matched.camera_of[first.photo] == matched.camera_of[own.photo]
                && (own.ln_focal - first.ln_focal).abs() < SAME_ZOOM
        };
        match zooms.last_mut() {
            Some(zoom) if is_of(zoom) => zoom.push(own),
            _ => zooms.push(vec![own]),
        }
    }
    for zoom in zooms {
        let camera = matched.camera_of[zoom[0].photo];
        let shared = &matched.cameras[camera];
        let initial = scaled(&model.cameras[camera].current(), zoom[0].ln_focal);
        let mut prior_sigma = shared.prior_sigma;
        prior_sigma[FOCAL] = Some(GUESS_FOCAL_SIGMA);
        if zoom.len() == 1 && refine != RefineIntrinsics::Focal {
            let offset = CROP_OFFSET * initial.longer_side();
            prior_sigma[PRINCIPAL_POINT].fill(Some(offset));
        }
        let own = CameraPrior {
            group: shared.group,
            initial,
            prior_sigma,
            start_ln_focal: 0.0,
            is_own: true,
            is_cropped: false,
            lens_of: None,
        };
        for OwnFocal { photo, .. } in zoom {
            matched.camera_of[photo] = matched.cameras.len();
        }
        matched.cameras.push(own);
    }
}

/// A warning for each camera that was made for photos of a focal length of their own.
pub(crate) fn warnings(matched: &MatchedPhotos<'_>, model: &Model) -> Vec<String> {
    let of = |camera: usize| {
        let posed = (0..matched.num_photos())
            .filter(move |&p| matched.camera_of[p] == camera && model.poses[p].is_some());
        posed.map(|p| matched.photos.photos[p].file_name.as_str())
    };
    (0..matched.cameras.len())
        .filter(|&k| matched.cameras[k].is_own)
        .filter_map(|k| {
            let names = first_and_more(of(k))?;
            let focal = model.cameras[k].current().focal_px();
            let group = matched.cameras[k].group;
            let shared = (0..k).find(|&other| matched.cameras[other].group == group)?;
            Some(format!(
                "{names}: the matches say a focal length of {focal:.0} px where the camera has {:.0} px: zoomed \
                 or cropped; the matches were believed",
                model.cameras[shared].current().focal_px(),
            ))
        })
        .collect()
}
