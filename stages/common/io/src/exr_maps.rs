//! Maps.
use crate::error::IoError;
use rilievo_scene::{DepthMap, LinearImage, NormalMap, PixelError, PixelSource, Raster};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Reads a depth map (channel `Z`).
///
/// # Errors
/// When the file cannot be read or has no such channel.
pub fn read_depth(path: &Path) -> Result<DepthMap, IoError> {
    read_channel(path, "Z")
}

/// Writes a depth map (channel `Z`, f32).
///
/// # Errors
/// When the file cannot be written.
pub fn write_depth(path: &Path, map: &DepthMap) -> Result<(), IoError> {
    write_channel(path, "Z", map)
}

/// Reads a normal map (channels `N.X N.Y N.Z`).
///
/// # Errors
/// When the file cannot be read or lacks a channel.
pub fn read_normal(path: &Path) -> Result<NormalMap, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Writes a normal map (channels `N.X N.Y N.Z`, f32).
///
/// # Errors
/// When the file cannot be written.
pub fn write_normal(path: &Path, _map: &NormalMap) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Reads one named channel.
///
/// # Errors
/// When the file cannot be read or has no such channel.
pub fn read_channel(path: &Path, _channel: &str) -> Result<Raster<f32>, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Writes one named channel, f32.
///
/// # Errors
/// When the file cannot be written.
pub fn write_channel(path: &Path, _channel: &str, _map: &Raster<f32>) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Reads a linear image (`R G B` or `Y`).
///
/// # Errors
/// When the file cannot be read or has neither.
pub fn read_linear(path: &Path) -> Result<LinearImage, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Writes a linear image (`R G B` or `Y`), f32.
///
/// # Errors
/// When the file cannot be written.
pub fn write_linear(path: &Path, _image: &LinearImage) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Pixels that wait in a linear OpenEXR file and are read each time they are asked for.
#[derive(Clone, Debug)]
pub struct LinearFile {
    /// The file, as [`write_linear`] writes it.
    pub path: PathBuf,
}

impl PixelSource for LinearFile {
    fn load(&self) -> Result<Arc<LinearImage>, PixelError> {
        read_linear(&self.path)
            .map(Arc::new)
            .map_err(|error| PixelError {
                name: self.path.display().to_string(),
                reason: error.reason,
            })
    }
}
