//! Depth and normal maps of other programs.
//!
//! | program | file | depth | normals |
//! |---|---|---|---|
//! | COLMAP | `depth_maps/NAME.geometric.bin`, `normal_maps/…` | along the axis, 0: none | camera frame, towards the camera |
//! | OpenMVS | `depthNNNN.dmap`, with its camera | along the axis, 0: none | camera frame, towards the camera |
//!
//! Values are handed on as they stand, also what is no number: whoever uses them drops it.

mod colmap;
mod openmvs;
mod pixels;

pub use colmap::{read_colmap_depth, read_colmap_normal};
pub use openmvs::{DmapFile, read_dmap};

#[cfg(test)]
mod tests;
