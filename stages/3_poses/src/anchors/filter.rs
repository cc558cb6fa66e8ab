//! Small filters on rasters: Gaussian blur and box sums.

use rilievo_scene::Raster;

/// Gaussian blur of deviation `sigma_px`, cut at three deviations; the border is repeated.
pub(super) fn gaussian_blur(raster: &Raster<f32>, sigma_px: f32) -> Raster<f32> {
    let radius = (3.0 * sigma_px).ceil() as isize;
    let mut kernel: Vec<f32> = (-radius..=radius)
        .map(|k| (-0.5 * (k as f32 / sigma_px).powi(2)).exp())
        .collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let (width, height) = (raster.width, raster.height);
    let clamp = |i: isize, n: usize| i.clamp(0, n as isize - 1) as usize;
    let mut rows = Raster::filled(width, height, 0.0_f32);
    for y in 0..height {
        let source = &raster.data[y * width..(y + 1) * width];
        let target = &mut rows.data[y * width..(y + 1) * width];
        for (k, &weight) in kernel.iter().enumerate() {
            let shift = k as isize - radius;
            for (x, value) in target.iter_mut().enumerate() {
                *value += weight * source[clamp(x as isize + shift, width)];
            }
        }
    }
    let mut blurred = Raster::filled(width, height, 0.0_f32);
    for y in 0..height {
        for (k, &weight) in kernel.iter().enumerate() {
            let from = clamp(y as isize + k as isize - radius, height);
            let (source, target) = (
                &rows.data[from * width..(from + 1) * width],
                &mut blurred.data[y * width..(y + 1) * width],
            );
            for (value, &s) in target.iter_mut().zip(source) {
                *value += weight * s;
            }
        }
    }
    blurred
}

/// Sums over squares of `2 radius + 1` pixels, by running sums; beyond the border is zero.
pub(super) fn box_sum(raster: &Raster<f32>, radius: usize) -> Raster<f32> {
    let (width, height) = (raster.width, raster.height);
    let mut rows = Raster::filled(width, height, 0.0_f32);
    // Running sums in f64: their rounding must not grow along a row.
    for y in 0..height {
        let source = &raster.data[y * width..(y + 1) * width];
        let mut sum: f64 = source.iter().take(radius).map(|&v| f64::from(v)).sum();
        for x in 0..width {
            if x + radius < width {
                sum += f64::from(source[x + radius]);
            }
            if x > radius {
                sum -= f64::from(source[x - radius - 1]);
            }
            rows.data[y * width + x] = sum as f32;
        }
    }
    let mut total = Raster::filled(width, height, 0.0_f32);
    let mut sums = vec![0.0_f64; width];
    for y in 0..radius.min(height) {
        for (sum, &v) in sums.iter_mut().zip(&rows.data[y * width..(y + 1) * width]) {
            *sum += f64::from(v);
        }
    }
    for y in 0..height {
        if y + radius < height {
            let row = &rows.data[(y + radius) * width..(y + radius + 1) * width];
            for (sum, &v) in sums.iter_mut().zip(row) {
                *sum += f64::from(v);
            }
        }
        if y > radius {
            let row = &rows.data[(y - radius - 1) * width..(y - radius) * width];
            for (sum, &v) in sums.iter_mut().zip(row) {
                *sum -= f64::from(v);
            }
        }
        for (value, &sum) in total.data[y * width..(y + 1) * width].iter_mut().zip(&sums) {
            *value = sum as f32;
        }
    }
    total
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
