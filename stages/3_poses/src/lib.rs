//! Stage 3: verified matches to camera poses, sparse points and depth anchors.

pub mod anchors;
pub mod error;
pub mod options;
pub mod report;

pub use error::PosesError;
pub use options::{GivenPoses, PosesOptions, RefineIntrinsics};
pub use report::{AdjustmentReport, PosesReport, ViewReport};

use rilievo_scene::{FeatureMatches, Observer, PhotoSet, PosedViews, SphereRequest};

/// Finds the poses of a photo set, its sparse points, its scale and its anchors.
///
/// # Errors
/// When the photos do not determine poses, given poses contradict them, or the observer asked to
/// stop.
pub fn run(
    photos: &PhotoSet,
    _matches: &FeatureMatches,
    _sphere: Option<&SphereRequest>,
    options: &PosesOptions,
    _observer: &dyn Observer,
) -> Result<(PosedViews, PosesReport), PosesError> {
    options.validate()?;
    Err(PosesError::TooFewPhotos {
        num_photos: photos.photos.len(),
    })
}
