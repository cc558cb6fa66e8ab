//! Poses as numbers row by row, as other languages hold them.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rilievo_scene::RigidTransform;

/// How far the rows of a rotation may be from unit length and right angles: numbers printed with
/// four digits.
const TOLERANCE: f64 = 1e-3;

/// A pose from the rows `[R | t]`; `None` where `R` is no rotation, or a number is not finite.
pub fn pose_of_rows(rows: &[[f64; 4]; 3]) -> Option<RigidTransform> {
    let rotation = Matrix3::from_fn(|row, column| rows[row][column]);
    let translation = Vector3::from_fn(|row, _| rows[row][3]);
    let off = (rotation * rotation.transpose() - Matrix3::identity()).abs();
    let is_rotation = off.max() < TOLERANCE && rotation.determinant() > 0.0;
    let is_finite = rows.iter().flatten().all(|value| value.is_finite());
    (is_rotation && is_finite).then(|| RigidTransform {
        rotation: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
        translation,
    })
}

/// The rows `[R | t]` of a pose.
pub fn pose_rows(pose: &RigidTransform) -> [[f64; 4]; 3] {
    let (r, t) = (pose.rotation_matrix(), pose.translation);
    [0, 1, 2].map(|row| [r[(row, 0)], r[(row, 1)], r[(row, 2)], t[row]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_become_a_pose_and_come_back_and_mirrors_and_nan_do_not() {
        let pose = RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.3, -0.7, 1.9),
            translation: Vector3::new(0.2, -1.5, 3.0),
        };
        let rows = pose_rows(&pose);
        let back = pose_of_rows(&rows).unwrap();
        assert!((back.rotation.angle_to(&pose.rotation)) < 1e-12);
        assert_eq!(back.translation, pose.translation);
        assert!(pose_of_rows(&rows.map(|row| row.map(|value| -value))).is_none());
        let mut nan = rows;
        nan[1][3] = f64::NAN;
        assert!(pose_of_rows(&nan).is_none());
        nan = rows;
        nan[0][0] = f64::NAN;
        assert!(pose_of_rows(&nan).is_none());
    }
}
