//! Pinhole intrinsics with the lens distortion of OpenCV and COLMAP.

use nalgebra::{Matrix2, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Lens distortion; all zero means none.
///
/// With `(a, b) = (x, y)`, or for a fisheye `(a, b) = (θ/r) (x, y)` with `r = |(x, y)|`, `θ = atan r`, and `s = a² + b²`:
/// ```text
/// radial = (1 + k1 s + k2 s² + k3 s³ + k4 s⁴) / (1 + d1 s + d2 s² + d3 s³)
/// x' = a radial + 2 p1 a b + p2 (s + 2a²) + s1 s
/// y' = b radial + 2 p2 a b + p1 (s + 2b²) + s2 s
/// ```
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
    /// Fourth radial coefficient, of fisheye lenses.
    #[serde(default)]
    pub k4: f64,
    /// Radial coefficients of the denominator: OpenCV's k4, k5, k6.
    #[serde(default)]
    pub denominator: [f64; 3],
    /// Thin prism.
    #[serde(default)]
    pub prism: [f64; 2],
    /// Whether equal angles from the axis are equally far apart, before the coefficients.
    #[serde(default)]
    pub fisheye: bool,
}

/// A distorted point with what its derivatives take.
#[derive(Clone, Copy, Debug)]
pub struct Bend {
    /// The distorted point.
    pub at: Vector2<f64>,
    /// Its derivative by the undistorted one.
    pub by_undistorted: Matrix2<f64>,
    /// The point that the coefficients act on: the undistorted one, of a fisheye that of equal angles.
    pub plane: Vector2<f64>,
    /// Denominator of the radial factor.
    pub denominator: f64,
}

/// Steps within which Newton's iteration finds a ray.
const MAX_NUM_STEPS: usize = 50;

/// Distance from the pixel, normalised, at which a ray is found: far below what a photo shows.
const FOUND: f64 = 1e-9;

impl Distortion {
    /// Whether the lens is free of distortion.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Whether k1, k2, p1, p2 and k3 are all there is.
    pub fn is_plain(&self) -> bool {
        let Self {
            k1, k2, p1, p2, k3, ..
        } = *self;
        *self
            == Self {
                k1,
                k2,
                p1,
                p2,
                k3,
                ..Self::default()
            }
    }

    /// All coefficients.
    pub fn numbers(&self) -> [f64; 11] {
        let Self {
            k1,
            k2,
            p1,
            p2,
            k3,
            k4,
            denominator: [d1, d2, d3],
            prism: [s1, s2],
            ..
        } = *self;
        [k1, k2, p1, p2, k3, k4, d1, d2, d3, s1, s2]
    }

