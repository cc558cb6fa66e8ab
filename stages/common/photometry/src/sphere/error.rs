//! Why a sphere could not be located.

use rilievo_scene::{PhotoIdx, PixelError};

/// Failures of the sphere's geometry.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SphereError {
    /// A radius that no sphere has.
    #[error("sphere radius {radius} is not usable: give a positive length in metres")]
    Radius {
        /// What was given.
        radius: f64,
    },
    /// The outlines in metric cameras give another radius.
    #[error(
        "sphere radius stated as {stated:.4} m, but its outlines in {views} photos give \
         {observed:.4} m where the given cameras or the known distance set the scale: check the \
         radius, its unit (metres), and what set the scale"
    )]
    RadiusMismatch {
        /// Stated radius, metres.
        stated: f64,
        /// Radius from the outlines, metres.
        observed: f64,
        /// Photos that agree on it.
        views: usize,
    },
    /// Too few outline points.
    #[error(
        "{available} different outline points, at least {needed} are needed: mark points all around the \
         outline"
    )]
    TooFewPoints {
        /// What there is.
        available: usize,
        /// What is needed.
        needed: usize,
    },
    /// Outline points that leave the outline's size open: on a line, on a short arc, or in one place.
    #[error(
        "its {available} outline points determine no ellipse: they lie on a line, on a short arc or in \
         one place, so that an error of {sigma_px:.1} px in each changes the outline's size by {}; \
         mark points all around the outline", percent(*.relative_sigma)
    )]
    OpenOutline {
        /// Distinct points.
        available: usize,
        /// Relative standard deviation of the outline's radius.
        relative_sigma: f64,
        /// Standard deviation of a point, pixels.
        sigma_px: f64,
    },
    /// The mark is no outline of a sphere.
    #[error(
        "not the outline of a sphere: {:.0} % of the outline lie on one cone (at least {:.0} % \
         expected, RMS {rms_px:.2} px)", 100.0 * inlier_share, 100.0 * needed
    )]
    NotADisc {
        /// Share of the outline points on the best cone.
        inlier_share: f64,
        /// Share that is needed.
        needed: f64,
        /// Distance of those points from it.
        rms_px: f64,
    },
    /// No view sees the sphere.
    #[error("the sphere is marked in no photo that got a pose: mark it in two that did")]
    NoView,
    /// A stated centre that no camera sees.
    #[error(
        "its stated centre ({:.4}, {:.4}, {:.4}) with the radius {radius:.4} lies in the frame of none of \
         the {views} cameras: check centre, unit and axes, or mark it in two photos",
        center[0], center[1], center[2]
    )]
    OutOfSight {
        /// The centre in the world, as stated.
        center: [f64; 3],
        /// The radius, as stated.
        radius: f64,
        /// Cameras that were tried.
        views: usize,
    },
    /// A stated centre without the frame that it is stated in.
    #[error(
        "its centre is stated in the frame of given cameras, but the poses were found from the photos: \
         give cameras with a pose for every photo (--cameras), or mark it in two photos"
    )]
    NoFrame,
    /// A stated centre and a radius in another unit.
    #[error(
        "its centre is stated in the unit of the given cameras, which they do not name, and its radius is \
         stated in metres: name the cameras' unit, mark it in two photos, or state the radius in the \
         cameras' unit with \"unit\": \"arbitrary\""
    )]
    NoUnit,
    /// The sphere in one view alone does not fix the scale of several views.
    #[error(
        "the sphere is marked in one posed photo only: scale needs two, seen from directions \
         that differ; mark it in a second photo"
    )]
    OneView,
    /// The views do not agree on one sphere.
    #[error(
        "the marks contradict each other: the best centre agrees with {agreeing} of {total} \
         photos (the worst is off by {worst_px:.1} px); check that all mark the same sphere"
    )]
    Contradiction {
        /// Views that agree.
        agreeing: usize,
        /// Views with a mark.
        total: usize,
        /// The photo that fits worst.
        worst: PhotoIdx,
        /// Its residual.
        worst_px: f64,
    },
    /// Two spheres stand where only one can.
    #[error("it stands in the place of {other}: the same ball is marked twice")]
    SamePlace {
        /// Name of the sphere that is kept.
        other: String,
    },
    /// The camera is inside the sphere or it lies behind.
    #[error("the sphere would contain a camera or lie behind all of them: check its radius")]
    Impossible,
    /// Nothing that looks like a matte sphere in the photos.
    #[error("no matte sphere found in the photos: {why}")]
    NotFound {
        /// How far the search came.
        why: String,
    },
    /// Pixels of a photo could not be had.
    #[error(transparent)]
    Pixels(#[from] PixelError),
}

/// A share as text; digits of what exceeds the whole mean nothing.
fn percent(share: f64) -> String {
    if share < 1.0 {
        format!("{:.0} %", 100.0 * share)
    } else {
        "more than 100 %".to_owned()
    }
}
