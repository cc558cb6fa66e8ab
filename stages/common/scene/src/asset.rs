//! A light mesh with textures, as renderers and game engines take it.

use crate::cloud::Mesh;
use crate::raster::Raster;
use serde::{Deserialize, Serialize};

/// Full scale of a texture's integers.
pub const FULL: u16 = u16::MAX;

/// What an asset's base colour shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BaseColor {
    /// The albedo of stage 5, per channel relative to its mean.
    Albedo,
    /// The photos, light and shadow included.
    Photographed,
    /// An even grey: there are no photos.
    #[default]
    Grey,
}

impl BaseColor {
    /// For people who open the asset's files.
    pub fn sentence(self) -> &'static str {
        match self {
            Self::Albedo => {
                "albedo without light and shadow, relative per channel to the object's mean, which is half"
            }
            Self::Photographed => "as photographed, light and shadow included",
            Self::Grey => "even grey: no photos were given",
        }
    }
}

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
    /// What the base colour shows.
    pub shows: BaseColor,
    /// Base colour, linear.
    pub base_color: Raster<[u16; 3]>,
    /// Unit normal along tangent, bitangent and mesh normal, each from -1 at 0 to 1 at [`FULL`].
    pub normal: Raster<[u16; 3]>,
    /// Share of a uniform sky that reaches the place, 0 to 255.
    pub occlusion: Raster<u8>,
}
