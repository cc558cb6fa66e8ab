//! One photo: linear pixels, camera, checked mask, measured facts.

use crate::encoding::{clip_level, linearize};
use crate::error::PhotosError;
use crate::focal::{FirstCamera, first_camera};
use crate::options::PhotosOptions;
use crate::report::PhotoFacts;
use crate::{edges, mask, measures, outline};
use rilievo_scene::{
    DecodedPhoto, FocalSource, InMemoryPixels, Intrinsics, LinearImage, Mask, Orientation,
    PackedMask, PixelSource, RigidTransform, artifact_name,
};
use std::sync::Arc;

/// Largest linear value, white being 1: more than the sun's disc beside a shaded wall. Squares of it still have
/// a sum in single precision.
const MAX_VALUE: f32 = 1e12;

/// Fewest pixels on a side of a usable photo: less holds no object.
const MIN_SIDE_PX: usize = 32;

/// A camera that the user gave for a photo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenCamera {
    /// Intrinsics.
    pub intrinsics: Intrinsics,
    /// Pose, where given.
    pub cam_from_world: Option<RigidTransform>,
}

/// A mask that belongs to a photo.
#[derive(Clone, Debug, PartialEq)]
pub struct GivenMask {
    /// White is object.
    pub mask: Mask,
    /// Whether it may have been drawn over the photo as EXIF turns it. The photo's own alpha channel and masks that the
    /// program made are in the frame of the pixels as stored.
    pub may_be_upright: bool,
}

impl GivenMask {
    /// A mask in the frame of the pixels as stored.
    pub fn as_stored(mask: Mask) -> Self {
        Self {
            mask,
            may_be_upright: false,
        }
    }
}

/// A usable photo.
///
/// To keep a large set out of memory, store the pixels and replace `pixels` by a source that reads
/// them back; the facts are serialisable.
#[derive(Clone, Debug)]
pub struct PreparedPhoto {
    /// Its pixels.
    pub pixels: Arc<dyn PixelSource>,
    /// Its object mask, where the user gave masks.
    pub mask: Option<Arc<PackedMask>>,
    /// Everything else.
    pub facts: PhotoFacts,
}

impl PreparedPhoto {
    /// A photo whose pixels are in memory.
    pub fn in_memory(image: LinearImage, mask: Option<Mask>, facts: PhotoFacts) -> Self {
        Self {
            pixels: Arc::new(InMemoryPixels(Arc::new(image))),
            mask: mask.map(|mask| Arc::new(mask.packed())),
            facts,
        }
    }
}

/// Makes a linear image of a decoded photo and checks everything that is known of it.
///
/// The photo's own alpha channel is not used: pass it as `mask` to make it the object's.
///
/// # Errors
/// Why this photo cannot be used; other photos may be.
pub fn prepare(
    decoded: DecodedPhoto,
    mask: Option<GivenMask>,
    camera: Option<GivenCamera>,
    options: &PhotosOptions,
) -> Result<PreparedPhoto, PhotosError> {
    options.validate()?;
    check_frame(&decoded)?;
    let size = (decoded.width, decoded.height);
    let orientation = decoded
        .exif
        .orientation
        .and_then(Orientation::of_exif)
        .unwrap_or_default();
    let may_be_upright = mask.as_ref().is_some_and(|mask| mask.may_be_upright);
    let mask = mask.map(|given| match may_be_upright {
        true => orientation.mask_by_size(given.mask, size),
        false => (given.mask, false),
    });
    if let Some((mask, _)) = &mask {
        mask::check(&decoded.file_name, size, mask)?;
    }
    let first = match camera {
        Some(given) => given_camera(&decoded, given.intrinsics)?,
        None => first_camera(size.0, size.1, &decoded.exif, options.focal_35mm),
    };

    let (mut image, encoding) = linearize(&decoded, options.encoding);
    let clip_level = clip_level(&decoded, options.encoding, options.clip_fraction);
    let num_invalid_px = zero_invalid(&mut image);
    let blank_value = image.data[0];
    if image.data.iter().all(|&value| value == blank_value) {
        let photo = decoded.file_name;
        return Err(if num_invalid_px == size.0 * size.1 {
            PhotosError::NotFinite { photo }
        } else if blank_value <= 0.0 {
            PhotosError::Black { photo }
        } else if blank_value >= clip_level {
            PhotosError::Overexposed { photo }
        } else {
            PhotosError::Blank {
                photo,
                value: blank_value,
            }
        });
    }

    let beyond = |value: &&f32| value.abs() > MAX_VALUE;
    if let Some(&value) = image.data.iter().find(beyond) {
        let photo = decoded.file_name;
        return Err(PhotosError::Beyond { photo, value });
    }
    let mask = mask.map(|(mask, was_turned)| match may_be_upright && !was_turned {
        true => mask::turned_by_content(mask, &image, orientation),
        false => (mask, was_turned),
    });
    let (mask, mask_was_upright) = mask.map_or((None, false), |(mask, was)| (Some(mask), was));
    let measured = measures::measure(&image, mask.as_ref(), clip_level);
    let facts = PhotoFacts {
        name: artifact_name(&decoded.file_name),
        width: size.0,
        height: size.1,
        channels: decoded.channels,
        bits: decoded.samples.bits(),
        encoding,
        encoding_reason: decoded.encoding_reason,
        intrinsics: first.intrinsics,
        focal_source: first.source,
        focal_note: first.note,
        given_cam_from_world: camera.and_then(|camera| camera.cam_from_world),
        orientation,
        mask_was_upright,
        cut_out: None,
        beyond_pinhole: beyond_pinhole(&first.intrinsics, mask.as_ref()),
        mask_coverage: mask.as_ref().map(Mask::coverage),
        mask_edge_ratio: mask
            .as_ref()
            .and_then(|mask| edges::mask_edge_ratio(&image, mask)),
        mask_outline: mask
            .as_ref()
            .and_then(|mask| outline::measure(&image, mask)),
        clipped_share: measured.clipped_share,
        clipped_share_on_object: measured.clipped_share_on_object,
        clip_level,
        num_invalid_px,
        median_level: measured.median_level,
        noise_sigma: measured.noise_sigma,
        sharpness: measured.sharpness,
        color_ratios: measured.color_ratios,
        black_level: measured.black_level,
        corner_falloff: measured.corner_falloff,
        exif: decoded.exif,
        file_name: decoded.file_name,
    };
    Ok(PreparedPhoto::in_memory(image, mask, facts))
}

