//! Options of the anchors.

use rilievo_scene::{OptionError, check_ranges};
use serde::{Deserialize, Serialize};

/// Options of the anchors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AnchorOptions {
    /// Distance between neighbouring anchors of a view, pixels of the photo (of its reduction,
    /// where it has more than 4 megapixels); more where a view would get more than about 6000.
    /// Smaller takes longer and gives more anchors, whose errors correlate; larger is faster.
    pub spacing_px: f64,
}

impl Default for AnchorOptions {
    fn default() -> Self {
        Self { spacing_px: 8.0 }
    }
}

impl AnchorOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        check_ranges!(self; spacing_px in 2.0..=64.0)
    }
}
