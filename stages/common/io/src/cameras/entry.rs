//! What camera files of every kind hold.

use super::photo_names::last_part;
use rilievo_scene::{Intrinsics, PosedViews, RigidTransform, Unit, WorldFrame};
use std::collections::HashSet;

/// One camera of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraEntry {
    /// The photo's file name; absent in a `camera.json` of one view.
    pub image: Option<String>,
    /// Intrinsics.
    pub intrinsics: Intrinsics,
    /// Pose, where the file has one.
    pub cam_from_world: Option<RigidTransform>,
}

/// A camera file of any kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFile {
    /// Unit of the world frame.
    pub unit: Unit,
    /// The cameras, in the file's order.
    pub cameras: Vec<CameraEntry>,
    /// Photos without a pose, with the reason: `(file name, reason)`.
    pub unregistered: Vec<(String, String)>,
    /// Further keys of `cameras.json` ("sphere", "exposure_gains", ...), as they stand.
    pub extra: serde_json::Map<String, serde_json::Value>,
}

impl CameraEntry {
    pub(crate) fn posed(image: String, intrinsics: Intrinsics, pose: RigidTransform) -> Self {
        Self {
            image: Some(image),
            intrinsics,
            cam_from_world: Some(pose),
        }
    }

    /// Leaves out the folders of all cameras' photos, unless two photos are then called alike.
    pub(crate) fn without_folders(cameras: &mut [Self]) {
        let names = cameras
            .iter()
            .map(|entry| last_part(entry.name()).to_owned());
        let names: Vec<String> = names.collect();
        if names.iter().collect::<HashSet<_>>().len() == cameras.len() {
            for (entry, name) in cameras.iter_mut().zip(names) {
                entry.image = Some(name);
            }
        }
    }

    /// The photo's file name, or a word for it.
    pub(crate) fn name(&self) -> &str {
        self.image.as_deref().unwrap_or("image")
    }
}

impl CameraFile {
    /// What stage 3 writes: every posed view, and the photos that got no pose.
    pub fn from_posed_views(views: &PosedViews) -> Self {
        let cameras = views.views.iter().map(|view| {
            CameraEntry::posed(view.file_name.clone(), view.intrinsics, view.cam_from_world)
        });
        let unregistered = views.unregistered.iter();
        Self {
            unit: views.scale.unit,
            cameras: cameras.collect(),
            unregistered: unregistered
                .map(|photo| (photo.file_name.clone(), photo.reason.clone()))
                .collect(),
            extra: [("frame".to_owned(), views.frame.words().into())]
                .into_iter()
                .collect(),
        }
    }

    /// Where the world's axes lie: level where the file's key `frame` states it.
    pub fn frame(&self) -> WorldFrame {
        let level = WorldFrame::Level;
        let frame = self.extra.get("frame").and_then(|frame| frame.as_str());
        if frame == Some(level.words()) {
            level
        } else {
            WorldFrame::Given
        }
    }

    /// The cameras that have a pose, with it.
    pub(crate) fn posed(&self) -> impl Iterator<Item = (&CameraEntry, RigidTransform)> {
        let cameras = self.cameras.iter();
        cameras.filter_map(|entry| Some((entry, entry.cam_from_world?)))
    }
}
