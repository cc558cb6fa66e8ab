//! Facts about a run of stage 3.

use crate::anchors::report::AnchorReport;
use crate::vertical::Vertical;
use rilievo_numerics::least_squares::SolveReport;
use rilievo_scene::{Scale, first_and_more};
use serde::{Deserialize, Serialize};

/// One bundle adjustment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdjustmentReport {
    /// What it was for ("global, 5 views").
    pub step: String,
    /// Views with free poses.
    pub num_views: usize,
    /// Points.
    pub num_points: usize,
    /// Observations.
    pub num_observations: usize,
    /// RMS reprojection error per coordinate after it, pixels.
    pub rms_px: f64,
    /// Cost per iteration and why it ended.
    pub solve: SolveReport,
}

/// A posed view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewReport {
    /// The photo's file name.
    pub file_name: String,
    /// Points that it sees.
    pub num_points: usize,
    /// Mean reprojection error, pixels.
    pub mean_error_px: f64,
    /// Standard deviation of the rotation, degrees (largest axis).
    pub rotation_sigma_deg: Option<f64>,
    /// Standard deviation of the centre, world's unit (largest axis).
    pub center_sigma: Option<f64>,
}

/// Radial distortion that given intrinsics do not state, and the poses allow for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LensReport {
    /// `k₁` of each distinct camera, in which the photos were explained best.
    pub k1: Vec<f64>,
    /// Largest displacement that it means at an observation, pixels.
    pub largest_px: f64,
    /// Share by which it lowers the adjustment's cost.
    pub cost_drop: f64,
}

impl LensReport {
    /// What the user should know of it.
    pub fn advice(&self) -> String {
        format!(
            "the photos show up to {:.1} px of radial distortion that the given intrinsics do not \
             state (with it the adjustment's cost falls by {:.0} %); the poses allow for it, the \
             intrinsics stay as given; correct the photos, state the distortion, or set \
             poses.refine_intrinsics = \"all\"",
            self.largest_px,
            100.0 * self.cost_drop
        )
    }
}

/// A focal length that was given, and that the photos contradict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContradictedFocal {
    /// A photo that it was given for.
    pub file_name: String,
    /// The focal length given, pixels.
    pub given_px: f64,
    /// The one that explains the photos best, pixels.
    pub found_px: f64,
}

impl PosesReport {
    /// What the user should know of photos from one place.
    pub(crate) fn same_place_warning(&self) -> Option<String> {
        let pairs = self.same_place.iter();
        let pairs: Vec<String> = pairs
            .map(|(photo, of)| format!("{photo} as {of}"))
            .collect();
        let names = first_and_more(pairs.iter().map(String::as_str))?;
        let num_views = self.views.len();
        Some(format!(
            "{} of {num_views} photos were taken from the same place as another ({names}): together they count as one and \
             confirm nothing; the photos have {} viewpoints",
            pairs.len(),
            num_views - pairs.len()
        ))
    }
}

/// Facts about a run of stage 3.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PosesReport {
    /// File names of the first pair, when poses were found incrementally.
    pub initial_pair: Option<(String, String)>,
    /// Views in the order of the result.
    pub views: Vec<ViewReport>,
    /// Photos that were taken from the place of another before them, with that one: copies, bursts. They confirm
    /// nothing.
    #[serde(default)]
    pub same_place: Vec<(String, String)>,
    /// Sparse points.
    pub num_points: usize,
    /// Mean number of sightings of a point.
    pub mean_track_length: f64,
    /// Mean reprojection error over all sightings, pixels.
    pub mean_reprojection_error_px: f64,
    /// Standard deviation of a refined keypoint coordinate, from the last adjustment, pixels.
    pub keypoint_sigma_px: f64,
    /// Median standard deviation of a sparse point (largest axis), world's unit.
    pub median_point_sigma: Option<f64>,
    /// Photos in models that were smaller than the one kept.
    pub other_model_sizes: Vec<usize>,
    /// Camera groups whose focal length was refined: (group, before, after), pixels.
    pub refined_focals_px: Vec<(usize, f64, f64)>,
    /// Unit and origin of the scale.
    pub scale: Scale,
    /// To be added to coordinates of all reports for those of the given cameras' world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset: Option<[f64; 3]>,
    /// The vertical, where ground or cameras show it.
    pub vertical: Option<Vertical>,
    /// Whether masks show where the object stands.
    #[serde(default)]
    pub knows_object: bool,
    /// Cameras in common with an earlier result, or with those of `--frame-of`, that its frame was taken over by.
    #[serde(default)]
    pub num_frame_cameras: Option<usize>,
    /// Distortion that given intrinsics leave.
    pub lens: Option<LensReport>,
    /// The given focal length, where the photos contradict it.
    #[serde(default)]
    pub contradicted_focal: Option<ContradictedFocal>,
    /// The adjustments that shaped the result.
    pub adjustments: Vec<AdjustmentReport>,
    /// Depth anchors.
    pub anchors: Option<AnchorReport>,
}
