//! Pinhole intrinsics with OpenCV distortion.

use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// OpenCV's radial and tangential lens distortion; all zero means none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// First radial coefficient.
    pub k1: f64,
    /// Second radial coefficient.
    pub k2: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// Third radial coefficient.
    pub k3: f64,
}

impl Distortion {
    /// Whether the lens is free of distortion.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Distorted normalised coordinates of undistorted ones.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Undistorted normalised coordinates of distorted ones, by fixed-point iteration
    /// (it contracts for every lens whose distortion is monotonic over the frame).
    pub fn undistort(&self, x_distorted: f64, y_distorted: f64) -> (f64, f64) {
        if self.is_none() {
            return (x_distorted, y_distorted);
        }
        let (mut x, mut y) = (x_distorted, y_distorted);
        for _ in 0..50 {
            let (xd, yd) = self.distort(x, y);
            let (dx, dy) = (x_distorted - xd, y_distorted - yd);
            x += dx;
            y += dy;
            if dx.abs() + dy.abs() < 1e-14 {
                break;
            }
        }
        (x, y)
    }
}

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
    pub fn key(&self) -> [u64; 11] {
        let d = &self.distortion;
        let [fx, fy, cx, cy] = [self.fx, self.fy, self.cx, self.cy];
        // Zero has two signs, and is one number.
        let [fx, fy, cx, cy, k1, k2, p1, p2, k3] =
            [fx, fy, cx, cy, d.k1, d.k2, d.p1, d.p2, d.k3].map(|value| (value + 0.0).to_bits());
        let (width, height) = (self.width as u64, self.height as u64);
        [width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3]
    }

    /// Focal lengths over the frame's longer side that a lens can have: from 157 degrees across the frame
    /// to half a degree.
    pub const FOCAL_OVER_SIDE: std::ops::RangeInclusive<f64> = 0.1..=100.0;

    /// A focal length that no lens has, pixels.
    pub fn implausible_focal_px(&self) -> Option<f64> {
        let side = self.width.max(self.height) as f64;
        let focal = [self.fx, self.fy].into_iter();
        focal
            .into_iter()
            .find(|f| !Self::FOCAL_OVER_SIDE.contains(&(f / side)))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unprojection_inverts_projection_with_distortion() {
        let camera = Intrinsics {
            distortion: Distortion {
                k1: -0.12,
                k2: 0.05,
                p1: 1e-3,
                p2: -7e-4,
                k3: -0.01,
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
}
