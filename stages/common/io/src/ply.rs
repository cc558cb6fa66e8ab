//! PLY.
use crate::error::IoError;
use rilievo_scene::{Mesh, PointCloud, Unit};
use std::path::Path;

/// Writes a cloud: binary little endian, `x y z nx ny nz red green blue confidence views`.
///
/// # Errors
/// When the file cannot be written.
pub fn write_cloud_ply(path: &Path, _cloud: &PointCloud, _unit: Unit) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Reads a cloud; properties that are absent are zero.
///
/// # Errors
/// When the file cannot be read or is no PLY with `x y z`.
pub fn read_cloud_ply(path: &Path) -> Result<PointCloud, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Writes a mesh: binary little endian, with normals and colours where the mesh has them.
///
/// # Errors
/// When the file cannot be written.
pub fn write_mesh_ply(path: &Path, _mesh: &Mesh, _unit: Unit) -> Result<(), IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Reads a mesh; polygons are cut into triangles.
///
/// # Errors
/// When the file cannot be read or is no PLY with `x y z`.
pub fn read_mesh_ply(path: &Path) -> Result<Mesh, IoError> {
    Err(IoError::input(path, "not yet"))
}
