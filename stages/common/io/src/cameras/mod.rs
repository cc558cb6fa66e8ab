//! Cameras: `cameras.json`, the `camera.json` of one view, and COLMAP folders as camera files.
//!
//! ```text
//! {"unit": "metre" | "arbitrary" | "millimetre" | "centimetre" | "inch" | "foot",
//!  "cameras": [{"image": "IMG_0001.jpg", "width": 1280, "height": 960, "K": [[fx,0,cx],[0,fy,cy],[0,0,1]],
//!   "distortion": {"model": "opencv", "coefficients": [k1,k2,p1,p2,k3]},
//!   "world_from_camera_rotation": [[..],[..],[..]], "camera_center": [x,y,z]}]}
//! ```
//! Pixel centres at integers; camera x right, y down, z forward. A camera without a pose fixes the
//! intrinsics alone. Further lens models: "opencv" with k4 k5 k6 too, "opencv_fisheye" with k1 k2 k3 k4, and
//! "thin_prism_fisheye" with COLMAP's k1 k2 p1 p2 k3 k4 sx sy. Numbers are written so that they are read back bit for
//! bit.

pub(crate) mod entry;
pub(crate) mod index;
pub(crate) mod lens;
mod photo_names;
mod read;
mod write;

pub use entry::{CameraEntry, CameraFile};
pub use index::CameraIndex;
pub(crate) use index::DistinctCameras;
pub(crate) use photo_names::{last_part, stem};
pub use read::read_cameras;
pub(crate) use read::{
    intrinsics_of, matrix_of, rigid_from_camera_pose, rigid_from_world_pose, unit,
};
pub use write::{cameras_file, write_cameras};

#[cfg(test)]
pub(crate) mod tests;
