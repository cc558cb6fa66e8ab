//! Pose from three points (Grunert 1841, as given by Haralick et al., IJCV 1994, eq. 9 to 11).
//!
//! Unit rays `f1, f2, f3` meet the points `P1, P2, P3` at distances `s1, s2 = u s1, s3 = v s1`.
//! With `a = |P2 P3|`, `b = |P1 P3|`, `c = |P1 P2|` the law of cosines gives a quartic in `v`;
//! each real root gives the distances, and three point pairs the pose.

use nalgebra::{Complex, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rilievo_scene::RigidTransform;

/// All poses `cam_from_world` (at most four) that see three world points along three unit rays.
pub(crate) fn solve(rays: &[Vector3<f64>; 3], points: &[Point3<f64>; 3]) -> Vec<RigidTransform> {
    let a2 = (points[1] - points[2]).norm_squared();
    let b2 = (points[0] - points[2]).norm_squared();
    let c2 = (points[0] - points[1]).norm_squared();
    if a2.min(b2).min(c2) <= 1e-24 * a2.max(b2).max(c2) || a2.is_nan() {
        return Vec::new();
    }
    let (cos_a, cos_b, cos_c) = (
        rays[1].dot(&rays[2]),
        rays[0].dot(&rays[2]),
        rays[0].dot(&rays[1]),
    );
    let q = (a2 - c2) / b2;
    let (ab, cb, sum) = (a2 / b2, c2 / b2, (a2 + c2) / b2);
    let quartic = [
        (1.0 + q).powi(2) - 4.0 * ab * cos_c * cos_c,
        4.0 * (-q * (1.0 + q) * cos_b + 2.0 * ab * cos_c * cos_c * cos_b
            - (1.0 - sum) * cos_a * cos_c),
        2.0 * (q * q - 1.0 + 2.0 * q * q * cos_b * cos_b + 2.0 * (1.0 - cb) * cos_a * cos_a
            - 4.0 * sum * cos_a * cos_b * cos_c
            + 2.0 * (1.0 - ab) * cos_c * cos_c),
        4.0 * (q * (1.0 - q) * cos_b - (1.0 - sum) * cos_a * cos_c
            + 2.0 * cb * cos_a * cos_a * cos_b),
        (q - 1.0).powi(2) - 4.0 * cb * cos_a * cos_a,
    ];
    let mut poses = Vec::with_capacity(4);
    for v in real_roots(&quartic) {
        let denominator = 2.0 * (cos_c - v * cos_a);
        if v <= 0.0 || denominator.abs() < 1e-12 {
            continue;
        }
        let u = ((q - 1.0) * v * v - 2.0 * q * cos_b * v + 1.0 + q) / denominator;
        let s1_squared = b2 / (1.0 + v * v - 2.0 * v * cos_b);
        if u <= 0.0 || s1_squared.is_nan() || s1_squared <= 0.0 {
            continue;
        }
        let s1 = s1_squared.sqrt();
        let in_cam = [rays[0] * s1, rays[1] * (u * s1), rays[2] * (v * s1)];
        if let Some(pose) = align(points, &in_cam) {
            poses.push(pose);
        }
    }
    poses
}

/// Rigid motion of three points onto three others (Kabsch).
fn align(points: &[Point3<f64>; 3], in_cam: &[Vector3<f64>; 3]) -> Option<RigidTransform> {
    let mean_world = (points[0].coords + points[1].coords + points[2].coords) / 3.0;
    let mean_cam = (in_cam[0] + in_cam[1] + in_cam[2]) / 3.0;
    let mut covariance = Matrix3::zeros();
    for (p, c) in points.iter().zip(in_cam) {
        covariance += (c - mean_cam) * (p.coords - mean_world).transpose();
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u * v_t).determinant().signum();
    let r = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r));
    Some(RigidTransform {
        rotation,
        translation: mean_cam - rotation * mean_world,
    })
}

/// Real roots of `Σ c_k x^k`, degree four, by Durand and Kerner's simultaneous iteration and a
/// Newton polish.
fn real_roots(c: &[f64; 5]) -> Vec<f64> {
    let largest = c.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if c[4].abs() <= 1e-14 * largest || largest.is_nan() {
        return Vec::new();
    }
    let monic: [f64; 5] = std::array::from_fn(|k| c[k] / c[4]);
    let bound = 1.0 + monic[..4].iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let radius = bound.min(4.0);
    let value = |x: Complex<f64>| {
        (((x + monic[3]) * x + monic[2]) * x + monic[1]) * x + Complex::new(monic[0], 0.0)
    };
    // Start on a circle, off the real axis and off its symmetries.
    let mut roots: [Complex<f64>; 4] = std::array::from_fn(|k| {
        Complex::from_polar(radius, 0.4 + std::f64::consts::FRAC_PI_2 * k as f64)
    });
    for _ in 0..100 {
        let mut change = 0.0_f64;
        for k in 0..4 {
            let mut product = Complex::new(1.0, 0.0);
            for (j, other) in roots.iter().enumerate() {
                if j != k {
                    product *= roots[k] - other;
                }
            }
            let step = value(roots[k]) / product;
            if !(step.re.is_finite() && step.im.is_finite()) {
                continue;
            }
            roots[k] -= step;
            change = change.max(step.norm() / (1.0 + roots[k].norm()));
        }
        if change < 1e-14 {
            break;
        }
    }
    roots
        .iter()
        .filter(|x| x.im.abs() <= 1e-4 * (1.0 + x.re.abs()))
        .map(|x| {
            let mut x = x.re;
            for _ in 0..2 {
                let p = (((x + monic[3]) * x + monic[2]) * x + monic[1]) * x + monic[0];
                let slope = ((4.0 * x + 3.0 * monic[3]) * x + 2.0 * monic[2]) * x + monic[1];
                if slope != 0.0 && (p / slope).is_finite() {
                    x -= p / slope;
                }
            }
            x
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_of_the_poses_is_the_true_one() {
        for k in 0..50 {
            let k = f64::from(k);
            let truth = RigidTransform {
                rotation: UnitQuaternion::from_euler_angles(k * 0.37, k * 0.61, k * 0.23),
                translation: Vector3::new(k.sin(), k.cos(), 5.0 + (3.0 * k).sin()),
            };
            let points = [0.0, 1.0, 2.0].map(|j: f64| {
                Point3::new(
                    (k + j * 2.1).sin(),
                    (k * 0.7 + j).cos(),
                    (k * 1.3 - j).sin(),
                )
            });
            let rays = points.map(|p| truth.apply(&p).coords.normalize());
            let best = solve(&rays, &points)
                .iter()
                .map(|p| {
                    p.rotation.angle_to(&truth.rotation)
                        + (p.translation - truth.translation).norm()
                })
                .fold(f64::INFINITY, f64::min);
            assert!(best < 1e-5, "case {k}: {best}");
        }
    }

    #[test]
    fn coincident_points_give_no_pose() {
        let p = Point3::new(0.1, 0.2, 3.0);
        let ray = p.coords.normalize();
        assert!(solve(&[ray; 3], &[p; 3]).is_empty());
    }
}
