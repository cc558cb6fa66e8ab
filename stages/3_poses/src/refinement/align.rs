//! Alignment of a patch of one photo with another photo.
//!
//! Minimises over an affine map `x ↦ A x + t` the sum over the patch of
//! `(I(A x + t) − g T(x) − o)²`, gain `g` and offset `o` eliminated, by the inverse compositional
//! method (Baker and Matthews, IJCV 2004, section 3.2): the derivatives belong to the template, so
//! the normal matrix is factored once. What counts is `t`, the place of the patch's centre.

use super::image::Pyramid;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Samples from the centre to the edge of a patch.
const RADIUS: i32 = 8;
const SIDE: usize = 2 * RADIUS as usize + 1;
const NUM_SAMPLES: usize = SIDE * SIDE;
/// Iterations, most patches need five.
const MAX_NUM_ITERATIONS: usize = 15;
/// Movement of the centre at which the alignment has converged, samples.
const CONVERGED: f32 = 0.003;

/// An affine map of offsets from the patch's centre (in full-size pixels) to another photo.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AffineMap {
    pub linear: Matrix2<f32>,
    /// Where the centre goes.
    pub center: Vector2<f32>,
}

/// A patch around a point of one photo, ready to be aligned.
pub(crate) struct Template {
    /// Values without mean, of unit length.
    values: [f32; NUM_SAMPLES],
    /// Derivatives by the map (a11, a12, a21, a22, t1, t2), without what gain and offset explain.
    jacobian: Vec<SVector<f32, 6>>,
    inverse_normal: SMatrix<f32, 6, 6>,
    /// Full-size pixels per sample.
    step: f32,
    level: usize,
}

pub(crate) struct Aligned {
    /// Place of the template's centre in the other photo, full-size pixels.
    pub center: Vector2<f32>,
    pub correlation: f32,
    /// Standard deviation of the centre as least squares sees it, full-size pixels.
    pub sigma_px: f32,
}

/// Subtracts the mean and scales to unit length; the length before, `None` where flat.
fn normalize(values: &mut [f32; NUM_SAMPLES]) -> Option<f32> {
    let mean = values.iter().sum::<f32>() / NUM_SAMPLES as f32;
    let mut squares = 0.0;
    for v in values.iter_mut() {
        *v -= mean;
        squares += *v * *v;
    }
    let length = squares.sqrt();
    // One code in 2^15 per sample is quantisation, not texture.
    if length.is_nan() || length < SIDE as f32 {
        return None;
    }
    for v in values.iter_mut() {
        *v /= length;
    }
    Some(length)
}

/// Samples a side of a patch with its border.
const WIDE_SIDE: usize = SIDE + 2;

/// Place of a sample among those of a patch with its border.
fn wide_index(i: i32, j: i32) -> usize {
    (j + RADIUS + 1) as usize * WIDE_SIDE + (i + RADIUS + 1) as usize
}

impl Template {
    /// The patch around `(x, y)` with `step` pixels between samples; `None` at the border or where
    /// the texture does not fix the place.
    pub fn new(image: &Pyramid, x: f32, y: f32, step: f32) -> Option<Self> {
        let level = (step.log2().floor().max(0.0) as usize).min(super::image::NUM_LEVELS - 1);
        // One sample more on every side, for the differences.
        let mut samples = [0.0; WIDE_SIDE * WIDE_SIDE];
        for j in -RADIUS - 1..=RADIUS + 1 {
            for i in -RADIUS - 1..=RADIUS + 1 {
                let value = image.sample(x + step * i as f32, y + step * j as f32, level)?;
                samples[wide_index(i, j)] = value;
            }
        }
        let mut values = [0.0; NUM_SAMPLES];
        let mut index = 0;
        for j in -RADIUS..=RADIUS {
            for i in -RADIUS..=RADIUS {
                values[index] = samples[wide_index(i, j)];
                index += 1;
            }
        }
        let length = normalize(&mut values)?;
        let mut jacobian = Vec::with_capacity(NUM_SAMPLES);
        for j in -RADIUS..=RADIUS {
            for i in -RADIUS..=RADIUS {
                let at = |di: i32, dj: i32| samples[wide_index(i + di, j + dj)];
                let gx = 0.5 * (at(1, 0) - at(-1, 0)) / length;
                let gy = 0.5 * (at(0, 1) - at(0, -1)) / length;
                let (i, j) = (i as f32, j as f32);
                jacobian.push(SVector::<f32, 6>::from([
                    gx * i,
                    gx * j,
                    gy * i,
                    gy * j,
                    gx,
                    gy,
                ]));
            }
        }
        let mean = jacobian.iter().sum::<SVector<f32, 6>>() / NUM_SAMPLES as f32;
        let mut along = SVector::<f32, 6>::zeros();
        for (row, v) in jacobian.iter().zip(&values) {
            along += row * *v;
        }
        let mut normal = SMatrix::<f32, 6, 6>::zeros();
        for (row, v) in jacobian.iter_mut().zip(&values) {
            *row -= mean + along * *v;
            normal += *row * row.transpose();
        }
        let inverse_normal = normal.cholesky()?.inverse();
        Some(Self {
            values,
            jacobian,
            inverse_normal,
            step,
            level,
        })
    }

