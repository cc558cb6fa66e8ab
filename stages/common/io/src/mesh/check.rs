//! Whether a mesh holds together, asked before a file of it is begun.

use crate::error::IoError;
use rilievo_scene::Mesh;
use std::path::Path;

/// Refuses a mesh whose attributes are not one per vertex, or whose triangles name none.
pub(crate) fn check(path: &Path, mesh: &Mesh) -> Result<(), IoError> {
    let num = mesh.vertices.len();
    for (what, len) in [
        ("normals", mesh.normals.len()),
        ("colours", mesh.colors.len()),
    ] {
        if len != 0 && len != num {
            let reason = format!("{len} {what} for {num} vertices");
            return Err(IoError::write(path, reason));
        }
    }
    let mut corners = mesh.triangles.iter().flatten();
    match corners.find(|&&v| v as usize >= num) {
        Some(v) => {
            let reason = format!("a triangle names vertex {v} of {num}");
            Err(IoError::write(path, reason))
        }
        None => Ok(()),
    }
}
