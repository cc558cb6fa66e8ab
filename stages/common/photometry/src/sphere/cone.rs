//! A sphere in a camera's frame: the cone of its rays, its outline and its normals.
//!
//! # Equations
//! With centre `C`, radius `R`, `ρ = |C|`, axis `u = C/ρ` and `sin a = R/ρ`:
//! * a unit ray `d` meets the sphere where `d · u ≥ cos a`, first at distance
//!   `t = d·C − √((d·C)² − ρ² + R²)`; the normal there is `(t d − C) / R`;
//! * the outline is the cone `d · u = cos a`; with the axis at `t` off the optical axis its image
//!   has its centre at `f sin t cos t / (cos²t − sin²a)`, semi-axes
//!   `f sin a cos a / (cos²t − sin²a)` away from the principal point and
//!   `f sin a / √(cos²t − sin²a)` across;
//! * points on the outline give the cone linearly: `d_i · w = 1` with `w = u / cos a`.

use super::error::SphereError;
use nalgebra::{Matrix3, Point2, Point3, Vector3};
use rilievo_scene::{Intrinsics, LocatedSphere, PosedView, PosedViews, RigidTransform};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// A sphere in a camera's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SphereInCamera {
    /// Centre in the camera frame.
    pub center: Point3<f64>,
    /// Radius, in the same unit.
    pub radius: f64,
}

/// A pixel of a sphere with its exact normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpherePixel {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Unit normal in the camera frame, towards the camera.
    pub normal_in_cam: Vector3<f64>,
    /// Cosine between the normal and the direction to the camera, 0 at the outline.
    pub cos_view: f64,
}

/// An ellipse in the picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EllipsePx {
    /// Centre, pixels.
    pub center: [f64; 2],
    /// Semi-axes, pixels.
    pub semi_axes: [f64; 2],
    /// Angle of the first semi-axis from +x towards +y, radians.
    pub angle_rad: f64,
}

impl EllipsePx {
    /// A point on the ellipse at a parameter angle.
    pub fn point(&self, parameter: f64) -> Point2<f64> {
        let (s, c) = self.angle_rad.sin_cos();
        let (a, b) = (
            self.semi_axes[0] * parameter.cos(),
            self.semi_axes[1] * parameter.sin(),
        );
        Point2::new(
            self.center[0] + c * a - s * b,
            self.center[1] + s * a + c * b,
        )
    }
}

impl SphereInCamera {
    /// A sphere of the world in a camera's frame.
    pub fn seen(located: &LocatedSphere, cam_from_world: &RigidTransform) -> Self {
        Self {
            center: cam_from_world.apply(&Point3::from(located.center_in_world)),
            radius: located.radius,
        }
    }

    /// All spheres of the world in a view's frame.
    pub fn all_seen(posed: &PosedViews, view: &PosedView) -> Vec<Self> {
        let seen = |located| Self::seen(located, &view.cam_from_world);
        posed.spheres.iter().map(seen).collect()
    }

    /// The cone of its outline; `None` when the camera is inside or it lies behind.
    pub fn cone(&self) -> Option<OutlineCone> {
        let distance = self.center.coords.norm();
        (distance > self.radius && self.radius > 0.0 && self.center.z > 0.0).then(|| OutlineCone {
            axis: self.center.coords / distance,
            half_angle: (self.radius / distance).asin(),
        })
    }

    /// Distance along a unit ray to the visible side; `None` where the ray misses.
    #[inline]
    pub fn distance_along(&self, unit_ray: &Vector3<f64>) -> Option<f64> {
        let along = unit_ray.dot(&self.center.coords);
        let discriminant =
            along * along - self.center.coords.norm_squared() + self.radius * self.radius;
        (discriminant >= 0.0 && along > 0.0).then(|| along - discriminant.sqrt())
    }

    /// Unit normal where the ray of a pixel meets the sphere, in the camera frame.
    #[inline]
    pub fn normal_at(&self, intrinsics: &Intrinsics, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        let ray = intrinsics.ray(pixel).normalize();
        let t = self.distance_along(&ray)?;
        Some((ray * t - self.center.coords) / self.radius)
    }

    /// Outline points in the picture, lens distortion included, evenly around the axis. Points
    /// behind the camera are left out; points outside the frame are kept.
    pub fn outline(&self, intrinsics: &Intrinsics, num_points: usize) -> Vec<Point2<f64>> {
        let Some(cone) = self.cone() else {
            return Vec::new();
        };
        (0..num_points)
            .filter_map(|k| {
                let angle = std::f64::consts::TAU * k as f64 / num_points as f64;
                intrinsics.project(&Point3::from(cone.ray(angle)))
            })
            .collect()
    }

