//! Whether what stages hand to each other is sound: sizes, indices and numbers that any consumer
//! relies on.
//!
//! A stage's results may come from a file that was damaged, or that another program wrote. Each
//! stage checks what it is given before it works with it, so that a wrong index is an error and no
//! panic.

use crate::calibration::{LightSample, LightingCalibration};
use crate::camera::Intrinsics;
use crate::events::StageId;
use crate::ids::{PhotoIdx, ViewIdx};
use crate::matches::{FeatureMatches, PhotoKeypoints};
use crate::photos::{Photo, PhotoSet, PixelError};
use crate::poses::{Anchor, PosedViews, SparsePoint};
use crate::raster::LinearImage;
use crate::transform::RigidTransform;
use nalgebra::Vector3;
use std::sync::Arc;

/// Results of a stage that contradict each other.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the results of {made_by} contradict each other: {reason}")]
pub struct Inconsistent {
    /// The stage that made them.
    pub made_by: StageId,
    /// What contradicts what.
    pub reason: String,
}

type Checked = Result<(), Inconsistent>;

/// Collects the first contradiction within one stage's results.
struct Checker(StageId);

impl Checker {
    fn that(&self, holds: bool, reason: impl FnOnce() -> String) -> Checked {
        if holds {
            return Ok(());
        }
        Err(Inconsistent {
            made_by: self.0,
            reason: reason(),
        })
    }

    fn finite<'a>(
        &self,
        values: impl IntoIterator<Item = &'a f64>,
        of: impl FnOnce() -> String,
    ) -> Checked {
        let is_finite = values.into_iter().all(|v| v.is_finite());
        self.that(is_finite, || format!("{} is not finite", of()))
    }

    fn index(&self, index: usize, count: usize, of: impl FnOnce() -> String) -> Checked {
        self.that(index < count, || format!("{} of {count}", of()))
    }

    fn camera(&self, camera: &Intrinsics, name: &str) -> Checked {
        let d = &camera.distortion;
        let Intrinsics { fx, fy, cx, cy, .. } = camera;
        self.that(camera.width > 0 && camera.height > 0, || {
            format!("{name} has no pixels")
        })?;
        let numbers = d.numbers();
        self.finite([fx, fy, cx, cy].into_iter().chain(&numbers), || {
            format!("the camera of {name}")
        })?;
        self.that(*fx > 0.0 && *fy > 0.0, || {
            format!("the focal length of {name} is {fx} and {fy} pixels")
        })
    }

    fn pose(&self, pose: &RigidTransform, name: &str) -> Checked {
        let rotation = pose.rotation.coords;
        self.finite(rotation.iter().chain(&pose.translation), || {
            format!("the pose of {name}")
        })?;
        self.that((rotation.norm() - 1.0).abs() < 1e-6, || {
            format!("the rotation of {name} is none")
        })
    }
}

impl Photo {
    /// The pixels, which have the camera's size.
    ///
    /// # Errors
    /// When they cannot be read, or have another size.
    pub fn linear(&self) -> Result<Arc<LinearImage>, PixelError> {
        let image = self.pixels.load()?;
        let (width, height) = (self.intrinsics.width, self.intrinsics.height);
        let fits = (image.width, image.height) == (width, height)
            && (image.channels == 1 || image.channels == 3)
            && image.data.len() == width * height * image.channels;
        if fits {
            return Ok(image);
        }
        Err(PixelError {
            name: self.file_name.clone(),
            reason: format!(
                "{} x {} pixels of {} channels, its camera has {width} x {height}",
                image.width, image.height, image.channels
            ),
        })
    }
}

impl PhotoSet {
    /// Checks cameras, masks and given poses.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn check(&self) -> Checked {
        let check = Checker(StageId::Photos);
        for photo in &self.photos {
            let name = &photo.file_name;
            check.that(!photo.name.is_empty(), || "a photo has no name".to_owned())?;
            check.camera(&photo.intrinsics, name)?;
            if let Some(mask) = &photo.mask {
                let size = (photo.intrinsics.width, photo.intrinsics.height);
                check.that((mask.width(), mask.height()) == size, || {
                    format!("the mask of {name} has another size")
                })?;
            }
            if let Some(pose) = &photo.given_cam_from_world {
                check.pose(pose, name)?;
            }
        }
        Ok(())
    }
}

/// How far outside the frame a place may lie, as a share of the side: one found between the pixels
/// of a much reduced photo may lie half of such a pixel beyond.
const SLACK: f64 = 0.05;

/// Whether a place lies within the frame, but for the slack.
fn is_inside(pixel: [f64; 2], camera: &Intrinsics) -> bool {
    let inside = |value: f64, size: usize| {
        let slack = SLACK * size as f64 + 1.0;
        (-slack..=size as f64 + slack).contains(&value)
    };
    inside(pixel[0], camera.width) && inside(pixel[1], camera.height)
}

