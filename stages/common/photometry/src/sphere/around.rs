//! What the photos show around located spheres.
//!
//! An outline is looked for within a few pixels of where it is predicted. A part of the photo around it
//! is all that this takes, with the camera that would have taken the part: the photo's own with the
//! principal point `c − (x₀, y₀)`, `(x₀, y₀)` the part's first pixel.

use super::cone::SphereInCamera;
use super::error::SphereError;
use super::locate::SphereFit;
use super::posed_image::PosedImage;
use rilievo_scene::{Intrinsics, LinearImage, Mask, PackedMask, PhotoSet, PosedView};
use std::sync::Arc;

/// What the photos show around the spheres that outlines located, one list per fit: parts of the
/// photos, each with the camera that would have taken it. One photo at a time is in memory: many
/// large ones take gigabytes.
pub(super) fn load_around(
    photos: &PhotoSet,
    views: &[PosedView],
    fits: &[SphereFit],
    search_px: f64,
) -> Result<Vec<Vec<PosedImage>>, SphereError> {
    let mut around = vec![Vec::new(); fits.len()];
    // A stated centre has no outline to follow.
    if fits.iter().all(|fit| fit.views.is_empty()) {
        return Ok(around);
    }
    for view in views {
        let photo = &photos.photos[view.photo.0];
        let part_of = |fit: &SphereFit| {
            let seen = SphereInCamera::seen(&fit.sphere, &view.cam_from_world);
            let part = part_around(&seen, &view.intrinsics, search_px);
            part.filter(|_| !fit.views.is_empty())
        };
        let parts: Vec<Option<Part>> = fits.iter().map(part_of).collect();
        if parts.iter().all(Option::is_none) {
            continue;
        }
        let image = photo.linear()?;
        for (list, part) in around.iter_mut().zip(parts) {
            let Some(part) = part else { continue };
            list.push(PosedImage {
                photo: view.photo,
                image: Arc::new(part.of_image(&image)),
                intrinsics: part.camera(&view.intrinsics),
                cam_from_world: view.cam_from_world,
                object: photo
                    .mask
                    .as_deref()
                    .map(|mask| Arc::new(part.of_mask(mask))),
                clip_level: photo.clip_level,
            });
        }
    }
    Ok(around)
}

/// Points of an outline that its extent is measured with.
const NUM_EXTENT_POINTS: usize = 64;
/// Room around a sphere for what the fit may still move, in its radius.
const ROOM_IN_RADII: f64 = 0.5;

/// A rectangle of a photo.
struct Part {
    x0: usize,
    y0: usize,
    width: usize,
    height: usize,
}

/// The part of a photo in which a sphere's outline is looked for; `None` outside the frame.
fn part_around(sphere: &SphereInCamera, intrinsics: &Intrinsics, search_px: f64) -> Option<Part> {
    // Samples reach two pixels beyond the search, and interpolation one more.
    let room = ROOM_IN_RADII * sphere.radius_px(intrinsics) + search_px + 3.0;
    let [columns, rows] = sphere.part_of_frame(intrinsics, NUM_EXTENT_POINTS, room)?;
    Some(Part {
        x0: *columns.start(),
        y0: *rows.start(),
        width: columns.count(),
        height: rows.count(),
    })
}

impl Part {
    fn camera(&self, whole: &Intrinsics) -> Intrinsics {
        whole.cropped(self.x0, self.y0, self.width, self.height)
    }

    fn of_image(&self, whole: &LinearImage) -> LinearImage {
        whole.cropped(self.x0, self.y0, self.width, self.height)
    }

    fn of_mask(&self, whole: &PackedMask) -> PackedMask {
        Mask::from_fn(self.width, self.height, |x, y| {
            whole.contains((x + self.x0) as isize, (y + self.y0) as isize)
        })
        .packed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point2, Point3};

    #[test]
    fn a_part_shows_what_the_photo_shows_and_ends_at_its_frame() {
        let whole = Intrinsics::pinhole(200, 150, 180.0, 99.5, 74.5);
        let image = LinearImage {
            width: 200,
            height: 150,
            channels: 1,
            data: (0..200 * 150).map(|k| k as f32).collect(),
        };
        // In the middle, cut by the left edge, and beyond it.
        for (x, inside) in [(0.1, true), (-1.05, true), (-2.0, false)] {
            let sphere = SphereInCamera {
                center: Point3::new(x, 0.05, 2.0),
                radius: 0.2,
            };
            let Some(part) = part_around(&sphere, &whole, 6.0) else {
                assert!(!inside, "sphere at {x}");
                continue;
            };
            assert!(inside, "sphere at {x}");
            let camera = part.camera(&whole);
            let cut = part.of_image(&image);
            assert_eq!((cut.width, cut.height), (camera.width, camera.height));
            for point in sphere.outline(&whole, 24) {
                let (dx, dy) = (part.x0 as f64, part.y0 as f64);
                let moved = Point2::new(point.x - dx, point.y - dy);
                assert!((camera.ray(&moved) - whole.ray(&point)).norm() < 1e-12);
                let shown = |i: &LinearImage, p: &Point2<f64>| i.sample(p.x, p.y, 0);
                assert_eq!(
                    shown(&cut, &moved).is_some(),
                    shown(&image, &point).is_some()
                );
                if let (Some(a), Some(b)) = (shown(&cut, &moved), shown(&image, &point)) {
                    assert!((f64::from(a) - f64::from(b)).abs() < 0.02, "{a} {b}");
                }
            }
        }
    }
}
