//! Scale from a distance that was measured in the scene.
//!
//! Between two camera centres `|C_a − C_b|`, or between two points that are marked in two photos or
//! more and triangulated. One unit of the world is `D / d` metres, where `D` was measured and `d` is
//! the distance in the world; `(σ_s / s)² = (σ_D / D)² + (σ_d / d)²`, where `σ_d` follows from the
//! centres' or the marks' covariance along the line between them.

use crate::error::PosesError;
use crate::projection::{CenteredPose, project_with_jacobian};
use crate::report::PosesReport;
use crate::triangulation::{Sighting, TriangulationLimits, triangulate};
use nalgebra::{Matrix3, Point2, Point3};
use rilievo_scene::{InTable, OptionError, PosedViews, fulfils, in_range};
use serde::{Deserialize, Serialize};

/// Standard deviation of a mark set by hand, pixels.
const MARK_SIGMA_PX: f64 = 1.0;
/// A mark farther from the others' point than this is another point, pixels.
const MAX_MARK_ERROR_PX: f64 = 10.0;
/// Rays that are more nearly parallel give no distance, radians (1°).
const MIN_MARK_ANGLE_RAD: f64 = 0.0175;

/// The two points in one photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkedPoints {
    /// File name of the photo, with or without ending.
    pub image: String,
    /// First point, pixels.
    pub first: [f64; 2],
    /// Second point, pixels.
    pub second: [f64; 2],
}

/// A distance that was measured, between two cameras or two marked points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownDistance {
    /// The distance, metres.
    pub metres: f64,
    /// Its standard deviation, metres.
    #[serde(default)]
    pub sigma_metres: f64,
    /// File names of the two photos between whose camera centres it was measured.
    #[serde(default)]
    pub cameras: Option<[String; 2]>,
    /// Or the two points between which it was measured, in two photos or more.
    #[serde(default)]
    pub marks: Vec<MarkedPoints>,
}

impl KnownDistance {
    /// Checks what can be checked without poses.
    ///
    /// # Errors
    /// When a number is out of its range, or not one of cameras and marks is given.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range("metres", self.metres, 1e-6..=1e6)?;
        in_range("sigma_metres", self.sigma_metres, 0.0..=self.metres)?;
        for mark in &self.marks {
            for (key, coordinates) in [("first", mark.first), ("second", mark.second)] {
                for coordinate in coordinates {
                    in_range(key, coordinate, -1e6..=1e6).in_table("marks")?;
                }
            }
        }
        let (fits, expected) = match self.cameras {
            Some(_) => (self.marks.is_empty(), "be left out where cameras are named"),
            None => (self.marks.len() >= 2, "stand in two photos or more"),
        };
        fulfils("marks", &self.marks, fits, || expected)
    }

    /// Metres per unit of the world, and its relative standard deviation.
    ///
    /// # Errors
    /// When a named photo has no pose, or the marks do not meet in a point.
    pub fn metres_per_unit(
        &self,
        posed: &PosedViews,
        report: &PosesReport,
    ) -> Result<(f64, f64), PosesError> {
        let (distance, sigma) = match &self.cameras {
            Some(names) => between_cameras(names, posed, report)?,
            None => between_marks(&self.marks, posed)?,
        };
        if distance <= 3.0 * sigma {
            let unit = posed.scale.unit.words();
            return Err(unusable(format!(
                "the two ends are {distance:.4} {unit} apart in the model, with a standard deviation of \
                 {sigma:.4}; measure a longer distance"
            )));
        }
        let relative = (self.sigma_metres / self.metres).hypot(sigma / distance);
        Ok((self.metres / distance, relative))
    }
}

fn unusable(reason: String) -> PosesError {
    PosesError::KnownDistance { reason }
}

/// Index of the view of a photo named with or without its ending.
fn view_of(name: &str, posed: &PosedViews) -> Result<usize, PosesError> {
    posed
        .views
        .iter()
        .position(|v| v.file_name == name || v.name == name)
        .ok_or_else(|| {
            let why = posed
                .unregistered
                .iter()
                .find(|u| u.file_name == name)
                .map_or("no photo has this name".to_owned(), |u| u.reason.clone());
            unusable(format!("{name} has no pose ({why})"))
        })
}

fn between_cameras(
    names: &[String; 2],
    posed: &PosedViews,
    report: &PosesReport,
) -> Result<(f64, f64), PosesError> {
    let (a, b) = (view_of(&names[0], posed)?, view_of(&names[1], posed)?);
    let center = |k: usize| posed.views[k].cam_from_world.center_in_source();
    let sigma = |k: usize| report.views[k].center_sigma.unwrap_or(0.0);
    Ok(((center(a) - center(b)).norm(), sigma(a).hypot(sigma(b))))
}

fn between_marks(marks: &[MarkedPoints], posed: &PosedViews) -> Result<(f64, f64), PosesError> {
    let views = marks
        .iter()
        .map(|mark| view_of(&mark.image, posed))
        .collect::<Result<Vec<_>, _>>()?;
    let poses: Vec<CenteredPose> = views
        .iter()
        .map(|&k| CenteredPose::from(posed.views[k].cam_from_world))
        .collect();
    let end = |pixel: &dyn Fn(&MarkedPoints) -> [f64; 2], which: &str| {
        let sightings: Vec<Sighting<'_>> = marks
            .iter()
            .zip(views.iter().zip(&poses))
            .map(|(mark, (&view, pose))| Sighting {
                camera: &posed.views[view].intrinsics,
                pose,
                pixel: Point2::from(pixel(mark)),
            })
            .collect();
        let limits = TriangulationLimits {
            max_error_px: MAX_MARK_ERROR_PX,
            min_angle_rad: MIN_MARK_ANGLE_RAD,
        };
        match triangulate(&sightings, &limits) {
            Some((point, support)) if support.len() == sightings.len() => {
                let covariance = covariance(&sightings, &point)
                    .ok_or_else(|| unusable(format!("the {which} point has no certain depth")))?;
                Ok((point, covariance))
            }
            _ => Err(unusable(format!(
                "the marks of the {which} point do not meet within {MAX_MARK_ERROR_PX} px in \
                 {} photos; mark the same point in two photos or more that look at it from \
                 different sides",
                sightings.len()
            ))),
        }
    };
    let (first, cov_first) = end(&|m| m.first, "first")?;
    let (second, cov_second) = end(&|m| m.second, "second")?;
    let apart: nalgebra::Vector3<f64> = second - first;
    let distance = apart.norm();
    let along = apart / distance.max(f64::MIN_POSITIVE);
    let variance = along.dot(&((cov_first + cov_second) * along));
    Ok((distance, variance.max(0.0).sqrt()))
}

/// Covariance of a triangulated mark: the marks' noise, or their disagreement where that is larger.
fn covariance(sightings: &[Sighting<'_>], point: &Point3<f64>) -> Option<Matrix3<f64>> {
    let mut normal = Matrix3::zeros();
    let mut squares = 0.0;
    for sighting in sightings {
        let (seen, j) = project_with_jacobian(sighting.camera, sighting.pose, point)?;
        normal += j.by_point.transpose() * j.by_point;
        squares += (seen - sighting.pixel).norm_squared();
    }
    let degrees = (2 * sightings.len()).saturating_sub(3).max(1);
    let variance = (squares / degrees as f64).max(MARK_SIGMA_PX * MARK_SIGMA_PX);
    normal.try_inverse().map(|inverse| inverse * variance)
}
