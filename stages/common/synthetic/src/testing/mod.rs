//! What the tests of all crates build their worlds from: photos in memory, cameras, spheres, light,
//! damage, and the data folder beside the repository.
//!
//! [`Scene`](crate::Scene) and [`Renderer`](crate::Renderer) photograph a whole object; here is what
//! suffices where a test renders its own few pixels, or none.

pub mod mat_file;
mod mutated;
mod posed_sphere;
mod shared_data;

pub use mutated::{Random, mutated};
pub use posed_sphere::{SphereWorld, sphere_world};
pub use shared_data::shared_data;

use crate::view::RenderedView;
use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, DecodedPhoto, DepthMap, FocalSource, InMemoryPixels,
    Intrinsics, Lighting, LinearImage, LocatedSphere, MarkedSphere, Mask, NormalMap, Photo,
    PhotoIdx, PhotoSet, PosedView, PosedViews, Raster, RigidTransform, Samples, ShadedView,
    SphericalHarmonics, ViewIdx, srgb,
};
use std::sync::Arc;

/// A photo in memory, of a known camera and without a mask.
pub fn photo(file_name: &str, image: LinearImage, intrinsics: Intrinsics) -> Photo {
    Photo {
        file_name: file_name.to_owned(),
        name: stem(file_name).to_owned(),
        pixels: in_memory(image),
        intrinsics,
        focal_source: FocalSource::CameraFile,
        camera_group: 0,
        orientation: 1,
        mask: None,
        clip_level: 1.0,
        given_cam_from_world: None,
    }
}

/// A photo of a test set as light: 8 bits have the sRGB curve, more are linear.
pub fn linear_of(photo: &DecodedPhoto) -> LinearImage {
    let data = match &photo.samples {
        Samples::U8(bytes) => {
            let decode = |&v| srgb::decode(f64::from(v) / 255.0) as f32;
            bytes.iter().map(decode).collect()
        }
        Samples::U16(words) => words.iter().map(|&v| f32::from(v) / 65535.0).collect(),
        Samples::F32(light) => light.clone(),
    };
    LinearImage {
        width: photo.width,
        height: photo.height,
        channels: photo.channels,
        data,
    }
}

fn stem(file_name: &str) -> &str {
    file_name
        .rsplit_once('.')
        .map_or(file_name, |parts| parts.0)
}

/// Pixels for a [`Photo`].
pub fn in_memory(image: LinearImage) -> Arc<InMemoryPixels> {
    Arc::new(InMemoryPixels(Arc::new(image)))
}

/// A rendered photo, masked by the object.
pub fn rendered_photo(file_name: &str, view: &RenderedView) -> Photo {
    Photo {
        mask: Some(Arc::new(view.object_mask.clone())),
        ..photo(file_name, view.image.clone(), view.intrinsics)
    }
}

/// Photos, and where they were taken.
#[derive(Clone, Debug, Default)]
pub struct PosedPhotos {
    /// The photos.
    pub photos: PhotoSet,
    /// A view of every photo, in the same order.
    pub posed: PosedViews,
}

impl PosedPhotos {
    /// Adds a photo that was taken from a place.
    pub fn push(&mut self, photo: Photo, cam_from_world: RigidTransform) {
        let (idx, camera) = (self.photos.photos.len(), photo.intrinsics);
        let view = posed_view(idx, &photo.file_name, camera, cam_from_world);
        self.posed.views.push(view);
        self.photos.photos.push(photo);
    }
}

/// Where a photo was taken, without its pixels.
pub fn posed_view(
    photo: usize,
    file_name: &str,
    intrinsics: Intrinsics,
    cam_from_world: RigidTransform,
) -> PosedView {
    PosedView {
        photo: PhotoIdx(photo),
        name: stem(file_name).to_owned(),
        file_name: file_name.to_owned(),
        intrinsics,
        cam_from_world,
    }
}

/// A camera at `center` that looks at `target`, its columns across `up`.
pub fn look_at(center: Point3<f64>, target: Point3<f64>, up: Vector3<f64>) -> RigidTransform {
    let forward = (target - center).normalize();
    let right = forward.cross(&up).normalize();
    let axes = [right, forward.cross(&right), forward];
    RigidTransform::from_world_pose(Rotation3::from_basis_unchecked(&axes), center)
}

/// Light of three channels: the same harmonics, a little less of them in green and blue.
pub fn tinted_light(harmonics: [f64; 9]) -> Lighting {
    let channel = |tint| SphericalHarmonics(harmonics.map(|l| tint * l));
    Lighting {
        channels: [1.0, 0.9, 0.8].map(channel).to_vec(),
    }
}

/// A reference sphere that nobody has looked for yet.
pub fn true_sphere(center_in_world: [f64; 3], radius: f64) -> LocatedSphere {
    LocatedSphere {
        name: MarkedSphere::ONLY.to_owned(),
        center_in_world,
        radius,
        center_sigma: [0.0; 3],
        seen_in: Vec::new(),
    }
}