    /// Distorted normalised coordinates of undistorted ones.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let [a, b] = self.plane(x, y);
        let s = a * a + b * b;
        let radial = self.numerator(s) / self.divisor(s);
        (
            a * radial + 2.0 * self.p1 * a * b + self.p2 * (s + 2.0 * a * a) + self.prism[0] * s,
            b * radial + self.p1 * (s + 2.0 * b * b) + 2.0 * self.p2 * a * b + self.prism[1] * s,
        )
    }

    /// The same with its derivative.
    pub fn bend(&self, x: f64, y: f64) -> Bend {
        let plane = Vector2::from(self.plane(x, y));
        let by_plane = self.by_plane(plane);
        let by_undistorted = if self.fisheye {
            by_plane * Self::plane_by_point(x, y)
        } else {
            by_plane
        };
        let (xd, yd) = self.distort(x, y);
        Bend {
            at: Vector2::new(xd, yd),
            by_undistorted,
            plane,
            denominator: self.divisor(plane.norm_squared()),
        }
    }

    fn numerator(&self, s: f64) -> f64 {
        1.0 + s * (self.k1 + s * (self.k2 + s * (self.k3 + s * self.k4)))
    }

    fn divisor(&self, s: f64) -> f64 {
        let [d1, d2, d3] = self.denominator;
        1.0 + s * (d1 + s * (d2 + s * d3))
    }

    fn plane(&self, x: f64, y: f64) -> [f64; 2] {
        let r = x.hypot(y);
        if !self.fisheye || r == 0.0 {
            return [x, y];
        }
        let factor = r.atan() / r;
        [factor * x, factor * y]
    }

    /// Derivative of a fisheye's plane by the undistorted point.
    fn plane_by_point(x: f64, y: f64) -> Matrix2<f64> {
        let r2 = x * x + y * y;
        let r = r2.sqrt();
        // Near the axis, where both terms cancel, the first terms of their series.
        let (factor, by_r_over_r) = if r < 1e-3 {
            (1.0 - r2 / 3.0, -2.0 / 3.0 + 0.8 * r2)
        } else {
            let factor = r.atan() / r;
            (factor, (1.0 / (1.0 + r2) - factor) / r2)
        };
        let at = Vector2::new(x, y);
        Matrix2::identity() * factor + at * at.transpose() * by_r_over_r
    }

    fn by_plane(&self, plane: Vector2<f64>) -> Matrix2<f64> {
        let (u, v) = (plane.x, plane.y);
        let (p1, p2) = (self.p1, self.p2);
        let s = u * u + v * v;
        let (above, below) = (self.numerator(s), self.divisor(s));
        let [d1, d2, d3] = self.denominator;
        let above_by_s = self.k1 + s * (2.0 * self.k2 + 3.0 * s * self.k3 + 4.0 * s * s * self.k4);
        let below_by_s = d1 + s * (2.0 * d2 + 3.0 * s * d3);
        let radial = above / below;
        let radial_by_s = (above_by_s - radial * below_by_s) / below;
        let both = 2.0 * u * v * radial_by_s + 2.0 * p1 * u + 2.0 * p2 * v;
        let plain = Matrix2::new(
            radial + 2.0 * u * u * radial_by_s + 2.0 * p1 * v + 6.0 * p2 * u,
            both,
            both,
            radial + 2.0 * v * v * radial_by_s + 6.0 * p1 * v + 2.0 * p2 * u,
        );
        plain + 2.0 * Vector2::from(self.prism) * plane.transpose()
    }

    /// Undistorted normalised coordinates of distorted ones, by fixed-point iteration
    /// (it contracts for every lens whose distortion is monotonic over the frame); of lenses with more than five
    /// coefficients by Newton's. A fisheye's rays at a right angle to the axis and beyond end just before it.
    pub fn undistort(&self, x_distorted: f64, y_distorted: f64) -> (f64, f64) {
        if self.is_none() {
            return (x_distorted, y_distorted);
        }
        if !self.is_plain() {
            return self.steepened(self.to_plane(x_distorted, y_distorted).0);
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

    /// The point of the plane that the coefficients act on, and whether it is found.
    fn to_plane(&self, x_distorted: f64, y_distorted: f64) -> (Vector2<f64>, bool) {
        let flat = Self {
            fisheye: false,
            ..*self
        };
        let wanted = Vector2::new(x_distorted, y_distorted);
        let missed = |plane: Vector2<f64>| {
            wanted - Vector2::from(<[f64; 2]>::from(flat.distort(plane.x, plane.y)))
        };
        let mut plane = wanted;
        let mut miss = missed(plane);
        for _ in 0..MAX_NUM_STEPS {
            let Some(inverse) = flat.by_plane(plane).try_inverse() else {
                break;
            };
            let mut step = inverse * miss;
            // Shortened until it helps: a whole step may lead beyond the lens's turning point.
            let mut next = missed(plane + step);
            while next.norm() > miss.norm() && step.norm() > 1e-15 {
                step *= 0.5;
                next = missed(plane + step);
            }
            if next.norm().is_nan() || next.norm() >= miss.norm() {
                break;
            }
            (plane, miss) = (plane + step, next);
        }
        let s = plane.norm_squared();
        // Neither on the axis's other side nor beyond a turning point on the way out.
        let is_first = self.numerator(s) / self.divisor(s) > 0.0
            && (1..=8).all(|i| flat.by_plane(plane * (f64::from(i) / 8.0)).determinant() > 0.0);
        let found = miss.norm() < FOUND && is_first;
        (plane, found)
    }

    /// The undistorted point of one of the plane that the coefficients act on.
    fn steepened(&self, plane: Vector2<f64>) -> (f64, f64) {
        let angle = plane.norm();
        if !self.fisheye || angle == 0.0 {
            return (plane.x, plane.y);
        }
        let factor = angle.min(STEEPEST_RAD).tan() / angle;
        (factor * plane.x, factor * plane.y)
    }
}

/// Angle from the axis at which a fisheye's rays end: a plane before the camera shows no more.
const STEEPEST_RAD: f64 = 1.56;

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

/// Places along each side of the frame at which a lens model is tried.
const NUM_CHECKED: usize = 64;

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
