//! Stage 1: decoded photos to linear images with intrinsics, masks and a preflight.
//!
//! In: a decoded photo, its mask and its camera where the user gave them, one photo at a time
//! ([`prepare`]); then all usable photos together ([`assemble`]).
//! Out: a [`PhotoSet`](rilievo_scene::PhotoSet) and a [`PhotosReport`] that lists every photo with
//! what was found.
//!
//! Steps, each in its module:
//! 1. `encoding`: stored samples to linear intensities, by the file's metadata or the user's word;
//! 2. `mask`: refuse masks that cannot be an object's; `edges`: whether their border lies on edges; `outline`: how far
//!    beyond the object's outline;
//! 3. `focal`: the camera before poses, from the best source there is;
//! 4. `measures`: level, clipping, noise, sharpness and colour for the preflight;
//! 5. `exposure`: photos brought to one exposure by EXIF;
//! 6. `assemble`: order, groups of photos that share a camera, spreads over the set, warnings.
//!
//! `table` writes the preflight for people.
//!
//! Pixels are never rotated or scaled: everything is in the frame of the pixels as stored. EXIF's
//! orientation is noted, and masks that were drawn over the photo as EXIF turns it are turned back.

mod assemble;
mod edges;
mod encoding;
mod error;
mod exposure;
mod findings;
mod focal;
mod mask;
mod measures;
mod options;
mod outline;
mod prepare;
mod report;
mod table;
mod vignetting;

pub use assemble::assemble;
pub use encoding::linearize;
pub use error::PhotosError;
pub use options::{Encoding, PhotosOptions, RETIRED_KEYS};
pub use outline::MaskOutline;
pub use prepare::{GivenCamera, GivenMask, PreparedPhoto, prepare};
pub use report::{AppliedEncoding, CameraGroup, CutOut, PhotoFacts, PhotosReport, RejectedPhoto};

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 9;
