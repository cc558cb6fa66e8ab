//! Output of stage 3: posed views, sparse points, depth anchors, scale and the located sphere.

use crate::camera::Intrinsics;
use crate::ids::{PhotoIdx, ViewIdx};
use crate::sphere::LocatedSphere;
use crate::transform::RigidTransform;
use serde::{Deserialize, Serialize};

/// Unit of the world frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Metres.
    Metre,
    /// Unknown scale.
    #[default]
    Arbitrary,
}

impl Unit {
    /// Name, as in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Metre => "metre",
            Self::Arbitrary => "arbitrary",
        }
    }
}

/// What fixed the scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScaleSource {
    /// Nothing: the first baseline is 1.
    #[default]
    Gauge,
    /// The reference sphere's known radius.
    Sphere,
    /// Poses given by the user.
    GivenPoses,
    /// A known distance between two cameras or two marked points.
    KnownDistance,
}

/// Scale of the world frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    /// Unit of every length in the world frame.
    pub unit: Unit,
    /// Where it comes from.
    pub source: ScaleSource,
    /// Relative standard deviation of the scale, where it is known.
    pub relative_sigma: Option<f64>,
}

/// Where the world's axes lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldFrame {
    /// The first posed camera's axes: x right, y down, z forward.
    #[default]
    FirstCamera,
    /// Those of the poses that were given.
    Given,
    /// z upwards from the ground that the object stands on, the origin on it under the object's
    /// middle, the cameras or the first of them on the side of -y.
    Level,
}

impl WorldFrame {
    /// What a file of a run in this frame says of it.
    pub fn of_file(self) -> String {
        format!("world of cameras.json, {}", self.words())
    }

    /// In words, for who opens a file in this frame.
    pub fn words(self) -> &'static str {
        match self {
            Self::FirstCamera => "first camera: x right, y down, z forward",
            Self::Given => "that of the given cameras",
            Self::Level => "level: z up, origin on the ground under the object, front towards -y",
        }
    }
}

/// What coordinates in the world mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorldCoordinates {
    /// Unit of every length.
    pub unit: Unit,
    /// Where the axes lie.
    pub frame: WorldFrame,
}

/// In the frame of cameras that are given.
impl From<Unit> for WorldCoordinates {
    fn from(unit: Unit) -> Self {
        let frame = WorldFrame::Given;
        Self { unit, frame }
    }
}

impl PosedViews {
    /// What coordinates in the world mean.
    pub fn coordinates(&self) -> WorldCoordinates {
        WorldCoordinates {
            unit: self.scale.unit,
            frame: self.frame,
        }
    }
}

/// A photo with a pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosedView {
    /// Its photo.
    pub photo: PhotoIdx,
    /// The photo's name without ending.
    pub name: String,
    /// The photo's file name.
    pub file_name: String,
    /// Camera, as given or as refined.
    pub intrinsics: Intrinsics,
    /// Pose.
    pub cam_from_world: RigidTransform,
}

/// A photo without a pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unregistered {
    /// The photo.
    pub photo: PhotoIdx,
    /// Its file name.
    pub file_name: String,
    /// Why it has no pose, and what to try.
    pub reason: String,
}

/// One sighting of a sparse point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackElement {
    /// The view.
    pub view: ViewIdx,
    /// Index of the keypoint in the view's photo.
    pub keypoint_idx: u32,
    /// Observed pixel.
    pub pixel: [f64; 2],
}

/// A triangulated track.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SparsePoint {
    /// Position in the world frame.
    pub position: [f64; 3],
    /// Display colour, sRGB.
    pub color: [u8; 3],
    /// Mean reprojection error, pixels.
    pub error_px: f64,
    /// Sightings, at least two.
    pub track: Vec<TrackElement>,
}

/// How an anchor was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnchorOrigin {
    /// Matched along epipolar lines and refined by patch alignment.
    Guided,
    /// Grown from a neighbouring anchor and refined by patch alignment.
    Grown,
}

/// A view's share of an anchor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnchorObservation {
    /// The view.
    pub view: ViewIdx,
    /// Where it sees the anchor, pixels.
    pub pixel: [f64; 2],
    /// Depth of the anchor in this view, world's unit.
    pub depth: f64,
    /// Standard deviation of the logarithm of that depth.
    pub sigma_ln_depth: f64,
}

/// A surface point whose depth the photos determine without shading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Anchor {
    /// Position in the world frame.
    pub position: [f64; 3],
    /// Covariance of the position (xx, xy, xz, yy, yz, zz), world's unit squared.
    pub covariance: [f64; 6],
    /// How it was found.
    pub origin: AnchorOrigin,
    /// Views that see it, at least two.
    pub observations: Vec<AnchorObservation>,
}

/// Posed views with everything that hangs on the poses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PosedViews {
    /// Views, ordered by photo.
    pub views: Vec<PosedView>,
    /// Photos that got no pose.
    pub unregistered: Vec<Unregistered>,
    /// Sparse points.
    pub points: Vec<SparsePoint>,
    /// Depth anchors on the object.
    pub anchors: Vec<Anchor>,
    /// Unit and origin of the scale.
    pub scale: Scale,
    /// Where the axes lie.
    #[serde(default)]
    pub frame: WorldFrame,
    /// The reference spheres that were located.
    pub spheres: Vec<LocatedSphere>,
    /// Why none of the reference spheres that were asked for was located.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_sphere: Option<String>,
}
