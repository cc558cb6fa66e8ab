//! What the preflight measures on the pixels: level, clipping, noise, sharpness, colour, black
//! level and fall-off towards the corners.
//!
//! Noise: `σ = median |L ∗ I| / (0.6745 · 6)` with the mask `L = [1 −2 1]ᵀ [1 −2 1]`, which is
//! blind to planes and edges along the axes, and whose squared entries sum to 36 (Immerkær, "Fast
//! noise variance estimation", CVIU 1996, with the median instead of the mean: texture then counts
//! less).
//!
//! Black level: the darkest thousandth of the frame. Fall-off: [`crate::vignetting`].

use rilievo_numerics::robust::median;
use rilievo_scene::{LinearImage, Mask, Raster};

/// Pixels that are looked at for medians and noise: enough for a per cent, whatever the photo's size.
const MAX_NUM_SAMPLES: usize = 200_000;

/// Median of the absolute value of a normal variable of unit deviation.
const NORMAL_MEDIAN: f64 = 0.674_489_75;

/// What was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Measures {
    pub clipped_share: f64,
    pub clipped_share_on_object: Option<f64>,
    pub median_level: f64,
    pub noise_sigma: f64,
    pub sharpness: f64,
    pub color_ratios: Option<[f64; 2]>,
    pub black_level: f64,
    pub corner_falloff: f64,
}

/// Share of the frame's pixels that are darker than the black level.
const BLACK_SHARE: f64 = 1e-3;

/// Largest over smallest of positive values.
pub(crate) fn ratio(values: &[f64]) -> Option<f64> {
    let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
    let largest = values.iter().copied().fold(0.0, f64::max);
    (smallest > 0.0 && smallest.is_finite()).then(|| largest / smallest)
}

pub(crate) fn measure(image: &LinearImage, mask: Option<&Mask>, clip_level: f32) -> Measures {
    let pixels = image.data.chunks_exact(image.channels);
    let is_clipped = |pixel: &[f32]| pixel.iter().any(|&value| value >= clip_level);
    let on_object = |i: usize| mask.is_none_or(|mask| mask.data[i]);

    let mut clipped = 0usize;
    let mut clipped_on_object = 0usize;
    for (i, pixel) in pixels.clone().enumerate() {
        if is_clipped(pixel) {
            clipped += 1;
            clipped_on_object += usize::from(on_object(i));
        }
    }

    let grey = image.to_grey();
    let num_on_object = mask.map_or(grey.data.len(), Mask::count);
    let step = num_on_object.div_ceil(MAX_NUM_SAMPLES).max(1);
    let chosen: Vec<usize> = (0..grey.data.len())
        .filter(|&i| on_object(i))
        .step_by(step)
        .collect();
    let mut levels: Vec<f64> = chosen.iter().map(|&i| f64::from(grey.data[i])).collect();
    let median_level = median(&mut levels).unwrap_or(0.0);

    let mut responses: Vec<f64> = chosen
        .iter()
        .filter_map(|&i| second_difference(&grey, i))
        .collect();
    let mean_square = responses.iter().map(|r| r * r).sum::<f64>() / responses.len().max(1) as f64;
    responses.iter_mut().for_each(|r| *r = r.abs());
    let noise_sigma = median(&mut responses).unwrap_or(0.0) / (NORMAL_MEDIAN * 6.0);

    // Ratios of sums: noise averages out before the division.
    let color_ratios = (image.channels == 3)
        .then(|| {
            let mut sums = [0.0f64; 3];
            for &i in &chosen {
                let pixel = &image.data[3 * i..3 * i + 3];
                if !is_clipped(pixel) {
                    (0..3).for_each(|c| sums[c] += f64::from(pixel[c]));
                }
            }
            (sums.iter().all(|&sum| sum > 0.0)).then(|| [sums[0] / sums[1], sums[2] / sums[1]])
        })
        .flatten();

    Measures {
        clipped_share: clipped as f64 / grey.data.len().max(1) as f64,
        clipped_share_on_object: mask
            .map(|_| clipped_on_object as f64 / num_on_object.max(1) as f64),
        median_level,
        noise_sigma,
        sharpness: mean_square.sqrt() / median_level.max(1e-6),
        color_ratios,
        black_level: black_level(&grey),
        corner_falloff: crate::vignetting::corner_falloff(&grey, mask, clip_level),
    }
}

