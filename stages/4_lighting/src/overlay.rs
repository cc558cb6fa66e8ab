//! Pictures that show at a glance whether spheres and light are right.
//!
//! Per view and sphere, three crops side by side: the photo with the fitted outline; the photo with
//! the sphere re-rendered under the light, in its own paint; the photo with the pixels that were left out (magenta:
//! clipped, blue: far from the light, grey: outline's margin, grazing or hidden). Several spheres
//! stand below each other. The program writes them as pictures; this stage touches no file.

use crate::environment::scaled;
use crate::error::LightingError;
use rilievo_photometry::samples::Shot;
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_scene::{Lighting, LightingCalibration, LinearImage, PhotoSet, PosedViews};

/// The overlay of one view.
#[derive(Clone, Debug)]
pub struct SphereOverlay {
    /// The view's name.
    pub name: String,
    /// Three crops side by side, a row per sphere, linear, 3 channels.
    pub picture: LinearImage,
}

/// Frame around a sphere, in radii.
const FRAME: f64 = 1.35;
/// Relative deviation from the light that is shown as far.
const FAR: f64 = 0.1;

/// Overlays of all views whose frame a sphere touches.
///
/// # Errors
/// [`LightingError::Pixels`].
pub fn overlays(
    photos: &PhotoSet,
    posed: &PosedViews,
    calibration: &LightingCalibration,
) -> Result<Vec<SphereOverlay>, LightingError> {
    if posed.spheres.is_empty() {
        return Ok(Vec::new());
    }
    photos.check()?;
    posed.check_with(photos)?;
    calibration.check(posed)?;
    let mut overlays = Vec::new();
    for (idx, view) in posed.views.iter().enumerate() {
        let photo = &photos.photos[view.photo.0];
        let image = photo.linear()?;
        let light = calibration.views.iter().find(|light| light.view.0 == idx);
        let shot = Shot::new(photo, &image, view);
        let spheres = SphereInCamera::all_seen(posed, view);
        let rows: Vec<LinearImage> = (0..spheres.len())
            .filter_map(|k| {
                let paint = calibration.spheres.get(k).and_then(|s| s.paint.as_deref());
                let lighting = light.map(|l| painted(&l.lighting, paint));
                crops(&shot, &spheres[k], &spheres, lighting.as_ref())
            })
            .collect();
        if !rows.is_empty() {
            overlays.push(SphereOverlay {
                name: view.name.clone(),
                picture: below_each_other(&rows),
            });
        }
    }
    Ok(overlays)
}

/// The light times a sphere's albedo over the one that the light contains. One that sees another
/// light is shown under this one as it is.
fn painted(lighting: &Lighting, paint: Option<&[f64]>) -> Lighting {
    paint.map_or_else(|| lighting.clone(), |paint| scaled(lighting.clone(), paint))
}

/// Pictures of different widths as one, the rest black.
fn below_each_other(rows: &[LinearImage]) -> LinearImage {
    let width = rows.iter().map(|row| row.width).max().unwrap_or(0);
    let height = rows.iter().map(|row| row.height).sum();
    let mut picture = LinearImage::filled(width, height, 3, 0.0);
    let mut top = 0;
    for row in rows {
        for y in 0..row.height {
            for x in 0..row.width {
                let color = row.pixel(x, y);
                picture.pixel_mut(x, top + y).copy_from_slice(color);
            }
        }
        top += row.height;
    }
    picture
}

/// The three crops of a sphere; `None` where the frame does not show it.
fn crops(
    shot: &Shot,
    sphere: &SphereInCamera,
    spheres: &[SphereInCamera],
    lighting: Option<&Lighting>,
) -> Option<LinearImage> {
    let image = shot.image;
    let at = shot.intrinsics.project(&sphere.center)?;
    let half = FRAME * sphere.radius_px(shot.intrinsics);
    let range = |center: f64, size: usize| {
        let low = (center - half).floor().max(0.0);
        let high = (center + half).ceil().min(size as f64 - 1.0);
        (high > low + 4.0).then_some((low as usize, high as usize))
    };
    let (x0, x1) = range(at.x, image.width)?;
    let (y0, y1) = range(at.y, image.height)?;
    let (width, height) = (x1 - x0 + 1, y1 - y0 + 1);
    let color_of = |x: usize, y: usize| {
        let source = image.pixel(x, y);
        [0, 1, 2].map(|c: usize| source[c.min(source.len() - 1)])
    };
    let mut picture = LinearImage::filled(3 * width, height, 3, 0.0);
    for y in 0..height {
        for x in 0..width {
            let color = color_of(x0 + x, y0 + y);
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
    for point in sphere.outline(shot.intrinsics, 8 * (half as usize).max(10)) {
        let (x, y) = (point.x.round(), point.y.round());
        if x >= 0.0 && y >= 0.0 {
            put(0, x as usize, y as usize, [0.9, 0.05, 0.02]);
        }
    }
    for pixel in sphere.pixels(shot.intrinsics, 0.0) {
        if let Some(light) = lighting {
            let value = |c: usize| {
                let channel = &light.channels[c.min(light.channels.len() - 1)];
                channel.evaluate(&pixel.normal_in_cam).max(0.0) as f32
            };
            put(1, pixel.x, pixel.y, [value(0), value(1), value(2)]);
        }
        put(2, pixel.x, pixel.y, [0.2; 3]);
    }
    let samples = shot.samples(sphere, spheres);
    for (reading, &(x, y)) in samples.readings.iter().zip(&samples.positions) {
        let is_far = lighting.is_some_and(|light| {
            let channels = light.channels.iter().zip(&reading.values);
            channels
                .map(|(l, v)| (l.evaluate(&reading.normal) - v).abs() / v.max(1e-4))
                .fold(0.0, f64::max)
                > FAR
        });
        let color = if !reading.is_whole() {
            [0.9, 0.0, 0.6]
        } else if is_far {
            [0.05, 0.1, 0.9]
        } else {
            color_of(x, y)
        };
        put(2, x, y, color);
    }
    Some(picture)
}
