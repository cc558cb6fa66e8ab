//! The image formation model on slopes, and its derivative: the readable version.
//!
//! **Problem.** With dimensionless slopes `p = f ∂ₓ ln z`, `q = f ∂ᵧ ln z` at a pixel whose ray is
//! `(X, Y, 1)`,
//!
//! ```text
//! n = [p, q, −w] / d,   w = 1 + X p + Y q,   d = √(p² + q² + w²),      (eq. 2, 3)
//! S(p, q) = l · h(n),                                                    (eq. 1)
//! ∂S/∂p = (g₀ − X g₂)/d − (g·n)(p + X w)/d²,   g = ∂(l·h)/∂n,
//! ```
//!
//! and the same in `q` with `Y` and `g₁`. Orthographic projection is `X = Y = 0` with slopes of
//! depth in pixels. `X, Y`: no unit; `l`: intensity. [`super::theta`] repeats these lines on lanes.
//!
//! Source: Quéau et al., ICCV 2017 (`queau2017`), eq. 1–3.

/// Value of `l·h(n)` and its derivatives in `n`.
#[inline(always)]
pub(crate) fn harmonics(l: &[f32; 9], n: [f32; 3]) -> (f32, [f32; 3]) {
    let [a, b, c] = n;
    let value = l[0] * a
        + l[1] * b
        + l[2] * c
        + l[3]
        + l[4] * a * b
        + l[5] * a * c
        + l[6] * b * c
        + l[7] * (a * a - b * b)
        + l[8] * (3.0 * c * c - 1.0);
    let gradient = [
        l[0] + l[4] * b + l[5] * c + 2.0 * l[7] * a,
        l[1] + l[4] * a + l[6] * c - 2.0 * l[7] * b,
        l[2] + l[5] * a + l[6] * b + 6.0 * l[8] * c,
    ];
    (value, gradient)
}

/// Geometry of one pixel at given slopes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    pub(crate) normal: [f32; 3],
    ray: [f32; 2],
    inverse_length: f32,
    // Derivatives of ln d.
    log_length: [f32; 2],
}

impl Facet {
    #[inline(always)]
    pub(crate) fn new(ray: [f32; 2], slopes: [f32; 2]) -> Self {
        let [x, y] = ray;
        let [p, q] = slopes;
        let w = 1.0 + x * p + y * q;
        let i = 1.0 / (p * p + q * q + w * w).sqrt();
        Self {
            normal: [p * i, q * i, -w * i],
            ray,
            inverse_length: i,
            log_length: [(p + x * w) * i * i, (q + y * w) * i * i],
        }
    }

    /// Shading and its derivatives in the slopes.
    #[inline(always)]
    pub(crate) fn shade(&self, l: &[f32; 9]) -> (f32, [f32; 2]) {
        let (value, g) = harmonics(l, self.normal);
        let n = self.normal;
        let along = g[0] * n[0] + g[1] * n[1] + g[2] * n[2];
        let i = self.inverse_length;
        (
            value,
            [
                i * (g[0] - self.ray[0] * g[2]) - along * self.log_length[0],
                i * (g[1] - self.ray[1] * g[2]) - along * self.log_length[1],
            ],
        )
    }

    /// Length `d` of the unnormalised normal: area of the facet per pixel of the reference plane.
    #[inline(always)]
    pub(crate) fn length(&self) -> f32 {
        1.0 / self.inverse_length
    }

    /// Gradient of `d` in the slopes.
    #[inline(always)]
    pub(crate) fn length_gradient(&self) -> [f32; 2] {
        let d = self.length();
        [d * self.log_length[0], d * self.log_length[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_numerics::derivatives::jacobian_error;

    #[test]
    fn derivatives_agree_with_differences() {
        let light: [f32; 9] = [-0.2, 0.3, -1.0, 0.4, 0.1, -0.1, -0.2, 0.15, 0.05];
        // The reference repeats the model in f64, since f32 differences are too coarse.
        let value = |ray: [f64; 2], s: &[f64]| {
            let w = 1.0 + ray[0] * s[0] + ray[1] * s[1];
            let d = (s[0] * s[0] + s[1] * s[1] + w * w).sqrt();
            let n = nalgebra::Vector3::new(s[0] / d, s[1] / d, -w / d);
            let l = rilievo_scene::SphericalHarmonics(light.map(f64::from));
            (l.evaluate(&n), d)
        };
        for ray in [[0.0, 0.0], [0.3, -0.2], [-0.4, 0.5]] {
            for slopes in [[0.0, 0.0], [0.7, -1.2], [-2.5, 0.4]] {
                let facet = Facet::new(ray.map(|v| v as f32), slopes.map(|v| v as f32));
                let (shade, gradient) = facet.shade(&light);
                let (expected, length) = value(ray, &slopes);
                assert!(
                    (f64::from(shade) - expected).abs() < 1e-6,
                    "{shade} {expected}"
                );
                assert!((f64::from(facet.length()) - length).abs() < 1e-5);
                let area = facet.length_gradient();
                let jacobian = [
                    f64::from(gradient[0]),
                    f64::from(gradient[1]),
                    f64::from(area[0]),
                    f64::from(area[1]),
                ];
                let error = jacobian_error(
                    &slopes,
                    2,
                    |s, out| {
                        let (shade, d) = value(ray, s);
                        out[0] = shade;
                        out[1] = d;
                    },
                    &jacobian,
                );
                assert!(error < 2e-6, "{error} at {ray:?} {slopes:?}");
            }
        }
    }
}
