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
use super::pixels::Slopes;
use rilievo_scene::ConfidenceMap;

/// Angle by which the normals of a start may err, radians.
const START_ERROR: f32 = 0.3;
/// Angle at which the confidence is one half, radians: five degrees.
const HALF_ANGLE: f32 = 0.0873;

/// Confidence from the final slopes `θ` and the surface's slopes `∇y`.
pub(crate) fn map(
    (width, height): (usize, usize),
    level: &Level,
    [p, q]: &Slopes,
    surface: &Slopes,
    sigma: f64,
) -> ConfidenceMap {
    let pixels = &level.pixels;
    let mut out = ConfidenceMap::filled(width, height, 0.0);
    let sigma = sigma as f32;
    for (k, (x, y)) in level.grid.pixels().enumerate() {
        let facet = pixels.facet(k, [p[k], q[k]]);
        let open = (START_ERROR * facet.length()).powi(2);
        let [a, b, d] = pixels.normal_matrix(k, &facet);
        let r2 = pixels
            .residuals(k, [p[k], q[k]])
            .fold(0.0, |sum, r| sum + r.powi(2));
        let mean = 0.5 * (a + d);
        let root = (0.25 * (a - d) * (a - d) + b * b).sqrt();
        let (large, small) = (mean + root, (mean - root).max(0.0));
        let conflict = (p[k] - surface[0][k]).powi(2) + (q[k] - surface[1][k]).powi(2);
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
