//! Options of stage 4.

use rilievo_scene::{LightKind, OptionError, RetiredKey, in_range};
use serde::{Deserialize, Serialize};

/// What the object's own brightness at the depth anchors may do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectLight {
    /// Replaces the light of a sphere beside the object where it predicts left-out anchors
    /// clearly better, and scales the light to the object's albedo.
    #[default]
    Correct,
    /// Not looked at.
    Off,
}

/// How the lighting is found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightingOptions {
    /// What the light is fixed to where it is fitted on the program's own shape; absent, the
    /// anchors' brightness decides.
    pub own_shape_light: Option<LightKind>,
    /// Whether the object's own anchors may correct the light of a sphere.
    pub object_light: ObjectLight,
    /// Fewest usable pixels of a sphere that make a view count. Spheres in small photos need less;
    /// fewer pixels leave more of the light's second order open.
    pub min_num_pixels: usize,
}

impl Default for LightingOptions {
    fn default() -> Self {
        Self {
            own_shape_light: None,
            object_light: ObjectLight::Correct,
            min_num_pixels: 150,
        }
    }
}

impl LightingOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range("min_num_pixels", self.min_num_pixels, 9..=1_000_000_000)
    }
}

const fn fixed(path: &'static [&'static str], instead: &'static str) -> RetiredKey {
    RetiredKey { path, instead }
}

/// Keys that the table `[lighting]` had once, with what to do instead: see [`RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[
    fixed(
        &["fit"],
        "the fit of the harmonics is fixed as it was by default",
    ),
    fixed(
        &["sphere"],
        "calibration spheres are found as by default; `poses.sphere` serves for others",
    ),
    fixed(&["margin_px"], "it is fixed at 2 px"),
    fixed(&["min_cos_view"], "it is fixed at 0.12"),
    fixed(
        &["clip_share"],
        "it is fixed at 0.97; `photos.clip_fraction` sets the clip level",
    ),
    fixed(
        &["gains"],
        "gains are found, and applied where they differ by more than their uncertainty",
    ),
    fixed(
        &["max_num_samples"],
        "it is fixed at 20 000: more changed nothing but the time",
    ),
    fixed(&["max_slope"], "it is fixed at 8"),
    fixed(&["advice_ratio"], "it is fixed at 1.4"),
    fixed(&["agreement_ratio"], "it is fixed at 1.4"),
];
