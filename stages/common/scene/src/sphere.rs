//! The reference sphere: what the user says of it, and where it was found.

use crate::ids::PhotoIdx;
use crate::raster::Mask;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// What the light is fixed to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightKind {
    /// Fixed in the world: the camera moves around a resting object. One environment for all views.
    #[default]
    World,
    /// Fixed to the camera (turntable, flash): one lighting per view.
    Camera,
}

/// The sphere's outline in one photo, as the user gave it.
#[derive(Clone, Debug, PartialEq)]
pub enum SphereMark {
    /// All pixels of the sphere.
    Mask(Mask),
    /// Ellipse: centre and semi-axes in pixels, angle of the first axis against x in radians.
    Ellipse {
        /// Centre, pixels.
        center_px: [f64; 2],
        /// Semi-axes, pixels.
        semi_axes_px: [f64; 2],
        /// Angle of the first semi-axis from +x towards +y, radians.
        angle_rad: f64,
    },
    /// Circle: centre and radius in pixels.
    Circle {
        /// Centre, pixels.
        center_px: [f64; 2],
        /// Radius, pixels.
        radius_px: f64,
    },
    /// At least five points on the outline, pixels.
    Points(Vec<[f64; 2]>),
}

/// A photo of a sphere standing in the object's place.
#[derive(Clone, Debug)]
pub struct SphereCalibration {
    /// The calibration photo (not part of the photo set), linear.
    pub image: crate::raster::LinearImage,
    /// Its file name, for messages.
    pub name: String,
    /// The photo of the set taken by the same camera in the same place.
    pub same_camera_as: PhotoIdx,
    /// Radius in the request's unit.
    pub radius: f64,
    /// Outline, or `None` to find it.
    pub mark: Option<SphereMark>,
}

/// A matte sphere beside the object, as the user described it.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkedSphere {
    /// What messages call it: [`MarkedSphere::ONLY`] where there is no other.
    pub name: String,
    /// Radius in metres.
    pub radius: f64,
    /// Marks by photo.
    pub marks: Vec<(PhotoIdx, SphereMark)>,
    /// Centre in the frame of the given cameras.
    pub center_in_world: Option<Point3<f64>>,
}

impl MarkedSphere {
    /// Name of a sphere that has no fellow.
    pub const ONLY: &'static str = "the sphere";

    /// The only sphere, marked in photos.
    pub fn only(radius: f64, marks: Vec<(PhotoIdx, SphereMark)>) -> Self {
        Self {
            name: Self::ONLY.to_owned(),
            radius,
            marks,
            center_in_world: None,
        }
    }
}

/// What is known of the reference spheres before poses are.
#[derive(Clone, Debug, Default)]
pub struct SphereRequest {
    /// The spheres beside the object; none where only calibration photos are given, or where they
    /// are searched for.
    pub spheres: Vec<MarkedSphere>,
    /// Search the photos for all matte spheres of this radius, metres.
    pub search_radius: Option<f64>,
    /// Whether the stated radii are in an unknown unit: they set the size then, and no unit.
    pub is_unitless: bool,
    /// What the light is fixed to, where it is stated; else the spheres show it, and where they
    /// cannot the light is taken to rest.
    pub light: Option<LightKind>,
    /// Photos of a sphere in the object's place.
    pub calibration: Vec<SphereCalibration>,
}

/// A sphere in the world, with the views that see it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocatedSphere {
    /// What messages call it.
    pub name: String,
    /// Centre in the world frame.
    pub center_in_world: [f64; 3],
    /// Radius in the world's unit, as the outlines show it.
    pub radius: f64,
    /// Standard deviation of the centre, world's unit, one per axis.
    pub center_sigma: [f64; 3],
    /// Photos in which the outline was marked or found, with the distance of the predicted
    /// outline from the observed one (RMS, pixels).
    pub seen_in: Vec<(PhotoIdx, f64)>,
}
