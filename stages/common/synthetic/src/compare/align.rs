//! The similarity between two frames, from the cameras that both know.
//!
//! `min Σ ‖c_t − (s R c_e + b)‖²` over the camera centres `c` (lengths in each frame's unit), in
//! closed form: with centred `x = c_e − c̄_e`, `y = c_t − c̄_t` and the decomposition
//! `Σ y xᵀ = U D Vᵀ`, `R = U S Vᵀ`, `s = tr(D S) / Σ‖x‖²`, `b = c̄_t − s R c̄_e`, where
//! `S = diag(1, 1, det U det V)`.
//!
//! Source: Umeyama, "Least-squares estimation of transformation parameters between two point
//! patterns", PAMI 1991, eqs. 40-42.
//!
//! Departure: two centres, or centres on one line, leave a rotation about that line free. Where
//! the second singular value is small, `R` is instead the chordal mean of the cameras' own
//! `R_tᵀ R_e`, and `s` follows from it.

use crate::error::SyntheticError;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use rilievo_scene::RigidTransform;
use serde::{Deserialize, Serialize};

/// How the estimate may be moved before it is compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlignmentRequest {
    /// Not at all where the estimate already lives in the truth's frame (its cameras stand within 5
    /// % of the rig's extent and 5 degrees of the true ones), a similarity otherwise; the scale is
    /// reported, so a metric estimate shows its scale error there.
    #[default]
    Auto,
    /// Not at all.
    None,
    /// Rotation and translation.
    Se3,
    /// Rotation, translation and one scale.
    Sim3,
}

/// Which motion brought the estimate onto the truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// None: both live in one frame.
    None,
    /// Rotation and translation.
    Se3,
    /// Rotation, translation and one scale.
    Sim3,
}

/// A camera of either side.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedPose {
    /// Name of the photo without its ending: the key by which both sides are joined.
    pub name: String,
    /// Pose.
    pub cam_from_world: RigidTransform,
}

/// `x_in_truth = scale · rotation · x_in_estimate + translation`.
#[derive(Clone, Debug, PartialEq)]
pub struct Similarity {
    /// Which motion was allowed.
    pub alignment: Alignment,
    /// Scale, 1 unless [`Alignment::Sim3`].
    pub scale: f64,
    /// Rotation.
    pub rotation: UnitQuaternion<f64>,
    /// Translation, truth's unit.
    pub translation: Vector3<f64>,
    /// Why this motion was chosen.
    pub reason: String,
}

impl Similarity {
    /// The motion that moves nothing.
    pub fn identity(reason: impl Into<String>) -> Self {
        Self {
            alignment: Alignment::None,
            scale: 1.0,
            rotation: UnitQuaternion::identity(),
            translation: Vector3::zeros(),
            reason: reason.into(),
        }
    }

    /// Moves a point from the estimate's to the truth's frame.
    pub fn apply(&self, point_in_estimate: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.scale * (self.rotation * point_in_estimate.coords) + self.translation)
    }
}

/// Camera poses after alignment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseComparison {
    /// Cameras that both sides know.
    pub num_cameras: usize,
    /// Cameras that only the truth knows.
    pub num_missing: usize,
    /// Mean distance of the camera centres, truth's unit.
    pub center_error_mean: f64,
    /// Largest distance of the camera centres, truth's unit.
    pub center_error_max: f64,
    /// Mean angle between the orientations, degrees.
    pub rotation_error_mean_deg: f64,
    /// Largest angle between the orientations, degrees.
    pub rotation_error_max_deg: f64,
}

/// Share of the rig's extent within which `Auto` takes two frames for one.
const SAME_FRAME_SHARE: f64 = 0.05;
/// Angle within which `Auto` takes two frames for one, radians.
const SAME_FRAME_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// Ratio of the second to the first singular value under which centres count as collinear: there
/// noise of a hundredth of the extent turns the rig freely.
const COLLINEAR: f64 = 1e-3;

fn common(estimated: &[NamedPose], truth: &[NamedPose]) -> Vec<(RigidTransform, RigidTransform)> {
    truth
        .iter()
        .filter_map(|t| {
            let e = estimated.iter().find(|e| e.name == t.name)?;
            Some((e.cam_from_world, t.cam_from_world))
        })
        .collect()
}

