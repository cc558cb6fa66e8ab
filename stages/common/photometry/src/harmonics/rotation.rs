//! Exact rotation of the nine coefficients.
//!
//! Zeroth order is a number, first order a vector `v` with `v · n`, second order a symmetric,
//! traceless matrix `Q` with `nᵀ Q n`:
//! ```text
//!     | l7−l8  l4/2   l5/2 |
//! Q = | l4/2  −l7−l8  l6/2 |      because 3n3²−1 = 2n3²−n1²−n2² on the unit sphere.
//!     | l5/2   l6/2   2 l8 |
//! ```
//! With `n_b = R n_a` they become `v_b = R v_a` and `Q_b = R Q_a Rᵀ`; reading the coefficients
//! back from `Q_b` loses nothing, as it stays symmetric and traceless.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rilievo_scene::{Lighting, SphericalHarmonics};

/// Coefficients in frame `b` of a lighting given in frame `a`.
pub fn rotate_harmonics(
    light_in_a: &SphericalHarmonics,
    b_from_a: &UnitQuaternion<f64>,
) -> SphericalHarmonics {
    let l = &light_in_a.0;
    let r = b_from_a.to_rotation_matrix().into_inner();
    let v = r * Vector3::new(l[0], l[1], l[2]);
    #[rustfmt::skip]
    let quadratic = Matrix3::new(
        l[7] - l[8], 0.5 * l[4],   0.5 * l[5],
        0.5 * l[4],  -l[7] - l[8], 0.5 * l[6],
        0.5 * l[5],  0.5 * l[6],   2.0 * l[8],
    );
    let q = r * quadratic * r.transpose();
    SphericalHarmonics([
        v.x,
        v.y,
        v.z,
        l[3],
        2.0 * q[(0, 1)],
        2.0 * q[(0, 2)],
        2.0 * q[(1, 2)],
        0.5 * (q[(0, 0)] - q[(1, 1)]),
        0.5 * q[(2, 2)],
    ])
}

/// All channels of a lighting, from frame `a` into frame `b`.
pub fn rotate(light_in_a: &Lighting, b_from_a: &UnitQuaternion<f64>) -> Lighting {
    Lighting {
        channels: light_in_a
            .channels
            .iter()
            .map(|channel| rotate_harmonics(channel, b_from_a))
            .collect(),
    }
}

/// Direction from which most light comes: the first-order vector summed over the channels.
/// `None` for a light without a direction.
pub fn dominant_direction(light: &Lighting) -> Option<Vector3<f64>> {
    light
        .channels
        .iter()
        .map(|channel| Vector3::new(channel.0[0], channel.0[1], channel.0[2]))
        .sum::<Vector3<f64>>()
        .try_normalize(1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::fit_robust;

    const LIGHT: SphericalHarmonics =
        SphericalHarmonics([0.2, -0.5, 0.7, 0.9, -0.3, 0.11, 0.25, -0.17, 0.08]);

    fn directions() -> Vec<Vector3<f64>> {
        // A Fibonacci lattice covers the sphere evenly without a random stream.
        (0..400)
            .map(|i| {
                let z = 1.0 - (2.0 * i as f64 + 1.0) / 400.0;
                let angle = i as f64 * 2.399_963_229_728_653;
                let r = (1.0 - z * z).sqrt();
                Vector3::new(r * angle.cos(), r * angle.sin(), z)
            })
            .collect()
    }

    #[test]
    fn rotated_coefficients_equal_a_brute_force_refit() {
        let b_from_a = UnitQuaternion::from_euler_angles(0.7, -1.1, 2.3);
        let normals_in_b = directions();
        let values: Vec<f64> = normals_in_b
            .iter()
            .map(|n| LIGHT.evaluate(&(b_from_a.inverse() * n)))
            .collect();
        let oracle = fit_robust(&normals_in_b, &values, None).unwrap();
        let rotated = rotate_harmonics(&LIGHT, &b_from_a);
        for (exact, fitted) in rotated.0.iter().zip(&oracle.coefficients.0) {
            assert!((exact - fitted).abs() < 1e-11, "{exact} against {fitted}");
        }
    }

    #[test]
    fn rotations_compose_and_invert() {
        let b_from_a = UnitQuaternion::from_euler_angles(0.7, -1.1, 2.3);
        let c_from_b = UnitQuaternion::from_euler_angles(-0.2, 0.4, 1.0);
        let in_two_steps = rotate_harmonics(&rotate_harmonics(&LIGHT, &b_from_a), &c_from_b);
        let at_once = rotate_harmonics(&LIGHT, &(c_from_b * b_from_a));
        let back = rotate_harmonics(&rotate_harmonics(&LIGHT, &b_from_a), &b_from_a.inverse());
        for k in 0..9 {
            let error = (in_two_steps.0[k] - at_once.0[k]).abs() + (back.0[k] - LIGHT.0[k]).abs();
            assert!(error < 1e-14, "coefficient {k}: {error}");
        }
    }
}
