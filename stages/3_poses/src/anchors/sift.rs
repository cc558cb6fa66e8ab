//! Sparse points as anchors, as they are.
//!
//! An anchor is a sparse point with at least two sightings on the object's mask. Its covariance is
//! that of the least-squares triangulation with poses held fixed,
//! `Σ = σ² (Σ_i J_iᵀ J_i)⁻¹`, `J_i` the 2×3 derivative of the pixel in view `i` by the point and
//! `σ` the standard deviation of a keypoint coordinate in pixels; the depth in a view is
//! `z_i = r_iᵀ X + t_i`, so `σ(ln z_i) = √(r_iᵀ Σ r_i) / z_i`.

use super::options::AnchorOptions;
use nalgebra::{Matrix2x3, Matrix3, Point3};
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, Intrinsics, PhotoSet, PosedViews, RigidTransform,
    SparsePoint,
};

/// Derivative of the pixel by the point in the world frame, distortion neglected (it changes the
/// covariance by its relative strength only).
pub(super) fn pixel_derivative(
    camera: &Intrinsics,
    cam_from_world: &RigidTransform,
    point: &Point3<f64>,
) -> Option<Matrix2x3<f64>> {
    let p = cam_from_world.apply(point);
    if p.z.is_nan() || p.z <= 0.0 {
        return None;
    }
    let (u, v) = (p.x / p.z, p.y / p.z);
    let by_cam = Matrix2x3::new(
        camera.fx / p.z,
        0.0,
        -camera.fx * u / p.z,
        0.0,
        camera.fy / p.z,
        -camera.fy * v / p.z,
    );
    Some(by_cam * cam_from_world.rotation_matrix())
}

/// The anchor of a sparse point, when at least two sightings lie on the object.
pub(super) fn sift_anchor(
    photos: &PhotoSet,
    posed: &PosedViews,
    point: &SparsePoint,
    options: &AnchorOptions,
) -> Option<Anchor> {
    let position = Point3::from(point.position);
    let on_object: Vec<_> = point
        .track
        .iter()
        .filter(|sighting| {
            let photo = &photos.photos[posed.views[sighting.view.0].photo.0];
            photo.mask.as_ref().is_none_or(|mask| {
                mask.contains(
                    sighting.pixel[0].round() as isize,
                    sighting.pixel[1].round() as isize,
                )
            })
        })
        .collect();
    if on_object.len() < 2 {
        return None;
    }
    let mut widest = 0.0_f64;
    let rays: Vec<_> = on_object
        .iter()
        .map(|s| (position - posed.views[s.view.0].cam_from_world.center_in_source()).normalize())
        .collect();
    for (k, a) in rays.iter().enumerate() {
        for b in &rays[k + 1..] {
            widest = widest.max(a.dot(b).clamp(-1.0, 1.0).acos());
        }
    }
    if widest < options.min_angle_deg.to_radians() {
        return None;
    }
    let mut information = Matrix3::zeros();
    let mut squares = 0.0;
    for sighting in &on_object {
        let view = &posed.views[sighting.view.0];
        let j = pixel_derivative(&view.intrinsics, &view.cam_from_world, &position)?;
        information += j.transpose() * j;
        let seen = view
            .intrinsics
            .project(&view.cam_from_world.apply(&position))?;
        squares += (seen.x - sighting.pixel[0]).powi(2) + (seen.y - sighting.pixel[1]).powi(2);
    }
    // Few residuals say little: the prior standard deviation counts as four of them.
    let degrees = (2 * on_object.len() - 3) as f64;
    let prior = options.keypoint_sigma_px.powi(2);
    let variance = (squares + 4.0 * prior) / (degrees + 4.0);
    let covariance = information.try_inverse()? * variance;
    let observations = on_object
        .iter()
        .map(|sighting| {
            let view = &posed.views[sighting.view.0];
            let depth = view.cam_from_world.apply(&position).z;
            let axis = view.cam_from_world.rotation_matrix().row(2).transpose();
            AnchorObservation {
                view: sighting.view,
                pixel: sighting.pixel,
                depth,
                sigma_ln_depth: (axis.dot(&(covariance * axis))).max(0.0).sqrt() / depth,
            }
        })
        .collect();
    Some(Anchor {
        position: point.position,
        covariance: [
            covariance[(0, 0)],
            covariance[(0, 1)],
            covariance[(0, 2)],
            covariance[(1, 1)],
            covariance[(1, 2)],
            covariance[(2, 2)],
        ],
        origin: AnchorOrigin::Sift,
        observations,
    })
}
