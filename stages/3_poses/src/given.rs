//! Poses that the user gave.
//!
//! They count only where every photo has one. Before use they are checked: the share of verified
//! matches within three times the epipolar limit of the essential matrix that the poses imply. Where
//! they do not agree, common other conventions are tried, so that the message can name the likely one.

use crate::adjustment::BundleOptions;
use crate::consistency::{MIN_CONSISTENT_SHARE, num_agreeing};
use crate::error::PosesError;
use crate::incremental::{Reconstruction, limits};
use crate::matched::MatchedPhotos;
use crate::model::{AdjustmentScope, Model};
use crate::options::{GivenPoses, PosesOptions};
use crate::projection::CenteredPose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rilievo_scene::{PhotoSet, RigidTransform};

/// The given poses, when every photo has one and they are to be used.
pub(crate) fn poses(photos: &PhotoSet, options: &PosesOptions) -> Option<Vec<RigidTransform>> {
    if options.given_poses == GivenPoses::Ignore {
        return None;
    }
    photos
        .photos
        .iter()
        .map(|p| p.given_cam_from_world)
        .collect()
}

/// Distance of two centres over their distance from the origin below which rounding made it.
const SAME_PLACE: f64 = 1e-12;

/// The centre that all cameras share in the world that they were given in, where they do.
fn common_place(poses: &[RigidTransform], offset: [f64; 3]) -> Option<[f64; 3]> {
    let centers = poses.iter().map(RigidTransform::center_in_source);
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
    poses: &[RigidTransform],
    max_error_px: f64,
) -> Option<f64> {
    let (mut agreeing, mut total) = (0_usize, 0_usize);
    for pair in &matched.matches.pairs {
        let (i, j) = (pair.first.0, pair.second.0);
        let cameras = [i, j].map(|photo| &matched.photos.photos[photo].intrinsics);
        if let Some(found) =
            num_agreeing(matched, pair, cameras, [&poses[i], &poses[j]], max_error_px)
        {
            agreeing += found;
            total += pair.matches.len();
        }
    }
    (total > 0).then(|| agreeing as f64 / total as f64)
}

/// Other conventions in which poses are often written, with their names.
fn other_conventions(poses: &[RigidTransform]) -> Vec<(&'static str, Vec<RigidTransform>)> {
    let rotation = |matrix: Matrix3<f64>| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
    };
    let opengl = RigidTransform {
        rotation: rotation(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))),
        translation: Vector3::zeros(),
    };
    let each = |f: &dyn Fn(&RigidTransform) -> RigidTransform| poses.iter().map(f).collect();
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

/// Points triangulated with the given poses; refined with them where asked.
///
/// # Errors
/// When the poses contradict the matches.
pub(crate) fn reconstruct(
    matched: &MatchedPhotos<'_>,
    poses: &[RigidTransform],
    options: &PosesOptions,
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
    let mut model = Model::empty(matched);
    model.poses = poses.iter().map(|&p| Some(CenteredPose::from(p))).collect();
    model.triangulate_all(matched, &limits(options));
    let mut reconstruction = Reconstruction::from(model);
    let model = &mut reconstruction.model;
    if model.num_points() > 0 {
        let scope = AdjustmentScope::points("points only");
        let adjusted = model.adjust(matched, &scope, &BundleOptions::complete(1e-6))?;
        reconstruction.adjustments.push(adjusted);
    }
    Ok(reconstruction)
}
