//! Output of stage 6: an oriented, coloured point cloud and a mesh.

use serde::{Deserialize, Serialize};

/// One oriented, coloured point in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CloudPoint {
    /// Position, world's unit.
    pub position: [f32; 3],
    /// Unit normal, outwards.
    pub normal: [f32; 3],
    /// Display colour, sRGB.
    pub color: [u8; 3],
    /// 0 to 1.
    pub confidence: f32,
    /// Number of views that agree on it.
    pub num_views: u8,
}

/// A set of oriented points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// The points.
    pub points: Vec<CloudPoint>,
}

/// A triangle mesh in the world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, world's unit.
    pub vertices: Vec<[f32; 3]>,
    /// Unit vertex normals, outwards; empty or one per vertex.
    pub normals: Vec<[f32; 3]>,
    /// Vertex colours, sRGB; empty or one per vertex.
    pub colors: Vec<[u8; 3]>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// The fused result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FusedCloud {
    /// Points of all views.
    pub cloud: PointCloud,
    /// Surface through them.
    pub mesh: Mesh,
}
