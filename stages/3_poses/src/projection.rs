//! Projection of a world point with its derivatives.
//!
//! `x = R (X − C)`, `(u, v) = (x₁/x₃, x₂/x₃)`, `(u', v') = distort(u, v)`,
//! `pixel = (f_x u' + c_x, f_y v' + c_y)`. A pose moves by `R ← exp([ω]ₓ) R`, `C ← C + δ`
//! (`ω` in the camera frame, radians; `δ` in the world's unit); a camera by `ln f` (both focal
//! lengths together), `c_x`, `c_y`, `k1`, `k2`, `p1`, `p2`, `k3`, in this order.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point2, Point3, SMatrix, UnitQuaternion, Vector3};
use rilievo_scene::{Intrinsics, RigidTransform};

/// Number of intrinsic parameters that may be refined.
pub(crate) const NUM_INTRINSICS: usize = 8;
/// Index of the logarithm of the focal length among the intrinsics.
pub(crate) const FOCAL: usize = 0;
/// Indices of `c_x` and `c_y`.
pub(crate) const PRINCIPAL_POINT: std::ops::Range<usize> = 1..3;
/// Indices of `k₁` and `k₂`, which `p₁`, `p₂` and `k₃` follow.
pub(crate) const K1: usize = 3;
pub(crate) const K2: usize = 4;

/// Derivatives of a pixel.
pub(crate) struct ProjectionJacobian {
    /// By `(ω, δ)`.
    pub by_pose: SMatrix<f64, 2, 6>,
    /// By the point in the world frame.
    pub by_point: Matrix2x3<f64>,
    /// By the intrinsics.
    pub by_intrinsics: SMatrix<f64, 2, NUM_INTRINSICS>,
}

/// A pose as rotation and centre: the form in which it is adjusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CenteredPose {
    /// Rotation `cam_from_world`.
    pub rotation: UnitQuaternion<f64>,
    /// Camera centre in the world frame.
    pub center: Point3<f64>,
}

impl From<RigidTransform> for CenteredPose {
    fn from(cam_from_world: RigidTransform) -> Self {
        Self {
            rotation: cam_from_world.rotation,
            center: cam_from_world.center_in_source(),
        }
    }
}

impl From<CenteredPose> for RigidTransform {
    fn from(pose: CenteredPose) -> Self {
        Self {
            rotation: pose.rotation,
            translation: -(pose.rotation * pose.center.coords),
        }
    }
}

impl CenteredPose {
    /// The point in the camera frame.
    pub fn apply(&self, point: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * (point - self.center))
    }

    /// The pose moved by `(ω, δ)`.
    pub fn retract(&self, step: &[f64]) -> Self {
        let omega = Vector3::new(step[0], step[1], step[2]);
        Self {
            rotation: UnitQuaternion::new(omega) * self.rotation,
            center: self.center + Vector3::new(step[3], step[4], step[5]),
        }
    }
}

/// A camera moved by a step of its eight parameters.
pub(crate) fn retract_intrinsics(camera: &Intrinsics, step: &[f64; NUM_INTRINSICS]) -> Intrinsics {
    let mut moved = *camera;
    let factor = step[0].exp();
    moved.fx *= factor;
    moved.fy *= factor;
    moved.cx += step[1];
    moved.cy += step[2];
    moved.distortion.k1 += step[3];
    moved.distortion.k2 += step[4];
    moved.distortion.p1 += step[5];
    moved.distortion.p2 += step[6];
    moved.distortion.k3 += step[7];
    moved
}

