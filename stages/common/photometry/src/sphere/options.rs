//! Options of the sphere's geometry and detection.

use rilievo_scene::{OptionError, check_ranges};
use serde::{Deserialize, Serialize};

/// How outlines are fitted and the sphere is located.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SphereOptions {
    /// Outline points farther than this from a cone are not of it, pixels. Marks by hand are good
    /// to about a pixel; larger lets an occluder's edge in.
    pub inlier_px: f64,
    /// Share of a mark's outline that must lie on one cone; below it the mark is no disc.
    pub min_inlier_share: f64,
    /// Systematic uncertainty of an outline, pixels: where the edge of a matte sphere is seen
    /// depends on blur, gamma and background, alike along the whole outline and in all photos. It enters the
    /// standard deviations of centre and scale.
    pub outline_bias_px: f64,
    /// Relative standard deviation of a stated radius, where several spheres are compared: a
    /// calliper reads a tenth of a millimetre. Too small takes its error for a contradiction.
    pub radius_sigma: f64,
    /// Whether marks are refined on the image's edge.
    pub refine: bool,
    /// Half width of the search for the edge across a mark, pixels.
    pub search_px: f64,
    /// A view whose outline misses the common sphere by more than this (RMS) is left out, pixels.
    pub max_view_rms_px: f64,
    /// Search: smallest radius of the outline, as a share of the image's longer side.
    pub min_radius_share: f64,
    /// Search: largest radius of the outline, as a share of the image's longer side.
    pub max_radius_share: f64,
    /// Search: share of the visible outline that must lie on an image edge.
    pub min_edge_support: f64,
    /// Search: largest relative residual of nine harmonics on a candidate's normals.
    pub max_shading_residual: f64,
}

impl Default for SphereOptions {
    fn default() -> Self {
        Self {
            inlier_px: 1.5,
            min_inlier_share: 0.4,
            outline_bias_px: 0.1,
            radius_sigma: 0.003,
            refine: true,
            search_px: 4.0,
            max_view_rms_px: 2.0,
            min_radius_share: 0.015,
            max_radius_share: 0.25,
            min_edge_support: 0.6,
            max_shading_residual: 0.06,
        }
    }
}

impl SphereOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        check_ranges!(
            self;
            inlier_px in 0.01..=100.0,
            min_inlier_share in 0.0..=1.0,
            outline_bias_px in 0.0..=100.0,
            radius_sigma in 0.0..=1.0,
            search_px in 0.1..=200.0,
            max_view_rms_px in 0.01..=1000.0,
            min_radius_share in 0.001..=1.0,
            max_radius_share in self.min_radius_share..=2.0,
            min_edge_support in 0.0..=1.0,
            max_shading_residual in 1e-6..=100.0,
        )
    }
}
