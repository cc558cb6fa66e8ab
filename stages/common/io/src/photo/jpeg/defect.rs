//! What the walk over a JPEG file finds wrong.

/// What is wrong with a JPEG file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Defect {
    /// The file ends before its end-of-image marker.
    #[error("the JPEG is cut off: it ends after {0} bytes without its end marker")]
    CutOff(usize),
    /// Four colour components.
    #[error("CMYK images have no red, green and blue to measure")]
    Cmyk,
    /// A frame of zero size, a lossless or arithmetic frame, or no frame at all.
    #[error("the JPEG is damaged: {0}")]
    Damaged(&'static str),
    /// The coded data do not fit the frame.
    #[error("the JPEG is damaged: its image data make no sense at row {row} of {height} or before")]
    Scan {
        /// Row of pixels at which it shows.
        row: usize,
        /// Rows of the photo.
        height: usize,
    },
    /// The coded data go on after the last pixel.
    #[error("the JPEG is damaged: {0} bytes of image data are left after the last pixel")]
    Left(usize),
}
