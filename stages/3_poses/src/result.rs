//! The model as the stage's output, with its report.

use crate::adjustment::BundleOptions;
use crate::incremental::{MIN_NUM_VISIBLE_POINTS, Reconstruction};
use crate::model::{AdjustmentScope, IntrinsicsScope};
use crate::report::{PosesReport, ViewReport};
use crate::scene::Scene;
use nalgebra::Point2;
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::{
    PhotoIdx, PosedView, PosedViews, RigidTransform, SparsePoint, TrackElement, Unregistered,
    ViewIdx,
};

/// Builds views, points and report from a model.
///
/// With `keeps_given` the poses are copied from the photos, so that they stay bit-identical.
pub fn assemble(
    scene: &Scene<'_>,
    reconstruction: &Reconstruction,
    other_models: &[Vec<usize>],
    keeps_given: bool,
) -> (PosedViews, PosesReport) {
    let model = &reconstruction.model;
    let cameras = model.intrinsics();
    let mut view_of = vec![None; scene.num_photos()];
    let mut posed = PosedViews::default();
    for (p, photo) in scene.photos.photos.iter().enumerate() {
        let Some(pose) = model.poses[p] else {
            posed.unregistered.push(Unregistered {
                photo: PhotoIdx(p),
                file_name: photo.file_name.clone(),
                reason: reason(scene, reconstruction, other_models, p),
            });
            continue;
        };
        view_of[p] = Some(ViewIdx(posed.views.len()));
        let kept = photo.given_cam_from_world.filter(|_| keeps_given);
        posed.views.push(PosedView {
            photo: PhotoIdx(p),
            name: photo.name.clone(),
            file_name: photo.file_name.clone(),
            intrinsics: cameras[scene.camera_of[p]],
            cam_from_world: kept.unwrap_or_else(|| RigidTransform::from(pose)),
        });
    }
    let mut error_sums = vec![(0.0, 0_usize); posed.views.len()];
    for (t, point) in model.points.iter().enumerate() {
        let Some(point) = point else { continue };
        let mut track = Vec::with_capacity(point.support.len());
        let mut error_sum = 0.0;
        for (place, pixel, _) in model.observations(scene, t) {
            let sighting = &scene.tracks[t][place];
            let Some(view) = view_of[sighting.photo] else {
                continue;
            };
            let posed_view = &posed.views[view.0];
            let seen = posed_view
                .intrinsics
                .project(&posed_view.cam_from_world.apply(&point.position));
            let error = seen.map_or(f64::INFINITY, |s| (s - pixel).norm());
            error_sum += error;
            error_sums[view.0].0 += error;
            error_sums[view.0].1 += 1;
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
                error_px: error_sum / track.len() as f64,
                track,
            });
        }
    }
    paint(scene, &mut posed);
    let scope = AdjustmentScope {
        step: "covariance",
        photos: if keeps_given { Some(&[]) } else { None },
        intrinsics: match reconstruction.lens {
            Some(_) => IntrinsicsScope::Nuisance,
            None => IntrinsicsScope::Fixed,
        },
    };
    let bundle_options = BundleOptions {
        loss: RobustLoss::Cauchy(2.0),
        max_num_iterations: 0,
        relative_cost_change: 0.0,
    };
    let precision = model.precision(scene, &scope, &bundle_options);
    let views = posed
        .views
        .iter()
        .zip(&error_sums)
        .map(|(view, (sum, count))| ViewReport {
            file_name: view.file_name.clone(),
            num_points: *count,
            mean_error_px: sum / (*count).max(1) as f64,
            rotation_sigma_deg: precision.poses[view.photo.0].map(|s| s.0.to_degrees()),
            center_sigma: precision.poses[view.photo.0].map(|s| s.1),
        })
        .collect();
    let num_sightings: usize = error_sums.iter().map(|s| s.1).sum();
    let total_error: f64 = error_sums.iter().map(|s| s.0).sum();
    let name = |p: usize| scene.photos.photos[p].file_name.clone();
    let report = PosesReport {
        initial_pair: reconstruction.initial_pair.map(|(a, b)| (name(a), name(b))),
        views,
        num_points: posed.points.len(),
        mean_track_length: num_sightings as f64 / posed.points.len().max(1) as f64,
        mean_reprojection_error_px: total_error / num_sightings.max(1) as f64,
        keypoint_sigma_px: precision.sigma_px,
        median_point_sigma: precision.median_point_sigma,
        other_model_sizes: other_models.iter().map(Vec::len).collect(),
        refined_focals_px: scene
            .cameras
            .iter()
            .zip(&cameras)
            .filter(|(before, after)| !before.is_own && before.initial.fx != after.fx)
            .map(|(before, after)| (before.group, before.initial.fx, after.fx))
            .collect(),
        lens: reconstruction.lens.clone(),
        contradicted_focal: reconstruction.contradicted_focal.clone(),
        adjustments: reconstruction.adjustments.clone(),
        ..PosesReport::default()
    };
    (posed, report)
}

/// Why a photo has no pose, and what to try.
fn reason(
    scene: &Scene<'_>,
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
    let most = scene
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
fn paint(scene: &Scene<'_>, posed: &mut PosedViews) {
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
        let Ok(image) = scene.photos.photos[posed.views[view].photo.0].linear() else {
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
