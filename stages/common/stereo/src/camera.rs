//! Pinhole cameras of one pyramid level, and the warp between two of them.
//!
//! A pixel `x = (x, y, 1)` of view i at inverse depth `w` lies in view j at
//! `P = K_j R_ji K_i⁻¹ x + w K_j t_ji`, pixel `(P₀, P₁) / P₂`, depth `P₂ / w`.
//! With `ζ = ln z = −ln w`: `∂P/∂ζ = −w K_j t_ji`.

use nalgebra::{Matrix3, Point3, Vector3};
use rilievo_scene::{Distortion, Intrinsics, RigidTransform};

/// Which rays `(x, y, 1)` a photo shows, and its straightened image with it: those between the middles of its outermost
/// pixels, both straight and bent by its lens.
#[derive(Clone, Copy, Debug)]
struct Extent {
    distortion: Distortion,
    /// Normalised coordinates of the middles of the first and the last pixel.
    lowest: [f64; 2],
    highest: [f64; 2],
    /// Size of the photo's pixels in these coordinates.
    pixel: [f64; 2],
}

impl Extent {
    fn new(intrinsics: &Intrinsics) -> Self {
        let k = intrinsics;
        let normalised = |x: f64, y: f64| [(x - k.cx) / k.fx, (y - k.cy) / k.fy];
        Self {
            distortion: k.distortion,
            lowest: normalised(0.0, 0.0),
            highest: normalised(k.width as f64 - 1.0, k.height as f64 - 1.0),
            pixel: [1.0 / k.fx, 1.0 / k.fy],
        }
    }

    fn holds(&self, x: f64, y: f64) -> bool {
        // Rounding shall not cut off outermost pixels.
        let is_between = |value: f64, axis: usize| {
            let rounding = 1e-6 * self.pixel[axis];
            value >= self.lowest[axis] - rounding && value <= self.highest[axis] + rounding
        };
        // Far outside, where lenses are not modelled, rays may be bent back into the photo.
        let is_inside = |x: f64, y: f64| is_between(x, 0) && is_between(y, 1);
        is_inside(x, y) && {
            let (x, y) = self.distortion.distort(x, y);
            is_inside(x, y)
        }
    }
}

/// A pinhole without distortion, with its pose.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
    /// Rotation of `cam_from_world`.
    pub rotation: Matrix3<f64>,
    /// Translation of `cam_from_world`, the world's unit.
    pub translation: Vector3<f64>,
    /// Centre in the world.
    pub center: Point3<f64>,
    /// What the whole photo shows.
    extent: Extent,
}

impl Camera {
    /// The pinhole of a photo straightened ([`crate::rectify`]), at a pose `cam_from_world`.
    pub fn new(intrinsics: &Intrinsics, pose: &RigidTransform) -> Self {
        Self {
            width: intrinsics.width,
            height: intrinsics.height,
            fx: intrinsics.fx,
            fy: intrinsics.fy,
            cx: intrinsics.cx,
            cy: intrinsics.cy,
            rotation: pose.rotation_matrix(),
            translation: pose.translation,
            center: pose.center_in_source(),
            extent: Extent::new(intrinsics),
        }
    }

    /// The camera of the image cropped to a window that starts at `(x0, y0)`.
    pub fn cropped(&self, x0: usize, y0: usize, width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            cx: self.cx - x0 as f64,
            cy: self.cy - y0 as f64,
            ..self.clone()
        }
    }

    /// The camera of the image reduced by blocks of `factor × factor` pixels; incomplete ones are dropped.
    pub fn reduced(&self, factor: usize) -> Self {
        let scale = 1.0 / factor as f64;
        Self {
            width: self.width / factor,
            height: self.height / factor,
            fx: self.fx * scale,
            fy: self.fy * scale,
            cx: (self.cx + 0.5) * scale - 0.5,
            cy: (self.cy + 0.5) * scale - 0.5,
            ..self.clone()
        }
    }

    /// Mean of both focal lengths, pixels.
    pub fn focal(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }

    /// Side of the square that a pixel covers at log depth `zeta` on a surface that faces the camera, world's unit.
    pub fn footprint(&self, zeta: f64) -> f64 {
        zeta.exp() / self.focal()
    }

    fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// Whether the photo shows the whole of a pixel, which may lie beyond the raster if that is a part of the photo.
    /// Straightened photos show nothing in parts of their raster.
    pub fn shows(&self, x: i32, y: i32) -> bool {
        let middle = self.ray(f64::from(x), f64::from(y));
        // From there to the middles of the outermost of the photo's pixels that this one covers.
        let reach = |size: f64, of_photo: f64| 0.5 * (size - of_photo);
        let [dx, dy] = [
            reach(1.0 / self.fx, self.extent.pixel[0]),
            reach(1.0 / self.fy, self.extent.pixel[1]),
        ];
        [(-dx, -dy), (dx, -dy), (-dx, dy), (dx, dy)]
            .iter()
            .all(|(dx, dy)| self.extent.holds(middle.x + dx, middle.y + dy))
    }

    /// Ray of a pixel in the camera frame, `z = 1`.
    #[inline]
    pub fn ray(&self, x: f64, y: f64) -> Vector3<f64> {
        Vector3::new((x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0)
    }

    /// World point at a pixel and a depth.
    #[inline]
    pub fn unproject(&self, x: f64, y: f64, depth: f64) -> Point3<f64> {
        self.center + self.rotation.tr_mul(&(self.ray(x, y) * depth))
    }

    /// Pixel and depth of a world point.
    #[inline]
    pub fn project(&self, point: &Point3<f64>) -> Option<(f64, f64, f64)> {
        let p = self.rotation * point.coords + self.translation;
        (p.z > 0.0).then(|| {
            (
                self.fx * p.x / p.z + self.cx,
                self.fy * p.y / p.z + self.cy,
                p.z,
            )
        })
    }
}

