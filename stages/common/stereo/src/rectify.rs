//! Lens distortion: photos are straightened to a pinhole before, and results bent back after.

use nalgebra::Point2;
use rilievo_scene::{DepthMap, Distortion, Intrinsics, LinearImage, Mask, NormalMap, Raster};

/// A photo's camera and the pinhole of the same matrix.
#[derive(Clone, Debug)]
pub struct Rectification {
    /// The photo's own camera.
    pub original: Intrinsics,
    /// The same matrix without distortion.
    pub pinhole: Intrinsics,
}

impl Rectification {
    /// From the photo's camera.
    pub fn new(intrinsics: &Intrinsics) -> Self {
        Self {
            original: *intrinsics,
            pinhole: Intrinsics {
                distortion: Distortion::default(),
                ..*intrinsics
            },
        }
    }

    /// Whether the photo has no distortion: then it is its own pinhole image.
    pub fn is_identity(&self) -> bool {
        self.original.distortion.is_none()
    }

    /// Straightened image and mask. Pixels that come from outside the photo are not masked.
    pub fn straighten(&self, image: &LinearImage, mask: &Mask) -> (LinearImage, Mask) {
        let (image, [mask]) = self.straighten_with(image, [mask]);
        (image, mask)
    }

    /// Straightened image and masks. Pixels that come from outside the photo are set in none of them.
    pub fn straighten_with<const N: usize>(
        &self,
        image: &LinearImage,
        masks: [&Mask; N],
    ) -> (LinearImage, [Mask; N]) {
        let mut out = LinearImage::filled(image.width, image.height, image.channels, 0.0);
        let mut out_masks = masks.map(|_| Mask::filled(image.width, image.height, false));
        for y in 0..image.height {
            for x in 0..image.width {
                let (xs, ys) = self.bent(x as f64, y as f64);
                let mut complete = true;
                for c in 0..image.channels {
                    match image.sample(xs, ys, c) {
                        Some(value) => out.pixel_mut(x, y)[c] = value,
                        None => complete = false,
                    }
                }
                for (out_mask, mask) in out_masks.iter_mut().zip(masks) {
                    *out_mask.at_mut(x, y) =
                        complete && mask.contains(xs.round() as isize, ys.round() as isize);
                }
            }
        }
        (out, out_masks)
    }

    /// Pixel of the photo that shows a pixel of the pinhole image.
    fn bent(&self, x: f64, y: f64) -> (f64, f64) {
        let k = &self.original;
        let (u, v) = k.distortion.distort((x - k.cx) / k.fx, (y - k.cy) / k.fy);
        (k.fx * u + k.cx, k.fy * v + k.cy)
    }

    /// Visits the pinhole image's pixels with a depth around the one that shows a pixel of the
    /// photo: column, row, depth and weight.
    fn for_each_parent(
        &self,
        depth: &DepthMap,
        (x, y): (usize, usize),
        mut visit: impl FnMut(isize, isize, f32, f64),
    ) {
        let k = &self.original;
        let ray = k.normalized(&Point2::new(x as f64, y as f64));
        let (xs, ys) = (k.fx * ray.x + k.cx, k.fy * ray.y + k.cy);
        let (x0, y0) = (xs.floor() as isize, ys.floor() as isize);
        for (u, v) in [(x0, y0), (x0 + 1, y0), (x0, y0 + 1), (x0 + 1, y0 + 1)] {
            if let Some(&z) = depth.get(u, v)
                && z > 0.0
            {
                let weight = (1.0 - (xs - u as f64).abs()) * (1.0 - (ys - v as f64).abs()) + 1e-6;
                visit(u, v, z, weight);
            }
        }
    }

    /// Maps of the pinhole image on the photo's own pixels, inside the photo's mask.
    pub fn bend_back(
        &self,
        mask: &Mask,
        depth: &DepthMap,
        normal: &NormalMap,
    ) -> (DepthMap, NormalMap) {
        let mut out_normal = Raster::filled(mask.width, mask.height, [0.0; 3]);
        let out_depth = Raster::from_fn(mask.width, mask.height, |x, y| {
            if !*mask.at(x, y) {
                return 0.0;
            }
            let (mut sum, mut total, mut n) = (0.0_f64, 0.0_f64, [0.0_f64; 3]);
            self.for_each_parent(depth, (x, y), |u, v, z, weight| {
                sum += weight * f64::from(z);
                total += weight;
                for (n, m) in n.iter_mut().zip(normal.get(u, v).into_iter().flatten()) {
                    *n += weight * f64::from(*m);
                }
            });
            let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
            if total > 0.0 && length > 0.0 {
                *out_normal.at_mut(x, y) = n.map(|v| (v / length) as f32);
                (sum / total) as f32
            } else {
                0.0
            }
        });
        (out_depth, out_normal)
    }

    /// Values on the photo's own pixels from those on the straightened ones, where `depth` has a
    /// value; zero elsewhere.
    pub fn bend_values_back<const N: usize>(
        &self,
        mask: &Mask,
        depth: &DepthMap,
        values: &Raster<[f32; N]>,
    ) -> Raster<[f32; N]> {
        Raster::from_fn(mask.width, mask.height, |x, y| {
            let (mut sum, mut total) = ([0.0_f32; N], 0.0_f32);
            if *mask.at(x, y) {
                self.for_each_parent(depth, (x, y), |u, v, _, weight| {
                    let weight = weight as f32;
                    for (s, v) in sum.iter_mut().zip(values.get(u, v).into_iter().flatten()) {
                        *s += weight * v;
                    }
                    total += weight;
                });
            }
            if total > 0.0 {
                sum.map(|s| s / total)
            } else {
                sum
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bending_back_undoes_straightening() {
        let camera = Intrinsics {
            distortion: Distortion {
                k1: -0.1,
                k2: 0.02,
                ..Distortion::default()
            },
            ..Intrinsics::pinhole(120, 90, 110.0, 59.5, 44.5)
        };
        let image = LinearImage {
            width: 120,
            height: 90,
            channels: 1,
            data: (0..120 * 90).map(|i| (i % 120) as f32).collect(),
        };
        let mask = Raster::from_fn(120, 90, |x, y| {
            (10..110).contains(&x) && (10..80).contains(&y)
        });
        let rectification = Rectification::new(&camera);
        let (straight, straight_mask) = rectification.straighten(&image, &mask);
        let depth = Raster::from_fn(120, 90, |x, y| {
            if *straight_mask.at(x, y) {
                straight.pixel(x, y)[0]
            } else {
                0.0
            }
        });
        let normal = Raster::filled(120, 90, [0.0, 0.0, -1.0]);
        let (back, _) = rectification.bend_back(&mask, &depth, &normal);
        for y in 12..78 {
            for x in 12..108 {
                let value = *back.at(x, y);
                assert!((value - x as f32).abs() < 0.01, "({x}, {y}): {value}");
            }
        }
    }
}