/// Finds the motion from the estimate's to the truth's frame.
///
/// # Errors
/// Too few cameras in common (1 for se3, 2 for sim3), or none of different places for a scale.
pub fn align(
    estimated: &[NamedPose],
    truth: &[NamedPose],
    request: AlignmentRequest,
) -> Result<Similarity, SyntheticError> {
    let pairs = common(estimated, truth);
    match request {
        AlignmentRequest::None => Ok(Similarity::identity("asked for")),
        AlignmentRequest::Se3 => solve(&pairs, Alignment::Se3, "asked for"),
        AlignmentRequest::Sim3 => solve(&pairs, Alignment::Sim3, "asked for"),
        AlignmentRequest::Auto if pairs.is_empty() => Ok(Similarity::identity(
            "no camera is known to both sides, so nothing can be aligned",
        )),
        AlignmentRequest::Auto if in_one_frame(&pairs) => Ok(Similarity::identity(
            "the cameras already stand where the true ones stand",
        )),
        AlignmentRequest::Auto => solve(
            &pairs,
            Alignment::Sim3,
            "the estimate lives in a frame of its own",
        ),
    }
}

fn in_one_frame(pairs: &[(RigidTransform, RigidTransform)]) -> bool {
    let mean = pairs
        .iter()
        .map(|(_, t)| t.center_in_source().coords)
        .sum::<Vector3<f64>>()
        / pairs.len() as f64;
    let extent = pairs
        .iter()
        .map(|(_, t)| (t.center_in_source().coords - mean).norm())
        .fold(0.0, f64::max);
    pairs.iter().all(|(e, t)| {
        (e.center_in_source() - t.center_in_source()).norm() <= SAME_FRAME_SHARE * extent
            && e.rotation.angle_to(&t.rotation) <= SAME_FRAME_RAD
    })
}

fn solve(
    pairs: &[(RigidTransform, RigidTransform)],
    alignment: Alignment,
    reason: &str,
) -> Result<Similarity, SyntheticError> {
    let (kind, needed) = match alignment {
        Alignment::Sim3 => ("sim3", 2),
        Alignment::Se3 => ("se3", 1),
        Alignment::None => ("none", 0),
    };
    if pairs.len() < needed {
        return Err(SyntheticError::TooFewCameras {
            alignment: kind,
            needed,
            found: pairs.len(),
        });
    }
    let count = pairs.len() as f64;
    let centers: Vec<_> = pairs
        .iter()
        .map(|(e, t)| (e.center_in_source().coords, t.center_in_source().coords))
        .collect();
    let mean_e = centers.iter().map(|c| c.0).sum::<Vector3<f64>>() / count;
    let mean_t = centers.iter().map(|c| c.1).sum::<Vector3<f64>>() / count;
    let mut cross = Matrix3::zeros();
    let (mut spread_e, mut spread_t) = (0.0, 0.0);
    for (e, t) in &centers {
        let (x, y) = (e - mean_e, t - mean_t);
        cross += y * x.transpose();
        spread_e += x.norm_squared();
        spread_t += y.norm_squared();
    }
    let from_centers = rotation_of(&cross);
    let rotation = match from_centers {
        Some((rotation, singular)) if singular[1] > COLLINEAR * singular[0] => rotation,
        // The cameras' own orientations hold what the centres leave free.
        _ => {
            let mut sum = Matrix3::zeros();
            for (e, t) in pairs {
                sum += t.rotation_matrix().transpose() * e.rotation_matrix();
            }
            rotation_of(&sum).map_or_else(UnitQuaternion::identity, |(rotation, _)| rotation)
        }
    };
    let scale = if alignment == Alignment::Sim3 {
        for (side, spread, mean) in [("estimated", spread_e, mean_e), ("true", spread_t, mean_t)] {
            if spread <= 1e-18 * mean.norm_squared().max(1e-12) {
                return Err(SyntheticError::CoincidentCameras { side });
            }
        }
        (rotation.to_rotation_matrix().matrix().transpose() * cross).trace() / spread_e
    } else {
        1.0
    };
    Ok(Similarity {
        alignment,
        scale,
        rotation,
        translation: mean_t - scale * (rotation * mean_e),
        reason: reason.into(),
    })
}

/// The rotation `R` that maximises `tr(Rᵀ M)`, and the singular values of `M` in falling order.
fn rotation_of(m: &Matrix3<f64>) -> Option<(UnitQuaternion<f64>, [f64; 3])> {
    let svd = m.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut s = Matrix3::identity();
    // nalgebra sorts the singular values, so the last axis is the weakest.
    s[(2, 2)] = (u.determinant() * v_t.determinant()).signum();
    let r = u * s * v_t;
    let rotation =
        UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(r));
    Some((rotation, svd.singular_values.into()))
}

