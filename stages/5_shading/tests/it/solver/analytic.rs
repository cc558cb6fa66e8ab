//! Surfaces with exact depth and normals, seen by a pinhole camera: the same scene at any resolution.

use nalgebra::Vector3;
use rilievo_scene::{DepthMap, Intrinsics, Lighting, LinearImage, Mask, SphericalHarmonics};
use rilievo_shading::paper::{ShadingView, ViewLight};
use std::sync::Arc;

/// Focal length over the frame's side.
pub const FOCAL: f64 = 1.5;
/// Half the side of the mask's disc over the frame's side.
pub const RADIUS: f64 = 0.4;

/// A surface in front of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Radius 1 at distance 3.
    Sphere,
    /// Semi-axes 1.3, 0.9 and 1.1, off the axis, at distance 3.
    Ellipsoid,
    /// `z = 3 + 0.05 sin(6 x) cos(5 y) + 0.1 x` over the plane of the camera's x and y.
    Wave,
}

pub const SHAPES: [Shape; 3] = [Shape::Sphere, Shape::Ellipsoid, Shape::Wave];

impl Shape {
    /// Point and normal (towards the camera) on the ray `(u, v, 1)`.
    pub fn hit(self, u: f64, v: f64) -> (Vector3<f64>, Vector3<f64>) {
        let ray = Vector3::new(u, v, 1.0);
        match self {
            Self::Sphere | Self::Ellipsoid => {
                let (axes, centre) = if self == Self::Sphere {
                    (Vector3::repeat(1.0), Vector3::new(0.0, 0.0, 3.0))
                } else {
                    (Vector3::new(1.3, 0.9, 1.1), Vector3::new(0.1, -0.05, 3.0))
                };
                let (r, c) = (ray.component_div(&axes), centre.component_div(&axes));
                let along = r.dot(&c);
                let root = (along * along - r.norm_squared() * (c.norm_squared() - 1.0)).sqrt();
                let point = ray * ((along - root) / r.norm_squared());
                let gradient = (point - centre).component_div(&axes).component_div(&axes);
                (point, gradient.normalize())
            }
            Self::Wave => {
                let height = |x: f64, y: f64| {
                    let (a, b) = ((6.0 * x).sin(), (5.0 * y).cos());
                    let slope = [0.3 * (6.0 * x).cos() * b + 0.1, -0.25 * a * (5.0 * y).sin()];
                    (3.0 + 0.05 * a * b + 0.1 * x, slope)
                };
                let mut z = 3.0;
                // Newton's method: slopes along the ray are far below 1.
                for _ in 0..20 {
                    let (wanted, [sx, sy]) = height(u * z, v * z);
                    z -= (z - wanted) / (1.0 - sx * u - sy * v);
                }
                let point = ray * z;
                let (_, [sx, sy]) = height(point.x, point.y);
                (point, Vector3::new(sx, sy, -1.0).normalize())
            }
        }
    }
}

/// A surface seen with square frames of a given side.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    pub shape: Shape,
    pub size: usize,
}

impl Seen {
    pub fn camera(&self) -> Intrinsics {
        let centre = (self.size as f64 - 1.0) / 2.0;
        Intrinsics::pinhole(self.size, self.size, self.focal(), centre, centre)
    }

    pub fn focal(&self) -> f64 {
        FOCAL * self.size as f64
    }

    /// Point and normal at a pixel position.
    pub fn at(&self, x: f64, y: f64) -> (Vector3<f64>, Vector3<f64>) {
        let camera = self.camera();
        self.shape.hit(
            (x - camera.cx) / self.focal(),
            (y - camera.cy) / self.focal(),
        )
    }

    /// Slopes `f ∂ ln z` at a pixel, from the normal.
    pub fn slopes(&self, x: f64, y: f64) -> [f64; 2] {
        let camera = self.camera();
        let (_, n) = self.at(x, y);
        let (u, v) = (
            (x - camera.cx) / self.focal(),
            (y - camera.cy) / self.focal(),
        );
        let along = -(n.x * u + n.y * v + n.z);
        [n.x / along, n.y / along]
    }

    /// The middle of the surface: a disc, whose edge is as jagged as any mask's.
    pub fn mask(&self) -> Mask {
        let centre = (self.size as f64 - 1.0) / 2.0;
        Mask::from_fn(self.size, self.size, |x, y| {
            (x as f64 - centre).hypot(y as f64 - centre) < RADIUS * self.size as f64
        })
    }

    /// The surface under three colours of light far apart, so that no other slope has
    /// nearly the same colour; started from a sphere's cap of half the curvature,
    /// or from the plane for the wave.
    pub fn view(&self) -> ShadingView {
        let rows = [
            [-0.5, 0.0, -0.8, 0.2, 0.0, 0.0, 0.05, 0.0, 0.0],
            [0.5, 0.1, -0.8, 0.2, 0.05, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.6, -0.8, 0.2, 0.0, 0.05, 0.0, 0.05, 0.0],
        ]
        .map(SphericalHarmonics);
        let mut image = LinearImage::filled(self.size, self.size, 3, 0.0);
        let mask = self.mask();
        for y in 0..self.size {
            for x in 0..self.size {
                if *mask.at(x, y) {
                    let (_, n) = self.at(x as f64, y as f64);
                    for (c, row) in rows.iter().enumerate() {
                        image.pixel_mut(x, y)[c] = row.evaluate(&n) as f32;
                    }
                }
            }
        }
        let mut view = ShadingView::new(
            format!("{:?}", self.shape),
            Arc::new(image),
            mask,
            self.camera(),
            ViewLight::Uniform(Lighting {
                channels: rows.to_vec(),
            }),
        );
        let centre = (self.size as f64 - 1.0) / 2.0;
        view.initial_depth = Some(DepthMap::from_fn(self.size, self.size, |x, y| {
            let r = (x as f64 - centre).hypot(y as f64 - centre) / self.focal();
            let bend = if self.shape == Shape::Wave { 0.0 } else { 1.5 };
            (2.2 + bend * r * r) as f32
        }));
        view
    }
}
