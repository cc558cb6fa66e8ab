//! Options of stage 1.

use rilievo_scene::{OptionError, RetiredKey, check_ranges, in_range};
use serde::{Deserialize, Serialize};

/// How the samples of a photo relate to light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// By the file's format and metadata, photo by photo (see the table in [`crate::encoding`]).
    #[default]
    Auto,
    /// The sRGB curve, whatever the file says.
    Srgb,
    /// Proportional to light, whatever the file says.
    Linear,
}

/// Keys that the table `[photos]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[];

/// Options of stage 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PhotosOptions {
    /// How samples relate to light. Taking sRGB for linear bends every slope; taking linear for
    /// sRGB the other way.
    pub encoding: Encoding,
    /// Focal length in 35 mm equivalents, mm, for photos without a camera file; overrules EXIF.
    /// Absent: what EXIF says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_35mm: Option<f64>,
    /// Focal length of a camera of which nothing is known, over the longer side of the image.
    /// It is refined with the poses; a start that is off by more than half may fail there.
    pub focal_guess_factor: f64,
    /// Stored value, over white, at and above which a channel counts as clipped. Too small loses
    /// bright pixels, too large takes clipped ones for measurements.
    pub clip_fraction: f64,
    /// Fewest pixels on a side of a usable photo.
    pub min_side_px: usize,
    /// Fewest object pixels of a usable mask.
    pub min_mask_px: usize,
    /// Share of the frame's border that a mask must mark, besides missing the middle, to be taken
    /// for inverted. Too small refuses objects that the frame cuts, too large misses inversions.
    pub inverted_border_share: f64,
    /// Clipped share of the object (or of the frame without mask) from which the user is warned.
    pub clipped_warning_share: f64,
    /// Spread of exposure between photos, in EV, from which the user is warned and the photos are
    /// brought to one exposure.
    pub exposure_warning_ev: f64,
    /// Whether photos are brought to one exposure by what EXIF says of time, aperture and
    /// sensitivity, where every photo tells them. Switch it off where EXIF is wrong: a grey filter, an
    /// aperture set at the lens, levels evened out while developing.
    pub normalize_exposure: bool,
    /// Spread of the photos' median levels, in EV, beyond which photos whose EXIF does not tell
    /// their exposure are refused: automatic exposure of that size leaves no light to solve for.
    /// Walking around an object under one light changes its level by one or two. Larger forces it.
    pub max_level_spread_ev: f64,
}

impl Default for PhotosOptions {
    fn default() -> Self {
        Self {
            encoding: Encoding::Auto,
            focal_35mm: None,
            focal_guess_factor: 1.2,
            // One step below white in 8 bits: JPEG rings around clipped areas by about that much.
            clip_fraction: 254.0 / 255.0,
            min_side_px: 32,
            min_mask_px: 64,
            inverted_border_share: 0.75,
            clipped_warning_share: 0.02,
            exposure_warning_ev: 0.1,
            normalize_exposure: true,
            max_level_spread_ev: 5.0,
        }
    }
}

impl PhotosOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range("focal_35mm", self.focal_35mm.unwrap_or(35.0), 1.0..=1e4)?;
        check_ranges!(
            self;
            focal_guess_factor in 0.1..=100.0,
            clip_fraction in 0.1..=1.0,
            min_side_px in 2..=1_000_000,
            min_mask_px in 1..=1_000_000_000,
            inverted_border_share in 0.1..=1.0,
            clipped_warning_share in 0.0..=1.0,
            exposure_warning_ev in 0.0..=100.0,
            max_level_spread_ev in 0.0..=1000.0,
        )
    }
}
