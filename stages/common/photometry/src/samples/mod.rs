//! What the photos show of the reference spheres: pixels with known normals.

mod cells;
mod pixels;

use crate::sphere::SphereInCamera;
use rilievo_scene::{LightSample, PhotoSet, PixelError, PosedViews, ViewIdx};

pub use cells::{NUM_CELLS, cell_of, light_samples};
pub use pixels::{CLIP_SHARE, Coverage, Shot, SphereSamples, surface_pixels};

/// What all views show of all posed spheres.
///
/// # Errors
/// When the pixels of a photo cannot be read.
pub fn read_spheres(photos: &PhotoSet, posed: &PosedViews) -> Result<Vec<LightSample>, PixelError> {
    let mut found = Vec::new();
    for (view, camera) in posed.views.iter().enumerate() {
        let photo = &photos.photos[camera.photo.0];
        let spheres = SphereInCamera::all_seen(posed, camera);
        if spheres.is_empty() {
            break;
        }
        let image = photo.linear()?;
        let shot = Shot::new(photo, &image, camera);
        let world_from_cam = camera.cam_from_world.rotation.inverse();
        for (k, sphere) in spheres.iter().enumerate() {
            let samples = shot.samples(sphere, &spheres);
            found.extend(light_samples(
                &samples,
                &world_from_cam,
                ViewIdx(view),
                (Some(k), true),
            ));
        }
    }
    Ok(found)
}
