//! Repeatable noise in space: the raw material of relief, speckle and print.

use nalgebra::Vector3;

/// Mixes integers into 32 well-spread bits (the finaliser of MurmurHash3).
#[inline]
pub(crate) fn hash(words: [u32; 4]) -> u32 {
    let mut h = 0x9e37_79b9_u32;
    for word in words {
        h ^= word;
        h = h.wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
        h = h.wrapping_mul(0xc2b2_ae35);
        h ^= h >> 16;
    }
    h
}

/// A number in `0..1` from integers.
#[inline]
pub(crate) fn unit(words: [u32; 4]) -> f64 {
    f64::from(hash(words)) / 4_294_967_296.0
}

/// Gradient noise with unit wavelength: smooth, zero mean, about −1 to 1, twice differentiable.
///
/// Source: Perlin, "Improving noise", SIGGRAPH 2002; gradients are the twelve edges of a cube.
pub(crate) fn gradient_noise(p: &Vector3<f64>, seed: u32) -> f64 {
    let cell = p.map(f64::floor);
    let f = p - cell;
    let fade = f.map(|t| t * t * t * (t * (t * 6.0 - 15.0) + 10.0));
    let (i, j, k) = (cell.x as i64, cell.y as i64, cell.z as i64);
    let corner = |di: i64, dj: i64, dk: i64| -> f64 {
        let h = hash([(i + di) as u32, (j + dj) as u32, (k + dk) as u32, seed]) % 12;
        let (x, y, z) = (f.x - di as f64, f.y - dj as f64, f.z - dk as f64);
        let (a, b) = match h / 4 {
            0 => (x, y),
            1 => (x, z),
            _ => (y, z),
        };
        (if h & 1 == 0 { a } else { -a }) + (if h & 2 == 0 { b } else { -b })
    };
    let lerp = |a: f64, b: f64, t: f64| a + t * (b - a);
    let plane = |dk: i64| {
        lerp(
            lerp(corner(0, 0, dk), corner(1, 0, dk), fade.x),
            lerp(corner(0, 1, dk), corner(1, 1, dk), fade.x),
            fade.y,
        )
    };
    lerp(plane(0), plane(1), fade.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_zero_mean_and_bounded_slope() {
        let (mut sum, mut square, mut slope) = (0.0, 0.0, 0.0_f64);
        let num = 20_000;
        for i in 0..num {
            let p = Vector3::new(
                unit([i, 1, 0, 0]) * 50.0 - 25.0,
                unit([i, 2, 0, 0]) * 50.0 - 25.0,
                unit([i, 3, 0, 0]) * 50.0 - 25.0,
            );
            let (a, b) = (
                gradient_noise(&p, 7),
                gradient_noise(&(p + Vector3::x() * 1e-6), 7),
            );
            sum += a;
            square += a * a;
            slope = slope.max((a - b).abs() / 1e-6);
        }
        let (mean, deviation) = (sum / f64::from(num), (square / f64::from(num)).sqrt());
        assert!(mean.abs() < 0.02, "{mean}");
        assert!((0.15..0.5).contains(&deviation), "{deviation}");
        assert!(slope < 5.0, "{slope}");
    }
}
