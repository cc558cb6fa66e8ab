//! Why a photo, or a set of photos, cannot be used.

use rilievo_scene::OptionError;
use thiserror::Error;

/// A photo or a set that cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum PhotosError {
    /// An option is out of its range.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// The photo is too small to hold an object.
    #[error(
        "{photo}: {} x {} pixels are too few; at least {min} on each side are needed",
        size.0, size.1
    )]
    TooSmall {
        /// The photo.
        photo: String,
        /// Columns and rows.
        size: (usize, usize),
        /// Fewest pixels on a side.
        min: usize,
    },
    /// The decoded samples do not fill the frame.
    #[error(
        "{photo}: {found} samples, {expected} expected for {} x {} x {channels}", size.0, size.1
    )]
    Samples {
        /// The photo.
        photo: String,
        /// Samples found.
        found: usize,
        /// Samples expected.
        expected: usize,
        /// Columns and rows.
        size: (usize, usize),
        /// Channels.
        channels: usize,
    },
    /// No pixel is a finite number.
    #[error(
        "{photo}: none of its pixels holds finite numbers, all are NaN or infinite; export it anew \
         from the original"
    )]
    NotFinite {
        /// The photo.
        photo: String,
    },
    /// A value that no photo holds.
    #[error(
        "{photo}: holds the value {value:e} where white is 1, which no photo does; export it anew from the \
         original"
    )]
    Beyond {
        /// The photo.
        photo: String,
        /// The value.
        value: f32,
    },
    /// Every pixel is black.
    #[error("{photo}: every pixel is black; is the lens cap off?")]
    Black {
        /// The photo.
        photo: String,
    },
    /// Every pixel is clipped.
    #[error("{photo}: overexposed everywhere, every pixel is white; expose less")]
    Overexposed {
        /// The photo.
        photo: String,
    },
    /// Every pixel has the same value, neither black nor clipped.
    #[error(
        "{photo}: every pixel has the same value {value}, so nothing is to be seen; leave it out"
    )]
    Blank {
        /// The photo.
        photo: String,
        /// The linear value.
        value: f32,
    },
    /// Masks were given, but none belongs to this photo.
    #[error(
        "{photo}: no mask belongs to it among {num_masks} files in {folder}; name it {expected}"
    )]
    MaskMissing {
        /// The photo.
        photo: String,
        /// Files in the masks' folder.
        num_masks: usize,
        /// The masks' folder.
        folder: String,
        /// A name that would have been found.
        expected: String,
    },
    /// The mask has another size than the photo.
    #[error(
        "mask of {photo} has {} x {} pixels, the photo {} x {}; export it at the photo's size, as \
         stored or upright as EXIF turns the photo", mask_size.0, mask_size.1, size.0, size.1
    )]
    MaskSize {
        /// The photo.
        photo: String,
        /// Columns and rows of the mask.
        mask_size: (usize, usize),
        /// Those of the photo.
        size: (usize, usize),
    },
    /// The mask has no object pixel, or hardly any.
    #[error("mask of {photo} is black: {num_pixels} object pixels; white must mark the object")]
    MaskEmpty {
        /// The photo.
        photo: String,
        /// Object pixels.
        num_pixels: usize,
    },
    /// The mask marks the whole frame.
    #[error(
        "mask of {photo} is white everywhere; leave it away, or mark the object alone in white"
    )]
    MaskFull {
        /// The photo.
        photo: String,
    },
    /// The mask marks most of the frame's border but not its middle.
    #[error(
        "mask of {photo} is probably inverted: it marks {border_percent:.0} % of the frame's \
         border and leaves out the middle; white must mark the object"
    )]
    MaskInverted {
        /// The photo.
        photo: String,
        /// Share of the border that the mask marks, per cent.
        border_percent: f64,
    },
    /// The mask's pixels have nothing to do with their neighbours.
    #[error(
        "mask of {photo} is noise: object and rest are mixed pixel by pixel (correlation of \
         neighbours {correlation:.2}, of masks above 0.5); white must mark the object, in one piece or a few"
    )]
    MaskNoise {
        /// The photo.
        photo: String,
        /// Correlation of neighbouring pixels.
        correlation: f64,
    },
    /// The given camera belongs to an image of another size.
    #[error(
        "camera of {photo} is for {} x {} pixels, the photo has {} x {}; give the camera for this \
         size (a rotated photo keeps the sensor's frame)",
        camera_size.0, camera_size.1, size.0, size.1
    )]
    CameraSize {
        /// The photo.
        photo: String,
        /// Columns and rows of the camera.
        camera_size: (usize, usize),
        /// Those of the photo.
        size: (usize, usize),
    },
    /// The given camera has a focal length that no lens has.
    #[error(
        "camera of {photo} has a focal length of {focal_px:e} pixels; {min_px:.0} to {max_px:.0} are \
         usable for a photo of this size: give it in pixels, not in millimetres"
    )]
    CameraFocal {
        /// The photo.
        photo: String,
        /// What was given.
        focal_px: f64,
        /// Smallest that a lens has.
        min_px: f64,
        /// Largest that a lens has.
        max_px: f64,
    },
    /// Two photos would write the same artifacts.
    #[error("{first} and {second} both have the name {name}, which names the results; rename one")]
    DuplicateName {
        /// The name without ending.
        name: String,
        /// One photo.
        first: String,
        /// The other.
        second: String,
    },
    /// Colour and grey photos in one set.
    #[error("{grey} is grey and {color} has colours; convert all photos to one kind")]
    MixedChannels {
        /// A grey photo.
        grey: String,
        /// A colour photo.
        color: String,
    },
    /// The photos' levels differ by more than one light and exposure can explain.
    #[error(
        "brightness differs by {spread_ev:.1} EV between {dark} and {bright}, and EXIF does not tell \
         the exposures: automatic exposure? Shoot with fixed exposure, keep EXIF, leave out the odd \
         photos, or force it with photos.max_level_spread_ev"
    )]
    Exposure {
        /// Largest over smallest median level, EV.
        spread_ev: f64,
        /// The darkest photo.
        dark: String,
        /// The brightest photo.
        bright: String,
    },
    /// There is no usable photo.
    #[error("no usable photo")]
    NoPhotos,
    /// The observer asked to stop.
    #[error("interrupted")]
    Interrupted,
}
