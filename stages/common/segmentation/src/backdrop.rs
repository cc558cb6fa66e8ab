//! Proposes an object's mask where the object stands before a plain backdrop, dark or bright.
//!
//! With `s = √L` per channel (the square root evens out shot noise), the backdrop is a smooth
//! surface `b(x, y) = Σ cᵢⱼ xⁱ yʲ, i + j ≤ 2`, fitted to a ring along the frame by least squares
//! with the object's share of the ring trimmed; its scatter σ is the ring's median deviation. A
//! pixel's distance is `d = |s − b| / σ`, and the object is the largest connected region of
//! `d > t`, its holes filled, with `t` by Otsu's method (IEEE Trans. SMC 9, 1979) on `ln(1 + d)`.
//!
//! It is a proposal, to be looked at and corrected by hand: shadows on the backdrop, and parts of
//! the object as dark as it, are beyond what brightness shows. [`MaskProposal`] states how sure it
//! is by how far the two classes lie apart, `η = between-class variance / variance` (Otsu's
//! measure), and by how much of the object's area lies near the threshold.

use crate::error::SegmentationError;
use crate::raster::regions;
use nalgebra::{Matrix6, Vector6};
use opencv::core::Mat;
use opencv::imgproc;
use rilievo_numerics::robust::median;
use rilievo_scene::{LinearImage, Mask, Raster};
use serde::{Deserialize, Serialize};

/// Width of the ring, share of the shorter side.
const RING_SHARE: f64 = 0.04;

/// Rounds of fitting and trimming.
const NUM_ROUNDS: usize = 6;

/// Deviations beyond which a ring's pixel is taken for the object.
const TRIM_SIGMA: f64 = 3.0;

/// Smallest scatter that is believed: a step of 8 bits at mid grey.
const MIN_SIGMA: f64 = 0.004;

/// Largest scatter of a plain backdrop.
const MAX_SIGMA: f64 = 0.05;

/// Least share of the ring that must be backdrop.
const MIN_BACKDROP_SHARE: f64 = 0.65;

/// Least threshold: an empty frame has no two classes for Otsu's method to part.
const MIN_DISTANCE: f64 = 6.0;

/// Shares of the frame between which a region can be an object.
const OBJECT_SHARES: std::ops::RangeInclusive<f64> = 0.002..=0.95;

/// Distances from the threshold, as a factor, within which a pixel is in doubt.
const DOUBT_FACTOR: f32 = 1.5;

/// Backdrop levels below which it is called dark and above which bright, square root of linear.
const DARK_BRIGHT: [f64; 2] = [0.35, 0.7];

type Surface = Vector6<f64>;

/// What the backdrop is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backdrop {
    /// Darker than an eighth of white.
    Dark,
    /// Between the two.
    Grey,
    /// Brighter than half of white.
    Bright,
}

/// A proposed mask and how far to trust it.
#[derive(Clone, Debug, PartialEq)]
pub struct MaskProposal {
    /// The object.
    pub mask: Mask,
    /// What it stands before.
    pub backdrop: Backdrop,
    /// How far object and backdrop lie apart: Otsu's `η`, 0 to 1.
    pub separability: f64,
    /// Pixels near the threshold over the object's pixels.
    pub doubtful_share: f64,
    /// Share of the frame's border that the object touches.
    pub border_share: f64,
}

impl MaskProposal {
    /// Trust in one number, 0 to 1: `η` times the share that is not in doubt.
    pub fn certainty(&self) -> f64 {
        self.separability * (1.0 - self.doubtful_share.min(1.0))
    }
}

fn monomials(x: f64, y: f64) -> Vector6<f64> {
    Vector6::new(1.0, x, y, x * x, x * y, y * y)
}

