//! Interpolation in rasters, and smoothing inside a mask.

use rilievo_numerics::plate_system::PixelNumbering;
use rilievo_scene::{LinearImage, Mask, Raster};

/// Whether the four pixels around a position are masked.
#[inline]
pub fn inside(mask: &Mask, x: f64, y: f64) -> bool {
    if !(x >= 0.0 && y >= 0.0 && x < (mask.width - 1) as f64 && y < (mask.height - 1) as f64) {
        return false;
    }
    let base = y as usize * mask.width + x as usize;
    mask.data[base]
        && mask.data[base + 1]
        && mask.data[base + mask.width]
        && mask.data[base + mask.width + 1]
}

/// Bilinear value; the position must be [`inside`].
#[inline]
pub fn bilinear(raster: &Raster<f32>, x: f64, y: f64) -> f32 {
    let (x0, y0) = (x as usize, y as usize);
    let (a, b) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
    let base = y0 * raster.width + x0;
    let d = &raster.data;
    let top = d[base] + a * (d[base + 1] - d[base]);
    let below = base + raster.width;
    let bottom = d[below] + a * (d[below + 1] - d[below]);
    top + b * (bottom - top)
}

/// Largest less smallest of the four values around a position, which must be [`inside`].
#[inline]
pub(crate) fn range_around(raster: &Raster<f32>, x: f64, y: f64) -> f32 {
    let base = y as usize * raster.width + x as usize;
    let d = &raster.data;
    let below = base + raster.width;
    let four = [d[base], d[base + 1], d[below], d[below + 1]];
    four.iter().fold(f32::MIN, |m, &v| m.max(v)) - four.iter().fold(f32::MAX, |m, &v| m.min(v))
}

/// Bilinear value and its derivatives along x and y; the position must be [`inside`].
#[inline]
pub(crate) fn bilinear_with_slope(raster: &Raster<f32>, x: f64, y: f64) -> (f64, f64, f64) {
    let (x0, y0) = (x as usize, y as usize);
    let (a, b) = (x - x0 as f64, y - y0 as f64);
    let base = y0 * raster.width + x0;
    let at = |i: usize| f64::from(raster.data[i]);
    let (p, q) = (at(base), at(base + 1));
    let (r, s) = (at(base + raster.width), at(base + raster.width + 1));
    let top = p + a * (q - p);
    let bottom = r + a * (s - r);
    (
        top + b * (bottom - top),
        (1.0 - b) * (q - p) + b * (s - r),
        bottom - top,
    )
}

/// Weights of the Catmull-Rom spline at offset `t` of 0 to 1, and their derivatives.
#[inline]
fn catmull_rom(t: f32) -> ([f32; 4], [f32; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [
            0.5 * (-t3 + 2.0 * t2 - t),
            0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
            0.5 * (-3.0 * t3 + 4.0 * t2 + t),
            0.5 * (t3 - t2),
        ],
        [
            0.5 * (-3.0 * t2 + 4.0 * t - 1.0),
            0.5 * (9.0 * t2 - 10.0 * t),
            0.5 * (-9.0 * t2 + 8.0 * t + 1.0),
            0.5 * (3.0 * t2 - 2.0 * t),
        ],
    )
}

/// Catmull-Rom value and its derivatives along x and y, where all sixteen pixels are masked and their
/// values span at most `max_range`.
#[inline]
pub(crate) fn cubic_with_slope(
    raster: &Raster<f32>,
    mask: &Mask,
    x: f64,
    y: f64,
    max_range: f64,
) -> Option<(f64, f64, f64)> {
    let (x0, y0) = (x.floor(), y.floor());
    let fits = |low: f64, count: usize| low >= 1.0 && low + 2.0 < count as f64;
    if !fits(x0, raster.width) || !fits(y0, raster.height) {
        return None;
    }
    let (wx, gx) = catmull_rom((x - x0) as f32);
    let (wy, gy) = catmull_rom((y - y0) as f32);
    let base = (y0 as usize - 1) * raster.width + x0 as usize - 1;
    // Differences from one of them: single precision would round sums of the values themselves.
    let origin = raster.data[base + raster.width + 1];
    let (mut value, mut along_x, mut along_y) = (0.0_f32, 0.0_f32, 0.0_f32);
    let (mut low, mut high) = (f32::MAX, f32::MIN);
    for k in 0..4 {
        let (mut v, mut d) = (0.0_f32, 0.0_f32);
        for l in 0..4 {
            let i = base + k * raster.width + l;
            if !mask.data[i] {
                return None;
            }
            let z = raster.data[i] - origin;
            low = low.min(z);
            high = high.max(z);
            v += wx[l] * z;
            d += gx[l] * z;
        }
        value += wy[k] * v;
        along_x += wy[k] * d;
        along_y += gy[k] * v;
    }
    (f64::from(high - low) <= max_range).then(|| {
        (
            f64::from(origin) + f64::from(value),
            f64::from(along_x),
            f64::from(along_y),
        )
    })
}

