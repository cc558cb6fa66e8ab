//! Errors of stage 6.

use rilievo_scene::{
    CloudError, Inconsistent, Observer, OptionError, PixelError, ScratchError, StageId, TeamError,
};

/// Why the views could not be fused.
#[derive(Debug, Clone, thiserror::Error)]
pub enum FusionError {
    /// An option has a value that makes no sense.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// What an earlier stage left contradicts itself.
    #[error(transparent)]
    Inconsistent(#[from] Inconsistent),
    /// No view has any depth.
    #[error("none of the {num_views} views has a depth map with values; run stage 5 first")]
    NoDepth {
        /// Views given.
        num_views: usize,
    },
    /// A view's maps do not belong to its camera.
    #[error(
        "the {what} of {view} is {got:?} pixels and its camera is {expected:?}; give maps and \
         cameras of the same photos"
    )]
    SizeMismatch {
        /// The view.
        view: String,
        /// Which map.
        what: &'static str,
        /// Its size, columns and rows.
        got: (usize, usize),
        /// The camera's size.
        expected: (usize, usize),
    },
    /// A view of the maps is not among the posed ones.
    #[error("maps are given for view {view_idx} ({view}), but only {num_posed} views have a pose")]
    NoCamera {
        /// The view.
        view: String,
        /// Its index.
        view_idx: usize,
        /// Posed views.
        num_posed: usize,
    },
    /// No point passed the checks.
    #[error(
        "no surface point is confirmed by {min_num_views} views ({num_candidates} candidates): the \
         views do not overlap or lie more than {tolerance_px} pixels apart; check the poses (--cameras), or \
         lower fusion.min_num_views"
    )]
    NothingAgrees {
        /// Points that were tried.
        num_candidates: usize,
        /// Views that had to agree.
        min_num_views: usize,
        /// Tolerance in pixel footprints.
        tolerance_px: f64,
    },
    /// The memory allowed does not hold what is worked on at once.
    #[error(
        "fusion needs {needed_mib} MiB to load one view; give it --memory {needed_mib}M or more, or smaller maps"
    )]
    OutOfMemory {
        /// What it was given, MiB.
        given_mib: usize,
        /// The smallest memory that would do, MiB.
        needed_mib: usize,
    },
    /// Another process of the run failed.
    #[error(transparent)]
    Team(#[from] TeamError),
    /// Working data could not be put aside or read back.
    #[error(transparent)]
    Scratch(#[from] ScratchError),
    /// Whoever takes the cloud could not.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// Pixels of a photo or a map could not be loaded.
    #[error(transparent)]
    Pixels(#[from] PixelError),
    /// The observer asked to stop.
    #[error("interrupted")]
    Interrupted,
}

/// Hands a warning to the observer, who may end the stage.
pub(crate) fn warn(observer: &dyn Observer, message: String) -> Result<(), FusionError> {
    let flow = observer.warn(StageId::Fusion, message);
    flow.ok_or(FusionError::Interrupted)
}
