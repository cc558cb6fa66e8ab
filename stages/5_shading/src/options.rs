//! Options of stage 5: the choice between its two models, and the options of each.

use crate::paper::PaperOptions;
use crate::photo::PhotoOptions;
use rilievo_scene::{InTable, OptionError, RetiredKey};
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
    /// Options of the paper's model, which `rilievo shade` takes too.
    pub paper: PaperOptions,
    /// Options of the photo model.
    pub photo: PhotoOptions,
}

impl ShadingOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        self.paper.validate().in_table("paper")?;
        self.photo.validate().in_table("photo")
    }
}

const fn fixed(path: &'static [&'static str], instead: &'static str) -> RetiredKey {
    RetiredKey { path, instead }
}

/// Keys that the table `[shading]` had once, with what to do instead: see [`RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[
    fixed(&["splitting"], "use `shading.paper.splitting`"),
    fixed(&["order"], "use `shading.paper.order`"),
    fixed(&["projection"], "use `shading.paper.projection`"),
    fixed(&["start"], "use `shading.paper.start`"),
    fixed(&["schedule"], "it follows from lighting, noise and anchors"),
    fixed(&["loss"], "use `shading.paper.loss`"),
    fixed(&["noise"], "use `shading.paper.noise`"),
    fixed(&["area_weight"], "use `shading.paper.area_weight`"),
    fixed(&["depth_edges"], "use `shading.paper.depth_edges`"),
    fixed(&["shadow_level"], "use `shading.paper.shadow_level`"),
    fixed(
        &["coupling"],
        "matches are always triangulated into anchors",
    ),
    fixed(
        &["match_noise_px"],
        "it is always estimated from the matches' epipolar distances",
    ),
    fixed(
        &["coarse_to_fine"],
        "the full splitting always starts on coarser grids, the paper's never does",
    ),
    fixed(&["max_num_iterations"], "it is fixed at 100"),
    fixed(&["relative_tolerance"], "it is fixed at 1e-3"),
    fixed(&["confidence"], "the map is always computed"),
    fixed(&["photo", "coarse_pixels"], "it is fixed at 90000"),
    fixed(&["photo", "num_sweeps"], "it is fixed at 4"),
    fixed(&["photo", "round_move_px"], "it is fixed at 0.1 px"),
    fixed(&["photo", "round_turn_deg"], "it is fixed at 0.4°"),
    fixed(&["photo", "max_num_rounds"], "it is fixed at 10"),
    fixed(
        &["photo", "num_laps"],
        "use `shading.photo.num_outer_iterations`",
    ),
    fixed(&["photo", "outer_turn_deg"], "it is fixed at 2°"),
    fixed(&["photo", "lap_turn_deg"], "it is fixed at 2°"),
    fixed(&["photo", "max_more_iterations"], "it is fixed at 3"),
    fixed(&["photo", "max_more_laps"], "it is fixed at 3"),
    fixed(&["photo", "num_half_iterations"], "it is fixed at 3"),
    fixed(&["photo", "num_half_laps"], "it is fixed at 3"),
    fixed(&["photo", "noisy_search_px"], "it is fixed at 0.65 px"),
    fixed(
        &["photo", "finer_search"],
        "photos that disagree are always searched at finer levels",
    ),
    fixed(&["photo", "num_rays"], "it is fixed at 256"),
];
