//! Options of stage 3.

use crate::anchors::options::AnchorOptions;
use crate::known_distance::KnownDistance;
use rilievo_photometry::sphere::SphereOptions;
use rilievo_scene::{InTable, OptionError, RetiredKey, in_range};
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
pub const RETIRED_KEYS: &[RetiredKey] = &[];

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
    /// Smallest angle between two rays of a triangulated point, degrees.
    pub min_triangulation_angle_deg: f64,
    /// Median triangulation angle that the first pair should have, degrees. Where no pair has it, the
    /// model begins with a narrower one, down to twice the smallest angle of a point, and a warning
    /// tells what that costs depth.
    pub min_initial_angle_deg: f64,
    /// Points that a photo must see to be registered.
    pub min_num_visible_points: usize,
    /// Least inliers of the first pair.
    pub min_num_initial_inliers: usize,
    /// A distance measured in the scene, which makes the world metric.
    pub known_distance: Option<KnownDistance>,
    /// How the reference sphere is found and located.
    pub sphere: SphereOptions,
    /// Bytes that the photos worked on at once may take; a few photos' where nothing is said. Changes no result.
    #[serde(skip)]
    pub memory: Option<u64>,
    /// Whether matches alone are used: the photos' pixels neither refine the tracks nor give anchors. For photo sets
    /// without pixels.
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
            min_triangulation_angle_deg: 1.5,
            min_initial_angle_deg: 8.0,
            min_num_visible_points: 15,
            min_num_initial_inliers: 30,
            known_distance: None,
            sphere: SphereOptions::default(),
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
        in_range(
            "min_triangulation_angle_deg",
            self.min_triangulation_angle_deg,
            0.001..=90.0,
        )?;
        in_range(
            "min_initial_angle_deg",
            self.min_initial_angle_deg,
            0.001..=90.0,
        )?;
        in_range(
            "min_num_visible_points",
            self.min_num_visible_points,
            6..=1_000_000,
        )?;
        in_range(
            "min_num_initial_inliers",
            self.min_num_initial_inliers,
            6..=1_000_000,
        )?;
        if let Some(known) = &self.known_distance {
            known.validate().in_table("known_distance")?;
        }
        self.sphere.validate().in_table("sphere")?;
        self.anchors.validate().in_table("anchors")
    }
}
