//! Cameras: `cameras.json`, the `camera.json` of one view, and COLMAP folders as camera files.
//!
//! ```text
//! {"unit": "metre" | "arbitrary", "cameras": [{"image": "IMG_0001.jpg", "width": 1280, "height": 960,
//!   "K": [[fx,0,cx],[0,fy,cy],[0,0,1]], "distortion": {"model": "opencv", "coefficients": [k1,k2,p1,p2,k3]},
//!   "world_from_camera_rotation": [[..],[..],[..]], "camera_center": [x,y,z]}]}
//! ```
//! Pixel centres at integers; camera x right, y down, z forward. A camera without a pose fixes the
//! intrinsics alone. Numbers are written so that they are read back bit for bit.

mod index;
mod read;
mod write;

use rilievo_scene::{Intrinsics, PosedViews, RigidTransform, Unit};

pub use index::CameraIndex;
pub(crate) use index::DistinctCameras;
pub use read::read_cameras;
pub(crate) use read::{rigid_from_camera_pose, rigid_from_world_pose, unit};
pub use write::{cameras_file, write_cameras};

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

/// A file name without folders.
pub(crate) fn last_part(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

/// A file name without folders and ending.
pub(crate) fn stem(name: &str) -> &str {
    let name = last_part(name);
    match name.rfind('.') {
        Some(dot) if dot > 0 => &name[..dot],
        _ => name,
    }
}

impl CameraEntry {
    /// The photo's file name, or a word for it.
    pub(crate) fn name(&self) -> &str {
        self.image.as_deref().unwrap_or("image")
    }
}

impl CameraFile {
    /// The camera of a photo, named with or without its ending. The whole name is tried first, so
    /// that `x.jpg` and `x.png` keep their own; a lone entry without a name fits every photo. For
    /// several photos, [`CameraFile::index`] is made once.
    pub fn find(&self, image: &str) -> Option<&CameraEntry> {
        self.index().find(image)
    }

    /// The cameras by their photos' names.
    pub fn index(&self) -> CameraIndex<'_> {
        CameraIndex::new(self)
    }

    /// What stage 3 writes: every posed view, and the photos that got no pose.
    pub fn from_posed_views(views: &PosedViews) -> Self {
        Self {
            unit: views.scale.unit,
            cameras: views
                .views
                .iter()
                .map(|view| CameraEntry {
                    image: Some(view.file_name.clone()),
                    intrinsics: view.intrinsics,
                    cam_from_world: Some(view.cam_from_world),
                })
                .collect(),
            unregistered: views
                .unregistered
                .iter()
                .map(|photo| (photo.file_name.clone(), photo.reason.clone()))
                .collect(),
            extra: serde_json::Map::new(),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
