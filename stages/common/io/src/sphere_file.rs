//! Sphere.
use crate::error::IoError;
use rilievo_scene::{LightKind, LinearImage, PhotoSet, SphereMark, SphereRequest, Unit};
use std::path::{Path, PathBuf};

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

/// A sphere file.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereFile {
    /// The file.
    pub path: PathBuf,
    /// Radius; absent only where every calibration photo carries its own.
    pub radius: Option<f64>,
    /// Unit of the radius.
    pub unit: Unit,
    /// What the light is fixed to.
    pub light: LightKind,
    /// Outlines by photo (named with or without ending).
    pub views: Vec<(String, SphereMark)>,
    /// Centre in the frame of the given cameras.
    pub center: Option<[f64; 3]>,
    /// Calibration photos.
    pub calibration: Vec<SphereFileCalibration>,
    /// Every further file that was read or is named: masks and calibration photos, in order.
    pub files: Vec<PathBuf>,
}

impl SphereFile {
    /// The request for a set of photos; `calibration_images` are the calibration photos, linear,
    /// in the file's order. Photos that the file names and the set lacks come back by name.
    ///
    /// # Errors
    /// When a calibration photo names a photo that the set lacks, or a mark does not fit its photo.
    pub fn to_request(
        &self,
        _photos: &PhotoSet,
        _calibration_images: Vec<LinearImage>,
    ) -> Result<(SphereRequest, Vec<String>), IoError> {
        Err(IoError::input(&self.path, "not yet"))
    }
}

/// Reads a sphere file with the masks that it names.
///
/// # Errors
/// When a file cannot be read or holds a value that cannot be used; names the key.
pub fn read_sphere_file(path: &Path) -> Result<SphereFile, IoError> {
    Err(IoError::input(path, "not yet"))
}