/// Differences of the poses after `similarity`; `None` without a camera in common.
pub fn compare_poses(
    estimated: &[NamedPose],
    truth: &[NamedPose],
    similarity: &Similarity,
) -> Option<PoseComparison> {
    let pairs = common(estimated, truth);
    if pairs.is_empty() {
        return None;
    }
    let count = pairs.len() as f64;
    let (mut center_sum, mut center_max, mut angle_sum, mut angle_max) =
        (0.0, 0.0_f64, 0.0, 0.0_f64);
    for (e, t) in &pairs {
        let center = (similarity.apply(&e.center_in_source()) - t.center_in_source()).norm();
        // cam_from_truth of the moved camera is R_e Rᵀ.
        let angle = (e.rotation * similarity.rotation.inverse())
            .angle_to(&t.rotation)
            .to_degrees();
        center_sum += center;
        center_max = center_max.max(center);
        angle_sum += angle;
        angle_max = angle_max.max(angle);
    }
    Some(PoseComparison {
        num_cameras: pairs.len(),
        num_missing: truth.len() - pairs.len(),
        center_error_mean: center_sum / count,
        center_error_max: center_max,
        rotation_error_mean_deg: angle_sum / count,
        rotation_error_max_deg: angle_max,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(num: usize, wobble: f64) -> Vec<NamedPose> {
        (0..num)
            .map(|i| {
                let a = i as f64;
                NamedPose {
                    name: format!("IMG_{i}"),
                    cam_from_world: RigidTransform {
                        rotation: UnitQuaternion::from_euler_angles(0.3 * a, -0.2 * a, 0.1 + a),
                        translation: Vector3::new(a.sin(), wobble * a * a, 2.0 + 0.3 * a),
                    },
                }
            })
            .collect()
    }

    fn moved(
        poses: &[NamedPose],
        s: f64,
        r: UnitQuaternion<f64>,
        b: Vector3<f64>,
    ) -> Vec<NamedPose> {
        poses
            .iter()
            .map(|p| {
                let center = s * (r * p.cam_from_world.center_in_source().coords) + b;
                let rotation = p.cam_from_world.rotation * r.inverse();
                NamedPose {
                    name: p.name.clone(),
                    cam_from_world: RigidTransform {
                        rotation,
                        translation: -(rotation * center),
                    },
                }
            })
            .collect()
    }

    #[test]
    fn a_similarity_is_found_back_exactly_also_from_two_cameras() {
        let r = UnitQuaternion::from_euler_angles(1.0, -0.4, 2.0);
        let b = Vector3::new(0.3, -4.0, 1.0);
        for num in [2, 3, 8] {
            let estimated = rig(num, 0.2);
            let truth = moved(&estimated, 0.37, r, b);
            let found = align(&estimated, &truth, AlignmentRequest::Auto);
            let found = found.expect("determined");
            assert_eq!(found.alignment, Alignment::Sim3);
            assert!((found.scale - 0.37).abs() < 1e-12, "{}", found.scale);
            let poses = compare_poses(&estimated, &truth, &found).expect("cameras in common");
            assert!(poses.center_error_max < 1e-12, "{poses:?}");
            assert!(poses.rotation_error_max_deg < 1e-6, "{poses:?}");
        }
    }

    #[test]
    fn auto_moves_nothing_that_already_lies_right() {
        let truth = rig(5, 0.2);
        let mut estimated = truth.clone();
        estimated[2].cam_from_world.translation.x += 0.01;
        let found = align(&estimated, &truth, AlignmentRequest::Auto).expect("determined");
        assert_eq!(found.alignment, Alignment::None);
        let poses = compare_poses(&estimated, &truth, &found).expect("cameras in common");
        assert!((poses.center_error_max - 0.01).abs() < 1e-12, "{poses:?}");
        assert!((poses.center_error_mean - 0.002).abs() < 1e-12, "{poses:?}");
    }

    #[test]
    fn se3_leaves_the_scale_error_visible() {
        let estimated = rig(6, 0.2);
        let truth = moved(
            &estimated,
            1.1,
            UnitQuaternion::identity(),
            Vector3::zeros(),
        );
        let found = align(&estimated, &truth, AlignmentRequest::Se3).expect("determined");
        assert_eq!(found.scale, 1.0);
        let poses = compare_poses(&estimated, &truth, &found).expect("cameras in common");
        assert!(poses.center_error_mean > 0.05, "{poses:?}");
    }

    #[test]
    fn what_the_cameras_do_not_determine_is_a_named_error() {
        let one = rig(1, 0.2);
        assert_eq!(
            align(&one, &one, AlignmentRequest::Sim3),
            Err(SyntheticError::TooFewCameras {
                alignment: "sim3",
                needed: 2,
                found: 1
            })
        );
        let truth = rig(3, 0.2);
        let estimated = moved(&truth, 0.0, UnitQuaternion::identity(), Vector3::zeros());
        assert_eq!(
            align(&estimated, &truth, AlignmentRequest::Sim3),
            Err(SyntheticError::CoincidentCameras { side: "estimated" })
        );
    }
}
