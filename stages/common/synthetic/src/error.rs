//! What can go wrong when a scene is made or results are compared.

use rilievo_scene::OptionError;

/// Errors of scenes and comparisons.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SyntheticError {
    /// An option has a value that makes no sense.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// The implicit shape has no surface in its box.
    #[error("the shape has no surface inside its bounding box (seed {seed})")]
    EmptyShape {
        /// Seed of the scene.
        seed: u64,
    },
    /// A given mesh is no surface.
    #[error("the mesh cannot be photographed: {reason}")]
    Mesh {
        /// Why.
        reason: String,
    },
    /// A photo beyond the last one.
    #[error("there is no photo {idx}: the scene has {num_views}")]
    NoSuchView {
        /// The index asked for.
        idx: usize,
        /// Number of photos.
        num_views: usize,
    },
    /// An alignment was asked for that the cameras in common do not determine.
    #[error(
        "{alignment} alignment needs {needed} cameras that both sides know, and there are {found}"
    )]
    TooFewCameras {
        /// The alignment asked for.
        alignment: &'static str,
        /// How many it needs.
        needed: usize,
        /// How many there are.
        found: usize,
    },
    /// All camera centres coincide, so that no scale can be read from them.
    #[error("the {side} cameras all stand in one place: a similarity has no scale there")]
    CoincidentCameras {
        /// "estimated" or "true".
        side: &'static str,
    },
    /// Two maps of one view have different sizes.
    #[error("the {what} of view {view} is {got:?} pixels, the truth is {expected:?}")]
    SizeMismatch {
        /// The view.
        view: String,
        /// Which map.
        what: &'static str,
        /// Its size, columns and rows.
        got: (usize, usize),
        /// The size it should have.
        expected: (usize, usize),
    },
}
