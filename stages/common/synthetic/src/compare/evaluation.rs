//! The numbers of `rilievo evaluate`, shaped as its JSON.

use super::align::{AlignmentRequest, NamedPose, PoseComparison, align, compare_poses};
use super::appearance::AppearanceComparison;
use super::cloud::{CloudComparison, TrueSurface, compare_cloud};
use super::maps::{MapComparison, PixelErrors, aggregate};
use crate::error::SyntheticError;
use rilievo_scene::CloudPoint;
use serde::Serialize;
use std::collections::BTreeMap;

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

/// Everything that can be said of a result against its truth.
///
/// What could not be computed is `None` (JSON null), and `reasons` says why under the same key.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// The motion used.
    pub alignment: Alignment,
    /// Lengths of the estimate are multiplied by this before comparison.
    pub scale: f64,
    /// Why this motion.
    pub alignment_reason: String,
    /// Camera poses.
    pub poses: Option<PoseComparison>,
    /// Maps of every view, by name.
    pub views: BTreeMap<String, MapComparison>,
    /// The pixels of all views together.
    pub all: Option<MapComparison>,
    /// The cloud against the true surface.
    pub cloud: Option<CloudComparison>,
    /// Light, albedo and re-rendered photos, of all views together.
    pub appearance: AppearanceComparison,
    /// Key of a null value: why it could not be computed.
    pub reasons: BTreeMap<String, String>,
}

/// Gathers an evaluation from poses, per-view errors (of [`super::compare_maps`] after
/// [`super::align`] gave the scale) and an optional cloud with the true surface; the appearance is
/// left to the caller, who knows the images.
///
/// # Errors
/// Those of the alignment.
pub fn evaluate(
    estimated: &[NamedPose],
    truth: &[NamedPose],
    request: AlignmentRequest,
    views: impl FnOnce(f64) -> Result<Vec<(String, PixelErrors)>, SyntheticError>,
    cloud: Result<(&[CloudPoint], TrueSurface<'_>), String>,
) -> Result<Evaluation, SyntheticError> {
    let similarity = align(estimated, truth, request)?;
    let mut reasons = BTreeMap::new();
    let poses = compare_poses(estimated, truth, &similarity);
    if poses.is_none() {
        reasons.insert("poses".into(), "no camera is known to both sides".into());
    }
    let errors = views(similarity.scale)?;
    let all = aggregate(errors.iter().map(|(_, e)| e));
    if all.is_none() {
        reasons.insert("all".into(), "the truth has no map of any view".into());
    }
    let cloud = match cloud {
        Ok((points, surface)) => {
            let compared = compare_cloud(points, &surface, &similarity);
            if compared.is_none() {
                reasons.insert(
                    "cloud".into(),
                    "the cloud or the true surface is empty".into(),
                );
            }
            compared
        }
        Err(reason) => {
            reasons.insert("cloud".into(), reason);
            None
        }
    };
    Ok(Evaluation {
        alignment: similarity.alignment,
        scale: similarity.scale,
        alignment_reason: similarity.reason.clone(),
        poses,
        views: errors
            .iter()
            .map(|(name, e)| (name.clone(), e.summary()))
            .collect(),
        all,
        cloud,
        appearance: AppearanceComparison::default(),
        reasons,
    })
}