    /// Lowest and highest coordinate of its outline along columns and rows, by so many points; `None`
    /// where any of them lies behind the camera.
    fn extent(&self, intrinsics: &Intrinsics, num_points: usize) -> Option<[[f64; 2]; 2]> {
        let outline = self.outline(intrinsics, num_points);
        let range = |axis: usize| {
            let ends = [f64::INFINITY, f64::NEG_INFINITY];
            let along = outline.iter().map(|p| p[axis]);
            along.fold(ends, |[low, high], x| [low.min(x), high.max(x)])
        };
        (outline.len() == num_points).then(|| [range(0), range(1)])
    }

    /// Whether any part of its outline's extent lies in the frame.
    pub fn is_in_frame(&self, intrinsics: &Intrinsics) -> bool {
        let size = [intrinsics.width, intrinsics.height];
        let extent = self.extent(intrinsics, 64);
        extent.is_some_and(|extent| {
            let mut sides = extent.iter().zip(size);
            sides.all(|([low, high], size)| *low <= size as f64 - 0.5 && *high >= -0.5)
        })
    }

    /// Columns and rows of the frame that its outline reaches, widened by `room_px`; `None` where none does.
    pub(super) fn part_of_frame(
        &self,
        intrinsics: &Intrinsics,
        num_points: usize,
        room_px: f64,
    ) -> Option<[RangeInclusive<usize>; 2]> {
        let within = |[low, high]: [f64; 2], size: usize| {
            let low = (low - room_px).floor().max(0.0);
            let high = (high + room_px).ceil().min(size as f64 - 1.0);
            (low <= high).then_some(low as usize..=high as usize)
        };
        let [x, y] = self.extent(intrinsics, num_points)?;
        Some([within(x, intrinsics.width)?, within(y, intrinsics.height)?])
    }

    /// Mean radius of the outline in pixels, close to the optical axis exact.
    pub fn radius_px(&self, intrinsics: &Intrinsics) -> f64 {
        self.cone().map_or(0.0, |cone| {
            let cos_off_axis = cone.axis.z;
            intrinsics.focal_px() * cone.half_angle.tan() / cos_off_axis.max(0.1)
        })
    }

    /// Ellipse of the outline, without lens distortion.
    ///
    /// # Errors
    /// [`SphereError::Impossible`] where the outline is no ellipse (camera inside the sphere, or
    /// the cone reaching a right angle off the optical axis).
    pub fn ellipse(&self, intrinsics: &Intrinsics) -> Result<EllipsePx, SphereError> {
        let cone = self.cone().ok_or(SphereError::Impossible)?;
        // In normalised coordinates the module's formula holds with f = 1 around the origin.
        let (sin_a2, cos_t) = (cone.half_angle.sin().powi(2), cone.axis.z);
        let denominator = cos_t * cos_t - sin_a2;
        if denominator <= 0.0 {
            return Err(SphereError::Impossible);
        }
        let sin_t = cone.axis.x.hypot(cone.axis.y);
        let angle = cone.axis.y.atan2(cone.axis.x);
        let at = sin_t * cos_t / denominator;
        let radial = cone.half_angle.sin() * cone.half_angle.cos() / denominator;
        let across = cone.half_angle.sin() / denominator.sqrt();
        // Different focal lengths along x and y stretch it: the image of the shape matrix.
        let (s, c) = angle.sin_cos();
        let (sx, sy) = (intrinsics.fx, intrinsics.fy);
        let first = (sx * c * radial, sy * s * radial);
        let second = (-sx * s * across, sy * c * across);
        let (xx, xy, yy) = (
            first.0 * first.0 + second.0 * second.0,
            first.0 * first.1 + second.0 * second.1,
            first.1 * first.1 + second.1 * second.1,
        );
        let half_difference = 0.5 * (xx - yy);
        let root = half_difference.hypot(xy);
        let mean = 0.5 * (xx + yy);
        Ok(EllipsePx {
            center: [intrinsics.cx + sx * at * c, intrinsics.cy + sy * at * s],
            semi_axes: [(mean + root).sqrt(), (mean - root).max(0.0).sqrt()],
            angle_rad: 0.5 * xy.atan2(half_difference),
        })
    }

