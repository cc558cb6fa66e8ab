//! The spheres of a file in a set of photos: marks become those of photos, in pixels as stored.

use super::file::{SphereFile, SphereFileCalibration, SphereFileEntry};
use crate::cameras::{last_part, stem};
use crate::error::IoError;
use nalgebra::Point3;
use rilievo_scene::{
    LinearImage, MarkedSphere, Orientation, Photo, PhotoIdx, PhotoSet, SphereCalibration,
    SphereMark, SphereRequest, Unit,
};

/// What a sphere file asks for in a set of photos.
#[derive(Clone, Debug, Default)]
pub struct SpheresInSet {
    /// The spheres, marked in the frame of the pixels as stored.
    pub request: SphereRequest,
    /// Photos that the file names and the set lacks.
    pub absent: Vec<String>,
    /// Photos whose marks were drawn over the photo as EXIF turns it, and were turned back.
    pub upright: Vec<String>,
    /// Whether that is undecided, since the marks fit either way: they were taken as they are.
    pub may_be_upright: bool,
}

/// A name, and what it is without folder and without ending: either may be meant.
fn meant(name: &str) -> [&str; 3] {
    [name, last_part(name), stem(name)]
}

/// A photo of the set by its name with or without ending or folder.
fn find_photo(photos: &PhotoSet, name: &str) -> Option<PhotoIdx> {
    meant(name).iter().find_map(|name| photos.find(name))
}

/// Whether a mark's name, with or without ending or folder, is that of a file name and its stem.
pub fn is_mark_of(name: &str, file_name: &str, stem: &str) -> bool {
    let mut meant = meant(name).into_iter();
    meant.any(|name| name == file_name || name == stem)
}

impl SphereFile {
    /// Whether the marks were drawn over photos as EXIF turns them: some fit their photos only so,
    /// and none only in the frame of the pixels as stored. What draws marks turns all photos or
    /// none. `None` where photos are turned and the marks fit either way.
    fn is_upright(&self, photos: &PhotoSet) -> Option<bool> {
        let marks = self.spheres.iter().flat_map(|sphere| &sphere.views);
        let (mut only_stored, mut only_upright, mut either) = (0, 0, 0);
        for (name, mark) in marks {
            let Some(photo) = find_photo(photos, name) else {
                continue;
            };
            let Photo {
                intrinsics,
                orientation,
                ..
            } = &photos.photos[photo.0];
            if *orientation == Orientation::UPRIGHT {
                continue;
            }
            let stored = (intrinsics.width, intrinsics.height);
            let fits = [stored, orientation.upright_size(stored)]
                .map(|(width, height)| check_frame(mark, width, height).is_ok());
            match fits {
                [true, false] => only_stored += 1,
                [false, true] => only_upright += 1,
                _ => either += 1,
            }
        }
        // One among many is a slip of the pen, and refused.
        if only_stored == 0 && 8 * only_upright > either {
            Some(true)
        } else if only_stored == 0 && either > 0 {
            None
        } else {
            Some(false)
        }
    }

    /// The request for a set of photos; `calibration_images` are the calibration photos, linear, in
    /// the file's order. The set may be a part of what the file describes. Marks are in pixels as
    /// stored, or all of them upright; those of calibration photos are in pixels as stored.
    ///
    /// # Errors
    /// When a calibration photo names a photo that the set lacks, its image is missing, or a mask
    /// has not its photo's size.
    pub fn to_request(
        &self,
        photos: &PhotoSet,
        calibration_images: Vec<LinearImage>,
    ) -> Result<SpheresInSet, IoError> {
        let is_upright = self.is_upright(photos);
        let mut in_set = SpheresInSet {
            may_be_upright: is_upright.is_none(),
            ..SpheresInSet::default()
        };
        in_set.request.light = self.light;
        in_set.request.is_unitless = self.unit == Unit::Arbitrary;
        for entry in &self.spheres {
            let sphere = self.marked(entry, photos, is_upright == Some(true), &mut in_set)?;
            in_set.request.spheres.push(sphere);
        }
        let (num, num_read) = (self.calibration.len(), calibration_images.len());
        if num_read != num {
            let reason = format!("names {num} calibration photos, of which {num_read} were read");
            return Err(IoError::input(&self.path, reason));
        }
        for (i, (entry, image)) in self.calibration.iter().zip(calibration_images).enumerate() {
            let calibration = calibration(entry, image, photos).map_err(|reason| {
                IoError::input(&self.path, format!("calibration[{i}]{reason}"))
            })?;
            in_set.request.calibration.push(calibration);
        }
        Ok(in_set)
    }

