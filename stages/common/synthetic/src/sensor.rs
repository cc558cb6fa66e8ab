//! From light to files: exposure, noise, and display values.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rilievo_scene::{LinearImage, srgb};

/// Two independent standard normal numbers (Box and Muller, 1958).
fn normal_pair(random: &mut ChaCha8Rng) -> (f64, f64) {
    // 1 - u lies in (0, 1], where the logarithm is finite.
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    let angle = std::f64::consts::TAU * random.random::<f64>();
    (radius * angle.cos(), radius * angle.sin())
}

fn stream(seed: u64, purpose: u64, item: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(purpose << 48 | item);
    random
}

/// Exposure of a photo relative to the mean one: `2^(drift · normal)`.
pub(crate) fn exposure_gain(seed: u64, view: usize, drift_ev: f64) -> f64 {
    let (normal, _) = normal_pair(&mut stream(seed, 1, view as u64));
    (drift_ev * normal).exp2()
}

/// Adds shot noise `σ(I) = noise √(I + 0.01)`; the 0.01 is the read noise, a tenth of that at
/// white.
pub(crate) fn add_noise(image: &mut LinearImage, seed: u64, view: usize, noise: f64) {
    if noise == 0.0 {
        return;
    }
    let row_length = image.width * image.channels;
    image
        .data
        .par_chunks_mut(row_length)
        .enumerate()
        .for_each(|(y, row)| {
            let mut random = stream(seed, 2, (view as u64) << 24 | y as u64);
            for pair in row.chunks_mut(2) {
                let (a, b) = normal_pair(&mut random);
                for (value, normal) in pair.iter_mut().zip([a, b]) {
                    let sigma = noise * (f64::from(value.max(0.0)) + 0.01).sqrt();
                    *value += (sigma * normal) as f32;
                }
            }
        });
}

/// 8-bit sRGB of linear values, clipped to 0..1.
pub fn to_srgb8(image: &LinearImage) -> Vec<u8> {
    image
        .data
        .par_iter()
        .map(|&linear| srgb::encode_byte(linear))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_deviation_asked_for_and_repeats() {
        let mut image = LinearImage::filled(200, 200, 3, 0.5);
        add_noise(&mut image, 3, 1, 0.02);
        let num = image.data.len() as f64;
        let mean = image.data.iter().map(|&v| f64::from(v)).sum::<f64>() / num;
        let square: f64 = image
            .data
            .iter()
            .map(|&v| (f64::from(v) - mean).powi(2))
            .sum();
        let expected = 0.02 * 0.51_f64.sqrt();
        let sigma = (square / num).sqrt();
        assert!((mean - 0.5).abs() < 5e-4, "{mean}");
        assert!((sigma / expected - 1.0).abs() < 0.02, "{sigma} {expected}");
        let mut again = LinearImage::filled(200, 200, 3, 0.5);
        add_noise(&mut again, 3, 1, 0.02);
        assert_eq!(image, again);
    }

    #[test]
    fn display_values_meet_the_standard() {
        let image = LinearImage {
            width: 4,
            height: 1,
            channels: 1,
            data: vec![0.0, 0.215_861, 1.0, 7.0],
        };
        assert_eq!(to_srgb8(&image), [0, 128, 255, 255]);
    }
}