/// Three channels at a position, with their derivatives along x and y (Catmull-Rom).
/// Positions closer than a pixel to the raster's edge repeat the edge.
#[inline]
pub fn bicubic(image: &LinearImage, x: f64, y: f64) -> ([f32; 3], [f32; 3], [f32; 3]) {
    let (x0, y0) = (x.floor(), y.floor());
    let (wx, gx) = catmull_rom((x - x0) as f32);
    let (wy, gy) = catmull_rom((y - y0) as f32);
    let column = |k: usize| (x0 as isize + k as isize - 1).clamp(0, image.width as isize - 1);
    let columns = [column(0), column(1), column(2), column(3)].map(|c| 3 * c as usize);
    let (mut value, mut along_x, mut along_y) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    for k in 0..4 {
        let row = (y0 as isize + k as isize - 1).clamp(0, image.height as isize - 1) as usize;
        let row = &image.data[3 * row * image.width..3 * (row + 1) * image.width];
        let (mut v, mut d) = ([0.0_f32; 3], [0.0_f32; 3]);
        for (l, &start) in columns.iter().enumerate() {
            for c in 0..3 {
                v[c] += wx[l] * row[start + c];
                d[c] += gx[l] * row[start + c];
            }
        }
        for c in 0..3 {
            value[c] += wy[k] * v[c];
            along_x[c] += wy[k] * d[c];
            along_y[c] += gy[k] * v[c];
        }
    }
    (value, along_x, along_y)
}

/// Smooths values of masked pixels: weighted means over a Gaussian of standard deviation `sigma_px`.
///
/// `values` holds `weights.len()` rows of `N`; pixels of zero weight receive the mean of the others.
/// The Gaussian is three passes of a box with running sums: cost independent of its width.
pub fn smooth<const N: usize>(
    pixels: &PixelNumbering,
    values: &[[f32; N]],
    weights: &[f32],
    sigma_px: f64,
) -> Vec<[f32; N]> {
    let (width, height) = (pixels.width, pixels.height);
    // Three boxes of half-width r have the variance r (r + 1).
    let radius = ((sigma_px * sigma_px + 0.25).sqrt() - 0.5).round().max(1.0) as usize;
    let mut field = vec![0.0_f32; width * height * (N + 1)];
    for i in 0..pixels.len() {
        let at = (pixels.ys[i] as usize * width + pixels.xs[i] as usize) * (N + 1);
        for c in 0..N {
            field[at + c] = values[i][c] * weights[i];
        }
        field[at + N] = weights[i];
    }
    let mut passed = vec![0.0_f32; field.len()];
    for _ in 0..3 {
        for (from, to) in field
            .chunks_exact((N + 1) * width)
            .zip(passed.chunks_exact_mut((N + 1) * width))
        {
            box_mean_along::<N>(from, to, radius);
        }
        box_mean(&passed, &mut field, (N + 1) * width, radius);
    }
    (0..pixels.len())
        .map(|i| {
            let at = (pixels.ys[i] as usize * width + pixels.xs[i] as usize) * (N + 1);
            let weight = field[at + N];
            let mut out = [0.0; N];
            if weight > 1e-9 {
                for c in 0..N {
                    out[c] = field[at + c] / weight;
                }
            }
            out
        })
        .collect()
}

/// Box mean along a line of pixels of `N` values and a weight: the sums stay in registers.
fn box_mean_along<const N: usize>(from: &[f32], to: &mut [f32], radius: usize) {
    let count = from.len() / (N + 1);
    let add = |(sums, weight): &mut ([f64; N], f64), k: usize, sign: f64| {
        let pixel = &from[k * (N + 1)..(k + 1) * (N + 1)];
        for c in 0..N {
            sums[c] += sign * f64::from(pixel[c]);
        }
        *weight += sign * f64::from(pixel[N]);
    };
    let mut sums = ([0.0; N], 0.0);
    for k in 0..radius.min(count) {
        add(&mut sums, k, 1.0);
    }
    let scale = 1.0 / (2 * radius + 1) as f64;
    for (k, out) in to.chunks_exact_mut(N + 1).enumerate() {
        if k + radius < count {
            add(&mut sums, k + radius, 1.0);
        }
        if k > radius {
            add(&mut sums, k - radius - 1, -1.0);
        }
        for (value, &sum) in out.iter_mut().zip(&sums.0) {
            *value = mean(sum, scale);
        }
        out[N] = mean(sums.1, scale);
    }
}

