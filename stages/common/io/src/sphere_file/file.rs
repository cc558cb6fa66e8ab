//! What a sphere file holds.

use crate::error::IoError;
use rilievo_scene::{LightKind, SphereMark, Unit};
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Most spheres of a file. Each is fitted in every photo, which takes a tenth of a second or more,
/// and nobody places as many beside an object: a longer list was made by mistake.
pub const MAX_NUM_SPHERES: usize = 64;
/// Radii that can be meant, in any unit of length: beyond, sums of squares lose the smaller term.
pub const SPHERE_RADII: RangeInclusive<f64> = 1e-6..=1e6;
/// A photo of a sphere in the object's place, as the file names it.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereFileCalibration {
    /// The photo, with the file's folder before it.
    pub image: PathBuf,
    /// The photo of the set taken by the same camera in the same place.
    pub same_camera_as: String,
    /// Radius in the file's unit.
    pub radius: f64,
    /// Outline, where given.
    pub mark: Option<SphereMark>,
}

/// A sphere beside the object, as the file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereFileEntry {
    /// Its name in messages.
    pub name: String,
    /// Radius in the file's unit.
    pub radius: f64,
    /// Outlines by photo (named with or without ending).
    pub views: Vec<(String, SphereMark)>,
    /// Centre in the frame of the given cameras.
    pub center: Option<[f64; 3]>,
    /// Its place in the file, for messages: `spheres[1].`, or nothing for the only one.
    pub key: String,
}

/// A sphere file.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereFile {
    /// The file.
    pub path: PathBuf,
    /// Unit of the radii.
    pub unit: Unit,
    /// What the light is fixed to, where the file states it.
    pub light: Option<LightKind>,
    /// The spheres beside the object.
    pub spheres: Vec<SphereFileEntry>,
    /// Calibration photos.
    pub calibration: Vec<SphereFileCalibration>,
    /// Every further file that was read or is named: masks and calibration photos, in order.
    pub files: Vec<PathBuf>,
    /// Masks that mark nothing and were left out, with the reason.
    pub left_out: Vec<(PathBuf, String)>,
}

impl SphereFile {
    /// Puts another radius in the place of the file's, which comes back, where the file has one.
    ///
    /// # Errors
    /// When the file's spheres differ in radius.
    pub fn replace_radius(&mut self, radius: f64) -> Result<Option<f64>, IoError> {
        let mut radii = self.spheres.iter().map(|sphere| sphere.radius);
        let first = radii.next();
        if radii.any(|other| Some(other) != first) {
            return Err(IoError::input(
                &self.path,
                "its spheres differ in radius: none can be stated beside the file",
            ));
        }
        for sphere in &mut self.spheres {
            sphere.radius = radius;
        }
        Ok(first)
    }
}
