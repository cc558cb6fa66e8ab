//! Usable pixels of a sphere in one view.
//!
//! Left out: pixels outside the frame, on the object's mask (the object stands in front of the
//! sphere, or beside it within the outline's blur), behind another sphere, within two pixels of the
//! outline, at grazing normals, and channels at the clip level.

use crate::harmonics::Reading;
use crate::sphere::SphereInCamera;
use nalgebra::{Point2, Vector3};
use rilievo_scene::{Intrinsics, LinearImage, NormalMap, PackedMask, Photo, PosedView};

/// Pixels nearer to the sphere's outline than this are left out: they mix with what is behind.
const MARGIN_PX: f64 = 2.0;
/// Smallest cosine between normal and viewing direction. Grazing normals change quickly within a pixel;
/// a larger one leaves out the sides that show the light's second order.
const MIN_COS_VIEW: f64 = 0.12;
/// Pixels brighter than this share of the photo's clip level are left out: compression and demosaicing
/// spread clipping to neighbours.
pub const CLIP_SHARE: f64 = 0.97;

/// Pixels of one view's sphere with normals and intensities.
#[derive(Clone, Debug, Default)]
pub struct SphereSamples {
    /// Each pixel with its normal in the camera frame.
    pub readings: Vec<Reading>,
    /// Column and row of each pixel.
    pub positions: Vec<(usize, usize)>,
    /// How much of the sphere is seen.
    pub coverage: Coverage,
    /// Radius of the outline, pixels.
    pub radius_px: f64,
}

/// How much of the spheres of a view is seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coverage {
    /// Pixels that are seen.
    num_seen: usize,
    /// Those with a clipped channel.
    num_clipped: usize,
    /// Area of the whole discs inside their margins, pixels: what the frame and the object hide
    /// counts.
    whole_px: f64,
}

impl Coverage {
    /// Counts another sphere's.
    pub fn add(&mut self, other: Self) {
        self.num_seen += other.num_seen;
        self.num_clipped += other.num_clipped;
        self.whole_px += other.whole_px;
    }

    /// Share of the spheres' pixels that have a clipped channel.
    pub fn clipped_share(&self) -> f64 {
        self.num_clipped as f64 / self.num_seen.max(1) as f64
    }

    /// Share of the discs outside the frame or behind something.
    pub fn hidden_share(&self) -> f64 {
        if self.whole_px > 0.0 {
            (1.0 - self.num_seen as f64 / self.whole_px).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }
}

impl SphereSamples {
    /// Pixels with at least one usable channel.
    pub fn num_usable(&self) -> usize {
        let readings = self.readings.iter();
        readings.filter(|r| r.usable.contains(&true)).count()
    }
}

/// A photo whose spheres are read.
#[derive(Clone, Copy)]
pub struct Shot<'a> {
    /// Linear pixels.
    pub image: &'a LinearImage,
    /// The object, which stands before the sphere or beside it.
    pub object: Option<&'a PackedMask>,
    /// Value from which a channel is clipped.
    pub clip_level: f32,
    /// Camera.
    pub intrinsics: &'a Intrinsics,
}

impl<'a> Shot<'a> {
    /// A photo of the set with its pixels, by the camera of its view.
    pub fn new(photo: &'a Photo, image: &'a LinearImage, view: &'a PosedView) -> Self {
        Self {
            image,
            object: photo.mask.as_deref(),
            clip_level: photo.clip_level,
            intrinsics: &view.intrinsics,
        }
    }

    /// Samples of a sphere that `others` may hide.
    pub fn samples(&self, sphere: &SphereInCamera, others: &[SphereInCamera]) -> SphereSamples {
        let radius_px = sphere.radius_px(self.intrinsics);
        let mut samples = SphereSamples {
            radius_px,
            ..SphereSamples::default()
        };
        // A small sphere needs the pixels near its outline, and its edge is as sharp as a large one's.
        let margin = MARGIN_PX.min((0.05 * radius_px).max(1.2));
        let limit = f64::from(self.clip_level) * CLIP_SHARE;
        let before = in_front_of(sphere, others, self.intrinsics, margin);
        let seen = &mut samples.coverage;
        for pixel in sphere.pixels(self.intrinsics, margin) {
            if pixel.cos_view < MIN_COS_VIEW {
                continue;
            }
            let (x, y) = (pixel.x as isize, pixel.y as isize);
            // The mask's own edge is uncertain by a pixel.
            let near_object = self.object.is_some_and(|mask| {
                (-1..=1).any(|dy| (-1..=1).any(|dx| mask.contains(x + dx, y + dy)))
            });
            if near_object {
                continue;
            }
            if !before.is_empty() {
                let at = Point2::new(pixel.x as f64, pixel.y as f64);
                let ray = self.intrinsics.ray(&at).normalize();
                if before.iter().any(|s| s.distance_along(&ray).is_some()) {
                    continue;
                }
            }
            seen.num_seen += 1;
            let channels = self.image.pixel(pixel.x, pixel.y);
            let reading = Reading::of_pixel(pixel.normal_in_cam, channels, limit);
            seen.num_clipped += usize::from(!reading.is_whole());
            samples.readings.push(reading);
            samples.positions.push((pixel.x, pixel.y));
        }
        seen.whole_px =
            std::f64::consts::PI * (radius_px - margin).powi(2) * (1.0 - MIN_COS_VIEW.powi(2));
        samples
    }
}

/// The spheres nearer than `sphere`, wider by the margin that blur needs.
fn in_front_of(
    sphere: &SphereInCamera,
    others: &[SphereInCamera],
    intrinsics: &Intrinsics,
    margin_px: f64,
) -> Vec<SphereInCamera> {
    others
        .iter()
        .filter(|other| other.center.coords.norm() < sphere.center.coords.norm())
        .map(|other| SphereInCamera {
            radius: other.radius * (1.0 + margin_px / other.radius_px(intrinsics)),
            ..*other
        })
        .collect()
}

/// Pixels with a normal, at most `max_num` of them, evenly spread.
pub fn surface_pixels(
    image: &LinearImage,
    mask: Option<&PackedMask>,
    normals: &NormalMap,
    max_num: usize,
) -> Vec<(usize, usize, Vector3<f64>)> {
    let mut pixels = Vec::new();
    for y in 0..image.height.min(normals.height) {
        for x in 0..image.width.min(normals.width) {
            if mask.is_some_and(|m| !m.contains(x as isize, y as isize)) {
                continue;
            }
            if let Some(normal) = normals.normal(x, y) {
                pixels.push((x, y, normal));
            }
        }
    }
    // An odd stride: in images of even width the samples do not fall into columns.
    let stride = pixels.len().div_ceil(max_num.max(1)).max(1);
    pixels.into_iter().step_by(stride | 1).collect()
}