/// A box's mean from its sum; rounding must not turn an empty box into a tiny negative weight.
#[inline]
fn mean(sum: f64, scale: f64) -> f32 {
    if sum.abs() < 1e-12 {
        0.0
    } else {
        (sum * scale) as f32
    }
}

/// Box mean over the rows of `from`, each `row` values long, so that memory is met in order in both directions: a
/// row is a pixel's channels along a line, and a whole line across the lines.
fn box_mean(from: &[f32], to: &mut [f32], row: usize, radius: usize) {
    let count = from.len() / row;
    let of = |k: usize| &from[k * row..(k + 1) * row];
    let scale = 1.0 / (2 * radius + 1) as f64;
    let mut sums = vec![0.0_f64; row];
    let add = |sums: &mut [f64], values: &[f32], sign: f64| {
        for (sum, &value) in sums.iter_mut().zip(values) {
            *sum += sign * f64::from(value);
        }
    };
    for k in 0..radius.min(count) {
        add(&mut sums, of(k), 1.0);
    }
    for (k, out) in to.chunks_exact_mut(row).enumerate() {
        if k + radius < count {
            add(&mut sums, of(k + radius), 1.0);
        }
        if k > radius {
            add(&mut sums, of(k - radius - 1), -1.0);
        }
        for (value, &sum) in out.iter_mut().zip(&sums) {
            *value = mean(sum, scale);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn bicubic_reproduces_a_quadratic_with_its_slopes() {
        let mut image = LinearImage::filled(12, 10, 3, 0.0);
        let f = |x: f64, y: f64, c: f64| 0.3 * x * x - 0.2 * x * y + (1.0 + c) * y;
        for y in 0..10 {
            for x in 0..12 {
                for c in 0..3 {
                    image.pixel_mut(x, y)[c] = f(x as f64, y as f64, c as f64) as f32;
                }
            }
        }
        let (x, y) = (5.3, 4.6);
        let (value, gx, gy) = bicubic(&image, x, y);
        for c in 0..3 {
            let cf = c as f64;
            assert!(
                (f64::from(value[c]) - f(x, y, cf)).abs() < 1e-4,
                "{value:?}"
            );
            assert!(
                (f64::from(gx[c]) - (0.6 * x - 0.2 * y)).abs() < 1e-4,
                "{gx:?}"
            );
            assert!(
                (f64::from(gy[c]) - (-0.2 * x + 1.0 + cf)).abs() < 1e-4,
                "{gy:?}"
            );
        }
    }

    #[test]
    fn cubic_depth_reproduces_a_quadratic_and_keeps_off_borders_and_breaks() {
        // About a log depth's size, where single precision is coarse.
        let f = |x: f64, y: f64| 6.0 + 1e-3 * (0.3 * x * x - 0.2 * x * y + y);
        let smooth = Raster::from_fn(16, 12, |x, y| f(x as f64, y as f64) as f32);
        let mask = Raster::from_fn(16, 12, |x, _| x > 2);
        let (x, y) = (7.3, 4.6);
        let (value, gx, gy) = cubic_with_slope(&smooth, &mask, x, y, 0.1).unwrap();
        assert!((value - f(x, y)).abs() < 1e-6, "{value}");
        assert!((gx - 1e-3 * (0.6 * x - 0.2 * y)).abs() < 2e-6, "{gx}");
        assert!((gy - 1e-3 * (-0.2 * x + 1.0)).abs() < 2e-6, "{gy}");

        assert!(cubic_with_slope(&smooth, &mask, 3.5, y, 0.1).is_none());
        assert!(cubic_with_slope(&smooth, &mask, x, 0.5, 0.1).is_none());
        assert!(cubic_with_slope(&smooth, &mask, 13.5, y, 0.1).is_some());
        assert!(cubic_with_slope(&smooth, &mask, 14.5, y, 0.1).is_none());
        let broken = Raster::from_fn(16, 12, |x, _| if x < 9 { 6.0 } else { 6.5 });
        assert!(cubic_with_slope(&broken, &mask, x, y, 0.1).is_none());
        assert!(cubic_with_slope(&broken, &mask, 6.9, y, 0.1).is_some());
    }

    #[test]
    fn smoothing_keeps_a_constant_and_fills_unweighted_pixels() {
        let mask = Raster::from_fn(30, 20, |x, y| x > 3 && y < 15);
        let pixels = PixelNumbering::new(&mask);
        let values = vec![[2.5_f32]; pixels.len()];
        let weights: Vec<f32> = (0..pixels.len()).map(|i| (i % 3) as f32).collect();
        for value in smooth(&pixels, &values, &weights, 3.0) {
            assert!((value[0] - 2.5).abs() < 1e-5, "{value:?}");
        }
    }
}
