//! Errors of stage 2.

use rilievo_scene::{Inconsistent, OptionError, PixelError, TeamError};

/// Why stage 2 failed.
#[derive(Debug, thiserror::Error)]
pub enum FeaturesError {
    /// An option is out of range.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// What an earlier stage left contradicts itself.
    #[error(transparent)]
    Inconsistent(#[from] Inconsistent),
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
    /// None of the listed pairs is one of two of the photos.
    #[error(
        "none of the {num} listed pairs names two of the photos: list them by file names, one pair a line"
    )]
    NoListedPair {
        /// Pairs listed.
        num: usize,
    },
    /// Another process of the run failed.
    #[error(transparent)]
    Team(#[from] TeamError),
    /// The observer asked to stop.
    #[error("interrupted")]
    Interrupted,
}
