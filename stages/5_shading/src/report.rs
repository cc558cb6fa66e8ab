//! What stage 5 found, as facts.

use crate::paper::PaperReport;
use crate::photo::PhotoReport;
use rilievo_scene::ViewLighting;
use serde::{Deserialize, Serialize};

/// Facts on a run of the stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ShadingReport {
    /// Facts of the paper's model; empty where the photo model was used.
    #[serde(flatten)]
    pub paper: PaperReport,
    /// The light that was used, of every posed view in its camera's frame, gains contained. Where the model
    /// allows for shadow, what falls on a surface in the open, without what ground and spheres send.
    pub light: Vec<ViewLighting>,
    /// Facts of the photo model, where it was used.
    pub photo: Option<PhotoReport>,
}