/// Values of a descriptor.
const DESCRIPTOR_LEN: usize = 128;

/// Checks that every keypoint has its descriptor.
///
/// # Errors
/// The first list that has more or fewer.
pub fn check_descriptors(lists: &[PhotoKeypoints], photos: &PhotoSet) -> Checked {
    let mut lists = lists.iter().zip(&photos.photos);
    lists.try_for_each(|(list, photo)| {
        let (values, count) = (list.descriptors.len(), list.keypoints.len());
        Checker(StageId::Features).that(values == DESCRIPTOR_LEN * count, || {
            let name = &photo.file_name;
            format!("{values} values describe {count} keypoints of {name}")
        })
    })
}

/// Checks lists of keypoints against the photos that they are of.
///
/// # Errors
/// The first contradiction.
pub fn check_keypoints(lists: &[PhotoKeypoints], photos: &PhotoSet) -> Checked {
    let check = Checker(StageId::Features);
    let photos = &photos.photos;
    check.that(lists.len() == photos.len(), || {
        format!(
            "{} lists of keypoints for {} photos",
            lists.len(),
            photos.len()
        )
    })?;
    for (list, photo) in lists.iter().zip(photos) {
        let name = &photo.file_name;
        for (k, keypoint) in list.keypoints.iter().enumerate() {
            let place = [f64::from(keypoint.x), f64::from(keypoint.y)];
            check.that(is_inside(place, &photo.intrinsics), || {
                format!("keypoint {k} lies outside {name}")
            })?;
            check.that(
                keypoint.size_px.is_finite() && keypoint.size_px >= 0.0,
                || format!("keypoint {k} of {name} has no size"),
            )?;
        }
    }
    Ok(())
}

impl FeatureMatches {
    /// Checks keypoints and matches against the photos that they are of.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn check(&self, photos: &PhotoSet) -> Checked {
        check_keypoints(&self.photos, photos)?;
        let check = Checker(StageId::Features);
        let photos = &photos.photos;
        for (k, pair) in self.pairs.iter().enumerate() {
            let (first, second) = (pair.first.0, pair.second.0);
            check.that(first < second, || {
                format!("pair {k} joins photo {first} with photo {second}")
            })?;
            check.index(second, photos.len(), || {
                format!("pair {k} has photo {second}")
            })?;
            let numbers = pair.essential.iter().flatten();
            check.finite(numbers.chain([&pair.homography_share]), || {
                format!("the geometry of pair {k}")
            })?;
            for &[i, j] in pair.matches.iter().chain(&pair.standing) {
                for (photo, keypoint) in [(first, i), (second, j)] {
                    let count = self.photos[photo].keypoints.len();
                    check.index(keypoint as usize, count, || {
                        let name = &photos[photo].file_name;
                        format!("a match of pair {k} has in {name} keypoint {keypoint}")
                    })?;
                }
            }
        }
        Ok(())
    }
}

