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
    write_obj(path, mesh, None, world.into())
}

/// What an OBJ takes from images.
pub(super) struct Textured<'a> {
    /// File of the material, and its name there.
    pub material: (&'a str, &'a str),
    /// Places of the vertices on the texture, its zero at the upper left.
    pub coords: &'a [[f32; 2]],
}

/// Writes a mesh as OBJ, with textures or without.
pub(super) fn write_obj(
    path: &Path,
    mesh: &Mesh,
    textured: Option<Textured<'_>>,
    world: WorldCoordinates,
) -> Result<(), IoError> {
    check(path, mesh)?;
    write_pieces(path, |out| {
        for line in world.comments() {
            writeln!(out, "# {line}")?;
        }
        if let Some(Textured { material, .. }) = &textured {
            writeln!(out, "mtllib {}", material.0)?;
        }
        writeln!(out, "o object")?;
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
        // The format's textures begin below.
        for [u, v] in textured.iter().flat_map(|textured| textured.coords) {
            writeln!(out, "vt {u} {}", 1.0 - v)?;
        }
        for [x, y, z] in &mesh.normals {
            writeln!(out, "vn {x:.5} {y:.5} {z:.5}")?;
        }
        if let Some(Textured { material, .. }) = &textured {
            writeln!(out, "usemtl {}", material.1)?;
        }
        for t in &mesh.triangles {
            // The format counts from one.
            let [a, b, c] = t.map(|v| u64::from(v) + 1);
            match (mesh.normals.is_empty(), &textured) {
                (true, None) => writeln!(out, "f {a} {b} {c}")?,
                (false, None) => writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?,
                (true, Some(_)) => writeln!(out, "f {a}/{a} {b}/{b} {c}/{c}")?,
                (false, Some(_)) => writeln!(out, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}")?,
            }
        }
        Ok(())
    })
}