/// Depth and normal (camera frame) where a pixel's ray enters a sphere, whose centre is given in the
/// camera frame.
pub fn on_sphere(
    center: &Vector3<f64>,
    radius: f64,
    camera: &Intrinsics,
    [x, y]: [f64; 2],
) -> Option<(f64, Vector3<f64>)> {
    let ray = camera.ray(&Point2::new(x, y));
    let (a, b) = (ray.norm_squared(), ray.dot(center));
    let root = b * b - a * (center.norm_squared() - radius * radius);
    (root > 0.0).then(|| {
        let depth = (b - root.sqrt()) / a;
        (depth, (ray * depth - center) / radius)
    })
}

/// Depth and normals of every pixel that meets a surface, and which do.
#[derive(Clone, Debug, PartialEq)]
pub struct Maps {
    /// Depth, 0 elsewhere.
    pub depth: DepthMap,
    /// Normals, camera frame; zero elsewhere.
    pub normal: NormalMap,
    /// Where the surface is.
    pub mask: Mask,
}

impl Maps {
    /// What `surface` tells of every pixel: depth and normal.
    pub fn of(
        camera: &Intrinsics,
        surface: impl Fn([f64; 2]) -> Option<(f64, Vector3<f64>)>,
    ) -> Self {
        let (width, height) = (camera.width, camera.height);
        let seen = Raster::from_fn(width, height, |x, y| surface([x as f64, y as f64]));
        Self {
            depth: map(&seen, |hit| hit.map_or(0.0, |(depth, _)| depth as f32)),
            normal: map(&seen, |hit| {
                hit.map_or([0.0; 3], |(_, n)| n.map(|c| c as f32).into())
            }),
            mask: map(&seen, |hit| hit.is_some()),
        }
    }

    /// The maps as if stage 5 had found them.
    pub fn shaded(self, view: usize, name: &str) -> ShadedView {
        ShadedView {
            view: ViewIdx(view),
            name: name.to_owned(),
            depth: self.depth,
            normal: self.normal,
            confidence: None,
            rendered: None,
            albedo: None,
        }
    }
}

fn map<T: Copy, U>(raster: &Raster<T>, value: impl Fn(T) -> U) -> Raster<U> {
    Raster {
        width: raster.width,
        height: raster.height,
        data: raster.data.iter().map(|&v| value(v)).collect(),
    }
}

/// A photo of a background in which pixels are painted where `colour` knows one.
pub fn painted<const CHANNELS: usize>(
    camera: &Intrinsics,
    background: f32,
    colour: impl Fn([f64; 2]) -> Option<[f64; CHANNELS]>,
) -> LinearImage {
    let mut image = LinearImage::filled(camera.width, camera.height, CHANNELS, background);
    for y in 0..camera.height {
        for x in 0..camera.width {
            if let Some(colour) = colour([x as f64, y as f64]) {
                for (value, channel) in image.pixel_mut(x, y).iter_mut().zip(colour) {
                    *value = channel as f32;
                }
            }
        }
    }
    image
}

/// Anchors on a grid of every view's pixels, seen by all views that see the surface there: the depth
/// of a map times the next of `factors`, and the surface is seen where the logarithm of the depth is
/// at most `tolerance` off.
pub fn anchors_on_grid(
    posed: &PosedViews,
    depths: &[DepthMap],
    step: usize,
    tolerance: f64,
    mut factors: impl FnMut() -> f64,
) -> Vec<Anchor> {
    let mut anchors = Vec::new();
    for (view, depth) in posed.views.iter().zip(depths) {
        for y in (0..depth.height).step_by(step) {
            for x in (0..depth.width).step_by(step) {
                let z = f64::from(*depth.at(x, y));
                if z <= 0.0 {
                    continue;
                }
                let pixel = Point2::new(x as f64, y as f64);
                let in_camera = view.intrinsics.unproject(&pixel, z * factors());
                let point = view.cam_from_world.inverse().apply(&in_camera);
                let seen = posed.views.iter().zip(depths).enumerate();
                let observations: Vec<AnchorObservation> = seen
                    .filter_map(|(idx, (view, depth))| {
                        let in_camera = view.cam_from_world.apply(&point);
                        let at = view.intrinsics.project(&in_camera)?;
                        let there = depth.get(at.x.round() as isize, at.y.round() as isize)?;
                        let off = (f64::from(*there) / in_camera.z).ln().abs();
                        (off < tolerance).then_some(AnchorObservation {
                            view: ViewIdx(idx),
                            pixel: at.into(),
                            depth: in_camera.z,
                            sigma_ln_depth: 1e-3,
                        })
                    })
                    .collect();
                if observations.len() >= 2 {
                    anchors.push(Anchor {
                        position: point.into(),
                        covariance: [1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8],
                        origin: AnchorOrigin::Grown,
                        observations,
                    });
                }
            }
        }
    }
    anchors
}
