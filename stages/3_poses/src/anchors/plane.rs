//! The plane that a patch is taken for: inverse depth, affine in the pixel.

use nalgebra::Vector3;
use rilievo_stereo::camera::Camera;
use serde::{Deserialize, Serialize};

/// A plane through a reference pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct PatchPlane {
    /// Column of the centre.
    pub x: usize,
    /// Row of the centre.
    pub y: usize,
    /// Inverse depth at the centre.
    pub q: f64,
    /// Change of the inverse depth per column.
    pub qx: f64,
    /// Change of the inverse depth per row.
    pub qy: f64,
}

impl PatchPlane {
    /// Inverse depth as a linear function of the homogeneous pixel `(x, y, 1)`.
    pub fn of_pixel(&self) -> Vector3<f64> {
        let at_origin = self.q - self.qx * self.x as f64 - self.qy * self.y as f64;
        Vector3::new(self.qx, self.qy, at_origin)
    }

    /// The plane in its camera's frame, `m·X = 1`: along its normal, towards the surface.
    pub fn in_camera(&self, camera: &Camera) -> Vector3<f64> {
        let n = self.of_pixel();
        Vector3::new(
            camera.fx * n.x,
            camera.fy * n.y,
            camera.cx * n.x + camera.cy * n.y + n.z,
        )
    }
}
