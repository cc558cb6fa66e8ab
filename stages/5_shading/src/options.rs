//! Options of stage 5: the choice between its two models, and the options of each.

use crate::paper::PaperOptions;
use crate::photo::PhotoOptions;
use rilievo_scene::{InTable, OptionError};
use serde::{Deserialize, Serialize};

/// Which model explains the photos.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShadingModel {
    /// Shading with visibility, and the photos' agreement with each other (several posed views).
    #[default]
    Photo,
    /// The paper's model: distant harmonics and depth anchors only.
    Paper,
}

/// Options of [`crate::run`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShadingOptions {
    /// What explains the photos, for several posed views.
    pub model: ShadingModel,
    /// Options of the paper's model, beside `model`.
    #[serde(flatten)]
    pub paper: PaperOptions,
    /// Options of the photo model, in a table of their own.
    pub photo: PhotoOptions,
}

impl ShadingOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        self.paper.validate()?;
        self.photo.validate().in_table("photo")
    }
}
