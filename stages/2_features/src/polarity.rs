//! Whether a keypoint is a bright blob or a dark one.
//!
//! A keypoint at `c` of width `σ` is an extremum of differences of Gaussians, which have the sign of
//! the Laplacian of the smoothed image (Lindeberg, IJCV 1998):
//!
//! ```text
//! σ² ∇²(G_σ ∗ I)(c) = Σ_p g(p) (|p − c|²/σ² − 2) (I(p) − m),   g(p) = exp(−|p − c|²/2σ²),
//! ```
//!
//! with `m` the mean of `I` under `g`, so that a cut-off window does not answer to even brightness.
//! It is negative in bright blobs. The sign stays from photo to photo, and keypoints of unlike sign
//! need not be compared: half of the matching (as with the Laplacian's sign of SURF: Bay et al.,
//! CVIU 2008). Wide keypoints are looked at in halved images.

use rilievo_scene::Raster;

/// Radius of the window, in `σ`: the weight there is a hundredth.
const RADIUS_IN_SIGMA: f32 = 3.0;

/// Width above which a halved image serves, pixels.
const MAX_SIGMA_PX: f32 = 4.0;

/// Between the two Gaussians of a difference of SIFT's, in the width of the narrower: `2^{1/6}` with
/// three levels an octave.
const MIDDLE_WIDTH: f32 = 1.122_462;

/// An image and its halvings.
pub(crate) struct BlobPolarity {
    levels: Vec<Raster<f32>>,
}

impl BlobPolarity {
    /// For keypoints of this image.
    pub fn new(image: &Raster<u8>) -> Self {
        Self {
            levels: vec![Raster {
                width: image.width,
                height: image.height,
                data: image.data.iter().map(|&v| f32::from(v)).collect(),
            }],
        }
    }

    /// Whether the keypoint at `(x, y)` with SIFT's width `sigma_px` is brighter than what surrounds it.
    pub fn is_bright(&mut self, x: f32, y: f32, sigma_px: f32) -> bool {
        let (mut x, mut y, mut sigma) = (x, y, MIDDLE_WIDTH * sigma_px);
        let mut level = 0;
        while sigma > MAX_SIGMA_PX {
            if level + 1 == self.levels.len() {
                let halved = halve(&self.levels[level]);
                if halved.width.min(halved.height) < 2 {
                    break;
                }
                self.levels.push(halved);
            }
            (x, y, sigma) = (0.5 * x - 0.25, 0.5 * y - 0.25, 0.5 * sigma);
            level += 1;
        }
        laplacian(&self.levels[level], x, y, sigma) < 0.0
    }
}

/// Mean of 2×2 pixels.
pub(crate) fn halve(image: &Raster<f32>) -> Raster<f32> {
    Raster::from_fn(image.width / 2, image.height / 2, |x, y| {
        0.25 * (image.at(2 * x, 2 * y)
            + image.at(2 * x + 1, 2 * y)
            + image.at(2 * x, 2 * y + 1)
            + image.at(2 * x + 1, 2 * y + 1))
    })
}

/// First pixel of the window along one axis, and for each of its pixels `exp(−d²/2σ²)` and `d²/σ²`.
fn window(center: f32, sigma: f32, size: usize) -> (usize, Vec<(f32, f32)>) {
    let radius = RADIUS_IN_SIGMA * sigma;
    let last = size as f32 - 1.0;
    let start = (center - radius).ceil().clamp(0.0, last) as usize;
    let end = (center + radius).floor().clamp(0.0, last) as usize;
    let weights = (start..=end.max(start))
        .map(|p| {
            let q = ((p as f32 - center) / sigma).powi(2);
            ((-0.5 * q).exp(), q)
        })
        .collect();
    (start, weights)
}

/// `σ² ∇²(G_σ ∗ I)(x, y)` up to a positive factor.
fn laplacian(image: &Raster<f32>, x: f32, y: f32, sigma: f32) -> f32 {
    let (x0, columns) = window(x, sigma, image.width);
    let (y0, rows) = window(y, sigma, image.height);
    // Sums of g, g q, g I and g q I with q = |p − c|²/σ².
    let mut sums = [0.0_f32; 4];
    for (dy, &(gy, qy)) in rows.iter().enumerate() {
        let start = (y0 + dy) * image.width + x0;
        let pixels = &image.data[start..start + columns.len()];
        for (&(gx, qx), &value) in columns.iter().zip(pixels) {
            let (g, q) = (gx * gy, qx + qy);
            sums[0] += g;
            sums[1] += g * q;
            sums[2] += g * value;
            sums[3] += g * q * value;
        }
    }
    sums[3] - sums[2] * sums[1] / sums[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An uneven background with blobs on it: `(x, y, σ, height)`.
    fn blobs(list: &[(f32, f32, f32, f32)]) -> Raster<u8> {
        Raster::from_fn(200, 160, |x, y| {
            let (x, y) = (x as f32, y as f32);
            let mut value = 120.0 + 0.3 * x;
            for &(bx, by, sigma, height) in list {
                let r2 = (x - bx).powi(2) + (y - by).powi(2);
                value += height * (-r2 / (2.0 * sigma * sigma)).exp();
            }
            value.round() as u8
        })
    }

    #[test]
    fn faint_blobs_of_all_widths_have_their_sign_also_at_the_border() {
        let list = [
            (40.3, 37.8, 1.6, 12.0),
            (90.7, 40.2, 3.0, -12.0),
            (60.0, 110.5, 7.0, -8.0),
            (140.4, 95.1, 18.0, 8.0),
            (198.0, 3.0, 2.5, -12.0),
            (2.0, 80.0, 2.5, 12.0),
        ];
        let mut polarity = BlobPolarity::new(&blobs(&list));
        for (x, y, sigma, height) in list {
            let found = polarity.is_bright(x, y, sigma);
            assert_eq!(found, height > 0.0, "blob of width {sigma} at ({x}, {y})");
        }
    }

    #[test]
    fn a_window_wider_than_the_image_is_no_harm() {
        let mut polarity =
            BlobPolarity::new(&Raster::from_fn(5, 3, |x, _| if x == 2 { 90 } else { 10 }));
        assert!(polarity.is_bright(2.0, 1.0, 40.0));
    }
}
