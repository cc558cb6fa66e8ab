//! Why there is no lighting.

use rilievo_photometry::harmonics::FitError;
use rilievo_photometry::sphere::SphereError;
use rilievo_scene::{Inconsistent, Observer, OptionError, PixelError, StageId, first_and_more};

/// Failures of stage 4.
#[derive(Clone, Debug, thiserror::Error)]
pub enum LightingError {
    /// An option out of range.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// What an earlier stage left contradicts itself.
    #[error(transparent)]
    Inconsistent(#[from] Inconsistent),
    /// No photo has a pose.
    #[error(
        "no photo has a pose, so no lighting can be fitted: give the poses (--cameras), or more photos"
    )]
    NoView,
    /// Lighting was to come from a sphere, but none was located.
    #[error(
        "no reference sphere was located: {}; or give the lighting (--lighting), a shape \
         (--lighting-shape), or do without (--sphere none)",
        why.as_deref().unwrap_or("mark it in two photos (--sphere FILE.json)")
    )]
    NoSphere {
        /// What hindered it, and what to try, where that is known.
        why: Option<String>,
    },
    /// The sphere is known, but no photo shows enough of it.
    #[error("no photo shows enough of the sphere: {}; mark it anew (--sphere FILE.json), or do without (--sphere none)", reasons.join("; "))]
    SphereUnusable {
        /// One reason per photo.
        reasons: Vec<String>,
    },
    /// A fit failed.
    #[error(
        "lighting of {of}: {source}; give the light (--lighting), or do without its source (--sphere none)"
    )]
    Fit {
        /// Of what.
        of: String,
        /// Why.
        source: FitError,
    },
    /// A calibration sphere could not be located.
    #[error(
        "calibration sphere of {of}: {source}; mark it anew (--sphere FILE.json), or do without (--sphere none)"
    )]
    Sphere {
        /// The photo.
        of: String,
        /// Why.
        source: SphereError,
    },
    /// A calibration photo names a photo that has no pose.
    #[error(
        "calibration photo {name} is taken from the camera of {camera}, which has no pose: name another photo in the sphere's file (--sphere FILE.json)"
    )]
    CalibrationCamera {
        /// The calibration photo.
        name: String,
        /// The photo it names.
        camera: String,
    },
    /// The file has no lighting for some views.
    #[error(
        "the lighting given has no entry for {}: add it, or have the light found (no --lighting)",
        first_and_more(views.iter().map(String::as_str)).unwrap_or_default()
    )]
    GivenMissing {
        /// Their names.
        views: Vec<String>,
    },
    /// A calibration photo has other channels than the photos.
    #[error("{name} has {found} channel(s), the photos have {photos}: convert it to their kind")]
    CalibrationChannels {
        /// Its name.
        name: String,
        /// Its channels.
        found: usize,
        /// Those of the photos.
        photos: usize,
    },
    /// A shape has another size than its view.
    #[error("shape of {name} is {width}x{height}, the photo {photo_width}x{photo_height}")]
    ShapeSize {
        /// The view.
        name: String,
        /// Columns of the shape.
        width: usize,
        /// Rows of the shape.
        height: usize,
        /// Columns of the photo.
        photo_width: usize,
        /// Rows of the photo.
        photo_height: usize,
    },
    /// No shape for any view.
    #[error(
        "no shape was given for any posed photo: name its maps as the photos (--lighting-shape)"
    )]
    NoShape,
    /// Too few depth anchors for a light without a sphere.
    #[error(
        "without a sphere or a shape the light is estimated on depth anchors, of which there are \
         {available} (at least {needed} needed): take more photos with texture, or use a sphere \
         (--sphere), or give the light (--lighting)"
    )]
    TooFewAnchors {
        /// What there is.
        available: usize,
        /// What is needed.
        needed: usize,
    },
    /// Pixels of a photo could not be had.
    #[error(transparent)]
    Pixels(#[from] PixelError),
    /// The observer asked to stop.
    #[error("interrupted")]
    Interrupted,
}

/// Tells the user of something; the stage goes on.
pub(crate) fn warn(observer: &dyn Observer, message: String) -> Result<(), LightingError> {
    let flow = observer.warn(StageId::Lighting, message);
    flow.ok_or(LightingError::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_an_option_that_helps() {
        let name = || "a.jpg".to_owned();
        let cases = [
            (LightingError::NoView, "--cameras"),
            (
                LightingError::SphereUnusable {
                    reasons: vec![name()],
                },
                "--sphere none",
            ),
            (
                LightingError::CalibrationCamera {
                    name: name(),
                    camera: name(),
                },
                "--sphere FILE.json",
            ),
            (
                LightingError::GivenMissing {
                    views: vec![name()],
                },
                "--lighting",
            ),
            (LightingError::NoShape, "--lighting-shape"),
            (
                LightingError::TooFewAnchors {
                    available: 3,
                    needed: 50,
                },
                "--lighting",
            ),
        ];
        for (error, option) in cases {
            assert!(error.to_string().contains(option), "{error}");
        }
    }
}
