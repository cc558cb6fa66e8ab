//! The model as the stage's output, with its report.

use crate::adjustment::FINAL_LOSS;
use crate::incremental::Reconstruction;
use crate::matched::MatchedPhotos;
use crate::model::{AdjustmentScope, IntrinsicsScope, Model};
use crate::ranking::MIN_NUM_VISIBLE_POINTS;
use crate::report::{PosesReport, ViewReport};
use nalgebra::Point2;
use rilievo_scene::{
    PhotoIdx, PosedView, PosedViews, RigidTransform, SparsePoint, TrackElement, Unregistered,
    ViewIdx,
};

/// Sum of reprojection errors, pixels, and their number.
#[derive(Clone, Copy, Default)]
struct Errors {
    sum_px: f64,
    num: usize,
}

impl Errors {
    fn add(&mut self, error_px: f64) {
        self.sum_px += error_px;
        self.num += 1;
    }

    fn mean_px(&self) -> f64 {
        self.sum_px / self.num.max(1) as f64
    }
}

/// Builds views, points and report from a model.
///
/// With `keeps_given` the poses are copied from the photos, so that they stay bit-identical.
pub(crate) fn assemble(
    matched: &MatchedPhotos<'_>,
    reconstruction: &Reconstruction,
    other_models: &[Vec<usize>],
    keeps_given: bool,
) -> (PosedViews, PosesReport) {
    let model = &reconstruction.model;
    let cameras = model.intrinsics();
    let mut posed = PosedViews::default();
    let mut view_of = vec![None; matched.num_photos()];
    for (p, photo) in matched.photos.photos.iter().enumerate() {
        let Some(pose) = model.poses[p] else {
            posed.unregistered.push(Unregistered {
                photo: PhotoIdx(p),
                file_name: photo.file_name.clone(),
                reason: reason(matched, reconstruction, other_models, p),
            });
            continue;
        };
        view_of[p] = Some(ViewIdx(posed.views.len()));
        let kept = photo.given_cam_from_world.filter(|_| keeps_given);
        posed.views.push(PosedView {
            photo: PhotoIdx(p),
            name: photo.name.clone(),
            file_name: photo.file_name.clone(),
            intrinsics: cameras[matched.camera_of[p]],
            cam_from_world: kept.unwrap_or_else(|| RigidTransform::from(pose)),
        });
    }
    let errors = add_points(matched, model, &view_of, &mut posed);
    paint(matched, &mut posed);
    let scope = match (keeps_given, &reconstruction.lens) {
        (true, _) => AdjustmentScope::points("covariance"),
        (false, Some(_)) => AdjustmentScope::all("covariance", IntrinsicsScope::Nuisance),
        (false, None) => AdjustmentScope::all("covariance", IntrinsicsScope::Fixed),
    };
    let precision = model.precision(matched, &scope, FINAL_LOSS);
    let views = posed.views.iter().zip(&errors).map(|(view, errors)| {
        let sigma = precision.poses[view.photo.0];
        ViewReport {
            file_name: view.file_name.clone(),
            num_points: errors.num,
            mean_error_px: errors.mean_px(),
            rotation_sigma_deg: sigma.map(|(rotation, _)| rotation.to_degrees()),
            center_sigma: sigma.map(|(_, center)| center),
        }
    });
    let all = Errors {
        sum_px: errors.iter().map(|e| e.sum_px).sum(),
        num: errors.iter().map(|e| e.num).sum(),
    };
    let name = |p: usize| matched.photos.photos[p].file_name.clone();
    let refined = matched.cameras.iter().zip(&cameras);
    let refined = refined.filter(|(before, after)| {
        !before.is_own && before.lens_of.is_none() && before.initial.fx != after.fx
    });
    let report = PosesReport {
        initial_pair: reconstruction.initial_pair.map(|(a, b)| (name(a), name(b))),
        views: views.collect(),
        same_place: same_place(&posed),
        num_points: posed.points.len(),
        mean_track_length: all.num as f64 / posed.points.len().max(1) as f64,
        mean_reprojection_error_px: all.mean_px(),
        keypoint_sigma_px: precision.sigma_px,
        median_point_sigma: precision.median_point_sigma,
        other_model_sizes: other_models.iter().map(Vec::len).collect(),
        refined_focals_px: refined
            .map(|(before, after)| (before.group, before.initial.fx, after.fx))
            .collect(),
        lens: reconstruction.lens.clone(),
        contradicted_focal: reconstruction.contradicted_focal.clone(),
        adjustments: reconstruction.adjustments.clone(),
        ..PosesReport::default()
    };
    (posed, report)
}

