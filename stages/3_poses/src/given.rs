//! Poses that the user gave.
//!
//! Two at different places fix the world: they are kept, and photos without one are posed in their frame. Before use
//! they are checked: the share of verified matches within three times the epipolar limit of the essential matrix that
//! the poses imply. Where they do not agree, common other conventions are tried, so that the message can name the
//! likely one.

use crate::adjustment::BundleOptions;
use crate::consistency::{MIN_CONSISTENT_SHARE, num_agreeing};
use crate::error::PosesError;
use crate::incremental::{self, Reconstruction, limits};
use crate::matched::MatchedPhotos;
use crate::model::{AdjustmentScope, Model};
use crate::options::{GivenPoses, PosesOptions};
use crate::projection::CenteredPose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rilievo_scene::{FocalSource, Observer, Photo, PhotoSet, RigidTransform, first_and_more};

/// The given poses, per photo, where at least two fix the world and they are to be used.
pub(crate) fn poses(photos: &PhotoSet, options: &PosesOptions) -> Option<Vec<Given>> {
    let poses = photos.photos.iter().map(|p| p.given_cam_from_world);
    let is_used = options.given_poses != GivenPoses::Ignore && poses.clone().flatten().count() > 1;
    is_used.then(|| poses.collect())
}

/// What to warn of where some photos have a given pose and others not.
pub(crate) fn incomplete(photos: &PhotoSet, is_used: bool) -> Option<String> {
    let names = |has_pose: bool| {
        let photos = photos.photos.iter();
        let of = photos.filter(move |p| p.given_cam_from_world.is_some() == has_pose);
        first_and_more(of.map(|photo| photo.file_name.as_str()))
    };
    let (with, without) = (names(true)?, names(false)?);
    Some(if is_used {
        format!(
            "no pose is given for {without}: posed in the frame of the given cameras by what these photos see of the same \
             points"
        )
    } else {
        format!(
            "a pose is given for {with} alone and not used, since one pose fixes neither scale nor place: all poses are \
             found from the photos"
        )
    })
}

/// A photo's given pose, if it has one.
type Given = Option<RigidTransform>;

/// Distance of two centres over their distance from the origin below which rounding made it.
const SAME_PLACE: f64 = 1e-12;

/// The centre that all cameras share in the world that they were given in, where they do.
fn common_place(poses: &[Given], offset: [f64; 3]) -> Option<[f64; 3]> {
    let centers = poses.iter().flatten().map(RigidTransform::center_in_source);
    let mut centers = centers.map(|center| center + Vector3::from(offset));
    let first = centers.next()?;
    let limit = SAME_PLACE * first.coords.norm();
    centers
        .all(|center| (center - first).norm() <= limit)
        .then(|| first.coords.into())
}

/// Share of all verified matches that poses explain; `None` without matches.
fn consistent_share(
    matched: &MatchedPhotos<'_>,
    poses: &[Given],
    max_error_px: f64,
) -> Option<f64> {
    let (mut agreeing, mut total) = (0_usize, 0_usize);
    for pair in &matched.matches.pairs {
        let (i, j) = (pair.first.0, pair.second.0);
        let cameras = [i, j].map(|photo| &matched.photos.photos[photo].intrinsics);
        if let (Some(first), Some(second)) = (&poses[i], &poses[j])
            && let Some(found) = num_agreeing(matched, pair, cameras, [first, second], max_error_px)
        {
            agreeing += found;
            total += pair.matches.len();
        }
    }
    (total > 0).then(|| agreeing as f64 / total as f64)
}