    /// A sphere with its marks in the set's photos, turned back where they were drawn upright.
    fn marked(
        &self,
        entry: &SphereFileEntry,
        photos: &PhotoSet,
        is_upright: bool,
        in_set: &mut SpheresInSet,
    ) -> Result<MarkedSphere, IoError> {
        let mut sphere = MarkedSphere {
            name: entry.name.clone(),
            radius: entry.radius,
            marks: Vec::new(),
            center_in_world: entry.center.map(Point3::from),
        };
        for (name, mark) in &entry.views {
            let Some(idx) = find_photo(photos, name) else {
                if !in_set.absent.contains(name) {
                    in_set.absent.push(name.clone());
                }
                continue;
            };
            let photo = &photos.photos[idx.0];
            let stored = (photo.intrinsics.width, photo.intrinsics.height);
            let mark = if is_upright && photo.orientation != Orientation::UPRIGHT {
                if !in_set.upright.contains(&photo.file_name) {
                    in_set.upright.push(photo.file_name.clone());
                }
                photo.orientation.mark_to_stored(mark, stored)
            } else {
                mark.clone()
            };
            check_frame(&mark, stored.0, stored.1).map_err(|reason| {
                IoError::input(&self.path, format!("{}views.{name}: {reason}", entry.key))
            })?;
            sphere.marks.push((idx, mark));
        }
        sphere.marks.sort_by_key(|(photo, _)| *photo);
        Ok(sphere)
    }
}

/// A calibration photo of a set; the reason, with its key, where it is none.
fn calibration(
    entry: &SphereFileCalibration,
    image: LinearImage,
    photos: &PhotoSet,
) -> Result<SphereCalibration, String> {
    let same = &entry.same_camera_as;
    let photo = find_photo(photos, same)
        .ok_or_else(|| format!(".same_camera_as: \"{same}\" is none of the photos"))?;
    let camera = &photos.photos[photo.0].intrinsics;
    let (width, height) = (image.width, image.height);
    if (width, height) != (camera.width, camera.height) {
        return Err(format!(
            ".image: {width} x {height} pixels, but {same} has {} x {}",
            camera.width, camera.height
        ));
    }
    if let Some(mark) = &entry.mark {
        check_frame(mark, width, height).map_err(|reason| format!(": {reason}"))?;
    }
    Ok(SphereCalibration {
        image,
        name: last_part(&entry.image.to_string_lossy()).to_owned(),
        same_camera_as: photo,
        radius: entry.radius,
        mark: entry.mark.clone(),
    })
}

/// Whether a mark is of a photo of this size: a mask has its size, any other reaches into it.
fn check_frame(mark: &SphereMark, width: usize, height: usize) -> Result<(), String> {
    let reaches = |x: [f64; 2], y: [f64; 2]| {
        x[1] >= -0.5 && x[0] <= width as f64 - 0.5 && y[1] >= -0.5 && y[0] <= height as f64 - 0.5
    };
    let around = |c: &[f64; 2], r: f64| reaches([c[0] - r, c[0] + r], [c[1] - r, c[1] + r]);
    let inside = match mark {
        SphereMark::Mask(mask) if (mask.width, mask.height) != (width, height) => {
            return Err(format!(
                "the sphere's mask has {} x {} pixels, the photo {width} x {height}",
                mask.width, mask.height
            ));
        }
        SphereMark::Mask(_) => true,
        SphereMark::Circle {
            center_px,
            radius_px,
        } => around(center_px, *radius_px),
        SphereMark::Ellipse {
            center_px,
            semi_axes_px: [a, b],
            ..
        } => around(center_px, a.max(*b)),
        SphereMark::Points(points) => points.iter().any(|&[x, y]| reaches([x, x], [y, y])),
    };
    if inside {
        Ok(())
    } else {
        Err(format!(
            "the mark lies outside the photo, which has {width} x {height} pixels"
        ))
    }
}