fn black_level(grey: &Raster<f32>) -> f64 {
    let step = grey.data.len().div_ceil(MAX_NUM_SAMPLES).max(1);
    let mut values: Vec<f64> = grey
        .data
        .iter()
        .step_by(step)
        .map(|&v| f64::from(v))
        .collect();
    if values.is_empty() {
        return 0.0;
    }
    let rank = (values.len() as f64 * BLACK_SHARE) as usize;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

/// `L ∗ I` at a pixel of the inside.
fn second_difference(grey: &Raster<f32>, index: usize) -> Option<f64> {
    let (x, y) = (index % grey.width, index / grey.width);
    if x == 0 || y == 0 || x + 1 >= grey.width || y + 1 >= grey.height {
        return None;
    }
    let row = |y: usize| {
        let at = |x: usize| f64::from(*grey.at(x, y));
        at(x - 1) - 2.0 * at(x) + at(x + 1)
    };
    Some(row(y - 1) - 2.0 * row(y) + row(y + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_synthetic::testing::Random;

    #[test]
    fn noise_on_a_ramp_is_measured_within_a_few_per_cent() {
        let mut random = Random(7);
        let mut image = LinearImage::filled(200, 150, 1, 0.0);
        for y in 0..150 {
            for x in 0..200 {
                let ramp = 0.2 + 1e-3 * x as f64 + 2e-3 * y as f64;
                image.pixel_mut(x, y)[0] = (ramp + 0.01 * random.normal()) as f32;
            }
        }
        let found = measure(&image, None, f32::MAX);
        assert!((found.noise_sigma / 0.01 - 1.0).abs() < 0.05, "{found:?}");
        assert!((found.median_level - 0.45).abs() < 0.01, "{found:?}");
        assert_eq!(found.clipped_share, 0.0);
    }

    #[test]
    fn clipping_is_counted_over_frame_and_object() {
        let mut image = LinearImage::filled(10, 10, 3, 0.5);
        image.pixel_mut(1, 1)[2] = 1.0;
        image.pixel_mut(8, 8)[0] = 1.0;
        let mask = Raster::from_fn(10, 10, |x, _| x < 5);
        let found = measure(&image, Some(&mask), 0.996);
        assert!((found.clipped_share - 0.02).abs() < 1e-12, "{found:?}");
        let on_object = found.clipped_share_on_object;
        assert!(
            on_object.is_some_and(|s| (s - 0.02).abs() < 1e-12),
            "{found:?}"
        );
        let ratios = found.color_ratios;
        assert!(
            ratios.is_some_and(|r| (r[0] - 1.0).abs() < 1e-6),
            "{found:?}"
        );
    }

    #[test]
    fn a_pedestal_and_dark_corners_are_measured() {
        let mut image = LinearImage::filled(120, 80, 1, 0.0);
        for y in 0..80 {
            for x in 0..120 {
                let r2 = (x as f32 - 59.5).hypot(y as f32 - 39.5).powi(2) / 5120.0;
                // Stripes, black and white, under a lens that loses half in the corners.
                let stripe = if x / 4 % 2 == 0 { 0.0 } else { 0.8 };
                image.pixel_mut(x, y)[0] = 0.05 + stripe * (1.0 - 0.5 * r2);
            }
        }
        let found = measure(&image, None, f32::MAX);
        assert!((found.black_level - 0.05).abs() < 1e-6, "{found:?}");
        let mut flat = LinearImage::filled(120, 80, 1, 0.0);
        for (i, value) in flat.data.iter_mut().enumerate() {
            let (x, y) = ((i % 120) as f32, (i / 120) as f32);
            *value = 1.0 - 0.5 * (x - 59.5).hypot(y - 39.5).powi(2) / 5120.0;
        }
        let falloff = measure(&flat, None, f32::MAX).corner_falloff;
        // Corners keep 0.55 to 0.6, the sides' middles 0.68 and 0.85.
        assert!((0.65..0.85).contains(&falloff), "{falloff}");
    }

    #[test]
    fn a_blurred_photo_is_less_sharp() {
        let texture = |period: f32| {
            let mut image = LinearImage::filled(64, 64, 1, 0.0);
            for y in 0..64 {
                for x in 0..64 {
                    let wave = (x as f32 / period).sin() * (y as f32 / period).sin();
                    image.pixel_mut(x, y)[0] = 0.5 + 0.2 * wave;
                }
            }
            measure(&image, None, f32::MAX).sharpness
        };
        let (sharp, soft) = (texture(1.0), texture(4.0));
        assert!(soft < 0.2 * sharp, "{soft} {sharp}");
    }
}
