//! Photos with their pixels and cameras.

use super::cone::SphereInCamera;
use super::error::SphereError;
use rilievo_scene::{
    Intrinsics, LinearImage, LocatedSphere, PackedMask, PhotoIdx, PhotoSet, PosedView,
    RigidTransform,
};
use std::sync::Arc;

/// A photo in which a sphere may be seen, with or without a pose.
pub(super) struct Photo<'a> {
    pub image: &'a LinearImage,
    pub intrinsics: &'a Intrinsics,
    pub object: Option<&'a PackedMask>,
    pub clip_level: f32,
}

impl Photo<'_> {
    /// Whether a pixel shows the object.
    pub fn is_object(&self, x: isize, y: isize) -> bool {
        self.object.is_some_and(|mask| mask.contains(x, y))
    }
}

/// A posed photo with its pixels.
#[derive(Clone, Debug)]
pub struct PosedImage {
    /// The photo.
    pub photo: PhotoIdx,
    /// Linear pixels.
    pub image: Arc<LinearImage>,
    /// Camera.
    pub intrinsics: Intrinsics,
    /// Pose, in the world's unit.
    pub cam_from_world: RigidTransform,
    /// Object mask: no outline is looked for on it.
    pub object: Option<Arc<PackedMask>>,
    /// Linear value from which a channel counts as clipped.
    pub clip_level: f32,
}

impl PosedImage {
    /// The whole photo of a posed view.
    ///
    /// # Errors
    /// [`SphereError::Pixels`].
    pub fn load(photos: &PhotoSet, view: &PosedView) -> Result<Self, SphereError> {
        let photo = &photos.photos[view.photo.0];
        Ok(Self {
            photo: view.photo,
            image: photo.linear()?,
            intrinsics: view.intrinsics,
            cam_from_world: view.cam_from_world,
            object: photo.mask.clone(),
            clip_level: photo.clip_level,
        })
    }

    /// The sphere in this camera's frame.
    pub fn sphere(&self, located: &LocatedSphere) -> SphereInCamera {
        SphereInCamera::seen(located, &self.cam_from_world)
    }

    /// The photo without its pose.
    pub(super) fn as_photo(&self) -> Photo<'_> {
        Photo {
            image: &self.image,
            intrinsics: &self.intrinsics,
            object: self.object.as_deref(),
            clip_level: self.clip_level,
        }
    }
}
