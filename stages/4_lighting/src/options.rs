//! Options of stage 4.

use rilievo_photometry::harmonics::FitOptions;
use rilievo_photometry::samples::SamplingOptions;
use rilievo_photometry::sphere::SphereOptions;
use rilievo_photometry::surface_check::CheckOptions;
use rilievo_scene::{InTable, LightKind, OptionError, RetiredKey, check_ranges};
use serde::{Deserialize, Serialize};

/// Whether the photos' exposures are compared on the sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GainMode {
    /// Found, and applied where they differ by more than their uncertainty.
    #[default]
    Auto,
    /// All photos are taken as equally exposed.
    Off,
    /// Found and applied always.
    Always,
}

/// What the object's own brightness at the depth anchors may do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectLight {
    /// Replaces the light of a sphere beside the object where it predicts left-out anchors
    /// clearly better, and scales the light to the object's albedo.
    #[default]
    Correct,
    /// Compared and reported, nothing is changed.
    Report,
    /// Not looked at.
    Off,
}

/// Keys that the table `[lighting]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[];

/// How the lighting is found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightingOptions {
    /// The robust fit of the harmonics.
    pub fit: FitOptions,
    /// Outlines of calibration spheres.
    pub sphere: SphereOptions,
    /// What the light is fixed to where it is fitted on the program's own shape; absent, the anchors'
    /// brightness tells.
    pub own_shape_light: Option<LightKind>,
    /// Pixels nearer to the sphere's outline than this are left out: they mix with what is behind.
    pub margin_px: f64,
    /// Smallest cosine between normal and viewing direction. Grazing normals change quickly within
    /// a pixel; too large leaves out the sides that tell the light's second order.
    pub min_cos_view: f64,
    /// Pixels brighter than this share of the photo's clip level are left out: compression and
    /// demosaicing spread clipping to neighbours.
    pub clip_share: f64,
    /// Fewest usable pixels that make a view count.
    pub min_num_pixels: usize,
    /// Whether the object's own anchors may correct the light of a sphere.
    pub object_light: ObjectLight,
    /// Exposure and white balance of the photos.
    pub gains: GainMode,
    /// Most pixels of a surface that a fit uses; more change nothing but the time.
    pub max_num_samples: usize,
    /// Depth steps beyond this slope (relative depth per pixel, in units of 1/focal length)
    /// are edges, not surface; no normal is taken across them.
    pub max_slope: f64,
    /// Advice is given where the light explains the surface worse than the best distant light by
    /// this factor, and by 4 % of the brightness at least.
    pub advice_ratio: f64,
    /// Two spheres see one light where the light of one leaves at most this times as much of the other
    /// unexplained as the other's own light does. Larger lets a shadowed sphere count, smaller leaves
    /// good ones out for their uneven paint.
    pub agreement_ratio: f64,
}

impl Default for LightingOptions {
    fn default() -> Self {
        let SamplingOptions {
            margin_px,
            min_cos_view,
            clip_share,
        } = SamplingOptions::default();
        Self {
            fit: FitOptions::default(),
            sphere: SphereOptions::default(),
            own_shape_light: None,
            margin_px,
            min_cos_view,
            clip_share,
            min_num_pixels: 150,
            object_light: ObjectLight::Correct,
            gains: GainMode::Auto,
            max_num_samples: 20_000,
            max_slope: 8.0,
            advice_ratio: 1.4,
            agreement_ratio: 1.4,
        }
    }
}

impl LightingOptions {
    /// How light and surface are compared.
    pub fn check(&self) -> CheckOptions {
        CheckOptions {
            fit: self.fit.clone(),
            clip_share: self.clip_share,
            max_num_samples: self.max_num_samples,
            min_num_pixels: self.min_num_pixels,
            advice_ratio: self.advice_ratio,
        }
    }

    /// Which pixels of a sphere count.
    pub(crate) fn sampling(&self) -> SamplingOptions {
        SamplingOptions {
            margin_px: self.margin_px,
            min_cos_view: self.min_cos_view,
            clip_share: self.clip_share,
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        self.fit.validate().in_table("fit")?;
        self.sphere.validate().in_table("sphere")?;
        check_ranges!(
            self;
            margin_px in 0.0..=1000.0,
            min_cos_view in 0.0..=0.999,
            clip_share in 0.001..=1.0,
            min_num_pixels in 9..=1_000_000_000,
            max_num_samples in 9..=100_000_000,
            max_slope in 0.001..=1e6,
            advice_ratio in 1.0..=1e6,
            agreement_ratio in 1.0..=1e6,
        )
    }
}
