//! Lighting.
use crate::error::IoError;
use rilievo_scene::{Lighting, LightingCalibration, PosedViews};
use std::path::{Path, PathBuf};

/// Lighting from a file.
#[derive(Clone, Debug, PartialEq)]
pub enum LightingFile {
    /// One lighting per view, by the photo's name without ending.
    PerView(Vec<(String, Lighting)>),
    /// One lighting, in each view's own camera frame, for every view.
    ForAll(Lighting),
}

impl LightingFile {
    /// The lighting of a view, by its name with or without ending.
    pub fn for_view(&self, _name: &str) -> Option<&Lighting> {
        None
    }
}

/// Splits `FILE` or `FILE:NAME` (a colon after the file's ending).
pub fn split_lighting_spec(spec: &str) -> (PathBuf, Option<String>) {
    (PathBuf::from(spec), None)
}

/// Reads `lighting.json` in its long form, or the short form (a name → rows), of which `name`
/// picks one.
///
/// # Errors
/// When the file cannot be read, a row has not nine numbers, or the name is missing or unknown.
pub fn read_lighting(path: &Path, _name: Option<&str>) -> Result<LightingFile, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Writes `lighting.json` of stage 4.
///
/// # Errors
/// When the file cannot be written.
pub fn write_lighting(
    path: &Path,
    _calibration: &LightingCalibration,
    _views: &PosedViews,
) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}