/// Proposes a mask of a photo.
///
/// # Errors
/// [`SegmentationError::NoBackdrop`] when the frame's border is not plain or nothing stands out
/// from it.
pub fn propose_mask(photo: &str, image: &LinearImage) -> Result<MaskProposal, SegmentationError> {
    let refuse = |reason: &'static str| SegmentationError::NoBackdrop {
        photo: photo.to_owned(),
        reason,
    };
    let (width, height) = (image.width, image.height);
    if width.min(height) < 16 {
        return Err(refuse("the photo is too small"));
    }
    let ring = ring(width, height);
    let scale = 2.0 / width.max(height) as f64;
    let at = |index: usize| {
        monomials(
            (index % width) as f64 * scale - 1.0,
            (index / width) as f64 * scale - 1.0,
        )
    };

    // Backdrop, channel by channel.
    let mut squared = vec![0.0f32; width * height];
    let mut levels = Vec::new();
    for channel in 0..image.channels {
        let value =
            |index: usize| f64::from(image.data[index * image.channels + channel].max(0.0)).sqrt();
        let (surface, sigma, kept) = fit(&ring, &at, &value).ok_or_else(|| {
            refuse("its border is not plain; put one even sheet behind the object")
        })?;
        if sigma > MAX_SIGMA || kept < MIN_BACKDROP_SHARE {
            return Err(refuse(
                "its border is not plain; put one even sheet behind the object",
            ));
        }
        let mut level: Vec<f64> = ring.iter().map(|&i| surface.dot(&at(i))).collect();
        levels.extend(median(&mut level));
        for (index, sum) in squared.iter_mut().enumerate() {
            let deviation = (value(index) - surface.dot(&at(index))) / sigma;
            *sum += (deviation * deviation) as f32;
        }
    }
    let distance: Vec<f32> = squared.into_iter().map(|sum| sum.sqrt().ln_1p()).collect();

    // Object.
    let (threshold, separability) = otsu(&distance)?;
    let threshold = threshold.max(MIN_DISTANCE.ln_1p() as f32);
    let apart = Raster {
        width,
        height,
        data: distance.iter().map(|&d| d > threshold).collect(),
    };
    let object = without_holes(&largest_region(&apart)?)?;
    if !OBJECT_SHARES.contains(&object.coverage()) {
        return Err(refuse("nothing stands out from the backdrop"));
    }
    // Inside the object everything may be as bright as the backdrop; only its rim is in doubt.
    let doubt = DOUBT_FACTOR.ln();
    let doubtful = distance
        .iter()
        .enumerate()
        .filter(|&(index, &d)| {
            (d - threshold).abs() < doubt && (!object.data[index] || !apart.data[index])
        })
        .count();
    let level = levels.iter().sum::<f64>() / levels.len() as f64;
    Ok(MaskProposal {
        backdrop: match level {
            l if l < DARK_BRIGHT[0] => Backdrop::Dark,
            l if l > DARK_BRIGHT[1] => Backdrop::Bright,
            _ => Backdrop::Grey,
        },
        separability,
        doubtful_share: doubtful as f64 / object.count().max(1) as f64,
        border_share: object.frame_share(),
        mask: object,
    })
}

/// Pixels along the frame, thinned to some ten thousand.
fn ring(width: usize, height: usize) -> Vec<usize> {
    let thickness = ((width.min(height) as f64 * RING_SHARE).ceil() as usize).max(2);
    let in_ring = |x: usize, y: usize| {
        x < thickness || y < thickness || x >= width - thickness || y >= height - thickness
    };
    let num = 2 * thickness * (width + height);
    let step = (num / 10_000).max(1);
    (0..width * height)
        .filter(|index| in_ring(index % width, index / width))
        .step_by(step)
        .collect()
}

/// The surface through the ring, its scatter, and the share of the ring that lies on it.
fn fit(
    ring: &[usize],
    at: &dyn Fn(usize) -> Vector6<f64>,
    value: &dyn Fn(usize) -> f64,
) -> Option<(Surface, f64, f64)> {
    let mut values: Vec<f64> = ring.iter().map(|&index| value(index)).collect();
    let mut surface = Surface::zeros();
    surface[0] = median(&mut values)?;
    let mut sigma = f64::NAN;
    let mut kept = 0;
    for _ in 0..NUM_ROUNDS {
        let residual = |index: usize| value(index) - surface.dot(&at(index));
        let mut deviations: Vec<f64> = ring.iter().map(|&index| residual(index).abs()).collect();
        sigma = (median(&mut deviations)? / 0.674_489_75).max(MIN_SIGMA);
        let mut normal = Matrix6::zeros();
        let mut right = Vector6::zeros();
        kept = 0;
        for &index in ring {
            if residual(index).abs() <= TRIM_SIGMA * sigma {
                let row = at(index);
                normal += row * row.transpose();
                right += row * value(index);
                kept += 1;
            }
        }
        surface = normal.cholesky()?.solve(&right);
    }
    sigma
        .is_finite()
        .then_some((surface, sigma, kept as f64 / ring.len() as f64))
}

/// The threshold that parts values into two classes with the largest variance between them, and
/// that variance over the whole.
fn otsu(values: &[f32]) -> opencv::Result<(f32, f64)> {
    let max = values.iter().copied().fold(0.0f32, f32::max).max(1e-6);
    let levels: Vec<u8> = values.iter().map(|v| (v / max * 255.0) as u8).collect();
    let (mode, mut parted) = (
        imgproc::THRESH_BINARY | imgproc::THRESH_OTSU,
        Mat::default(),
    );
    let best = imgproc::threshold(&Mat::from_slice(&levels)?, &mut parted, 0.0, 255.0, mode)?;
    // Number, sum and sum of squares of all levels, and of those of the lower class.
    let (mut all, mut below) = ([0.0; 3], [0.0; 3]);
    for level in levels.into_iter().map(f64::from) {
        for (k, value) in [1.0, level, level * level].into_iter().enumerate() {
            all[k] += value;
            below[k] += if level <= best { value } else { 0.0 };
        }
    }
    let [num_above, sum_above] = [all[0] - below[0], all[1] - below[1]];
    let gap = below[1] / below[0] - sum_above / num_above;
    let between = below[0] * num_above * gap * gap / all[0];
    let separability = between / (all[2] - all[1] * all[1] / all[0]).max(f64::MIN_POSITIVE);
    // Values without two classes have none apart.
    let separability = if separability.is_finite() {
        separability.clamp(0.0, 1.0)
    } else {
        0.0
    };
    Ok(((best as f32 + 1.0) / 255.0 * max, separability))
}

