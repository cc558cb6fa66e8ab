//! Why there is no outline.

/// Why the object cannot be told from what stands around it.
#[derive(Debug, thiserror::Error)]
pub enum SegmentationError {
    /// Too few points stand out from their surroundings.
    #[error(
        "only {found} matched points stand together in the middle of what the photos look at ({needed} are needed): the \
         object cannot be told from what stands around it; draw the masks in an image editor"
    )]
    FewPoints {
        /// Points of the largest group.
        found: usize,
        /// Fewest that are enough.
        needed: usize,
    },
    /// The object is not in this photo.
    #[error(
        "{photo}: too few points of the object lie in this photo; draw its mask in an image editor"
    )]
    NotInPhoto {
        /// The photo's file name.
        photo: String,
    },
    /// The object does not stand before a plain backdrop.
    #[error("{photo}: no mask can be proposed: {reason}")]
    NoBackdrop {
        /// The photo's file name.
        photo: String,
        /// Why, and what to try.
        reason: &'static str,
    },
    /// OpenCV failed.
    #[error("the library that cuts masks failed ({0}); draw the masks in an image editor")]
    OpenCv(#[from] opencv::Error),
}
