//! Rigid motions between frames.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A rotation followed by a translation, `x_in_target = R x_in_source + t`.
///
/// Name values `target_from_source`; then `a_from_b.compose(&b_from_c)` is `a_from_c` by eye.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigidTransform {
    /// Rotation part.
    pub rotation: UnitQuaternion<f64>,
    /// Translation part, in the target frame's unit.
    pub translation: Vector3<f64>,
}

impl RigidTransform {
    /// The transform that moves nothing.
    pub fn identity() -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// `cam_from_world` of a camera given by its rotation `world_from_camera` and its centre.
    pub fn from_world_pose(
        world_from_camera: Rotation3<f64>,
        center_in_world: Point3<f64>,
    ) -> Self {
        let rotation = UnitQuaternion::from_rotation_matrix(&world_from_camera.inverse());
        Self {
            rotation,
            translation: -(rotation * center_in_world.coords),
        }
    }

    /// Moves a point from the source to the target frame.
    pub fn apply(&self, point_in_source: &Point3<f64>) -> Point3<f64> {
        self.rotation * point_in_source + self.translation
    }

    /// `a_from_b.compose(&b_from_c)` is `a_from_c`.
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation + self.translation,
        }
    }

    /// `source_from_target`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// Origin of the target frame, seen in the source frame: the camera centre of a `cam_from_world`.
    pub fn center_in_source(&self) -> Point3<f64> {
        Point3::from(-(self.rotation.inverse() * self.translation))
    }

    /// Rotation as a matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn composition_and_inverse_agree_with_application() {
        let a_from_b = RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.3, -0.7, 1.9),
            translation: Vector3::new(0.2, -1.5, 3.0),
        };
        let b_from_c = RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(-1.3, 0.1, 0.4),
            translation: Vector3::new(-2.0, 0.5, 0.1),
        };
        let x_in_c = Point3::new(0.3, 0.4, -0.9);
        let direct = a_from_b.apply(&b_from_c.apply(&x_in_c));
        let composed = a_from_b.compose(&b_from_c).apply(&x_in_c);
        assert!((direct - composed).norm() < 1e-14);
        let back = a_from_b.inverse().apply(&a_from_b.apply(&x_in_c));
        assert!((back - x_in_c).norm() < 1e-14);
        let center = a_from_b.center_in_source();
        assert!(a_from_b.apply(&center).coords.norm() < 1e-14);
    }
}
