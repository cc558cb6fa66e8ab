//! Writing clouds and meshes.

use crate::error::IoError;
use crate::files::{OutputFile, write_pieces};
use crate::mesh::check::check;
use rilievo_scene::{Mesh, PointCloud, Unit};
use std::io::Write;
use std::path::Path;

fn preamble(unit: Unit) -> String {
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment unit {}\n\
         comment frame world of cameras.json\n",
        unit.name()
    )
}

fn put(out: &mut impl Write, values: [f32; 3]) -> std::io::Result<()> {
    values
        .iter()
        .try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

/// Writes a cloud: binary little endian, `x y z nx ny nz red green blue confidence views`.
///
/// # Errors
/// When the file cannot be written.
pub fn write_cloud_ply(path: &Path, cloud: &PointCloud, unit: Unit) -> Result<(), IoError> {
    write_pieces(path, |out| {
        out.write_all(preamble(unit).as_bytes())?;
        writeln!(out, "element vertex {}", cloud.points.len())?;
        for name in ["x", "y", "z", "nx", "ny", "nz"] {
            writeln!(out, "property float {name}")?;
        }
        for name in ["red", "green", "blue"] {
            writeln!(out, "property uchar {name}")?;
        }
        out.write_all(b"property float confidence\nproperty uchar views\nend_header\n")?;
        for point in &cloud.points {
            put(out, point.position)?;
            put(out, point.normal)?;
            out.write_all(&point.color)?;
            out.write_all(&point.confidence.to_le_bytes())?;
            out.write_all(&[point.num_views])?;
        }
        Ok(())
    })
}

/// Writes a mesh: binary little endian, with normals and colours where the mesh has them.
///
/// # Errors
/// When the file cannot be written, or the mesh is inconsistent.
pub fn write_mesh_ply(path: &Path, mesh: &Mesh, unit: Unit) -> Result<(), IoError> {
    check(path, mesh)?;
    write_pieces(path, |out| put_mesh(out, mesh, unit))
}

/// The same, to be written.
///
/// # Errors
/// When the mesh is inconsistent.
pub fn mesh_ply_file(path: &Path, mesh: &Mesh, unit: Unit) -> Result<OutputFile, IoError> {
    check(path, mesh)?;
    let mut content = Vec::new();
    put_mesh(&mut content, mesh, unit).map_err(|error| IoError::write(path, error))?;
    Ok(OutputFile::new(path, content))
}

fn put_mesh(out: &mut impl Write, mesh: &Mesh, unit: Unit) -> std::io::Result<()> {
    out.write_all(preamble(unit).as_bytes())?;
    writeln!(out, "element vertex {}", mesh.vertices.len())?;
    out.write_all(b"property float x\nproperty float y\nproperty float z\n")?;
    if !mesh.normals.is_empty() {
        out.write_all(b"property float nx\nproperty float ny\nproperty float nz\n")?;
    }
    if !mesh.colors.is_empty() {
        out.write_all(b"property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
    }
    writeln!(out, "element face {}", mesh.triangles.len())?;
    out.write_all(b"property list uchar int vertex_indices\nend_header\n")?;
    for (i, &vertex) in mesh.vertices.iter().enumerate() {
        put(out, vertex)?;
        if let Some(&normal) = mesh.normals.get(i) {
            put(out, normal)?;
        }
        if let Some(color) = mesh.colors.get(i) {
            out.write_all(color)?;
        }
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for index in triangle {
            out.write_all(&index.to_le_bytes())?;
        }
    }
    Ok(())
}