/// The largest connected region.
fn largest_region(mask: &Mask) -> opencv::Result<Mask> {
    let (number, num_regions) = regions(mask)?;
    let mut area = vec![0_usize; num_regions];
    number.data.iter().for_each(|&k| area[k as usize] += 1);
    // The first of equals; number 0 is no region.
    let largest = (1..num_regions).rev().max_by_key(|&k| area[k]);
    Ok(Mask::from_fn(mask.width, mask.height, |x, y| {
        largest == Some(*number.at(x, y) as usize)
    }))
}

/// Sets everything that is not connected to the frame's border from outside.
fn without_holes(mask: &Mask) -> opencv::Result<Mask> {
    let (number, num_regions) = regions(&mask.clone().inverted())?;
    let mut is_outside = vec![false; num_regions];
    for (x, y) in mask.frame() {
        is_outside[*number.at(x, y) as usize] = true;
    }
    is_outside[0] = false;
    Ok(Mask::from_fn(mask.width, mask.height, |x, y| {
        !is_outside[*number.at(x, y) as usize]
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_synthetic::testing::overlap;

    /// Uniform numbers in -1..1 from the pixel's place.
    fn noise(index: usize) -> f32 {
        let mut h = (index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        h ^= h >> 29;
        h = h.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        h ^= h >> 32;
        (h >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    fn scene(backdrop: impl Fn(f32, f32) -> f32, object: f32) -> (LinearImage, Mask) {
        let (width, height) = (160, 120);
        let truth = Raster::from_fn(width, height, |x, y| {
            let (x, y) = (x as f32 - 85.0, y as f32 - 62.0);
            x * x / 1600.0 + y * y / 1000.0 < 1.0
        });
        let mut image = LinearImage::filled(width, height, 3, 0.0);
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f32 / 160.0, y as f32 / 120.0);
                // The object is shaded, with a spot as bright as the backdrop inside.
                let spot = (u - 0.5).hypot(v - 0.5) < 0.05;
                let value = if *truth.at(x, y) && !spot {
                    object * (0.6 + 0.4 * u)
                } else {
                    backdrop(u, v)
                };
                for c in 0..3 {
                    let grain = 0.01 * noise(3 * (y * width + x) + c);
                    image.pixel_mut(x, y)[c] = (value + grain).max(0.0);
                }
            }
        }
        (image, truth)
    }

    #[test]
    fn objects_before_dark_and_bright_gradients_are_found() {
        let dark = scene(|u, v| 0.03 + 0.03 * u * v, 0.5);
        let bright = scene(|u, v| 0.9 - 0.2 * u + 0.1 * v, 0.35);
        let cases = [(dark, Backdrop::Dark), (bright, Backdrop::Bright)];
        for ((image, truth), backdrop) in cases {
            let found = propose_mask("a.jpg", &image).unwrap();
            let overlap = overlap(&found.mask, &truth);
            assert!(overlap > 0.98, "{overlap}");
            assert_eq!(found.backdrop, backdrop);
            assert!(found.certainty() > 0.8, "{found:?}");
            assert!(found.border_share == 0.0, "{}", found.border_share);
        }
    }

    #[test]
    fn an_object_hardly_brighter_than_its_backdrop_is_less_certain() {
        let certainty = |object: f32| {
            let (image, _) = scene(|u, v| 0.2 + 0.05 * u * v, object);
            propose_mask("a.jpg", &image).map(|found| found.certainty())
        };
        let clear = certainty(0.8).unwrap();
        // The object's brightness passes through the backdrop's.
        let unclear = certainty(0.32).unwrap_or(0.0);
        assert!(unclear < clear - 0.1, "{unclear} {clear}");
    }

    #[test]
    fn an_uneven_backdrop_and_an_empty_frame_are_refused() {
        let (uneven, _) = scene(|u, v| 0.4 + 0.35 * (40.0 * u).sin() * (31.0 * v).cos(), 0.5);
        let error = propose_mask("a.jpg", &uneven).unwrap_err().to_string();
        assert!(error.contains("not plain"), "{error}");
        let (mut empty, _) = scene(|_, _| 0.5, 0.5);
        for (i, value) in empty.data.iter_mut().enumerate() {
            *value = 0.5 + 0.01 * noise(i);
        }
        let error = propose_mask("a.jpg", &empty).unwrap_err().to_string();
        assert!(error.contains("nothing stands out"), "{error}");
    }
}
