//! Edges for the search: gradients of all channels on a reduced image, thinned to ridges.
//!
//! # Steps
//! 1. Box reduction to at most [`WORK_SIZE`] pixels on the longer side; square root of the
//!    intensities, so that noise and contrast weigh alike in light and shade.
//! 2. Binomial smoothing, central differences per channel; the strongest channel gives magnitude
//!    and direction (Canny).
//! 3. Thinning across the gradient, and a threshold.

use rilievo_scene::{LinearImage, Raster};

/// Longer side of the reduced image; an outline of 20 pixels radius in a frame of 1300 keeps 10.
const WORK_SIZE: usize = 720;
/// Smallest gradient of an edge, square-root intensity per pixel.
const EDGE: f32 = 0.012;

/// Gradients and thinned edges of a reduced image.
pub(super) struct Edges {
    /// Full-size pixels per reduced pixel.
    pub reduction: usize,
    /// Gradient vector where the pixel is an edge, zero elsewhere.
    pub edge: Raster<[f32; 2]>,
    /// Gradient magnitude everywhere.
    pub magnitude: Raster<f32>,
}

impl Edges {
    /// Full-size coordinate of a reduced one: centres of pixel blocks.
    pub fn full(&self, reduced: f64) -> f64 {
        (reduced + 0.5) * self.reduction as f64 - 0.5
    }
}

pub(super) fn find_edges(image: &LinearImage) -> Edges {
    let reduction = image.width.max(image.height).div_ceil(WORK_SIZE).max(1);
    let (width, height) = (image.width / reduction, image.height / reduction);
    let mut gradient = Raster::filled(width, height, [0.0_f32; 2]);
    let mut magnitude = Raster::filled(width, height, 0.0_f32);
    for channel in 0..image.channels {
        let plane = smooth(&reduce(image, channel, reduction, width, height));
        for y in 1..height.saturating_sub(1) {
            for x in 1..width - 1 {
                let g = [
                    0.5 * (plane.at(x + 1, y) - plane.at(x - 1, y)),
                    0.5 * (plane.at(x, y + 1) - plane.at(x, y - 1)),
                ];
                let size = g[0].hypot(g[1]);
                if size > *magnitude.at(x, y) {
                    *magnitude.at_mut(x, y) = size;
                    *gradient.at_mut(x, y) = g;
                }
            }
        }
    }
    let edge = Raster::from_fn(width, height, |x, y| {
        let size = *magnitude.at(x, y);
        let g = *gradient.at(x, y);
        let ridge = size >= EDGE && {
            // The nearer of the four neighbour directions along the gradient.
            let (dx, dy) = (
                if g[0].abs() > 0.4 * size {
                    g[0].signum() as isize
                } else {
                    0
                },
                if g[1].abs() > 0.4 * size {
                    g[1].signum() as isize
                } else {
                    0
                },
            );
            let at = |sign: isize| {
                let (x, y) = (x as isize + sign * dx, y as isize + sign * dy);
                magnitude.get(x, y).copied().unwrap_or(0.0)
            };
            size >= at(1) && size > at(-1)
        };
        if ridge { g } else { [0.0; 2] }
    });
    Edges {
        reduction,
        edge,
        magnitude,
    }
}

fn reduce(
    image: &LinearImage,
    channel: usize,
    reduction: usize,
    width: usize,
    height: usize,
) -> Raster<f32> {
    let scale = 1.0 / (reduction * reduction) as f32;
    Raster::from_fn(width, height, |x, y| {
        let mut sum = 0.0;
        for dy in 0..reduction {
            for dx in 0..reduction {
                sum += image.pixel(x * reduction + dx, y * reduction + dy)[channel];
            }
        }
        (sum * scale).max(0.0).sqrt()
    })
}

/// Binomial filter 1 4 6 4 1 along both axes (standard deviation one pixel).
fn smooth(plane: &Raster<f32>) -> Raster<f32> {
    const WEIGHTS: [f32; 5] = [1.0 / 16.0, 0.25, 0.375, 0.25, 1.0 / 16.0];
    let along = |source: &Raster<f32>, dx: isize, dy: isize| {
        Raster::from_fn(source.width, source.height, |x, y| {
            let mut sum = 0.0;
            for (k, weight) in WEIGHTS.iter().enumerate() {
                let step = k as isize - 2;
                let xs = (x as isize + step * dx).clamp(0, source.width as isize - 1);
                let ys = (y as isize + step * dy).clamp(0, source.height as isize - 1);
                sum += weight * source.at(xs as usize, ys as usize);
            }
            sum
        })
    };
    along(&along(plane, 1, 0), 0, 1)
}
