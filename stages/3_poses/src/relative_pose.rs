//! Relative pose of two views from their essential matrix.
//!
//! `E = [t]ₓ R = U diag(1,1,0) Vᵀ` leaves four motions, `R ∈ {U W Vᵀ, U Wᵀ Vᵀ}`, `t = ± u₃` with
//! `W` a quarter turn about the third axis (Hartley and Zisserman, result 9.19); the one with most
//! points in front of both cameras is right.

use nalgebra::{Matrix3, Point2, Rotation3, UnitQuaternion, Vector3};
use rilievo_scene::RigidTransform;

/// A relative pose with what supports it.
pub(crate) struct RelativePose {
    /// Second camera from the first, translation of length 1.
    pub second_from_first: RigidTransform,
    /// Angle between the rays of each match in front of both cameras, radians.
    pub angles_rad: Vec<f64>,
}

/// The four motions of an essential matrix.
fn motions(essential: &Matrix3<f64>) -> Option<[RigidTransform; 4]> {
    let svd = essential.svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    // The sign of E is free: choose it so that both factors are rotations.
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into_owned();
    let motion = |r: Matrix3<f64>, t: Vector3<f64>| RigidTransform {
        rotation: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r)),
        translation: t,
    };
    let (a, b) = (u * w * v_t, u * w.transpose() * v_t);
    Some([motion(a, t), motion(a, -t), motion(b, t), motion(b, -t)])
}

/// Signed distances along both rays of normalised coordinates to where they come nearest, with the
/// angle between them.
pub(crate) fn depths(
    motion: &RigidTransform,
    x1: &Point2<f64>,
    x2: &Point2<f64>,
) -> (f64, f64, f64) {
    // λ2 d2 = λ1 R d1 + t, in the least-squares sense.
    let d1 = (motion.rotation * x1.to_homogeneous()).normalize();
    let d2 = x2.to_homogeneous().normalize();
    let cosine = d1.dot(&d2);
    let sine2 = (1.0 - cosine * cosine).max(1e-18);
    let (t1, t2) = (d1.dot(&motion.translation), d2.dot(&motion.translation));
    let depth1 = (cosine * t2 - t1) / sine2;
    let depth2 = (t2 - cosine * t1) / sine2;
    (depth1, depth2, d1.cross(&d2).norm().atan2(cosine))
}

/// Chooses the motion that puts most matches in front of both cameras.
pub(crate) fn from_essential(
    essential: &Matrix3<f64>,
    x1: &[Point2<f64>],
    x2: &[Point2<f64>],
) -> Option<RelativePose> {
    motions(essential)?
        .into_iter()
        .map(|motion| {
            let angles_rad: Vec<f64> = x1
                .iter()
                .zip(x2)
                .filter_map(|(a, b)| {
                    let (depth1, depth2, angle) = depths(&motion, a, b);
                    (depth1 > 0.0 && depth2 > 0.0).then_some(angle)
                })
                .collect();
            RelativePose {
                second_from_first: motion,
                angles_rad,
            }
        })
        .reduce(|best, next| {
            if next.angles_rad.len() > best.angles_rad.len() {
                next
            } else {
                best
            }
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn recovers_the_motion_from_exact_points() {
        let truth = RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.1, 0.35, -0.2),
            translation: Vector3::new(-0.8, 0.1, 0.25).normalize(),
        };
        let points: Vec<Point3<f64>> = (0..20)
            .map(|k| {
                let k = f64::from(k);
                Point3::new((k * 1.7).sin(), (k * 0.9).cos(), 4.0 + (k * 2.3).sin())
            })
            .collect();
        let x1: Vec<_> = points.iter().map(|p| p.xy() / p.z).collect();
        let x2: Vec<_> = points
            .iter()
            .map(|p| truth.apply(p))
            .map(|p| p.xy() / p.z)
            .collect();
        let e = truth.translation.cross_matrix() * truth.rotation_matrix();
        for sign in [1.0, -1.0] {
            let found = from_essential(&(e * sign), &x1, &x2).unwrap();
            assert_eq!(found.angles_rad.len(), 20);
            let turned = found.second_from_first.rotation.angle_to(&truth.rotation);
            let moved = (found.second_from_first.translation - truth.translation).norm();
            assert!(turned < 1e-9 && moved < 1e-9, "{turned} {moved}");
        }
    }
}