/// Pixel of a world point and its derivatives; `None` behind the camera.
pub(crate) fn project_with_jacobian(
    camera: &Intrinsics,
    pose: &CenteredPose,
    point: &Point3<f64>,
) -> Option<(Point2<f64>, ProjectionJacobian)> {
    let in_cam = pose.apply(point);
    if in_cam.z.is_nan() || in_cam.z <= 0.0 {
        return None;
    }
    let inverse_depth = 1.0 / in_cam.z;
    let (u, v) = (in_cam.x * inverse_depth, in_cam.y * inverse_depth);
    let bend = camera.distortion.bend(u, v);
    let undistorted_by_cam = Matrix2x3::new(
        inverse_depth,
        0.0,
        -u * inverse_depth,
        0.0,
        inverse_depth,
        -v * inverse_depth,
    );
    let focal = Matrix2::new(camera.fx, 0.0, 0.0, camera.fy);
    let by_cam = focal * bend.by_undistorted * undistorted_by_cam;
    let rotation: Matrix3<f64> = pose.rotation.to_rotation_matrix().into_inner();
    let by_point = by_cam * rotation;
    // d(exp(ω) x)/dω = −[x]ₓ at ω = 0.
    let by_rotation = -by_cam * in_cam.coords.cross_matrix();
    let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
    by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_rotation);
    by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_point);
    let (fx, fy) = (camera.fx, camera.fy);
    let (u, v, ud, vd) = (bend.plane.x, bend.plane.y, bend.at.x, bend.at.y);
    let (r2, below) = (u * u + v * v, bend.denominator);
    #[rustfmt::skip]
    let by_intrinsics = SMatrix::<f64, 2, NUM_INTRINSICS>::from_row_slice(&[
        fx * ud, 1.0, 0.0,
        fx * u * r2 / below, fx * u * r2 * r2 / below, fx * 2.0 * u * v, fx * (r2 + 2.0 * u * u), fx * u * r2 * r2 * r2 / below,
        fy * vd, 0.0, 1.0,
        fy * v * r2 / below, fy * v * r2 * r2 / below, fy * (r2 + 2.0 * v * v), fy * 2.0 * u * v, fy * v * r2 * r2 * r2 / below,
    ]);
    Some((
        Point2::new(camera.fx * ud + camera.cx, camera.fy * vd + camera.cy),
        ProjectionJacobian {
            by_pose,
            by_point,
            by_intrinsics,
        },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_numerics::derivatives::jacobian_error;
    use rilievo_scene::Distortion;

    #[test]
    fn derivatives_agree_with_differences() {
        let plain = Distortion {
            k1: -0.15,
            k2: 0.06,
            p1: 2e-3,
            p2: -1e-3,
            k3: 0.02,
            ..Distortion::default()
        };
        let rational = Distortion {
            denominator: [0.2, -0.03, 0.01],
            ..plain
        };
        let fisheye = Distortion {
            k4: -0.01,
            prism: [3e-3, -2e-3],
            fisheye: true,
            ..plain
        };
        for distortion in [plain, rational, fisheye] {
            agrees(Intrinsics {
                distortion,
                ..Intrinsics::pinhole(1000, 800, 900.0, 505.0, 395.0)
            });
        }
    }

    fn agrees(camera: Intrinsics) {
        let pose = CenteredPose {
            rotation: UnitQuaternion::from_euler_angles(0.2, -0.4, 0.1),
            center: Point3::new(0.3, -0.2, -3.0),
        };
        let point = Point3::new(0.4, 0.1, 0.5);
        let (_, j) = project_with_jacobian(&camera, &pose, &point).unwrap();
        let mut analytic = Vec::new();
        for row in 0..2 {
            analytic.extend((0..6).map(|k| j.by_pose[(row, k)]));
            analytic.extend((0..3).map(|k| j.by_point[(row, k)]));
            analytic.extend((0..NUM_INTRINSICS).map(|k| j.by_intrinsics[(row, k)]));
        }
        let residual = |x: &[f64], out: &mut [f64]| {
            let step: [f64; NUM_INTRINSICS] = std::array::from_fn(|k| x[9 + k]);
            let moved = pose.retract(&x[..6]);
            let at = point + Vector3::new(x[6], x[7], x[8]);
            let pixel = retract_intrinsics(&camera, &step)
                .project(&moved.apply(&at))
                .unwrap();
            out[0] = pixel.x;
            out[1] = pixel.y;
        };
        let error = jacobian_error(&[0.0; 17], 2, residual, &analytic);
        assert!(error < 1e-6, "{error}");
    }
}
