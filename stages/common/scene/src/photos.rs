//! Output of stage 1: linear photos with intrinsics and masks.

use crate::camera::{FocalSource, Intrinsics};
use crate::ids::PhotoIdx;
use crate::orientation::Orientation;
use crate::packed_mask::PackedMask;
use crate::raster::LinearImage;
use crate::transform::RigidTransform;
use std::sync::Arc;

/// Why the pixels of a photo could not be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("pixels of {name} cannot be read: {reason}")]
pub struct PixelError {
    /// The photo.
    pub name: String,
    /// What went wrong.
    pub reason: String,
}

/// Gives the linear pixels of a photo when asked, so that a large set need not be in memory at once.
pub trait PixelSource: Send + Sync + std::fmt::Debug {
    /// Loads (or hands out) the pixels.
    ///
    /// # Errors
    /// When the backing store cannot be read.
    fn load(&self) -> Result<Arc<LinearImage>, PixelError>;
}

/// Pixels that are already in memory.
#[derive(Debug, Clone)]
pub struct InMemoryPixels(pub Arc<LinearImage>);

impl PixelSource for InMemoryPixels {
    fn load(&self) -> Result<Arc<LinearImage>, PixelError> {
        Ok(self.0.clone())
    }
}

/// One usable photo.
#[derive(Debug, Clone)]
pub struct Photo {
    /// File name with its ending, unique in the set.
    pub file_name: String,
    /// File name without its ending: names every artifact of this photo.
    pub name: String,
    /// Pixels, linear, 1 or 3 channels.
    pub pixels: Arc<dyn PixelSource>,
    /// Camera as known before poses (never rotated behind the user's back).
    pub intrinsics: Intrinsics,
    /// Where the focal length came from.
    pub focal_source: FocalSource,
    /// Photos of one group share their intrinsics (same body, lens, zoom and size).
    pub camera_group: usize,
    /// How EXIF turns it for display; pixels, mask and camera are as stored.
    pub orientation: Orientation,
    /// Object mask, `None` when the user gave no masks.
    pub mask: Option<Arc<PackedMask>>,
    /// Linear value at and above which a channel counts as clipped.
    pub clip_level: f32,
    /// Pose given by the user.
    pub given_cam_from_world: Option<RigidTransform>,
}

/// All usable photos, ordered by file name.
#[derive(Debug, Clone, Default)]
pub struct PhotoSet {
    /// The photos.
    pub photos: Vec<Photo>,
}

impl PhotoSet {
    /// Index of the photo with a file name, given with or without its ending.
    pub fn find(&self, name: &str) -> Option<PhotoIdx> {
        self.photos
            .iter()
            .position(|photo| photo.file_name == name)
            .or_else(|| self.photos.iter().position(|photo| photo.name == name))
            .map(PhotoIdx)
    }
}
