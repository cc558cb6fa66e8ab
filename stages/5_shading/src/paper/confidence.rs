//! How well intensities determine each normal, and how well the surface agrees.
//!
//! **Model.** At a pixel with singular values `s₁ ≥ s₂` of its shading Jacobian and noise `σ`, the
//! slope's expected squared error is the sum of
//!
//! ```text
//! σ²/(s₂² + σ²/(D d)²)        what the pixel leaves open, at most the error D of a start's normals,
//! |θ − ∇y|²                   the conflict between shading and an integrable surface,
//! (r/s₁)²                     the residual r of the image, as a slope,
//! ```
//!
//! and the confidence is `1/(1 + e²/E²)` with `E` five degrees after the slope error `e` has been
//! turned into an angle of the normal (`1/d` for the facet's length `d`). It ranks errors; it is not
//! a calibrated probability, since errors of the light are not seen in it.

use super::levels::Level;
use super::model::Facet;
use rilievo_scene::ConfidenceMap;

/// Angle by which the normals of a start may err, radians.
const START_ERROR: f32 = 0.3;
/// Angle at which the confidence is one half, radians: five degrees.
const HALF_ANGLE: f32 = 0.0873;

/// Confidence from the final slopes `θ` and the surface's slopes `∇y`.
pub(crate) fn map(
    (width, height): (usize, usize),
    level: &Level,
    theta: (&[f32], &[f32]),
    surface: (&[f32], &[f32]),
    sigma: f64,
) -> ConfidenceMap {
    let pixels = &level.pixels;
    let mut out = ConfidenceMap::filled(width, height, 0.0);
    let sigma = sigma as f32;
    for (k, (x, y)) in level.grid.pixels().enumerate() {
        let facet = Facet::new([pixels.ray_x[k], pixels.ray_y[k]], [theta.0[k], theta.1[k]]);
        let open = (START_ERROR * facet.length()).powi(2);
        let (mut a, mut b, mut d, mut r2) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
        for c in 0..pixels.channels {
            let (shade, [jp, jq]) = facet.shade(&pixels.light(c, k));
            a += jp * jp;
            b += jp * jq;
            d += jq * jq;
            r2 += (shade - pixels.intensity[c * pixels.padded + k]).powi(2);
        }
        let mean = 0.5 * (a + d);
        let root = (0.25 * (a - d) * (a - d) + b * b).sqrt();
        let (large, small) = (mean + root, (mean - root).max(0.0));
        let conflict = (theta.0[k] - surface.0[k]).powi(2) + (theta.1[k] - surface.1[k]).powi(2);
        let squared = if pixels.weight[k] > 0.0 {
            let left_open = sigma * sigma / (small + sigma * sigma / open);
            left_open + conflict + (r2 / (large + sigma * sigma / open)).min(1.0)
        } else {
            open + conflict
        };
        let angle = squared / (facet.length() * facet.length());
        *out.at_mut(x, y) = 1.0 / (1.0 + angle / (HALF_ANGLE * HALF_ANGLE));
    }
    out
}
