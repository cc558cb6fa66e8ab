//! Small separable filters on rasters: Gaussian blur and box sums.

use rilievo_scene::Raster;

/// Gaussian blur of deviation `sigma_px`, cut at three deviations; the border is repeated.
pub(super) fn gaussian_blur(raster: &Raster<f32>, sigma_px: f32) -> Raster<f32> {
    let radius = (3.0 * sigma_px).ceil() as isize;
    let mut kernel: Vec<f32> = (-radius..=radius)
        .map(|k| (-0.5 * (k as f32 / sigma_px).powi(2)).exp())
        .collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    separable(raster, |source, target| {
        let last = source.len() as isize - 1;
        for (shift, &weight) in (-radius..).zip(&kernel) {
            for (x, value) in (shift..).zip(target.iter_mut()) {
                *value += weight * source[x.clamp(0, last) as usize];
            }
        }
    })
}

/// Sums over squares of `2 radius + 1` pixels, by running sums; beyond the border is zero.
pub(super) fn box_sum(raster: &Raster<f32>, radius: usize) -> Raster<f32> {
    separable(raster, |source, target| {
        // In f64: rounding must not grow along a row.
        let mut sum: f64 = source.iter().take(radius).map(|&v| f64::from(v)).sum();
        for (x, value) in target.iter_mut().enumerate() {
            if x + radius < source.len() {
                sum += f64::from(source[x + radius]);
            }
            if x > radius {
                sum -= f64::from(source[x - radius - 1]);
            }
            *value = sum as f32;
        }
    })
}

/// Filters every row from a source into zeros, then every column.
fn separable(raster: &Raster<f32>, filter: impl Fn(&[f32], &mut [f32])) -> Raster<f32> {
    let rows_filtered = |raster: &Raster<f32>| {
        let mut filtered = Raster::filled(raster.width, raster.height, 0.0_f32);
        let sources = raster.data.chunks(raster.width.max(1));
        for (source, target) in sources.zip(filtered.data.chunks_mut(raster.width.max(1))) {
            filter(source, target);
        }
        filtered
    };
    let transposed = |raster: &Raster<f32>| {
        Raster::from_fn(raster.height, raster.width, |x, y| *raster.at(y, x))
    };
    transposed(&rows_filtered(&transposed(&rows_filtered(raster))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_keeps_a_constant_and_the_sum_of_a_spike() {
        let constant = gaussian_blur(&Raster::filled(9, 7, 2.5), 0.8);
        assert!(constant.data.iter().all(|&v| (v - 2.5).abs() < 1e-5));
        let mut spike = Raster::filled(21, 21, 0.0);
        *spike.at_mut(10, 10) = 1.0;
        let blurred = gaussian_blur(&spike, 1.3);
        let sum: f32 = blurred.data.iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
    }

    #[test]
    fn box_sums_equal_the_plain_double_loop() {
        let raster = Raster::from_fn(11, 8, |x, y| ((x * 7 + y * 13) % 5) as f32);
        let sums = box_sum(&raster, 2);
        for y in 0..8_isize {
            for x in 0..11_isize {
                let mut plain = 0.0;
                for v in -2..=2 {
                    for u in -2..=2 {
                        plain += raster.get(x + u, y + v).copied().unwrap_or(0.0);
                    }
                }
                let fast = *sums.at(x as usize, y as usize);
                assert!((fast - plain).abs() < 1e-4, "{x} {y}: {fast} {plain}");
            }
        }
    }
}