/// The views that are not the first of their viewpoint, with the first.
fn same_place(posed: &PosedViews) -> Vec<(String, String)> {
    let name = |view: usize| posed.views[view].file_name.clone();
    let viewpoints = posed.viewpoints().into_iter().enumerate();
    let others = viewpoints.filter(|&(view, first)| view != first.0);
    others
        .map(|(view, first)| (name(view), name(first.0)))
        .collect()
}

/// Adds the points with two sightings or more; the reprojection errors of each view.
fn add_points(
    matched: &MatchedPhotos<'_>,
    model: &Model,
    view_of: &[Option<ViewIdx>],
    posed: &mut PosedViews,
) -> Vec<Errors> {
    let mut of_views = vec![Errors::default(); posed.views.len()];
    for (t, point) in model.points.iter().enumerate() {
        let Some(point) = point else { continue };
        let mut track = Vec::with_capacity(point.support.len());
        let mut errors = Errors::default();
        for (place, pixel, _) in model.observations(matched, t) {
            let sighting = &matched.tracks[t][place];
            let Some(view) = view_of[sighting.photo] else {
                continue;
            };
            let PosedView {
                intrinsics,
                cam_from_world,
                ..
            } = &posed.views[view.0];
            let seen = intrinsics.project(&cam_from_world.apply(&point.position));
            let error_px = seen.map_or(f64::INFINITY, |s| (s - pixel).norm());
            errors.add(error_px);
            of_views[view.0].add(error_px);
            track.push(TrackElement {
                view,
                keypoint_idx: sighting.keypoint,
                pixel: [pixel.x, pixel.y],
            });
        }
        if track.len() >= 2 {
            posed.points.push(SparsePoint {
                position: point.position.coords.into(),
                color: [0; 3],
                error_px: errors.mean_px(),
                track,
            });
        }
    }
    of_views
}

/// Why a photo has no pose, and what to try.
fn reason(
    matched: &MatchedPhotos<'_>,
    reconstruction: &Reconstruction,
    other_models: &[Vec<usize>],
    photo: usize,
) -> String {
    if reconstruction.contradicting.contains(&photo) {
        return "wherever it is placed, most of its matches with other photos contradict that; \
                repeated texture or a symmetric object deceives it, put a printed mat under the object"
            .to_owned();
    }
    if let Some(others) = other_models.iter().find(|m| m.contains(&photo)) {
        return format!(
            "belongs to a separate model of {} photos that shares no points with the larger one; add photos in between",
            others.len()
        );
    }
    let most = matched
        .matches
        .pairs
        .iter()
        .filter(|p| p.first.0 == photo || p.second.0 == photo)
        .map(|p| p.matches.len())
        .max();
    match (reconstruction.failed.iter().find(|f| f.0 == photo), most) {
        (Some((_, seen, agreed)), _) => format!(
            "{agreed} of {seen} known points agree on a pose, too few; it may be blurred, distorted, or show something else"
        ),
        (None, Some(most)) => format!(
            "sees fewer than {} known points (best pair: {most} matches); add photos between it and the others",
            MIN_NUM_VISIBLE_POINTS
        ),
        (None, None) => {
            "matches no other photo; it shows something else or is too far from its neighbours"
                .to_owned()
        }
    }
}

/// Colours each point from its first sighting.
fn paint(matched: &MatchedPhotos<'_>, posed: &mut PosedViews) {
    let mut of_view: Vec<Vec<(usize, Point2<f64>)>> = vec![Vec::new(); posed.views.len()];
    for (k, point) in posed.points.iter().enumerate() {
        if let Some(first) = point.track.first() {
            of_view[first.view.0].push((k, Point2::new(first.pixel[0], first.pixel[1])));
        }
    }
    for (view, points) in of_view.iter().enumerate() {
        if points.is_empty() {
            continue;
        }
        // Colours are for looking at: a photo that cannot be read leaves its points black.
        let Ok(image) = matched.photos.photos[posed.views[view].photo.0].linear() else {
            continue;
        };
        for (k, pixel) in points {
            for c in 0..3 {
                let channel = c.min(image.channels - 1);
                let linear = image.sample(pixel.x, pixel.y, channel).unwrap_or(0.0);
                posed.points[*k].color[c] = rilievo_scene::srgb::encode_byte(linear);
            }
        }
    }
}
