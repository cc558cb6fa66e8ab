//! Stage 1: decoded photos to linear images with intrinsics, masks and a preflight.
//!
//! In: a decoded photo, its mask and its camera where the user gave them, one photo at a time
//! ([`prepare`]); then all usable photos together ([`assemble`]).
//! Out: a [`PhotoSet`] and a [`PhotosReport`] that lists every photo with what was found.

pub mod encoding;
pub mod error;
pub mod options;
pub mod report;

pub use encoding::linearize;
pub use error::PhotosError;
pub use options::{Encoding, PhotosOptions};
pub use report::{AppliedEncoding, CameraGroup, PhotoFacts, PhotosReport, RejectedPhoto};

use rilievo_scene::{
    DecodedPhoto, Intrinsics, LinearImage, Mask, PhotoSet, PixelSource, RigidTransform,
};
use std::sync::Arc;

/// A camera that the user gave for a photo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenCamera {
    /// Intrinsics.
    pub intrinsics: Intrinsics,
    /// Pose, where given.
    pub cam_from_world: Option<RigidTransform>,
}

/// A usable photo. To keep a large set out of memory, store `image` and replace `pixels` by a
/// source that reads it back.
#[derive(Clone, Debug)]
pub struct PreparedPhoto {
    /// Its pixels.
    pub pixels: Arc<dyn PixelSource>,
    /// Its object mask, where the user gave masks.
    pub mask: Option<Arc<Mask>>,
    /// Everything else; serialisable.
    pub facts: PhotoFacts,
}

impl PreparedPhoto {
    /// A photo whose pixels are in memory.
    pub fn in_memory(image: LinearImage, mask: Option<Mask>, facts: PhotoFacts) -> Self {
        Self {
            pixels: Arc::new(rilievo_scene::InMemoryPixels(Arc::new(image))),
            mask: mask.map(Arc::new),
            facts,
        }
    }
}

/// Makes a linear image of a decoded photo and checks everything that is known of it.
///
/// # Errors
/// Why the photo cannot be used; other photos may be.
pub fn prepare(
    _decoded: DecodedPhoto,
    _mask: Option<Mask>,
    _camera: Option<GivenCamera>,
    _options: &PhotosOptions,
) -> Result<PreparedPhoto, PhotosError> {
    Err(PhotosError::NoPhotos)
}

/// Orders photos by file name, groups them by camera, and reports on the set.
///
/// # Errors
/// When no photo is left, or two have the same name.
pub fn assemble(
    _photos: Vec<PreparedPhoto>,
    _options: &PhotosOptions,
) -> Result<(PhotoSet, PhotosReport), PhotosError> {
    Err(PhotosError::NoPhotos)
}
