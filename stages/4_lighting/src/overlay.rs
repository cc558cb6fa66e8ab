//! Pictures that show at a glance whether sphere and light are right.
//!
//! Per view, three crops around the sphere side by side: the photo with the fitted outline; the
//! photo with the sphere re-rendered under the light; the photo with the pixels that were left out
//! (magenta: clipped, blue: far from the light, grey: outline's margin, grazing or hidden). The
//! program writes them as pictures; this stage touches no file.

use crate::samples::of_sphere;
use crate::{LightingError, LightingOptions};
use nalgebra::Point3;
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_scene::{LightingCalibration, LinearImage, PhotoSet, PosedViews};

/// The overlay of one view.
#[derive(Clone, Debug)]
pub struct SphereOverlay {
    /// The view's name.
    pub name: String,
    /// Three crops side by side, linear, 3 channels.
    pub picture: LinearImage,
}

/// Frame around the sphere, in radii.
const FRAME: f64 = 1.35;
/// Relative deviation from the light that is shown as far.
const FAR: f64 = 0.1;

/// Overlays of all views whose frame the sphere touches.
///
/// # Errors
/// [`LightingError::Pixels`].
pub fn overlays(
    photos: &PhotoSet,
    posed: &PosedViews,
    calibration: &LightingCalibration,
    options: &LightingOptions,
) -> Result<Vec<SphereOverlay>, LightingError> {
    let Some(sphere) = &posed.sphere else {
        return Ok(Vec::new());
    };
    let mut overlays = Vec::new();
    for (idx, view) in posed.views.iter().enumerate() {
        let in_camera = SphereInCamera {
            center: view
                .cam_from_world
                .apply(&Point3::from(sphere.center_in_world)),
            radius: sphere.radius,
        };
        let Some(at) = view.intrinsics.project(&in_camera.center) else {
            continue;
        };
        let half = FRAME * in_camera.radius_px(&view.intrinsics);
        let photo = &photos.photos[view.photo.0];
        let image = photo.pixels.load()?;
        let range = |center: f64, size: usize| {
            let low = (center - half).floor().max(0.0);
            let high = (center + half).ceil().min(size as f64 - 1.0);
            (high > low + 4.0).then_some((low as usize, high as usize))
        };
        let (Some((x0, x1)), Some((y0, y1))) =
            (range(at.x, image.width), range(at.y, image.height))
        else {
            continue;
        };
        let (width, height) = (x1 - x0 + 1, y1 - y0 + 1);
        let mut picture = LinearImage::filled(3 * width, height, 3, 0.0);
        for y in 0..height {
            for x in 0..width {
                let source = image.pixel(x0 + x, y0 + y);
                let color = [0, 1, 2].map(|c| source[c.min(source.len() - 1)]);
                for part in 0..3 {
                    picture
                        .pixel_mut(part * width + x, y)
                        .copy_from_slice(&color);
                }
            }
        }
        let mut put = |part: usize, x: usize, y: usize, color: [f32; 3]| {
            if (x0..=x1).contains(&x) && (y0..=y1).contains(&y) {
                picture
                    .pixel_mut(part * width + x - x0, y - y0)
                    .copy_from_slice(&color);
            }
        };
        for point in in_camera.outline(&view.intrinsics, 8 * (half as usize).max(10)) {
            let (x, y) = (point.x.round(), point.y.round());
            if x >= 0.0 && y >= 0.0 {
                put(0, x as usize, y as usize, [0.9, 0.05, 0.02]);
            }
        }
        let lighting = calibration.views.iter().find(|light| light.view.0 == idx);
        for pixel in in_camera.pixels(&view.intrinsics, 0.0) {
            if let Some(light) = lighting {
                let value = |c: usize| {
                    let channel =
                        &light.lighting.channels[c.min(light.lighting.channels.len() - 1)];
                    channel.evaluate(&pixel.normal_in_cam).max(0.0) as f32
                };
                put(1, pixel.x, pixel.y, [value(0), value(1), value(2)]);
            }
            put(2, pixel.x, pixel.y, [0.2; 3]);
        }
        let samples = of_sphere(
            &image,
            photo.mask.as_deref(),
            photo.clip_level,
            &view.intrinsics,
            &in_camera,
            options,
        );
        for (k, &(x, y)) in samples.positions.iter().enumerate() {
            let is_far = lighting.is_some_and(|light| {
                let channels = light.lighting.channels.iter().zip(&samples.values[k]);
                channels
                    .map(|(l, v)| (l.evaluate(&samples.normals[k]) - v).abs() / v.max(1e-4))
                    .fold(0.0, f64::max)
                    > FAR
            });
            let source = image.pixel(x, y);
            let color = if samples.usable[k].contains(&false) {
                [0.9, 0.0, 0.6]
            } else if is_far {
                [0.05, 0.1, 0.9]
            } else {
                [0, 1, 2].map(|c| source[c.min(source.len() - 1)])
            };
            put(2, x, y, color);
        }
        overlays.push(SphereOverlay {
            name: view.name.clone(),
            picture,
        });
    }
    Ok(overlays)
}
