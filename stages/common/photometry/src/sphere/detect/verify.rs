//! A candidate against what only a sphere shows.
//!
//! 1. Outline: the edge follows one cone around most of the visible outline.
//! 2. Shading: nine harmonics over the exact normals of that cone explain the pixels inside it.
//!    Flat things, faces and textured patches leave several times the residual of a sphere.

use super::votes::Circle;
use crate::sphere::cone::OutlineCone;
use crate::sphere::mark::{MIN_INLIER_SHARE, cone_from_points, outline_of_mark};
use crate::sphere::options::SphereOptions;
use crate::sphere::posed_image::Photo;
use crate::sphere::refine::{Effort, MIN_EDGE_SUPPORT, refine_outline};
use crate::sphere::shading::{Shading, shading};
use nalgebra::Point2;
use rilievo_scene::SphereMark;

/// A verified candidate in one photo.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub cone: OutlineCone,
    pub outline: Vec<Point2<f64>>,
    /// Share of the searched outline that lies on the cone.
    pub support: f64,
    /// Share of the outline inside the frame and not hidden by the object.
    pub visible: f64,
    /// Relative residual of nine harmonics, and what they explain.
    pub shading: Shading,
    /// Whether a proposal has used it.
    pub is_spent: bool,
}

impl Candidate {
    /// Higher is better; both terms lie between 0 and about 1.
    pub fn score(&self, options: &SphereOptions) -> f64 {
        self.support
            * self.visible.sqrt()
            * (1.0 - 0.5 * (self.shading.residual / options.max_shading_residual).min(2.0))
    }
}

/// Share of a refined outline that must lie on one cone: less than of a mark, since edges of the ground
/// beside the sphere are among its points.
const LOOSE_INLIER_SHARE: f64 = 0.3;

/// Refines a circle to a cone and measures it; `None` where no edge follows it.
pub(super) fn verify(photo: &Photo, circle: &Circle) -> Option<Candidate> {
    let mark = SphereMark::Circle {
        center_px: circle.center,
        radius_px: circle.radius,
    };
    let start =
        cone_from_points(&outline_of_mark(&mark), photo.intrinsics, MIN_INLIER_SHARE).ok()?;
    let mut cone = start.cone;
    let mut best = None;
    // From the tenth of the radius that voting leaves open down to the width of the edge.
    for search_px in [
        (0.12 * circle.radius).max(4.0),
        (0.06 * circle.radius).max(3.0),
        3.0,
        2.0,
    ] {
        let found = refine_outline(photo, &cone.sphere(1.0), search_px, Effort::Quick);
        if found.visible_share() < 0.3 {
            return None;
        }
        let fit = cone_from_points(&found.points, photo.intrinsics, LOOSE_INLIER_SHARE).ok()?;
        cone = fit.cone;
        let support = fit.inliers.len() as f64 / found.num_searched.max(1) as f64;
        // Most circles follow no edge at all: they need no second look.
        if support < 0.5 * MIN_EDGE_SUPPORT {
            return None;
        }
        best = Some((fit, support, found.visible_share()));
    }
    let (fit, support, visible) = best?;
    if support < MIN_EDGE_SUPPORT {
        return None;
    }
    let shading = shading(photo, &cone)?;
    Some(Candidate {
        cone,
        outline: fit.inliers,
        support,
        visible,
        shading,
        is_spent: false,
    })
}
