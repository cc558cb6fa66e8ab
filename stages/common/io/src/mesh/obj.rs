//! Wavefront OBJ with normals, and colours after the positions as most programs read them.
//!
//! ```text
//! v x y z r g b
//! vn x y z
//! f a//a b//b c//c
//! ```

use super::check::check;
use crate::error::IoError;
use crate::files::write_pieces;
use rilievo_scene::{Mesh, WorldCoordinates};
use std::io::Write;
use std::path::Path;

/// Writes a mesh as OBJ, in the frame of `cameras.json`.
///
/// # Errors
/// When the file cannot be written, or the mesh is inconsistent.
pub fn write_mesh_obj(
    path: &Path,
    mesh: &Mesh,
    world: impl Into<WorldCoordinates>,
) -> Result<(), IoError> {
    check(path, mesh)?;
    let world = world.into();
    write_pieces(path, |out| {
        let (unit, frame) = (world.unit.name(), world.frame.of_file());
        writeln!(out, "# unit {unit}\n# frame {frame}\no object")?;
        for (i, [x, y, z]) in mesh.vertices.iter().enumerate() {
            write!(out, "v {x} {y} {z}")?;
            match mesh.colors.get(i) {
                Some(color) => {
                    let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
                    writeln!(out, " {r:.4} {g:.4} {b:.4}")?;
                }
                None => writeln!(out)?,
            }
        }
        for [x, y, z] in &mesh.normals {
            writeln!(out, "vn {x:.5} {y:.5} {z:.5}")?;
        }
        for t in &mesh.triangles {
            // The format counts from one.
            let [a, b, c] = t.map(|v| u64::from(v) + 1);
            if mesh.normals.is_empty() {
                writeln!(out, "f {a} {b} {c}")?;
            } else {
                writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
            }
        }
        Ok(())
    })
}
