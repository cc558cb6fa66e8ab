//! Options of the anchors.

use rilievo_scene::{OptionError, in_range};
use serde::{Deserialize, Serialize};

/// How anchors are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnchorMode {
    /// The sparse points on the object, as they are: the sparse case of the paper.
    Sift,
    /// Searched along epipolar lines, then refined by patch alignment.
    Guided,
    /// Grown over the surface from refined seeds.
    #[default]
    Grown,
}

/// Options of the anchors. Lengths in working pixels: those of the photo, unless it has more than
/// `max_working_mpx`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AnchorOptions {
    /// How anchors are found.
    pub mode: AnchorMode,
    /// Standard deviation of a SIFT keypoint coordinate, pixels; used in `sift` mode for points
    /// whose own residuals are too few to tell it.
    pub keypoint_sigma_px: f64,
    /// Smallest angle between two rays of an anchor in `sift` mode, degrees.
    pub min_angle_deg: f64,
    /// Smallest angle between the rays of a patch and a source, degrees: below it a pixel of noise
    /// moves the depth too far. Where the widest rays of most points meet at less than four times
    /// this, a quarter of their angle takes its place.
    pub min_source_angle_deg: f64,
    /// Largest such angle, degrees: beyond it patches look too different.
    pub max_source_angle_deg: f64,
    /// Distance between neighbouring anchors of a view, pixels; more where the object is so large
    /// that a view would get more than about 6000. Smaller gives more anchors whose errors correlate.
    pub spacing_px: f64,
    /// Radius of a patch, pixels; samples are weighed by a Gaussian of 3/7 of it. Smaller follows
    /// curvature, larger averages noise.
    pub patch_radius_px: usize,
    /// Prior deviation of the contrast between views, relative. Larger lets patches of another
    /// texture pass, smaller fails where photos are tone-mapped differently.
    pub gain_sigma: f64,
    /// Smallest zero-mean correlation of a patch with a source.
    pub min_correlation: f64,
    /// Smallest correlation of a patch that others grow from at the start.
    pub seed_correlation: f64,
    /// Largest doubt about an anchor, pixels of disparity: its deviation, made larger by depth edges,
    /// tilt, missing neighbours and few agreeing views. Smaller leaves fewer and better anchors.
    pub max_doubt_px: f64,
    /// Photos with more megapixels are reduced by a whole factor: bounds memory and time.
    pub max_working_mpx: f64,
}

impl Default for AnchorOptions {
    fn default() -> Self {
        Self {
            mode: AnchorMode::Grown,
            keypoint_sigma_px: 0.7,
            min_angle_deg: 2.0,
            min_source_angle_deg: 5.0,
            max_source_angle_deg: 60.0,
            spacing_px: 8.0,
            patch_radius_px: 14,
            gain_sigma: 0.02,
            min_correlation: 0.7,
            seed_correlation: 0.85,
            max_doubt_px: 3.35,
            max_working_mpx: 4.0,
        }
    }
}

impl AnchorOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range("keypoint_sigma_px", self.keypoint_sigma_px, 0.001..=100.0)?;
        in_range("min_angle_deg", self.min_angle_deg, 0.001..=90.0)?;
        in_range(
            "min_source_angle_deg",
            self.min_source_angle_deg,
            0.001..=89.0,
        )?;
        in_range(
            "max_source_angle_deg",
            self.max_source_angle_deg,
            self.min_source_angle_deg..=89.9,
        )?;
        in_range("spacing_px", self.spacing_px, 2.0..=64.0)?;
        in_range("patch_radius_px", self.patch_radius_px, 3..=24)?;
        in_range("gain_sigma", self.gain_sigma, 1e-6..=1e3)?;
        in_range("min_correlation", self.min_correlation, 0.0..=0.9999)?;
        in_range("seed_correlation", self.seed_correlation, 0.0..=0.9999)?;
        in_range("max_doubt_px", self.max_doubt_px, 0.001..=1000.0)?;
        in_range("max_working_mpx", self.max_working_mpx, 0.001..=1e4)
    }
}
