//! Cameras.
use crate::error::IoError;
use rilievo_scene::{Intrinsics, PosedViews, RigidTransform, Unit};
use std::path::Path;

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

impl CameraFile {
    /// The camera of a photo, named with or without its ending.
    pub fn find(&self, _image: &str) -> Option<&CameraEntry> {
        None
    }

    /// What stage 3 writes: every posed view, and the photos that got no pose.
    pub fn from_posed_views(_views: &PosedViews) -> Self {
        Self::default()
    }
}

/// Reads `cameras.json`, a `camera.json` of one view, or a COLMAP model folder (text or binary).
///
/// # Errors
/// When a file cannot be read or holds a value that cannot be a camera; names the key.
pub fn read_cameras(path: &Path) -> Result<CameraFile, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Writes `cameras.json`.
///
/// # Errors
/// When the file cannot be written.
pub fn write_cameras(path: &Path, _cameras: &CameraFile) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}