    /// The other photo's samples under a map, normalised.
    fn warped(&self, image: &Pyramid, map: &AffineMap) -> Option<[f32; NUM_SAMPLES]> {
        let mut values = [0.0; NUM_SAMPLES];
        let mut index = 0;
        for j in -RADIUS..=RADIUS {
            for i in -RADIUS..=RADIUS {
                let p = map.linear * Vector2::new(i as f32 * self.step, j as f32 * self.step)
                    + map.center;
                values[index] = image.sample(p.x, p.y, self.level)?;
                index += 1;
            }
        }
        normalize(&mut values)?;
        Some(values)
    }

    fn correlation(&self, other: &[f32; NUM_SAMPLES]) -> f32 {
        self.values.iter().zip(other).map(|(a, b)| a * b).sum()
    }

    /// Correlation under a map, as it is.
    pub fn correlate(&self, image: &Pyramid, map: &AffineMap) -> Option<f32> {
        Some(self.correlation(&self.warped(image, map)?))
    }

    /// Improves a map; `None` when it leaves the photo or does not settle within
    /// `max_shift_px` of its start.
    pub fn align(&self, image: &Pyramid, start: AffineMap, max_shift_px: f32) -> Option<Aligned> {
        let mut map = start;
        for _ in 0..MAX_NUM_ITERATIONS {
            let other = self.warped(image, &map)?;
            let correlation = self.correlation(&other);
            if correlation < 0.2 {
                return None;
            }
            let mut gradient = SVector::<f32, 6>::zeros();
            for ((row, t), o) in self.jacobian.iter().zip(&self.values).zip(&other) {
                // Scaled so that the gain that fits best is taken out.
                gradient += row * (o / correlation - t);
            }
            let delta = self.inverse_normal * gradient;
            // I∘W ≈ T + J δ means that W is ahead by δ: compose with the inverse of that.
            let shift = Matrix2::new(1.0 + delta[0], delta[1], delta[2], 1.0 + delta[3]);
            let inverse = shift.try_inverse()?;
            let offset = inverse * Vector2::new(delta[4], delta[5]) * self.step;
            map.center -= map.linear * offset;
            map.linear *= inverse;
            if (map.center - start.center).norm() > max_shift_px {
                return None;
            }
            if offset.norm() < CONVERGED * self.step {
                let other = self.warped(image, &map)?;
                let correlation = self.correlation(&other);
                let variance =
                    (1.0 / (correlation * correlation) - 1.0).max(0.0) / (NUM_SAMPLES - 8) as f32;
                let spread = 0.5 * (self.inverse_normal[(4, 4)] + self.inverse_normal[(5, 5)]);
                return Some(Aligned {
                    center: map.center,
                    correlation,
                    sigma_px: (variance * spread).sqrt() * self.step,
                });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::LinearImage;

    fn texture(x: f64, y: f64) -> f64 {
        0.4 + 0.1 * (0.31 * x + 0.17 * y).sin()
            + 0.1 * (0.23 * y - 0.11 * x).cos()
            + 0.05 * (0.45 * x).sin() * (0.38 * y).cos()
    }

    fn image(map: impl Fn(f64, f64) -> (f64, f64), gain: f64) -> Pyramid {
        let mut image = LinearImage::filled(120, 120, 1, 0.0);
        for y in 0..120 {
            for x in 0..120 {
                let (u, v) = map(x as f64, y as f64);
                image.pixel_mut(x, y)[0] = (gain * texture(u, v)).powi(2) as f32;
            }
        }
        Pyramid::new(&image)
    }

    #[test]
    fn finds_an_affine_shift_under_a_gain() {
        let first = image(|x, y| (x, y), 1.0);
        // Second photo: texture coordinates as a function of its pixels.
        let (a, b, c, d) = (0.95, 0.08, -0.05, 1.06);
        let second = image(
            |x, y| {
                let (x, y) = (x - 61.37, y - 58.81);
                (60.0 + a * x + b * y, 60.0 + c * x + d * y)
            },
            0.8,
        );
        for step in [1.0, 2.0] {
            let template = Template::new(&first, 60.0, 60.0, step).unwrap();
            let start = AffineMap {
                linear: Matrix2::identity(),
                center: Vector2::new(60.5, 59.6),
            };
            let aligned = template.align(&second, start, 4.0).unwrap();
            let error = (aligned.center - Vector2::new(61.37, 58.81)).norm();
            assert!(error < 0.02, "step {step}: {error} px");
            assert!(aligned.correlation > 0.995, "{}", aligned.correlation);
        }
    }

    #[test]
    fn a_flat_patch_is_refused() {
        let flat = Pyramid::new(&LinearImage::filled(60, 60, 1, 0.3));
        assert!(Template::new(&flat, 30.0, 30.0, 1.0).is_none());
    }
}