/// Steps between the pixels that are looked at for [`beyond_pinhole`].
const LENS_STEP_PX: usize = 8;

/// Share of the object, else of the frame, whose rays a pinhole of the same matrix and size does not show.
fn beyond_pinhole(camera: &Intrinsics, mask: Option<&Mask>) -> f64 {
    if camera.distortion.is_none() {
        return 0.0;
    }
    let (mut num, mut beyond) = (0usize, 0usize);
    for y in (0..camera.height).step_by(LENS_STEP_PX) {
        for x in (0..camera.width).step_by(LENS_STEP_PX) {
            if mask.is_some_and(|mask| !*mask.at(x, y)) {
                continue;
            }
            let bent = [
                (x as f64 - camera.cx) / camera.fx,
                (y as f64 - camera.cy) / camera.fy,
            ];
            let ray = camera.distortion.undistort(bent[0], bent[1]);
            let (u, v) = (camera.fx * ray.0 + camera.cx, camera.fy * ray.1 + camera.cy);
            let inside = u > -0.5 && v > -0.5;
            let inside = inside && u < camera.width as f64 - 0.5 && v < camera.height as f64 - 0.5;
            num += 1;
            beyond += usize::from(!inside);
        }
    }
    beyond as f64 / num.max(1) as f64
}

fn check_frame(decoded: &DecodedPhoto) -> Result<(), PhotosError> {
    let size = (decoded.width, decoded.height);
    if size.0.min(size.1) < MIN_SIDE_PX {
        return Err(PhotosError::TooSmall {
            photo: decoded.file_name.clone(),
            size,
            min: MIN_SIDE_PX,
        });
    }
    let expected = size.0 * size.1 * decoded.channels;
    if decoded.samples.len() != expected || !matches!(decoded.channels, 1 | 3) {
        return Err(PhotosError::Samples {
            photo: decoded.file_name.clone(),
            found: decoded.samples.len(),
            expected,
            size,
            channels: decoded.channels,
        });
    }
    Ok(())
}

fn given_camera(
    decoded: &DecodedPhoto,
    intrinsics: Intrinsics,
) -> Result<FirstCamera, PhotosError> {
    let size = (decoded.width, decoded.height);
    let camera_size = (intrinsics.width, intrinsics.height);
    if camera_size != size {
        return Err(PhotosError::CameraSize {
            photo: decoded.file_name.clone(),
            camera_size,
            size,
        });
    }
    if let Some(focal_px) = intrinsics.implausible_focal_px() {
        let side = intrinsics.longer_side();
        return Err(PhotosError::CameraFocal {
            photo: decoded.file_name.clone(),
            focal_px,
            min_px: Intrinsics::FOCAL_OVER_SIDE.start() * side,
            max_px: Intrinsics::FOCAL_OVER_SIDE.end() * side,
        });
    }
    Ok(FirstCamera {
        intrinsics,
        source: FocalSource::CameraFile,
        note: "camera file".to_owned(),
    })
}

/// Replaces what is not a finite number by zero, which no later step can be hurt by.
fn zero_invalid(image: &mut LinearImage) -> usize {
    let mut num_px = 0;
    for pixel in image.data.chunks_exact_mut(image.channels) {
        if pixel.iter().any(|value| !value.is_finite()) {
            pixel.fill(0.0);
            num_px += 1;
        }
    }
    num_px
}
