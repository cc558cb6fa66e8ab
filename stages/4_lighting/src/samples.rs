//! Usable pixels of the sphere in one view.
//!
//! Left out: pixels outside the frame, on the object's mask (the object stands in front of the
//! sphere, or beside it within the outline's blur), within `margin_px` of the outline, at grazing
//! normals, and channels at the clip level.

use crate::LightingOptions;
use nalgebra::Vector3;
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_scene::{Intrinsics, LinearImage, Mask};

/// Pixels of one view's sphere with normals and intensities.
#[derive(Clone, Debug, Default)]
pub(crate) struct SphereSamples {
    /// Normals, camera frame.
    pub normals: Vec<Vector3<f64>>,
    /// Channels of each pixel.
    pub values: Vec<Vec<f64>>,
    /// Which channels are not clipped.
    pub usable: Vec<Vec<bool>>,
    /// Column and row of each pixel.
    pub positions: Vec<(usize, usize)>,
    /// Share of the sphere's pixels that have a clipped channel.
    pub clipped_share: f64,
    /// Share of the disc outside the frame or behind the object.
    pub hidden_share: f64,
    /// Radius of the outline, pixels.
    pub radius_px: f64,
}

impl SphereSamples {
    /// Pixels with at least one usable channel.
    pub fn num_usable(&self) -> usize {
        self.usable.iter().filter(|u| u.contains(&true)).count()
    }
}

/// Collects them.
pub(crate) fn of_sphere(
    image: &LinearImage,
    object: Option<&Mask>,
    clip_level: f32,
    intrinsics: &Intrinsics,
    sphere: &SphereInCamera,
    options: &LightingOptions,
) -> SphereSamples {
    let radius_px = sphere.radius_px(intrinsics);
    let mut samples = SphereSamples {
        radius_px,
        ..SphereSamples::default()
    };
    // A small sphere needs the pixels near its outline, and its edge is as sharp as a large one's.
    let margin = options.margin_px.min((0.05 * radius_px).max(1.2));
    let limit = f64::from(clip_level) * options.clip_share;
    let mut clipped = 0;
    let mut seen = 0;
    for pixel in sphere.pixels(intrinsics, margin) {
        if pixel.cos_view < options.min_cos_view {
            continue;
        }
        let (x, y) = (pixel.x as isize, pixel.y as isize);
        // The mask's own edge is uncertain by a pixel.
        let near_object = object.is_some_and(|mask| {
            (-1..=1).any(|dy| (-1..=1).any(|dx| mask.contains(x + dx, y + dy)))
        });
        if near_object {
            continue;
        }
        seen += 1;
        let values: Vec<f64> = image
            .pixel(pixel.x, pixel.y)
            .iter()
            .map(|&v| f64::from(v))
            .collect();
        let usable: Vec<bool> = values.iter().map(|&v| v.is_finite() && v < limit).collect();
        if usable.contains(&false) {
            clipped += 1;
        }
        samples.normals.push(pixel.normal_in_cam);
        samples.values.push(values);
        samples.usable.push(usable);
        samples.positions.push((pixel.x, pixel.y));
    }
    samples.clipped_share = f64::from(clipped) / f64::from(seen.max(1));
    // The whole disc's pixels inside the margin, as an area: what the frame and the object hide.
    let whole =
        std::f64::consts::PI * (radius_px - margin).powi(2) * (1.0 - options.min_cos_view.powi(2));
    samples.hidden_share = (1.0 - f64::from(seen) / whole).clamp(0.0, 1.0);
    samples
}
