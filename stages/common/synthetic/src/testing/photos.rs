//! Photos in memory, cameras, light and spheres, as the stages hand them on.

use crate::view::RenderedView;
use nalgebra::{Point3, Rotation3, Vector3};
use rilievo_scene::{
    DecodedPhoto, Event, Flow, FocalSource, InMemoryPixels, Intrinsics, Lighting, LinearImage,
    LocatedSphere, MarkedSphere, Observer, Orientation, Photo, PhotoIdx, PhotoSet, PosedView,
    PosedViews, RigidTransform, Samples, SphericalHarmonics, srgb,
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
        orientation: Orientation::UPRIGHT,
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
        mask: Some(Arc::new(view.object_mask.packed())),
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

/// An observer that asks to stop at once.
pub struct Impatient;

impl Observer for Impatient {
    fn event(&self, _: Event) -> Flow {
        Flow::Stop
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

/// The three colours of light L3 of the paper's table.
pub const PAPER_LIGHT: [[f64; 9]; 3] = [
    [-0.2, -0.2, -1.0, 0.4, 0.1, -0.1, -0.1, -0.1, 0.05],
    [0.0, 0.2, -1.0, 0.3, 0.0, 0.2, 0.1, 0.0, 0.1],
    [0.2, -0.2, -1.0, 0.2, -0.1, 0.0, 0.0, 0.1, 0.0],
];

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