impl PosedViews {
    /// Checks all that hangs on the poses; photos are looked up where a view has one.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn check(&self) -> Checked {
        let check = Checker(StageId::Poses);
        for view in &self.views {
            check.that(!view.name.is_empty(), || "a view has no name".to_owned())?;
            check.camera(&view.intrinsics, &view.file_name)?;
            check.pose(&view.cam_from_world, &view.file_name)?;
        }
        check.finite(&self.scale.relative_sigma, || "the scale".to_owned())?;
        for sphere in &self.spheres {
            let numbers = sphere.center_in_world.iter().chain(&sphere.center_sigma);
            check.finite(numbers, || format!("the place of {}", sphere.name))?;
            check.that(sphere.radius > 0.0 && sphere.radius.is_finite(), || {
                format!("{} has the radius {}", sphere.name, sphere.radius)
            })?;
        }
        self.points
            .iter()
            .enumerate()
            .try_for_each(|(k, point)| self.check_point(&check, k, point))?;
        self.anchors
            .iter()
            .enumerate()
            .try_for_each(|(k, anchor)| self.check_anchor(&check, k, anchor))
    }

    /// The same, and that every view is of a photo of its own in the set, with a camera of its
    /// size.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn check_with(&self, photos: &PhotoSet) -> Checked {
        self.check()?;
        let check = Checker(StageId::Poses);
        let photos = &photos.photos;
        let mut seen = vec![false; photos.len()];
        for view in &self.views {
            let (PhotoIdx(idx), name) = (view.photo, &view.file_name);
            check.index(idx, photos.len(), || format!("{name} is photo {idx}"))?;
            let photo = &photos[idx];
            check.that(photo.name == view.name, || {
                format!("{name} is taken for {}", photo.file_name)
            })?;
            check.that(!std::mem::replace(&mut seen[idx], true), || {
                format!("{name} has two poses")
            })?;
            let size = |camera: &Intrinsics| (camera.width, camera.height);
            check.that(size(&photo.intrinsics) == size(&view.intrinsics), || {
                format!("the camera of {name} has another size than the photo")
            })?;
        }
        let unregistered = self.unregistered.iter().map(|u| u.photo);
        let marked = self.spheres.iter().flat_map(|s| &s.seen_in);
        for PhotoIdx(idx) in unregistered.chain(marked.map(|(photo, _)| *photo)) {
            check.index(idx, photos.len(), || format!("photo {idx} is named"))?;
        }
        Ok(())
    }

    fn check_point(&self, check: &Checker, k: usize, point: &SparsePoint) -> Checked {
        let numbers = point.position.iter().chain([&point.error_px]);
        check.finite(numbers, || format!("point {k}"))?;
        for sighting in &point.track {
            self.check_sighting(check, sighting.view, &sighting.pixel, || {
                format!("point {k}")
            })?;
        }
        Ok(())
    }

    fn check_anchor(&self, check: &Checker, k: usize, anchor: &Anchor) -> Checked {
        let numbers = anchor.position.iter().chain(&anchor.covariance);
        check.finite(numbers, || format!("anchor {k}"))?;
        for seen in &anchor.observations {
            self.check_sighting(check, seen.view, &seen.pixel, || format!("anchor {k}"))?;
            let (depth, sigma) = (seen.depth, seen.sigma_ln_depth);
            let is_measured = depth > 0.0 && sigma >= 0.0 && depth.is_finite() && sigma.is_finite();
            check.that(is_measured, || {
                format!("anchor {k} has the depth {depth} with the deviation {sigma}")
            })?;
        }
        Ok(())
    }

    /// A place in a view, which lies within it but for half a pixel of rounding.
    fn check_sighting(
        &self,
        check: &Checker,
        ViewIdx(view): ViewIdx,
        pixel: &[f64; 2],
        of: impl Fn() -> String,
    ) -> Checked {
        check.index(view, self.views.len(), || {
            format!("{} is seen in view {view}", of())
        })?;
        check.that(is_inside(*pixel, &self.views[view].intrinsics), || {
            let name = &self.views[view].file_name;
            format!("{} lies outside {name}, at {pixel:?}", of())
        })
    }
}

impl LightingCalibration {
    /// Checks the lighting against the views that it is for.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn check(&self, posed: &PosedViews) -> Checked {
        let check = Checker(StageId::Lighting);
        let num_channels = self.views.first().map_or(1, |v| v.lighting.channels.len());
        check.that(num_channels == 1 || num_channels == 3, || {
            format!("the light has {num_channels} channels")
        })?;
        for entry in &self.views {
            let ViewIdx(view) = entry.view;
            check.index(view, posed.views.len(), || format!("light of view {view}"))?;
            let name = &posed.views[view].file_name;
            let rows = entry.lighting.channels.iter().flat_map(|row| &row.0);
            check.finite(rows.chain(&entry.gain).chain(&entry.residual), || {
                format!("the light of {name}")
            })?;
            let channels = entry.lighting.channels.len();
            check.that(channels == num_channels, || {
                format!("the light of {name} has {channels} channels, others have {num_channels}")
            })?;
            let gains = &entry.gain;
            let is_gain = gains.len() == channels && gains.iter().all(|gain| *gain > 0.0);
            check.that(is_gain, || format!("the gain of {name} is {gains:?}"))?;
        }
        let environment = self.environment_in_world.iter();
        let rows = environment.flat_map(|light| light.channels.iter().flat_map(|row| &row.0));
        check.finite(rows, || "the environment".to_owned())?;
        for sphere in &self.spheres {
            let paint = sphere.paint.as_ref();
            let is_paint = |p: &Vec<f64>| {
                p.len() == num_channels && p.iter().all(|ratio| *ratio > 0.0 && ratio.is_finite())
            };
            check.that(paint.is_none_or(is_paint), || {
                format!("the paint of {} is {paint:?}", sphere.name)
            })?;
        }
        for sample in &self.samples {
            let LightSample { view, sphere, .. } = *sample;
            check.index(view.0, posed.views.len(), || {
                format!("a sample of the light in view {}", view.0)
            })?;
            if let Some(sphere) = sphere {
                check.index(sphere, posed.spheres.len(), || {
                    format!("a sample of the light on sphere {sphere}")
                })?;
            }
            let length = Vector3::from(sample.normal_in_world).norm();
            let is_sample = (length - 1.0).abs() < 1e-3
                && sample.intensity.iter().all(|v| v.is_finite() && *v >= 0.0);
            check.that(is_sample, || format!("a sample of the light is {sample:?}"))?;
        }
        let (entries, spheres) = (self.spheres.len(), posed.spheres.len());
        check.that(entries == 0 || entries == spheres, || {
            format!("{entries} spheres have a light and {spheres} a place")
        })
    }
}
