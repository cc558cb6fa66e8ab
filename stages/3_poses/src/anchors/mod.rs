//! Depth anchors: points on the object whose depth the photos determine without shading.
//!
//! In `sift` mode an anchor is a sparse point with at least two sightings on the object's mask.
//! Its covariance is that of the least-squares triangulation with poses held fixed,
//! `Σ = σ² (Σ_i J_iᵀ J_i)⁻¹`, `J_i` the 2×3 derivative of the pixel in view `i` by the point and
//! `σ` the standard deviation of a keypoint coordinate in pixels; the depth in a view is
//! `z_i = r_iᵀ X + t_i`, so `σ(ln z_i) = √(r_iᵀ Σ r_i) / z_i`.

use crate::error::PosesError;
use nalgebra::{Matrix2x3, Matrix3, Point3};
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, FeatureMatches, Flow, Intrinsics, Observer, PhotoSet,
    PosedViews, RigidTransform, SparsePoint,
};
use serde::{Deserialize, Serialize};

/// How anchors are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnchorMode {
    /// The sparse points on the object, as they are: the sparse case of the paper.
    Sift,
    /// Keypoints matched along epipolar lines, then refined by patch alignment.
    Guided,
    /// Grown over the surface from refined seeds.
    #[default]
    Grown,
}

/// Options of the anchors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AnchorOptions {
    /// How anchors are found.
    pub mode: AnchorMode,
    /// Standard deviation of a SIFT keypoint coordinate, pixels; used in `sift` mode for points
    /// whose own residuals are too few to tell it.
    pub keypoint_sigma_px: f64,
    /// Smallest angle between two rays of an anchor, degrees.
    pub min_angle_deg: f64,
}

impl Default for AnchorOptions {
    fn default() -> Self {
        Self {
            mode: AnchorMode::Grown,
            keypoint_sigma_px: 0.7,
            min_angle_deg: 2.0,
        }
    }
}

impl AnchorOptions {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first option that is out of its range.
    pub fn validate(&self) -> Result<(), PosesError> {
        for (option, value) in [
            ("anchors.keypoint_sigma_px", self.keypoint_sigma_px),
            ("anchors.min_angle_deg", self.min_angle_deg),
        ] {
            if value.is_nan() || value <= 0.0 {
                return Err(PosesError::InvalidOption {
                    option,
                    value,
                    range: "must be positive",
                });
            }
        }
        Ok(())
    }
}

/// Anchors of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewAnchors {
    /// The photo's file name.
    pub file_name: String,
    /// Anchors that the view sees.
    pub num_anchors: usize,
    /// Share of the mask within 20 px of an anchor; `None` without a mask.
    pub coverage: Option<f64>,
    /// Median standard deviation of ln depth.
    pub median_sigma_ln_depth: Option<f64>,
}

/// Facts about the anchors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnchorReport {
    /// How they were found.
    pub mode: AnchorMode,
    /// Anchors in all.
    pub num_anchors: usize,
    /// One entry per view.
    pub views: Vec<ViewAnchors>,
}

/// Distance within which an anchor covers a pixel of the mask.
const COVERAGE_RADIUS_PX: f64 = 20.0;

/// Finds the depth anchors of posed views.
///
/// # Errors
/// When an option is out of range, a photo cannot be read, or the observer asked to stop.
pub fn find(
    photos: &PhotoSet,
    _matches: &FeatureMatches,
    posed: &PosedViews,
    options: &AnchorOptions,
    observer: &dyn Observer,
) -> Result<(Vec<Anchor>, AnchorReport), PosesError> {
    options.validate()?;
    if observer.flow() == Flow::Stop {
        return Err(PosesError::Interrupted);
    }
    let anchors: Vec<Anchor> = posed
        .points
        .iter()
        .filter_map(|point| sift_anchor(photos, posed, point, options))
        .collect();
    let report = report(photos, posed, options.mode, &anchors);
    Ok((anchors, report))
}

/// Derivative of the pixel by the point in the world frame, distortion neglected (it changes the
/// covariance by its relative strength only).
fn pixel_derivative(
    camera: &Intrinsics,
    cam_from_world: &RigidTransform,
    point: &Point3<f64>,
) -> Option<Matrix2x3<f64>> {
    let p = cam_from_world.apply(point);
    if p.z.is_nan() || p.z <= 0.0 {
        return None;
    }
    let (u, v) = (p.x / p.z, p.y / p.z);
    let by_cam = Matrix2x3::new(
        camera.fx / p.z,
        0.0,
        -camera.fx * u / p.z,
        0.0,
        camera.fy / p.z,
        -camera.fy * v / p.z,
    );
    Some(by_cam * cam_from_world.rotation_matrix())
}

