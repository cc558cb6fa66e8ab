//! Options of stage 1.

use rilievo_scene::{OptionError, RetiredKey, check_ranges, in_range};
use serde::{Deserialize, Serialize};

/// How the samples of a photo relate to light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// By the file's format and metadata, photo by photo (see the table in `encoding.rs`).
    #[default]
    Auto,
    /// The sRGB curve, whatever the file says.
    Srgb,
    /// Proportional to light, whatever the file says.
    Linear,
}

/// Keys that the table `[photos]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[
    RetiredKey::new(
        &["focal_guess_factor"],
        "it is fixed at 1.2; give a focal length by `photos.focal_35mm` or --cameras",
    ),
    RetiredKey::new(&["min_side_px"], "it is fixed at 32"),
    RetiredKey::new(&["min_mask_px"], "it is fixed at 64"),
    RetiredKey::new(&["inverted_border_share"], "it is fixed at 0.75"),
    RetiredKey::new(&["clipped_warning_share"], "it is fixed at 0.02"),
    RetiredKey::new(
        &["exposure_warning_ev"],
        "it is fixed at 0.1; `photos.normalize_exposure` switches the correction off",
    ),
];

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
    /// Stored value, over white, at and above which a channel counts as clipped. Too small loses
    /// bright pixels, too large takes clipped ones for measurements.
    pub clip_fraction: f64,
    /// Whether photos are brought to one exposure by what EXIF says of time, aperture and
    /// sensitivity, where every photo states them. Switch it off where EXIF is wrong: a grey
    /// filter, an aperture set at the lens, levels evened out while developing.
    pub normalize_exposure: bool,
    /// Spread of the photos' median levels, in EV, beyond which photos whose EXIF does not state
    /// their exposure are refused: automatic exposure of that size leaves no light to solve for.
    /// Walking around an object under one light changes its level by one or two. Larger forces it.
    pub max_level_spread_ev: f64,
}

impl Default for PhotosOptions {
    fn default() -> Self {
        Self {
            encoding: Encoding::Auto,
            focal_35mm: None,
            // One step below white in 8 bits: JPEG rings around clipped areas by about that much.
            clip_fraction: 254.0 / 255.0,
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
            clip_fraction in 0.1..=1.0,
            max_level_spread_ev in 0.0..=1000.0,
        )
    }
}
