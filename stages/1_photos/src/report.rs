//! Facts of the preflight: what the photos are, before anything is computed from them.

use crate::outline::MaskOutline;
use rilievo_scene::{ExifFacts, FocalSource, Intrinsics, Orientation, RigidTransform};
use serde::{Deserialize, Serialize};

/// What becomes of the surroundings of an object that was cut out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CutOut {
    /// What they leave is the mask.
    Taken,
    /// The object is as black or white itself along its outline: they are not used.
    Unsure,
}

/// Which curve was undone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AppliedEncoding {
    /// None: samples were proportional to light.
    Linear,
    /// The sRGB curve.
    Srgb,
    /// The tone curve of the embedded colour profile.
    Profile,
}

/// Everything but the pixels of a usable photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoFacts {
    /// File name with its ending.
    pub file_name: String,
    /// File name without its ending.
    pub name: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 1 or 3.
    pub channels: usize,
    /// Bits of a stored sample.
    pub bits: u32,
    /// Which curve was undone.
    pub encoding: AppliedEncoding,
    /// Why.
    pub encoding_reason: String,
    /// Camera before poses.
    pub intrinsics: Intrinsics,
    /// Where its focal length came from.
    pub focal_source: FocalSource,
    /// How it was computed, in words.
    pub focal_note: String,
    /// Pose given by the user.
    pub given_cam_from_world: Option<RigidTransform>,
    /// How EXIF turns it for display, 1 to 8; pixels, mask and camera are as stored.
    pub orientation: Orientation,
    /// Whether the mask was given upright, as EXIF turns the photo, and was turned back.
    #[serde(default)]
    pub mask_was_upright: bool,
    /// What became of surroundings that are exactly black or white, where no mask was given.
    #[serde(default)]
    pub cut_out: Option<CutOut>,
    /// Share of the object, else of the frame, that the photo straightened to a pinhole of its focal length and size does
    /// not show.
    #[serde(default)]
    pub beyond_pinhole: f64,
    /// Share of the frame that the mask marks, where there is a mask.
    pub mask_coverage: Option<f64>,
    /// How much stronger brightness changes along the mask's border than along the same border shifted,
    /// at the shift where it does most; below 1 the border lies on no edge of the photo. Absent
    /// without mask, or where nothing changes.
    pub mask_edge_ratio: Option<f64>,
    /// Where most of the mask's border lies against the object's outline. Absent without mask or clear outline.
    #[serde(default)]
    pub mask_outline: Option<MaskOutline>,
    /// Share of pixels with a clipped channel, over the whole frame.
    pub clipped_share: f64,
    /// The same over the mask.
    pub clipped_share_on_object: Option<f64>,
    /// Linear value at and above which a channel counts as clipped.
    pub clip_level: f32,
    /// Pixels that were not a number or infinite, and were set to zero.
    pub num_invalid_px: usize,
    /// Median linear grey value over the mask, or over the frame.
    pub median_level: f64,
    /// Standard deviation of the noise, linear, from the finest differences.
    pub noise_sigma: f64,
    /// Sharpness: root mean square of the finest second differences over the median level.
    /// Comparable only between photos of one object at one size.
    pub sharpness: f64,
    /// Red over green and blue over green, over the mask or the frame, of unclipped pixels.
    pub color_ratios: Option<[f64; 2]>,
    /// Darkest thousandth of the frame, linear.
    pub black_level: f64,
    /// Brightness of the corners over that of the sides' middles that the lens alone would cause, as
    /// far as one photo shows; hints at vignetting over a whole set.
    pub corner_falloff: f64,
    /// What EXIF says.
    pub exif: ExifFacts,
}

/// A photo that cannot be used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RejectedPhoto {
    /// The file.
    pub file: String,
    /// Why, and what to try.
    pub reason: String,
}

/// Photos that share their intrinsics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraGroup {
    /// Body, lens, zoom and size in words.
    pub description: String,
    /// File names.
    pub photos: Vec<String>,
}

/// The preflight of a set.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotosReport {
    /// Usable photos, in the set's order.
    pub photos: Vec<PhotoFacts>,
    /// Photos that could not be used (filled in by whoever read the files).
    pub rejected: Vec<RejectedPhoto>,
    /// Groups of photos with shared intrinsics, by their number.
    pub camera_groups: Vec<CameraGroup>,
    /// Photos with a mask.
    pub num_masks: usize,
    /// Mean share of the frame that masks mark.
    pub mean_mask_coverage: Option<f64>,
    /// Largest over smallest exposure by EXIF, in EV; absent unless every photo states its own.
    pub exposure_spread_ev: Option<f64>,
    /// Factor that brings every photo, in their order, to one exposure; empty where none was applied.
    #[serde(default)]
    pub exposure_gains: Vec<f64>,
    /// Largest over smallest median level over the masks (or frames), with those factors, in EV.
    pub level_spread_ev: f64,
    /// Largest over smallest ratio of colours over the masks (or frames), of both ratios the worse;
    /// absent unless all photos have colours.
    pub white_balance_spread: Option<f64>,
    /// Median over the photos of the lens' fall-off.
    pub corner_falloff: f64,
}