/// Other conventions in which poses are often written, with their names.
fn other_conventions(poses: &[Given]) -> Vec<(&'static str, Vec<Given>)> {
    let rotation = |matrix: Matrix3<f64>| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
    };
    let opengl = RigidTransform {
        rotation: rotation(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))),
        translation: Vector3::zeros(),
    };
    let each = |f: &dyn Fn(&RigidTransform) -> RigidTransform| {
        let poses = poses.iter();
        poses.map(|pose| pose.as_ref().map(f)).collect()
    };
    // A mirrored world: the same cameras seen in a mirror across one axis.
    let mirrored = |axis: usize| {
        let mut m = Matrix3::identity();
        m[(axis, axis)] = -1.0;
        each(&|p| RigidTransform {
            rotation: rotation(m * p.rotation_matrix() * m),
            translation: m * p.translation,
        })
    };
    vec![
        (
            "they look like camera-from-world transforms given where world-from-camera is expected (or the reverse): invert them",
            each(&|p| p.inverse()),
        ),
        (
            "they look like OpenGL cameras (y up, z backwards): turn them half around x",
            each(&|p| opengl.compose(p)),
        ),
        (
            "they look like inverted OpenGL cameras (y up, z backwards): invert them and turn them half around x",
            each(&|p| opengl.compose(&p.inverse())),
        ),
        (
            "their x axis is mirrored (a left-handed frame): negate it",
            mirrored(0),
        ),
        (
            "their y axis is mirrored (a left-handed frame): negate it",
            mirrored(1),
        ),
        (
            "their z axis is mirrored (a left-handed frame): negate it",
            mirrored(2),
        ),
    ]
}

/// Points triangulated with the given poses, and the photos without one posed by them.
///
/// # Errors
/// When the poses contradict the matches, or the observer asked to stop.
pub(crate) fn reconstruct(
    matched: &mut MatchedPhotos<'_>,
    poses: &[Given],
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Reconstruction, PosesError> {
    let max_error_px = 3.0 * options.max_reprojection_error_px;
    if let Some(place) = common_place(poses, options.given_world.offset) {
        return Err(PosesError::GivenPosesAtOnePlace { place });
    }
    if let Some(share) = consistent_share(matched, poses, max_error_px)
        && share < MIN_CONSISTENT_SHARE
    {
        let best = other_conventions(poses)
            .into_iter()
            .filter_map(|(hint, other)| {
                Some((consistent_share(matched, &other, max_error_px)?, hint))
            })
            .reduce(|a, b| if b.0 > a.0 { b } else { a });
        let hint = match best {
            Some((other, hint)) if other > MIN_CONSISTENT_SHARE.max(2.0 * share) => {
                hint.to_owned()
            }
            _ => "check that they belong to these photos, and their convention (camera x right, y down, z forward)".to_owned(),
        };
        return Err(PosesError::GivenPosesInconsistent {
            share_consistent: 100.0 * share,
            hint,
        });
    }
    start_from_given_focals(matched, poses);
    let mut model = Model::empty(matched);
    model.poses = poses.iter().map(|p| p.map(CenteredPose::from)).collect();
    model.triangulate_all(matched, &limits(options));
    let mut reconstruction = Reconstruction::from(model);
    let model = &mut reconstruction.model;
    if model.num_points() > 0 {
        let scope = AdjustmentScope::points("points only");
        let adjusted = model.adjust(matched, &scope, &BundleOptions::complete(1e-6))?;
        reconstruction.adjustments.push(adjusted);
    }
    incremental::extend_around(matched, &mut reconstruction, options, observer)?;
    Ok(reconstruction)
}

/// Photos of which no focal length is known begin with that of a given camera of their size, likely the same one.
fn start_from_given_focals(matched: &mut MatchedPhotos<'_>, poses: &[Given]) {
    let photos = &matched.photos.photos;
    for (photo, &camera) in photos.iter().zip(&matched.camera_of) {
        let is_like = |(other, pose): &(&Photo, &Given)| {
            let size = |photo: &Photo| (photo.intrinsics.width, photo.intrinsics.height);
            pose.is_some() && other.focal_source != FocalSource::Guess && size(other) == size(photo)
        };
        if photo.focal_source == FocalSource::Guess
            && let Some((like, _)) = photos.iter().zip(poses).find(is_like)
        {
            let ratio = like.intrinsics.focal_px() / photo.intrinsics.focal_px();
            matched.cameras[camera].start_ln_focal = ratio.ln();
        }
    }
}
