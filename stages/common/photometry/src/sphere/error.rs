//! Why a sphere could not be located.

use rilievo_scene::{OptionError, PhotoIdx};

/// Failures of the sphere's geometry.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SphereError {
    /// An option out of range.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
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
    /// Too few outline points inside the frame.
    #[error("{available} outline points inside the frame, at least {needed} are needed")]
    TooFewPoints {
        /// What there is.
        available: usize,
        /// What is needed.
        needed: usize,
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
    Pixels(#[from] PixelFailure),
}

/// A photo whose pixels could not be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("pixels of {name} cannot be read: {reason}")]
pub struct PixelFailure {
    /// The photo.
    pub name: String,
    /// What went wrong.
    pub reason: String,
}

impl From<rilievo_scene::PixelError> for SphereError {
    fn from(error: rilievo_scene::PixelError) -> Self {
        Self::Pixels(PixelFailure {
            name: error.name,
            reason: error.reason,
        })
    }
}
