//! Options of stage 3.

use crate::anchors::options::AnchorOptions;
use crate::known_distance::KnownDistance;
use rilievo_scene::{
    InTable, OptionError, RetiredKey, RigidTransform, Unit, WorldCoordinates, in_range,
};
use serde::{Deserialize, Serialize};

/// Which intrinsics the adjustment may change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RefineIntrinsics {
    /// Focal length where it is not from a camera file, and distortion where the photos show it;
    /// what a camera file says stays bit-identical. Where the photos clearly show distortion that
    /// it does not state, the poses allow for it and a warning says so.
    #[default]
    Auto,
    /// Nothing, and poses take the intrinsics as exact.
    None,
    /// Focal length of every camera group.
    Focal,
    /// Focal length, principal point and distortion of every camera group.
    All,
}

/// What to do with poses that the user gave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GivenPoses {
    /// Keep them exactly; only triangulate.
    #[default]
    Keep,
    /// Start from them and adjust.
    Refine,
    /// Ignore them.
    Ignore,
}

/// Keys that the table `[poses]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[
    RetiredKey::new(&["min_triangulation_angle_deg"], "it is fixed at 1.5"),
    RetiredKey::new(
        &["min_initial_angle_deg"],
        "it is fixed at 8; where no pair has it, narrower ones begin",
    ),
    RetiredKey::new(&["min_num_visible_points"], "it is fixed at 15"),
    RetiredKey::new(&["min_num_initial_inliers"], "it is fixed at 30"),
    RetiredKey::new(&["refine_tracks"], "tracks are always refined"),
    RetiredKey::new(
        &["sphere"],
        "its values are fixed; mark the sphere by hand where it is not found",
    ),
    RetiredKey::new(
        &["anchors", "mode"],
        "anchors are always grown; `poses.anchors.spacing_px` makes them fewer",
    ),
    RetiredKey::new(
        &["anchors", "keypoint_sigma_px"],
        "anchors are always grown",
    ),
    RetiredKey::new(&["anchors", "min_angle_deg"], "anchors are always grown"),
    RetiredKey::new(&["anchors", "min_source_angle_deg"], "it is fixed at 5"),
    RetiredKey::new(&["anchors", "max_source_angle_deg"], "it is fixed at 60"),
    RetiredKey::new(&["anchors", "patch_radius_px"], "it is fixed at 14"),
    RetiredKey::new(&["anchors", "gain_sigma"], "it is fixed at 0.02"),
    RetiredKey::new(&["anchors", "min_correlation"], "it is fixed at 0.7"),
    RetiredKey::new(&["anchors", "seed_correlation"], "it is fixed at 0.85"),
    RetiredKey::new(&["anchors", "max_doubt_px"], "it is fixed at 3.35"),
    RetiredKey::new(
        &["anchors", "max_working_mpx"],
        "it is fixed at 4; --memory bounds the memory",
    ),
];

/// A world that the result is to share.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceFrame {
    /// Poses by the photos' file names.
    pub cameras: Vec<(String, RigidTransform)>,
    /// What coordinates of that world mean.
    pub world: WorldCoordinates,
    /// Whether masks showed where the object stands when it was found.
    pub knows_object: bool,
    /// Whether the user asked for it; else it is that of the result before.
    pub is_asked: bool,
}

/// How poses are found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PosesOptions {
    /// Which intrinsics may change.
    pub refine_intrinsics: RefineIntrinsics,
    /// What to do with poses given for all photos.
    pub given_poses: GivenPoses,
    /// Largest reprojection error of an observation, pixels; smaller loses true tracks on large
    /// photos, larger lets wrong ones bend the poses.
    pub max_reprojection_error_px: f64,
    /// A distance measured in the scene, which makes the world metric.
    pub known_distance: Option<KnownDistance>,
    /// What coordinates of the given poses mean.
    #[serde(skip)]
    pub given_world: WorldCoordinates,
    /// A world that the result is to share, where its cameras agree.
    #[serde(skip)]
    pub reference: Option<ReferenceFrame>,
    /// Bytes that the photos worked on at once may take; a few photos' where nothing is said. Changes no result.
    #[serde(skip)]
    pub memory: Option<u64>,
    /// Whether matches alone are used: the photos' pixels neither refine the tracks nor give
    /// anchors. For photo sets without pixels.
    #[serde(skip)]
    pub matches_only: bool,
    /// Seed of all random samples.
    pub seed: u64,
    /// How depth anchors are found.
    pub anchors: AnchorOptions,
}

impl Default for PosesOptions {
    fn default() -> Self {
        Self {
            refine_intrinsics: RefineIntrinsics::Auto,
            given_poses: GivenPoses::Keep,
            max_reprojection_error_px: 3.0,
            known_distance: None,
            given_world: Unit::Arbitrary.into(),
            reference: None,
            memory: None,
            matches_only: false,
            seed: 1,
            anchors: AnchorOptions::default(),
        }
    }
}

impl PosesOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range(
            "max_reprojection_error_px",
            self.max_reprojection_error_px,
            0.01..=1000.0,
        )?;
        if let Some(known) = &self.known_distance {
            known.validate().in_table("known_distance")?;
        }
        self.anchors.validate().in_table("anchors")
    }
}
