//! What camera files of every kind hold.

use super::photo_names::last_part;
use rilievo_scene::{
    Intrinsics, PosedViews, RigidTransform, Unit, WorldCoordinates, WorldFrame, local_offset,
};
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

/// Key of the offset of a run's surface, cloud and anchors in its `cameras.json`.
const SURFACE_OFFSET: &str = "surface_offset";

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
        let back = views.offset.map(|v| -v);
        let cameras = views.views.iter().map(|view| {
            let cam_from_world = view.cam_from_world.with_origin_at(back);
            CameraEntry::posed(view.file_name.clone(), view.intrinsics, cam_from_world)
        });
        let mut extra = serde_json::Map::new();
        extra.insert("frame".to_owned(), views.frame.words().into());
        // Other files of a run are in metres where it has a unit.
        let is_unit_of_run = matches!(views.scale.unit, Unit::Metre | Unit::Arbitrary);
        if let Some(offset) = views.coordinates().offset().filter(|_| is_unit_of_run) {
            extra.insert(SURFACE_OFFSET.to_owned(), offset.to_vec().into());
        }
        let unregistered = views.unregistered.iter();
        Self {
            unit: views.scale.unit,
            cameras: cameras.collect(),
            unregistered: unregistered
                .map(|photo| (photo.file_name.clone(), photo.reason.clone()))
                .collect(),
            extra,
        }
    }

    /// Puts the lengths into metres, where the file's unit is one of length.
    pub fn to_metres(&mut self) {
        let Some(metres) = self.unit.metres() else {
            return;
        };
        self.unit = Unit::Metre;
        for pose in self.poses_mut() {
            pose.translation *= metres;
        }
        if let Some(stated) = self.surface_offset() {
            let offset = stated.map(|v| v * metres);
            self.extra
                .insert(SURFACE_OFFSET.to_owned(), offset.to_vec().into());
        }
    }

    /// Moves the cameras to a local frame as of [`CameraFile::local_world`]; what their coordinates mean then.
    pub fn localize(&mut self, known: [f64; 3]) -> WorldCoordinates {
        let world = self.local_world(self.posed().map(|(_, pose)| pose), known);
        self.move_origin(world.offset);
        world
    }

    /// A local frame for cameras of this file at these poses: at `known` where that is no zero, else at the
    /// offset that the file states, where they stand near that, else near their own place.
    pub fn local_world(
        &self,
        poses: impl Iterator<Item = RigidTransform>,
        known: [f64; 3],
    ) -> WorldCoordinates {
        let poses: Vec<RigidTransform> = poses.collect();
        let known = match known {
            [0.0, 0.0, 0.0] => self.surface_offset().unwrap_or(known),
            known => known,
        };
        WorldCoordinates {
            unit: self.unit,
            frame: self.frame(),
            offset: local_offset(&poses, known),
        }
    }

    /// Subtracts an offset from the cameras' places.
    pub fn move_origin(&mut self, offset: [f64; 3]) {
        for pose in self.poses_mut() {
            *pose = pose.with_origin_at(offset);
        }
    }

    fn surface_offset(&self) -> Option<[f64; 3]> {
        let stated = self.extra.get(SURFACE_OFFSET)?;
        serde_json::from_value(stated.clone()).ok()
    }

    fn poses_mut(&mut self) -> impl Iterator<Item = &mut RigidTransform> {
        let cameras = self.cameras.iter_mut();
        cameras.filter_map(|entry| entry.cam_from_world.as_mut())
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
