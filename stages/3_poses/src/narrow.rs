//! Photos that lie close together: what that costs depth.
//!
//! # Equations
//! Rays that meet at the angle `θ` under the focal length `f` give the relative depth with the
//! error `δ / (f tan θ)` for an error of `δ` pixels between the photos.

use crate::initial_pair::MIN_ANGLE_DEG;
use crate::triangulation;
use nalgebra::Point3;
use rilievo_numerics::robust::median;
use rilievo_scene::PosedViews;

/// Points that are used; more change nothing but the time.
const MAX_POINTS: usize = 2000;
/// Error between photos that the warning states depth's error for, pixels.
const ERROR_PX: f64 = 0.1;

/// The median over the sparse points of the widest angle between two of their rays, radians.
pub(crate) fn widest_angle(posed: &PosedViews) -> Option<f64> {
    let centers: Vec<Point3<f64>> = posed
        .views
        .iter()
        .map(|view| view.cam_from_world.center_in_source())
        .collect();
    let stride = posed.points.len().div_ceil(MAX_POINTS).max(1);
    let mut widest: Vec<f64> = posed
        .points
        .iter()
        .step_by(stride)
        .map(|point| {
            let seen_from: Vec<Point3<f64>> = point
                .track
                .iter()
                .map(|sighting| centers[sighting.view.0])
                .collect();
            triangulation::widest_angle(&Point3::from(point.position), &seen_from)
        })
        .collect();
    median(&mut widest)
}

/// A warning of photos that all lie within the angle that a first pair should have.
pub(crate) fn warning(posed: &PosedViews) -> Option<String> {
    let angle = widest_angle(posed)?;
    if angle >= MIN_ANGLE_DEG.to_radians() || angle <= 0.0 {
        return None;
    }
    let mut focals: Vec<f64> = posed.views.iter().map(|view| view.intrinsics.fx).collect();
    let depth = ERROR_PX / (median(&mut focals)? * angle.tan());
    let gain = (3.0 * MIN_ANGLE_DEG).to_radians().tan() / angle.tan();
    Some(format!(
        "the photos see most points from within {:.1} degrees: where they disagree by a tenth of a \
         pixel, depth errs by {:.2} %, {gain:.0} times as much as from within {:.0} degrees; move \
         further between photos",
        angle.to_degrees(),
        100.0 * depth,
        3.0 * MIN_ANGLE_DEG
    ))
}
