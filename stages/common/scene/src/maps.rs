//! Per-pixel results of a view.

use crate::raster::Raster;
use nalgebra::Vector3;

/// Depth `z` along the optical axis in the world's unit; 0 where there is none.
pub type DepthMap = Raster<f32>;

/// Unit normals in the camera frame, towards the camera (`n3 < 0` in front); zero where none.
pub type NormalMap = Raster<[f32; 3]>;

/// How well data determine a pixel, 0 (not at all) to 1.
pub type ConfidenceMap = Raster<f32>;

impl NormalMap {
    /// Normal at `(x, y)`; `None` where the map has no value.
    ///
    /// # Panics
    /// Outside the map.
    pub fn normal(&self, x: usize, y: usize) -> Option<Vector3<f64>> {
        let [a, b, c] = *self.at(x, y);
        (a != 0.0 || b != 0.0 || c != 0.0).then(|| Vector3::new(a as f64, b as f64, c as f64))
    }
}