/// Maps pixels of one view at an inverse depth into another.
#[derive(Clone, Copy, Debug)]
pub struct Warp {
    /// `K_j R_ji K_i⁻¹`.
    pub a: Matrix3<f64>,
    /// `K_j t_ji`.
    pub b: Vector3<f64>,
}

/// Where a pixel lands, and how that depends on `ζ`.
#[derive(Clone, Copy, Debug)]
pub struct Landing {
    /// Column in the other view.
    pub u: f64,
    /// Row in the other view.
    pub v: f64,
    /// Log depth in the other view.
    pub zeta: f64,
    /// `∂u/∂ζ`.
    pub du: f64,
    /// `∂v/∂ζ`.
    pub dv: f64,
    /// `∂ζ_other/∂ζ`.
    pub dzeta: f64,
}

impl Warp {
    /// The warp between two cameras; `None` where the first one's matrix is singular.
    pub fn between(from: &Camera, to: &Camera) -> Option<Self> {
        let inverse = from.matrix().try_inverse()?;
        let rotation = to.rotation * from.rotation.transpose();
        let translation = to.translation - rotation * from.translation;
        Some(Self {
            a: to.matrix() * rotation * inverse,
            b: to.matrix() * translation,
        })
    }

    /// Homogeneous pixel `P` of the other view; its third component times the depth is the depth there.
    #[inline]
    pub fn at(&self, x: f64, y: f64, inverse_depth: f64) -> Vector3<f64> {
        self.a * Vector3::new(x, y, 1.0) + self.b * inverse_depth
    }

    /// Lands pixel `(x, y)` with log depth `zeta`; `None` behind the other camera.
    #[inline]
    pub(crate) fn land(&self, x: f64, y: f64, zeta: f64) -> Option<Landing> {
        let w = (-zeta).exp();
        let p = self.at(x, y, w);
        if p.z.is_nan() || p.z <= 1e-9 {
            return None;
        }
        let d = -self.b * w;
        let (u, v) = (p.x / p.z, p.y / p.z);
        Some(Landing {
            u,
            v,
            zeta: p.z.ln() + zeta,
            du: (d.x - u * d.z) / p.z,
            dv: (d.y - v * d.z) / p.z,
            dzeta: d.z / p.z + 1.0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn landing_agrees_with_projection_and_its_derivatives_with_differences() {
        let k = Intrinsics::pinhole(640, 480, 700.0, 319.5, 239.5);
        let first = Camera::new(&k, &RigidTransform::identity());
        let second = Camera::new(
            &k,
            &RigidTransform {
                rotation: UnitQuaternion::from_euler_angles(0.02, -0.3, 0.05),
                translation: Vector3::new(0.3, -0.02, 0.1),
            },
        );
        let Some(warp) = Warp::between(&first, &second) else {
            panic!("singular camera")
        };
        let zeta = 1.1_f64.ln();
        let at = |z: f64| warp.land(300.0, 200.0, z);
        let projected = second.project(&first.unproject(300.0, 200.0, 1.1));
        let (Some(l), Some((u, v, z))) = (at(zeta), projected) else {
            panic!("not visible")
        };
        assert!((l.u - u).abs() < 1e-9 && (l.v - v).abs() < 1e-9, "{l:?}");
        assert!((l.zeta - z.ln()).abs() < 1e-12, "{l:?}");
        let (Some(p), Some(m)) = (at(zeta + 1e-6), at(zeta - 1e-6)) else {
            panic!("not visible")
        };
        assert!(((p.u - m.u) / 2e-6 - l.du).abs() < 1e-4, "{l:?}");
        assert!(((p.v - m.v) / 2e-6 - l.dv).abs() < 1e-4, "{l:?}");
        assert!(((p.zeta - m.zeta) / 2e-6 - l.dzeta).abs() < 1e-6, "{l:?}");
    }
}