    /// All pixels of the frame that see the sphere, at least `margin_px` inside its outline.
    pub fn pixels(&self, intrinsics: &Intrinsics, margin_px: f64) -> Vec<SpherePixel> {
        let part = self.part_of_frame(intrinsics, 256, 0.0);
        let (Some([columns, rows]), Some(cone)) = (part, self.cone()) else {
            return Vec::new();
        };
        // The margin in pixels as an angle off the outline; the same all around to first order.
        let margin = margin_px * cone.half_angle / self.radius_px(intrinsics).max(1e-9);
        let limit = (cone.half_angle - margin).max(0.0).cos();
        let mut pixels = Vec::new();
        for y in rows {
            for x in columns.clone() {
                let ray = intrinsics.ray(&Point2::new(x as f64, y as f64)).normalize();
                if ray.dot(&cone.axis) < limit {
                    continue;
                }
                if let Some(t) = self.distance_along(&ray) {
                    let normal = (ray * t - self.center.coords) / self.radius;
                    pixels.push(SpherePixel {
                        x,
                        y,
                        normal_in_cam: normal,
                        cos_view: -normal.dot(&ray),
                    });
                }
            }
        }
        pixels
    }
}

/// The cone of rays that touch a sphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutlineCone {
    /// Unit axis in the camera frame.
    pub axis: Vector3<f64>,
    /// Half-angle, radians.
    pub half_angle: f64,
}

impl OutlineCone {
    /// The sphere of a known radius that has this outline.
    pub fn sphere(&self, radius: f64) -> SphereInCamera {
        SphereInCamera {
            center: Point3::from(self.axis * (radius / self.half_angle.sin())),
            radius,
        }
    }

    /// Unit ray on the cone at an angle around the axis.
    pub fn ray(&self, angle: f64) -> Vector3<f64> {
        let (e1, e2) = self.frame();
        self.axis * self.half_angle.cos()
            + (e1 * angle.cos() + e2 * angle.sin()) * self.half_angle.sin()
    }

    /// Two unit vectors across the axis; the first points along the image's rows for a cone in
    /// front, so that angles start at +x and turn towards +y.
    fn frame(&self) -> (Vector3<f64>, Vector3<f64>) {
        let e2 = self.axis.cross(&Vector3::x()).normalize();
        (e2.cross(&self.axis), e2)
    }

    /// Signed angle of a unit ray outside (+) or inside (−) the cone, radians.
    #[inline]
    pub fn angle_outside(&self, unit_ray: &Vector3<f64>) -> f64 {
        // atan2 keeps its precision for narrow cones, where acos loses half the digits.
        let along = unit_ray.dot(&self.axis);
        let across = (unit_ray - self.axis * along).norm();
        across.atan2(along) - self.half_angle
    }

    /// Linear least squares through at least three unit rays, each with a weight.
    pub fn from_rays(unit_rays: &[Vector3<f64>], weights: &[f64]) -> Option<Self> {
        // Around the mean ray the problem is well scaled however narrow the cone: with
        // d = (e + m)/|e + m|, e across m, the cone reads e · w_across + w_along = |e + m|.
        let mean = unit_rays
            .iter()
            .zip(weights)
            .map(|(ray, w)| ray * *w)
            .sum::<Vector3<f64>>()
            .try_normalize(1e-12)?;
        let helper = if mean.x.abs() < 0.7 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let e1 = mean.cross(&helper).normalize();
        let e2 = mean.cross(&e1);
        let planar = |ray: &Vector3<f64>| {
            let along = ray.dot(&mean);
            (ray.dot(&e1) / along, ray.dot(&e2) / along)
        };
        let size = unit_rays
            .iter()
            .map(|ray| {
                let (x, y) = planar(ray);
                x.hypot(y)
            })
            .fold(0.0, f64::max);
        if !(size > 0.0 && size.is_finite()) {
            return None;
        }
        let mut matrix = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for (ray, w) in unit_rays.iter().zip(weights) {
            let (x, y) = planar(ray);
            // |e + m| − 1 by its expansion's closed form, exact for small angles.
            let length = 1.0_f64.hypot(x.hypot(y));
            let excess = (x * x + y * y) / (length + 1.0) / (size * size);
            let row = Vector3::new(x / size, y / size, 1.0);
            matrix += row * row.transpose() * *w;
            right += row * (*w * excess);
        }
        let solved = matrix.try_inverse()? * right;
        // w = (solved.x e1 + solved.y e2) size + (1 + solved.z size²) m
        let vector = (e1 * solved.x + e2 * solved.y) * size + mean * (1.0 + solved.z * size * size);
        let norm = vector.norm();
        if !(norm > 1.0 && norm.is_finite()) {
            return None;
        }
        // tan a = √(|w|² − 1), with |w|² − 1 again without cancellation.
        let small = solved.z * size * size;
        let square_minus_one =
            size * size * (solved.x * solved.x + solved.y * solved.y) + small * (2.0 + small);
        Some(Self {
            axis: vector / norm,
            half_angle: square_minus_one.sqrt().atan(),
        })
    }
}
