//! Point clouds and meshes as PLY.
//!
//! Written is binary little endian, with a comment that states unit and frame:
//! ```text
//! cloud  x y z nx ny nz (float)  red green blue (uchar)  confidence (float)  views (uchar)
//! mesh   x y z [nx ny nz] (float)  [red green blue] (uchar);  faces: list uchar int vertex_indices
//! ```
//! Read is any PLY 1.0, ascii or binary of either order, properties in any order and of any type,
//! unknown elements and properties skipped.

mod header;
mod read;
mod write;

pub use read::{read_cloud_ply, read_mesh_ply, read_mesh_ply_near};
pub use write::{CloudPlyWriter, mesh_ply_file, write_cloud_ply, write_mesh_ply};

#[cfg(test)]
mod tests;
