//! Output of stage 3: posed views, sparse points, depth anchors, scale and the located sphere.

use crate::camera::Intrinsics;
use crate::ids::{PhotoIdx, ViewIdx};
use crate::sphere::LocatedSphere;
use crate::transform::RigidTransform;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// Unit of the world frame. A run works in metres or in arbitrary units; the others are of files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Metres.
    Metre,
    /// Unknown scale.
    #[default]
    Arbitrary,
    /// Millimetres.
    Millimetre,
    /// Centimetres.
    Centimetre,
    /// Inches.
    Inch,
    /// International feet.
    Foot,
}

impl Unit {
    /// All, in the order in which messages name them.
    pub const ALL: [Self; 6] = [
        Self::Metre,
        Self::Centimetre,
        Self::Millimetre,
        Self::Inch,
        Self::Foot,
        Self::Arbitrary,
    ];

    /// Name, as in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Metre => "metre",
            Self::Arbitrary => "arbitrary",
            Self::Millimetre => "millimetre",
            Self::Centimetre => "centimetre",
            Self::Inch => "inch",
            Self::Foot => "foot",
        }
    }

    /// The unit of a name or of a usual short form.
    pub fn of_name(name: &str) -> Option<Self> {
        Some(match name {
            "meter" | "metres" | "meters" | "m" => Self::Metre,
            "millimeter" | "millimetres" | "millimeters" | "mm" => Self::Millimetre,
            "centimeter" | "centimetres" | "centimeters" | "cm" => Self::Centimetre,
            "inches" | "in" => Self::Inch,
            "feet" | "ft" => Self::Foot,
            name => return Self::ALL.into_iter().find(|unit| unit.name() == name),
        })
    }

    /// Its length in metres, where it is one.
    pub fn metres(self) -> Option<f64> {
        Some(match self {
            Self::Metre => 1.0,
            Self::Arbitrary => return None,
            Self::Millimetre => 1e-3,
            Self::Centimetre => 1e-2,
            Self::Inch => 0.0254,
            Self::Foot => 0.3048,
        })
    }

    /// What stands behind a length.
    pub fn words(self) -> &'static str {
        match self {
            Self::Metre => "m",
            Self::Arbitrary => "of the cameras' units",
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Inch => "in",
            Self::Foot => "ft",
        }
    }

    /// A length with its unit: millimetres with `digits` decimals, or two significant decimals of
    /// an unknown unit.
    pub fn length(self, value: f64, digits: usize) -> String {
        match self.metres() {
            Some(metres) => format!("{:.digits$} mm", 1e3 * metres * value),
            None => format!("{value:.2e} {}", self.words()),
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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorldCoordinates {
    /// Unit of every length.
    pub unit: Unit,
    /// Where the axes lie.
    pub frame: WorldFrame,
    /// What is added to local coordinates for those of the world: [`crate::local_offset`].
    pub offset: [f64; 3],
}

impl WorldCoordinates {
    /// The offset, where there is one.
    pub fn offset(&self) -> Option<[f64; 3]> {
        (self.offset != [0.0; 3]).then_some(self.offset)
    }

    /// Lines on unit, frame and offset for a file's comments.
    pub fn comments(&self) -> Vec<String> {
        let mut lines = vec![
            format!("unit {}", self.unit.name()),
            format!("frame {}", self.frame.of_file()),
        ];
        lines.extend(self.offset().map(|[x, y, z]| {
            format!("offset {x} {y} {z} is to be added to coordinates for those of the world")
        }));
        lines
    }
}

/// In the frame of cameras that are given.
impl From<Unit> for WorldCoordinates {
    fn from(unit: Unit) -> Self {
        let frame = WorldFrame::Given;
        let offset = [0.0; 3];
        Self {
            unit,
            frame,
            offset,
        }
    }
}

impl PosedViews {
    /// What coordinates in the world mean.
    pub fn coordinates(&self) -> WorldCoordinates {
        WorldCoordinates {
            unit: self.scale.unit,
            frame: self.frame,
            offset: self.offset,
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

/// Smallest angle between two rays of a triangulated point, degrees: below it a pixel moves the point too far. Views
/// that are no farther apart are of one viewpoint: none of them confirms what another shows.
pub const MIN_TRIANGULATION_ANGLE_DEG: f64 = 1.5;

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
    /// What is added to coordinates here for those of the given cameras, in the unit here:
    /// [`crate::local_offset`].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub offset: [f64; 3],
    /// Unit of the given cameras, where it is another unit of length than that of the world here.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub given_unit: Option<Unit>,
    /// The reference spheres that were located.
    pub spheres: Vec<LocatedSphere>,
    /// Why none of the reference spheres that were asked for was located.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_sphere: Option<String>,
}

fn is_zero(offset: &[f64; 3]) -> bool {
    *offset == [0.0; 3]
}

impl PosedViews {
    /// Of every view the first view of its viewpoint, itself where none before it was taken from there: copies of a
    /// photo, bursts, and frames of a video that hardly moves. The way from view to view is held against the smaller of
    /// the median depths of the points that they see; views without points share a viewpoint only at the very same
    /// place.
    pub fn viewpoints(&self) -> Vec<ViewIdx> {
        let mut depths: Vec<Vec<f64>> = vec![Vec::new(); self.views.len()];
        for point in &self.points {
            for seen in &point.track {
                if let Some(view) = self.views.get(seen.view.0) {
                    let in_camera = view.cam_from_world.apply(&Point3::from(point.position));
                    depths[seen.view.0].push(in_camera.z);
                }
            }
        }
        let median = |depths: &mut Vec<f64>| {
            depths.sort_by(f64::total_cmp);
            depths.get(depths.len() / 2).copied().unwrap_or(0.0)
        };
        let depths: Vec<f64> = depths.iter_mut().map(median).collect();
        let centers = self
            .views
            .iter()
            .map(|v| v.cam_from_world.center_in_source());
        let centers: Vec<Point3<f64>> = centers.collect();
        let widest = MIN_TRIANGULATION_ANGLE_DEG.to_radians().tan();
        let mut first_views: Vec<usize> = Vec::new();
        let of_viewpoint = |view: usize| {
            let is_same = |&&other: &&usize| {
                let apart = (centers[view] - centers[other]).norm();
                apart <= widest * depths[view].min(depths[other])
            };
            let found = first_views.iter().find(is_same).copied();
            let first = found.unwrap_or(view);
            if first == view {
                first_views.push(view);
            }
            ViewIdx(first)
        };
        (0..self.views.len()).map(of_viewpoint).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    /// Views beside each other at these places, metres, that see a point one metre away.
    fn at(places: &[f64]) -> PosedViews {
        let view = |(k, &x): (usize, &f64)| PosedView {
            photo: PhotoIdx(k),
            name: format!("{k}"),
            file_name: format!("{k}.jpg"),
            intrinsics: Intrinsics::pinhole(4, 3, 5.0, 1.5, 1.0),
            cam_from_world: RigidTransform {
                rotation: UnitQuaternion::identity(),
                translation: Vector3::new(-x, 0.0, 0.0),
            },
        };
        let seen = |k: usize| TrackElement {
            view: ViewIdx(k),
            keypoint_idx: 0,
            pixel: [0.0; 2],
        };
        PosedViews {
            views: places.iter().enumerate().map(view).collect(),
            points: vec![SparsePoint {
                position: [0.0, 0.0, 1.0],
                color: [0; 3],
                error_px: 0.0,
                track: (0..places.len()).map(seen).collect(),
            }],
            ..PosedViews::default()
        }
    }

    #[test]
    fn views_from_one_place_are_one_viewpoint() {
        let of = |places: &[f64]| -> Vec<usize> {
            at(places).viewpoints().iter().map(|view| view.0).collect()
        };
        // 1.5 degrees are 26 mm at a metre.
        assert_eq!(of(&[0.0, 0.0, 0.2, 0.22, 0.4]), [0, 0, 2, 2, 4]);
        // A video that moves slowly does move.
        assert_eq!(of(&[0.0, 0.02, 0.04, 0.06, 0.08]), [0, 0, 2, 2, 4]);
        let without_points = PosedViews {
            points: Vec::new(),
            ..at(&[0.0, 0.0, 0.01])
        };
        assert_eq!(
            without_points.viewpoints(),
            [ViewIdx(0), ViewIdx(0), ViewIdx(2)]
        );
    }
}
