//! A model with the numbers of its files: pixel centres at halves.

use crate::cameras::lens::LensModel;
use rilievo_scene::RigidTransform;

/// A camera model that can be converted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraModel {
    /// Its name in text files.
    pub name: &'static str,
    /// How many of its parameters are focal lengths.
    pub num_focals: usize,
    /// How many parameters it has.
    pub num_params: usize,
    /// What the parameters behind the principal point are the first of.
    pub lens: LensModel,
}

impl CameraModel {
    /// fx fy cx cy
    pub const PINHOLE: Self = Self::new("PINHOLE", 2, 4);
    /// fx fy cx cy k1 k2 p1 p2
    pub const OPENCV: Self = Self::new("OPENCV", 2, 8);
    /// fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
    pub const FULL_OPENCV: Self = Self::new("FULL_OPENCV", 2, 12);

    /// fx fy cx cy k1 k2 k3 k4
    pub const OPENCV_FISHEYE: Self = Self::new("OPENCV_FISHEYE", 2, 8).bent(LensModel::Fisheye);
    /// fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1
    pub const THIN_PRISM_FISHEYE: Self =
        Self::new("THIN_PRISM_FISHEYE", 2, 12).bent(LensModel::ThinPrismFisheye);

    /// Those that begin with SIMPLE or RADIAL have f in the place of fx fy, and k, or k1 k2, behind cy.
    const ALL: [Self; 12] = [
        Self::PINHOLE,
        Self::OPENCV,
        Self::FULL_OPENCV,
        Self::OPENCV_FISHEYE,
        Self::THIN_PRISM_FISHEYE,
        Self::new("SIMPLE_RADIAL_FISHEYE", 1, 4).bent(LensModel::Fisheye),
        Self::new("RADIAL_FISHEYE", 1, 5).bent(LensModel::Fisheye),
        Self::new("SIMPLE_FISHEYE", 1, 3).bent(LensModel::Fisheye),
        Self::new("FISHEYE", 2, 4).bent(LensModel::Fisheye),
        Self::new("SIMPLE_PINHOLE", 1, 3),
        Self::new("SIMPLE_RADIAL", 1, 4),
        Self::new("RADIAL", 1, 5),
    ];

    /// Every model that COLMAP knows, by its number in binary files.
    const NAMES: &str = "SIMPLE_PINHOLE PINHOLE SIMPLE_RADIAL RADIAL OPENCV OPENCV_FISHEYE \
        FULL_OPENCV FOV SIMPLE_RADIAL_FISHEYE RADIAL_FISHEYE THIN_PRISM_FISHEYE \
        RAD_TAN_THIN_PRISM_FISHEYE SIMPLE_DIVISION DIVISION SIMPLE_FISHEYE FISHEYE \
        EQUIRECTANGULAR EUCM";

    const fn new(name: &'static str, num_focals: usize, num_params: usize) -> Self {
        Self {
            name,
            num_focals,
            num_params,
            lens: LensModel::OpenCv,
        }
    }

    const fn bent(self, lens: LensModel) -> Self {
        Self { lens, ..self }
    }

    /// The model of a name; the reason where it cannot be converted.
    pub(super) fn from_name(name: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|model| model.name == name);
        known.ok_or_else(|| {
            format!(
                "the camera model {name} is not supported; undistort the images with COLMAP, or \
                 use OPENCV"
            )
        })
    }

    /// The model of a number in a binary file.
    pub(super) fn from_number(number: u32) -> Result<Self, String> {
        match Self::NAMES.split(' ').nth(number as usize) {
            Some(name) => Self::from_name(name),
            None => Err(format!("the camera model number {number} is unknown")),
        }
    }

    /// Its number in a binary file.
    pub(super) fn number(self) -> u32 {
        let before = Self::NAMES.split(' ').take_while(|name| *name != self.name);
        before.count() as u32
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
