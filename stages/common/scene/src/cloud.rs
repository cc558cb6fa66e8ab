//! Output of stage 6: an oriented, coloured point cloud and a mesh.

use nalgebra::Vector3;
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

/// Why a cloud could not be taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the cloud cannot be kept: {reason}")]
pub struct CloudError {
    /// What went wrong, and where.
    pub reason: String,
}

/// Takes the points of a cloud part by part, so that a large one need not be in memory as a whole.
pub trait CloudSink {
    /// Takes the next points.
    ///
    /// # Errors
    /// When they cannot be kept.
    fn add(&mut self, points: &[CloudPoint]) -> Result<(), CloudError>;
}

impl CloudSink for PointCloud {
    fn add(&mut self, points: &[CloudPoint]) -> Result<(), CloudError> {
        self.points.extend_from_slice(points);
        Ok(())
    }
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

impl Mesh {
    /// Place of a vertex.
    ///
    /// # Panics
    /// Where there is no such vertex.
    #[inline]
    pub fn vertex(&self, v: u32) -> Vector3<f64> {
        Vector3::from(self.vertices[v as usize].map(f64::from))
    }

    /// Smallest and largest coordinates of the vertices; `None` without any.
    pub fn bounds(&self) -> Option<[[f32; 3]; 2]> {
        let grow = |[low, high]: [[f32; 3]; 2], v: &[f32; 3]| {
            [
                std::array::from_fn(|k| low[k].min(v[k])),
                std::array::from_fn(|k| high[k].max(v[k])),
            ]
        };
        let first = *self.vertices.first()?;
        Some(self.vertices.iter().fold([first; 2], grow))
    }
}

/// Numbers the vertices that triangles use anew, in the order of their first use; returns which they were, of
/// `num_vertices`.
pub fn renumber(triangles: &mut [[u32; 3]], num_vertices: usize) -> Vec<usize> {
    let mut number = vec![u32::MAX; num_vertices];
    let mut used = Vec::new();
    for corner in triangles.iter_mut().flatten() {
        let number = &mut number[*corner as usize];
        if *number == u32::MAX {
            *number = used.len() as u32;
            used.push(*corner as usize);
        }
        *corner = *number;
    }
    used
}
