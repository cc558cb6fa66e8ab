//! How a view sees a point of another view's surface.
//!
//! A pixel of view `i` with point `X` and normal `n` meets the surface of view `j` along `j`'s ray
//! in `Y`; their distance along the mean normal is `d = n·(Y − X)`, positive where `j` lies
//! further out.

use crate::view::{Surface, View};
use nalgebra::{Point3, Vector3};
use rilievo_scene::PageCache;

/// Depths of two views of one point differ by no more than this, pixel footprints. With less, views
/// that lie on each other only to a few footprints lose points; with more, false surface near edges
/// survives.
pub(crate) const DEPTH_TOLERANCE_PX: f64 = 4.0;
/// Normals of two views of one point differ by no more than this angle, degrees: what the smoothest
/// and the most detailed map of one relief differ by.
const NORMAL_TOLERANCE_DEG: f64 = 40.0;
/// Cosine of incidence up to which a surface counts as turned away from a view: noise of the
/// normals at the rim must not turn it back.
pub(crate) const MIN_FACING: f64 = 0.05;
/// Distance within which surface that faces the same way counts as the same wall, doubled or not,
/// pixel footprints: what is farther apart are different parts of the object.
const WALL_PX: f64 = 30.0;

/// Least cosine between normals of two views of one point.
pub(crate) fn min_normal_cosine() -> f64 {
    NORMAL_TOLERANCE_DEG.to_radians().cos()
}

/// How another view sees a point.
pub(crate) enum Sight {
    /// Outside its map, or turned away.
    Nothing,
    /// Something nearer hides the point.
    Hidden,
    /// The view looks through the point at something farther.
    SeenThrough,
    /// One surface.
    Same(SameSurface),
}

/// A view's surface at a point of another view.
pub(crate) struct SameSurface {
    /// Distance along the mean normal, world's unit.
    pub distance: f64,
    /// Normal there, world frame.
    pub normal: Vector3<f64>,
    /// Cosine between that normal and the ray back to the camera.
    pub cosine: f64,
    pub footprint: f64,
    pub confidence: f64,
    /// Whether the pixel nearest to it makes a point of its own.
    pub makes_points: bool,
}

/// A point with what fusion needs of it, world frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub point: Point3<f64>,
    pub normal: Vector3<f64>,
    pub footprint: f64,
}

impl Candidate {
    /// The surface of a view along a ray of its camera, `z = 1`.
    pub fn of(view: &View, ray: &Vector3<f64>, surface: &Surface) -> Self {
        Self {
            point: view.point_to_world(&(ray * surface.depth)),
            normal: view.to_world(&surface.normal),
            footprint: view.footprint(surface.depth),
        }
    }
}

/// Compares a point with the surface of a view, within `tolerance` (world's unit) along the normal.
/// Also returns how far the view's surface lies from the point, along the mean normal, where it
/// covers the point: where it sees surface that faces the same way within [`WALL_PX`].
#[inline]
pub(crate) fn look(
    pixels: &mut PageCache<'_>,
    view: &View,
    candidate: &Candidate,
    tolerance: f64,
    min_normal_cosine: f64,
) -> (Sight, Option<f64>) {
    let in_cam = view.pose.apply(&candidate.point);
    if in_cam.z <= 0.0 {
        return (Sight::Nothing, None);
    }
    let ray = view.to_world(&(in_cam.coords / in_cam.z));
    // What is turned away lies behind the rim that the view sees, however near.
    if candidate.normal.dot(&ray) > -MIN_FACING * ray.norm() {
        return (Sight::Hidden, None);
    }
    let Some(seen) = view.along(pixels, &in_cam) else {
        return (Sight::Nothing, None);
    };
    let normal = view.to_world(&seen.normal);
    let gap = seen.depth - in_cam.z;
    let mean = candidate.normal + normal;
    let length = mean.norm();
    // Opposite normals have no mean; the surface's own decides how far apart they lie.
    let direction = if length > 0.2 { mean / length } else { normal };
    let distance = direction.dot(&ray) * gap;
    let faces_alike = candidate.normal.dot(&normal) >= min_normal_cosine;
    let is_wall =
        faces_alike && !seen.is_extrapolated && distance.abs() <= WALL_PX * candidate.footprint;
    let covers = is_wall.then_some(distance);
    let sight = if distance.abs() <= tolerance {
        if faces_alike {
            Sight::Same(SameSurface {
                distance,
                normal,
                cosine: -normal.dot(&ray) / ray.norm(),
                footprint: view.footprint(seen.depth),
                confidence: seen.confidence,
                makes_points: seen.makes_points,
            })
        } else {
            Sight::Nothing
        }
    } else if gap < 0.0 {
        Sight::Hidden
    } else if gap > 2.0 * tolerance.max(candidate.footprint) {
        Sight::SeenThrough
    } else {
        Sight::Nothing
    };
    (sight, covers)
}