/// The anchor of a sparse point, when at least two sightings lie on the object.
fn sift_anchor(
    photos: &PhotoSet,
    posed: &PosedViews,
    point: &SparsePoint,
    options: &AnchorOptions,
) -> Option<Anchor> {
    let position = Point3::from(point.position);
    let on_object: Vec<_> = point
        .track
        .iter()
        .filter(|sighting| {
            let photo = &photos.photos[posed.views[sighting.view.0].photo.0];
            photo.mask.as_ref().is_none_or(|mask| {
                mask.contains(
                    sighting.pixel[0].round() as isize,
                    sighting.pixel[1].round() as isize,
                )
            })
        })
        .collect();
    if on_object.len() < 2 {
        return None;
    }
    let mut widest = 0.0_f64;
    let rays: Vec<_> = on_object
        .iter()
        .map(|s| (position - posed.views[s.view.0].cam_from_world.center_in_source()).normalize())
        .collect();
    for (k, a) in rays.iter().enumerate() {
        for b in &rays[k + 1..] {
            widest = widest.max(a.dot(b).clamp(-1.0, 1.0).acos());
        }
    }
    if widest < options.min_angle_deg.to_radians() {
        return None;
    }
    let mut information = Matrix3::zeros();
    let mut squares = 0.0;
    for sighting in &on_object {
        let view = &posed.views[sighting.view.0];
        let j = pixel_derivative(&view.intrinsics, &view.cam_from_world, &position)?;
        information += j.transpose() * j;
        let seen = view
            .intrinsics
            .project(&view.cam_from_world.apply(&position))?;
        squares += (seen.x - sighting.pixel[0]).powi(2) + (seen.y - sighting.pixel[1]).powi(2);
    }
    // Few residuals say little: the prior standard deviation counts as four of them.
    let degrees = (2 * on_object.len() - 3) as f64;
    let prior = options.keypoint_sigma_px.powi(2);
    let variance = (squares + 4.0 * prior) / (degrees + 4.0);
    let covariance = information.try_inverse()? * variance;
    let observations = on_object
        .iter()
        .map(|sighting| {
            let view = &posed.views[sighting.view.0];
            let depth = view.cam_from_world.apply(&position).z;
            let axis = view.cam_from_world.rotation_matrix().row(2).transpose();
            AnchorObservation {
                view: sighting.view,
                pixel: sighting.pixel,
                depth,
                sigma_ln_depth: (axis.dot(&(covariance * axis))).max(0.0).sqrt() / depth,
            }
        })
        .collect();
    Some(Anchor {
        position: point.position,
        covariance: [
            covariance[(0, 0)],
            covariance[(0, 1)],
            covariance[(0, 2)],
            covariance[(1, 1)],
            covariance[(1, 2)],
            covariance[(2, 2)],
        ],
        origin: AnchorOrigin::Sift,
        observations,
    })
}

/// Counts, coverage and precision per view.
fn report(
    photos: &PhotoSet,
    posed: &PosedViews,
    mode: AnchorMode,
    anchors: &[Anchor],
) -> AnchorReport {
    let views = posed
        .views
        .iter()
        .enumerate()
        .map(|(idx, view)| {
            let seen: Vec<&AnchorObservation> = anchors
                .iter()
                .flat_map(|a| a.observations.iter().filter(|o| o.view.0 == idx))
                .collect();
            let mut sigmas: Vec<f64> = seen.iter().map(|o| o.sigma_ln_depth).collect();
            let coverage = photos.photos[view.photo.0].mask.as_ref().map(|mask| {
                let mut covered = vec![false; mask.data.len()];
                let radius = COVERAGE_RADIUS_PX as isize;
                for o in &seen {
                    let (cx, cy) = (o.pixel[0].round() as isize, o.pixel[1].round() as isize);
                    for dy in -radius..=radius {
                        for dx in -radius..=radius {
                            if dx * dx + dy * dy <= radius * radius
                                && mask.contains(cx + dx, cy + dy)
                            {
                                covered[mask.index((cx + dx) as usize, (cy + dy) as usize)] = true;
                            }
                        }
                    }
                }
                covered.iter().filter(|&&c| c).count() as f64 / mask.count().max(1) as f64
            });
            ViewAnchors {
                file_name: view.file_name.clone(),
                num_anchors: seen.len(),
                coverage,
                median_sigma_ln_depth: rilievo_numerics::robust::median(&mut sigmas),
            }
        })
        .collect();
    AnchorReport {
        mode,
        num_anchors: anchors.len(),
        views,
    }
}
