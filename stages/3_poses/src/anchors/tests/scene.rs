//! Textured surfaces photographed without error: the texture is a function of the point in space, so
//! every view sees exactly the same surface.

use nalgebra::{Point3, Rotation3, Vector3};
use rilievo_scene::{
    Distortion, FocalSource, InMemoryPixels, Intrinsics, LinearImage, Mask, Orientation, Photo,
    PhotoIdx, PhotoSet, PosedView, PosedViews, Raster, RigidTransform,
};
use std::sync::Arc;

/// Surfaces of the scene; the nearest one along a ray is seen.
#[derive(Clone, Copy)]
pub enum Shape {
    Sphere {
        center: Point3<f64>,
        radius: f64,
    },
    /// Square piece of the plane `z = height`, facing the cameras at negative `z`.
    Square {
        height: f64,
        half_side: f64,
    },
}

impl Shape {
    /// Distance along a ray of a camera centre, in units of the direction.
    fn hit(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        match *self {
            Self::Sphere { center, radius } => {
                let to = origin - center;
                let (a, b) = (direction.norm_squared(), to.dot(direction));
                let discriminant = b * b - a * (to.norm_squared() - radius * radius);
                (discriminant > 0.0).then(|| (-b - discriminant.sqrt()) / a)
            }
            Self::Square { height, half_side } => {
                let t = (height - origin.z) / direction.z;
                let p = origin + direction * t;
                (t > 0.0 && p.x.abs() < half_side && p.y.abs() < half_side).then_some(t)
            }
        }
    }
}

pub struct Scene {
    pub photos: PhotoSet,
    pub posed: PosedViews,
    pub depths: Vec<Raster<f64>>,
}

/// Random bits of an item: independent of any order.
fn hash(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A standard normal value of an item.
pub fn normal(seed: u64) -> f64 {
    let uniform = |k: u64| ((hash(k) >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
    let (u, v) = (uniform(2 * seed), uniform(2 * seed + 1));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Logarithm of the radiance at a point: waves of several lengths and directions.
fn texture(point: &Point3<f64>, contrast: f64) -> f64 {
    let mut sum = 0.0;
    for k in 0..12_u64 {
        let direction = Vector3::new(
            normal(100 + 3 * k),
            normal(101 + 3 * k),
            normal(102 + 3 * k),
        );
        let frequency = 14.0 + 7.0 * k as f64;
        sum += (frequency * direction.normalize().dot(&point.coords) + normal(500 + k)).sin();
    }
    contrast * sum / 3.5
}

pub struct Settings {
    pub num_views: usize,
    /// Angle between neighbouring views, degrees.
    pub step_deg: f64,
    /// Deviation of the log radiance.
    pub contrast: f64,
    /// Relative deviation of a pixel's noise.
    pub noise: f64,
    pub masks: bool,
    pub size: (usize, usize),
    pub distortion: Distortion,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            num_views: 5,
            step_deg: 14.0,
            contrast: 0.1,
            noise: 0.0,
            masks: true,
            size: (256, 208),
            distortion: Distortion::default(),
        }
    }
}

/// Photographs shapes from an arc of radius 3 around the origin, from negative `z`.
pub fn photograph(shapes: &[Shape], settings: &Settings) -> Scene {
    let (width, height) = settings.size;
    let camera = Intrinsics {
        distortion: settings.distortion,
        ..Intrinsics::pinhole(
            width,
            height,
            1.6 * width as f64,
            0.5 * (width as f64 - 1.0) + 1.3,
            0.5 * (height as f64 - 1.0) - 0.7,
        )
    };
    let mut scene = Scene {
        photos: PhotoSet::default(),
        posed: PosedViews::default(),
        depths: Vec::new(),
    };
    for idx in 0..settings.num_views {
        let middle = 0.5 * (settings.num_views as f64 - 1.0);
        let yaw = ((idx as f64 - middle) * settings.step_deg).to_radians();
        // Off the plane of the arc by turns, so that the epipolar lines differ.
        let pitch = if idx % 2 == 0 { 0.06 } else { -0.07 };
        let rotation = Rotation3::from_euler_angles(pitch, yaw, 0.02 * idx as f64);
        let center = Point3::from(rotation * Vector3::new(0.0, 0.0, -3.0));
        let cam_from_world = RigidTransform::from_world_pose(rotation, center);
        let mut image = LinearImage::filled(width, height, 1, 0.05);
        let mut depth = Raster::filled(width, height, 0.0);
        for y in 0..height {
            for x in 0..width {
                let ray = camera.ray(&nalgebra::Point2::new(x as f64, y as f64));
                let direction = rotation * ray;
                let nearest = shapes
                    .iter()
                    .filter_map(|shape| shape.hit(&center, &direction))
                    .min_by(f64::total_cmp);
                let Some(t) = nearest else { continue };
                let log = texture(&(center + direction * t), settings.contrast);
                let seed = ((idx * height + y) * width + x) as u64 + 1_000_000;
                let value = 0.4 * log.exp() * (1.0 + settings.noise * normal(seed));
                image.pixel_mut(x, y)[0] = value as f32;
                // The ray has z = 1, so its parameter is the depth.
                *depth.at_mut(x, y) = t;
            }
        }
        let mask = settings.masks.then(|| {
            let is_object = |x, y| *depth.at(x, y) > 0.0;
            Arc::new(Mask::from_fn(width, height, is_object).packed())
        });
        let name = format!("view{idx}");
        scene.posed.views.push(PosedView {
            photo: PhotoIdx(idx),
            name: name.clone(),
            file_name: format!("{name}.png"),
            intrinsics: camera,
            cam_from_world,
        });
        scene.photos.photos.push(Photo {
            file_name: format!("{name}.png"),
            name,
            pixels: Arc::new(InMemoryPixels(Arc::new(image))),
            intrinsics: camera,
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: Orientation::UPRIGHT,
            mask,
            clip_level: 0.98,
            given_cam_from_world: None,
        });
        scene.depths.push(depth);
    }
    scene
}

impl Scene {
    /// Replaces a photo's pixels by a changed copy.
    pub fn change(&mut self, idx: usize, change: impl Fn(usize, usize, f32) -> f32) {
        let photo = &mut self.photos.photos[idx];
        let image = photo.linear().expect("pixels in memory");
        let mut image = (*image).clone();
        for y in 0..image.height {
            for x in 0..image.width {
                let value = image.pixel(x, y)[0];
                image.pixel_mut(x, y)[0] = change(x, y, value);
            }
        }
        photo.pixels = Arc::new(InMemoryPixels(Arc::new(image)));
    }

    /// True depth at a sub-pixel position away from depth edges.
    pub fn depth(&self, view: usize, pixel: [f64; 2]) -> Option<f64> {
        let depth = &self.depths[view];
        let (x0, y0) = (pixel[0].floor(), pixel[1].floor());
        let (fx, fy) = (pixel[0] - x0, pixel[1] - y0);
        let near = *depth.get(pixel[0].round() as isize, pixel[1].round() as isize)?;
        let mut sum = 0.0;
        for (u, v, w) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let z = depth
                .get(x0 as isize + u, y0 as isize + v)
                .copied()
                .unwrap_or(near);
            if (z / near - 1.0).abs() > 0.02 {
                return Some(near);
            }
            // Inverse depth is affine in the pixel.
            sum += w / z;
        }
        Some(1.0 / sum)
    }
}
