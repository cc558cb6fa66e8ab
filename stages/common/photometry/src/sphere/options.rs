//! Options of the sphere's position and detection.

use rilievo_scene::{OptionError, RetiredKey, check_ranges};
use serde::{Deserialize, Serialize};

/// How spheres are located and found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SphereOptions {
    /// Half width of the search for the photo's edge across a marked outline, pixels: how far off a
    /// mark may be. Too small misses the edge of a rough mark, too large finds other edges.
    pub search_px: f64,
    /// Without marks: largest relative residual of nine harmonics on a candidate's normals. Larger
    /// finds dirty spheres, and takes other round things for one.
    pub max_shading_residual: f64,
}

impl Default for SphereOptions {
    fn default() -> Self {
        Self {
            search_px: 4.0,
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
            search_px in 0.1..=200.0,
            max_shading_residual in 1e-6..=100.0,
        )
    }
}

const fn fixed(path: &'static [&'static str], instead: &'static str) -> RetiredKey {
    RetiredKey { path, instead }
}

/// Keys that a table `sphere` had once.
pub const RETIRED_KEYS: &[RetiredKey] = &[
    fixed(&["sphere", "inlier_px"], "it is fixed at 1.5 px"),
    fixed(&["sphere", "min_inlier_share"], "it is fixed at 0.4"),
    fixed(&["sphere", "outline_bias_px"], "it is fixed at 0.1 px"),
    fixed(&["sphere", "radius_sigma"], "it is fixed at 0.003"),
    fixed(
        &["sphere", "refine"],
        "marks are always refined on the photos' edges",
    ),
    fixed(&["sphere", "max_view_rms_px"], "it is fixed at 2 px"),
    fixed(&["sphere", "min_radius_share"], "it is fixed at 0.015"),
    fixed(&["sphere", "max_radius_share"], "it is fixed at 0.25"),
    fixed(&["sphere", "min_edge_support"], "it is fixed at 0.6"),
];
