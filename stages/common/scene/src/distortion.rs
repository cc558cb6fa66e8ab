//! Lens distortion of OpenCV and COLMAP.

use nalgebra::{Matrix2, Vector2};
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
    /// Of k1, k2, p1, p2 and k3, OpenCV's order.
    pub fn plain([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        Self {
            k1,
            k2,
            p1,
            p2,
            k3,
            ..Self::default()
        }
    }

    /// Whether the lens is free of distortion.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Whether k1, k2, p1, p2 and k3 are all there is.
    pub fn is_plain(&self) -> bool {
        let Self {
            k1, k2, p1, p2, k3, ..
        } = *self;
        *self == Self::plain([k1, k2, p1, p2, k3])
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
    pub(crate) fn to_plane(self, x_distorted: f64, y_distorted: f64) -> (Vector2<f64>, bool) {
        let flat = Self {
            fisheye: false,
            ..self
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
pub(crate) const STEEPEST_RAD: f64 = 1.56;
