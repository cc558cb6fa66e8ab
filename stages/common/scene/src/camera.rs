//! Pinhole intrinsics with lens distortion.

use crate::distortion::{Distortion, STEEPEST_RAD};
use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Where a focal length was taken from; a guess is refined with the poses, the others are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FocalSource {
    /// A camera file given by the user.
    CameraFile,
    /// EXIF focal length in 35 mm equivalents.
    Exif35mm,
    /// EXIF focal length with the focal-plane resolution or sensor size.
    ExifSensor,
    /// Nothing was known: 1.2 times the longer side.
    Guess,
}

/// A pinhole camera in pixels, centres of pixels at integers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Number of columns of the image.
    pub width: usize,
    /// Number of rows of the image.
    pub height: usize,
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl Intrinsics {
    /// A camera of one focal length, without distortion.
    pub fn pinhole(width: usize, height: usize, focal_px: f64, cx: f64, cy: f64) -> Self {
        Self::undistorted((width, height), [focal_px, focal_px, cx, cy])
    }

    /// A camera of two focal lengths, without distortion.
    pub fn undistorted((width, height): (usize, usize), [fx, fy, cx, cy]: [f64; 4]) -> Self {
        Self {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion: Distortion::default(),
        }
    }

    /// The camera of the image cropped to a rectangle that starts at `(x0, y0)`.
    pub fn cropped(&self, x0: usize, y0: usize, width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            cx: self.cx - x0 as f64,
            cy: self.cy - y0 as f64,
            ..*self
        }
    }

    /// All numbers as bits: equal for equal cameras.
    pub fn key(&self) -> [u64; 18] {
        let Self { fx, fy, cx, cy, .. } = *self;
        let of_lens = self.distortion.numbers();
        let numbers = [fx, fy, cx, cy].into_iter().chain(of_lens);
        // Zero has two signs, and is one number.
        let bits = numbers.map(|value| (value + 0.0).to_bits());
        let sizes = [self.width as u64, self.height as u64];
        let mut all = sizes.into_iter().chain(bits);
        let mut key = [u64::from(self.distortion.fisheye); 18];
        key[..17].fill_with(|| all.next().unwrap_or(0));
        key
    }

    /// Why the lens model shows no ray, or more than one, for some pixel at the frame's border; of a fisheye also where it
    /// sees 180 degrees or more across.
    ///
    /// # Errors
    /// The reason, in words.
    pub fn check_lens(&self) -> Result<(), String> {
        let d = &self.distortion;
        if d.is_plain() {
            return Ok(());
        }
        let (right, lower) = (self.width as f64 - 0.5, self.height as f64 - 0.5);
        let along = |end: f64| {
            (0..=NUM_CHECKED).map(move |i| -0.5 + (end + 0.5) * i as f64 / NUM_CHECKED as f64)
        };
        let upright = along(lower).flat_map(|y| [(-0.5, y), (right, y)]);
        let across = along(right).flat_map(|x| [(x, -0.5), (x, lower)]);
        for (x, y) in upright.chain(across) {
            let (plane, found) = d.to_plane((x - self.cx) / self.fx, (y - self.cy) / self.fy);
            if d.fisheye && found && plane.norm() >= STEEPEST_RAD {
                return Err(format!(
                    "the lens sees {:.0} degrees across the frame; fields of view of 180 degrees and more are not \
                     supported: crop the photos, or undistort them",
                    2.0 * plane.norm().to_degrees()
                ));
            }
            if !found {
                return Err(format!(
                    "the lens model shows no single ray at pixel ({x:.0}, {y:.0}): its coefficients do not hold up to \
                     the frame's border"
                ));
            }
        }
        Ok(())
    }

    /// Focal lengths over the frame's longer side that a lens can have: from 157 degrees across the frame
    /// to half a degree.
    pub const FOCAL_OVER_SIDE: std::ops::RangeInclusive<f64> = 0.1..=100.0;

    /// A focal length that no lens has, pixels.
    pub fn implausible_focal_px(&self) -> Option<f64> {
        let side = self.longer_side();
        let focal = [self.fx, self.fy].into_iter();
        focal
            .into_iter()
            .find(|f| !Self::FOCAL_OVER_SIDE.contains(&(f / side)))
    }

    /// Longer side of the frame, pixels.
    pub fn longer_side(&self) -> f64 {
        self.width.max(self.height) as f64
    }

    /// Mean focal length in pixels.
    pub fn focal_px(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }

    /// Pixel of a point in the camera frame; `None` behind the camera.
    pub fn project(&self, point_in_cam: &Point3<f64>) -> Option<Point2<f64>> {
        if point_in_cam.z.is_nan() || point_in_cam.z <= 0.0 {
            return None;
        }
        let (x, y) = self.distortion.distort(
            point_in_cam.x / point_in_cam.z,
            point_in_cam.y / point_in_cam.z,
        );
        Some(Point2::new(self.fx * x + self.cx, self.fy * y + self.cy))
    }

    /// Undistorted normalised coordinates `(x/z, y/z)` of a pixel.
    pub fn normalized(&self, pixel: &Point2<f64>) -> Point2<f64> {
        let (x, y) = self
            .distortion
            .undistort((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        Point2::new(x, y)
    }

    /// Ray of a pixel in the camera frame, scaled to `z = 1`.
    pub fn ray(&self, pixel: &Point2<f64>) -> Vector3<f64> {
        let n = self.normalized(pixel);
        Vector3::new(n.x, n.y, 1.0)
    }

    /// Point in the camera frame at a pixel and a depth along the optical axis.
    pub fn unproject(&self, pixel: &Point2<f64>, depth: f64) -> Point3<f64> {
        Point3::from(self.ray(pixel) * depth)
    }
}

/// Places along each side of the frame at which a lens model is tried.
const NUM_CHECKED: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn unprojection_inverts_projection_with_distortion() {
        let camera = Intrinsics {
            distortion: Distortion {
                k1: -0.12,
                k2: 0.05,
                p1: 1e-3,
                p2: -7e-4,
                k3: -0.01,
                ..Distortion::default()
            },
            ..Intrinsics::pinhole(1280, 960, 1100.0, 639.5, 479.5)
        };
        for &(x, y) in &[(0.0, 0.0), (1279.0, 959.0), (300.25, 700.75)] {
            let pixel = Point2::new(x, y);
            let back = camera.project(&camera.unproject(&pixel, 2.5));
            assert!(back.is_some_and(|b| (b - pixel).norm() < 1e-9), "{back:?}");
        }
        assert!(camera.project(&Point3::new(0.0, 0.0, -1.0)).is_none());
    }

    /// Numbers of pycolmap 4.2.1: `Camera.img_from_cam` of the point (0.62, -0.41, 1) on a camera of 640 x 480 with
    /// fx 300, fy 310, cx 322, cy 238, less its half pixel.
    fn lenses() -> [(Distortion, [f64; 2]); 4] {
        let none = Distortion::default();
        [
            (
                Distortion {
                    k1: 0.11,
                    k2: -0.02,
                    p1: 1e-3,
                    p2: -2e-3,
                    k3: 0.004,
                    denominator: [0.21, 0.015, -0.001],
                    ..none
                },
                [495.749193348259, 118.374467878689],
            ),
            (
                Distortion {
                    k1: 0.05,
                    k2: -0.012,
                    k3: 0.004,
                    k4: -0.0007,
                    fisheye: true,
                    ..none
                },
                [484.437840581966, 126.159142268990],
            ),
            (
                Distortion {
                    k1: 0.05,
                    k2: -0.012,
                    p1: 1e-3,
                    p2: -2e-3,
                    k3: 0.004,
                    k4: -0.0007,
                    prism: [3e-3, -2e-3],
                    fisheye: true,
                    ..none
                },
                [484.106503692982, 126.342655059272],
            ),
            (
                Distortion {
                    fisheye: true,
                    ..none
                },
                [481.450130405226, 128.200744223096],
            ),
        ]
    }

    #[test]
    fn wide_lenses_bend_as_colmaps_do() {
        for (distortion, [x, y]) in lenses() {
            let camera = Intrinsics {
                distortion,
                ..Intrinsics::undistorted((640, 480), [300.0, 310.0, 321.5, 237.5])
            };
            let pixel = camera.project(&Point3::new(0.62, -0.41, 1.0)).unwrap();
            let error = (pixel - Point2::new(x, y)).norm();
            assert!(error < 1e-9, "{distortion:?}: {error}");
            let steep = camera.project(&Point3::new(-1.7, 0.9, 1.0)).unwrap();
            for pixel in [
                pixel,
                steep,
                Point2::new(321.5, 237.5),
                Point2::new(0.0, 479.0),
            ] {
                let back = camera.project(&camera.unproject(&pixel, 2.5)).unwrap();
                assert!(
                    (back - pixel).norm() < 1e-7,
                    "{distortion:?}: {back} {pixel}"
                );
            }
            for (x, y) in [(0.62, -0.41), (-1.7, 0.9), (2e-4, -1e-4), (0.0, 0.0)] {
                let bend = distortion.bend(x, y);
                let step = 1e-6;
                let at = |x, y| Vector2::from(<[f64; 2]>::from(distortion.distort(x, y)));
                let by_x = (at(x + step, y) - at(x - step, y)) / (2.0 * step);
                let by_y = (at(x, y + step) - at(x, y - step)) / (2.0 * step);
                let error = (bend.by_undistorted - Matrix2::from_columns(&[by_x, by_y])).amax();
                assert!(error < 1e-8, "{distortion:?} ({x}, {y}): {error}");
            }
            assert_eq!(camera.check_lens(), Ok(()));
        }
    }

    #[test]
    fn lenses_that_show_no_single_ray_are_refused() {
        let of = |focal, distortion| Intrinsics {
            distortion,
            ..Intrinsics::pinhole(640, 480, focal, 319.5, 239.5)
        };
        let fisheye = Distortion {
            fisheye: true,
            ..Distortion::default()
        };
        assert_eq!(of(270.0, fisheye).check_lens(), Ok(()));
        let error = of(200.0, fisheye).check_lens().unwrap_err();
        assert!(error.contains("sees 229 degrees"), "{error}");
        // Turns back before the corners: 1 - 3 * 0.4 s = 0 at s = .83.
        let turning = Distortion {
            k1: -0.4,
            ..fisheye
        };
        let error = of(300.0, turning).check_lens().unwrap_err();
        assert!(error.contains("no single ray"), "{error}");
    }
}
