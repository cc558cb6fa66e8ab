//! Meshes for other programs: Wavefront OBJ and binary glTF (GLB). PLY is in [`crate::ply`].
//!
//! | format | frame | unit | colours |
//! |---|---|---|---|
//! | OBJ | that of `cameras.json` | that of `cameras.json`, told in a comment | after the position, 0 to 1, sRGB |
//! | GLB | y up, front towards z ([`ViewerFrame`]) | metres; unknown units are told in `asset.extras` | `COLOR_0`, linear |

mod glb;
mod obj;

pub use glb::{ViewerFrame, write_mesh_glb};
pub use obj::write_mesh_obj;

use crate::error::IoError;
use rilievo_scene::Mesh;
use std::path::Path;

/// Refuses a mesh whose attributes are not one per vertex, or whose triangles name none.
fn check(path: &Path, mesh: &Mesh) -> Result<(), IoError> {
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
    match mesh
        .triangles
        .iter()
        .flatten()
        .find(|&&v| v as usize >= num)
    {
        Some(v) => Err(IoError::write(
            path,
            format!("a triangle names vertex {v} of {num}"),
        )),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
