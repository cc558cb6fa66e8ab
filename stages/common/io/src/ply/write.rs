//! Writing clouds and meshes.

use crate::error::IoError;
use crate::files::{OutputFile, write_pieces};
use crate::mesh::check::check;
use rilievo_scene::{CloudError, CloudPoint, CloudSink, Mesh, PointCloud, WorldCoordinates};
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

fn preamble(world: WorldCoordinates) -> String {
    let mut text = "ply\nformat binary_little_endian 1.0\n".to_owned();
    for line in world.comments() {
        text += &format!("comment {line}\n");
    }
    text
}

fn put(out: &mut impl Write, values: [f32; 3]) -> std::io::Result<()> {
    values
        .iter()
        .try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

/// Columns of a cloud's header for the number of its points: those of the largest `u64`.
const COUNT_COLUMNS: usize = 20;

/// Header of a cloud, to be written over: the comment is filled up, for one length at any number.
fn cloud_header(world: WorldCoordinates, num_points: u64) -> String {
    let count = num_points.to_string();
    let mut header = preamble(world);
    header.truncate(header.trim_end().len());
    header.extend(std::iter::repeat_n(' ', COUNT_COLUMNS - count.len()));
    header += &format!("\nelement vertex {count}\n");
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        header += &format!("property float {name}\n");
    }
    for name in ["red", "green", "blue"] {
        header += &format!("property uchar {name}\n");
    }
    header + "property float confidence\nproperty uchar views\nend_header\n"
}

/// A cloud that is written as its points come: binary little endian, `x y z nx ny nz red green blue
/// confidence views`.
#[derive(Debug)]
pub struct CloudPlyWriter {
    path: PathBuf,
    out: BufWriter<File>,
    world: WorldCoordinates,
    num_points: u64,
}

impl CloudPlyWriter {
    /// Begins a file, in a folder that exists.
    pub fn create(path: &Path, world: impl Into<WorldCoordinates>) -> Result<Self, IoError> {
        let world = world.into();
        let begin = || {
            let mut out = BufWriter::new(File::create(path)?);
            out.write_all(cloud_header(world, 0).as_bytes())?;
            Ok(out)
        };
        Ok(Self {
            path: path.to_owned(),
            out: begin().map_err(|error: std::io::Error| IoError::write(path, error))?,
            world,
            num_points: 0,
        })
    }

    /// Writes how many points there are: a file without that is not finished.
    pub fn finish(mut self) -> Result<(), IoError> {
        let header = cloud_header(self.world, self.num_points);
        let mut end = || {
            self.out.rewind()?;
            self.out.write_all(header.as_bytes())?;
            self.out.flush()
        };
        end().map_err(|error| IoError::write(&self.path, error))
    }

    fn put(&mut self, points: &[CloudPoint]) -> Result<(), IoError> {
        let out = &mut self.out;
        let mut all = || {
            points.iter().try_for_each(|point| {
                put(out, point.position)?;
                put(out, point.normal)?;
                out.write_all(&point.color)?;
                out.write_all(&point.confidence.to_le_bytes())?;
                out.write_all(&[point.num_views])
            })
        };
        all().map_err(|error| IoError::write(&self.path, error))?;
        self.num_points += points.len() as u64;
        Ok(())
    }
}

impl CloudSink for CloudPlyWriter {
    fn add(&mut self, points: &[CloudPoint]) -> Result<(), CloudError> {
        self.put(points).map_err(|error| CloudError {
            reason: error.to_string(),
        })
    }
}

/// Writes a cloud that is in memory, as [`CloudPlyWriter`] does.
pub fn write_cloud_ply(
    path: &Path,
    cloud: &PointCloud,
    world: impl Into<WorldCoordinates>,
) -> Result<(), IoError> {
    let mut writer = CloudPlyWriter::create(path, world)?;
    writer.put(&cloud.points)?;
    writer.finish()
}

/// Writes a mesh: binary little endian, with normals and colours where the mesh has them.
///
/// # Errors
/// When the file cannot be written, or the mesh is inconsistent.
pub fn write_mesh_ply(
    path: &Path,
    mesh: &Mesh,
    world: impl Into<WorldCoordinates>,
) -> Result<(), IoError> {
    check(path, mesh)?;
    let world = world.into();
    write_pieces(path, |out| put_mesh(out, mesh, world))
}

/// The same, to be written.
///
/// # Errors
/// When the mesh is inconsistent.
pub fn mesh_ply_file(
    path: &Path,
    mesh: &Mesh,
    world: impl Into<WorldCoordinates>,
) -> Result<OutputFile, IoError> {
    check(path, mesh)?;
    let mut content = Vec::new();
    put_mesh(&mut content, mesh, world.into()).map_err(|error| IoError::write(path, error))?;
    Ok(OutputFile::new(path, content))
}

fn put_mesh(out: &mut impl Write, mesh: &Mesh, world: WorldCoordinates) -> std::io::Result<()> {
    out.write_all(preamble(world).as_bytes())?;
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
