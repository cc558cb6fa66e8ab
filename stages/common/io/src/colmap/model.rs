//! A model with the numbers of its files: pixel centres at halves.

use rilievo_scene::RigidTransform;

/// The camera models that can be converted, by their numbers in binary files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraModel {
    /// f cx cy
    SimplePinhole = 0,
    /// fx fy cx cy
    Pinhole = 1,
    /// f cx cy k
    SimpleRadial = 2,
    /// f cx cy k1 k2
    Radial = 3,
    /// fx fy cx cy k1 k2 p1 p2
    Opencv = 4,
    /// fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
    FullOpencv = 6,
}

/// Every model that COLMAP knows, by its number in binary files.
const NAMES: [&str; 18] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EQUIRECTANGULAR",
    "EUCM",
];

impl CameraModel {
    const ALL: [Self; 6] = [
        Self::SimplePinhole,
        Self::Pinhole,
        Self::SimpleRadial,
        Self::Radial,
        Self::Opencv,
        Self::FullOpencv,
    ];

    /// The model of a name.
    ///
    /// # Errors
    /// The reason, with the name.
    pub fn from_name(name: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|model| model.name() == name);
        known.ok_or_else(|| {
            format!(
                "the camera model {name} is not supported; undistort the images with COLMAP, or \
                 use OPENCV"
            )
        })
    }

    /// The model of a number in a binary file.
    pub(super) fn from_number(number: i32) -> Result<Self, String> {
        match usize::try_from(number).ok().and_then(|i| NAMES.get(i)) {
            Some(name) => Self::from_name(name),
            None => Err(format!("the camera model number {number} is unknown")),
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        NAMES[self as usize]
    }

    /// How many of its parameters are focal lengths.
    pub(super) fn num_focals(self) -> usize {
        match self {
            Self::SimplePinhole | Self::SimpleRadial | Self::Radial => 1,
            Self::Pinhole | Self::Opencv | Self::FullOpencv => 2,
        }
    }

    /// How many parameters it has.
    pub fn num_params(self) -> usize {
        match self {
            Self::SimplePinhole => 3,
            Self::Pinhole | Self::SimpleRadial => 4,
            Self::Radial => 5,
            Self::Opencv => 8,
            Self::FullOpencv => 12,
        }
    }
}

/// A camera.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapCamera {
    /// Its number.
    pub id: u32,
    /// Its model.
    pub model: CameraModel,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Parameters, principal point with its half pixel.
    pub params: Vec<f64>,
}

/// A posed image.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// Its number.
    pub id: u32,
    /// Pose.
    pub cam_from_world: RigidTransform,
    /// Number of its camera.
    pub camera_id: u32,
    /// File name, perhaps with folders.
    pub name: String,
    /// Observed pixels, with their half pixel, and the points that they see.
    pub points2d: Vec<([f64; 2], Option<u64>)>,
}

/// A sparse point.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapPoint {
    /// Its number.
    pub id: u64,
    /// Position in the world frame.
    pub position: [f64; 3],
    /// Colour.
    pub color: [u8; 3],
    /// Mean reprojection error, pixels.
    pub error_px: f64,
    /// Images that see it: number, and place in their list of observed pixels.
    pub track: Vec<(u32, u32)>,
}

/// A model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColmapModel {
    /// Cameras.
    pub cameras: Vec<ColmapCamera>,
    /// Images.
    pub images: Vec<ColmapImage>,
    /// Points.
    pub points: Vec<ColmapPoint>,
}
