//! The reference spheres as the user describes them: `--sphere FILE.json`.
//!
//! ```text
//! {"radius": 0.04, "unit": "metre", "light": "world" | "camera",
//!  "views": {"IMG_0003.jpg": {"mask": "sphere_masks/IMG_0003.png"}
//!           , "IMG_0004.jpg": {"ellipse": [cx, cy, semi_a, semi_b, angle_deg]}
//!           , "IMG_0005.jpg": {"circle": [cx, cy, r]}, "IMG_0006.jpg": {"points": [[x,y], ... 5 or more]}},
//!  "center": [x, y, z],
//!  "calibration": [{"image": "calibration/CAL_0001.jpg", "same_camera_as": "IMG_0004.jpg", "radius": 0.09, "mask": "..."}]}
//! ```
//! Several spheres stand in a list instead of `views` and `center`; one without a radius has the
//! file's:
//! ```text
//! {"radius": 0.04, "spheres": [{"views": {...}}, {"name": "left", "radius": 0.03, "views": {...}, "center": [...]}]}
//! ```
//! Paths are relative to the file; photos are named with or without ending; marks are in pixels
//! with centres at integers.

mod file;
mod in_set;
mod read;

pub use file::{MAX_NUM_SPHERES, SPHERE_RADII, SphereFile, SphereFileCalibration, SphereFileEntry};
pub use in_set::{SpheresInSet, is_mark_of};
pub use read::read_sphere_file;

#[cfg(test)]
mod tests;
