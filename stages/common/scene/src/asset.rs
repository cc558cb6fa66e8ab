//! A light mesh with textures, as renderers and game engines take it.

use crate::cloud::Mesh;
use crate::raster::Raster;

/// Full scale of a texture's integers.
pub const FULL: u16 = u16::MAX;

/// A light mesh, unwrapped onto textures that hold what it leaves out.
///
/// Texture coordinates have their zero at the upper left corner of the texture, `v` downwards, as glTF's.
#[derive(Clone, Debug, PartialEq)]
pub struct Asset {
    /// The mesh, in the world frame, with smooth normals and without colours. Vertices on seams of the texture are there
    /// once for each side.
    pub mesh: Mesh,
    /// Texture coordinates of the vertices, 0 to 1.
    pub texture_coords: Vec<[f32; 2]>,
    /// Unit tangents of the vertices, world frame, and the sign of the bitangent `sign (n × t)`, which points up in the
    /// texture, to smaller `v`.
    pub tangents: Vec<[f32; 4]>,
    /// The surface's own colour, relative albedo, linear: half of [`FULL`] is the mean albedo of stage 5.
    pub base_color: Raster<[u16; 3]>,
    /// Unit normal along tangent, bitangent and mesh normal, each from -1 at 0 to 1 at [`FULL`].
    pub normal: Raster<[u16; 3]>,
    /// Share of a uniform sky that reaches the place, 0 to 255.
    pub occlusion: Raster<u8>,
}
