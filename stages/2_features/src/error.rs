//! Errors of stage 2.

use rilievo_scene::{OptionError, PixelError};

/// Why stage 2 failed.
#[derive(Debug, thiserror::Error)]
pub enum FeaturesError {
    /// An option is out of range.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// Photos and keypoints do not belong together.
    #[error("{num_keypoint_lists} keypoint lists for {num_photos} photos")]
    CountMismatch {
        /// Photos in the set.
        num_photos: usize,
        /// Keypoint lists given.
        num_keypoint_lists: usize,
    },
    /// A photo could not be read.
    #[error(transparent)]
    Pixels(#[from] PixelError),
    /// OpenCV refused a call.
    #[error("opencv failed to {action}: {source}")]
    OpenCv {
        /// What was being done.
        action: &'static str,
        /// OpenCV's message.
        source: opencv::Error,
    },
    /// The observer asked to stop.
    #[error("interrupted")]
    Interrupted,
}
