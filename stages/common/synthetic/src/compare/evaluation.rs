//! The numbers of `rilievo evaluate`, shaped as its JSON.

use super::align::{Alignment, AlignmentRequest, NamedPose, PoseComparison, align, compare_poses};
use super::appearance::AppearanceComparison;
use super::cloud::{CloudComparison, TrueSurface, compare_cloud};
use super::maps::{MapComparison, PixelErrors, aggregate};
use crate::error::SyntheticError;
use rilievo_numerics::robust::median;
use rilievo_scene::{CloudPoint, Unit};
use serde::Serialize;
use std::collections::BTreeMap;

/// Everything that can be said of a result against its truth.
///
/// What could not be computed is `None` (JSON null), and `reasons` says why under the same key.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// The motion used.
    pub alignment: Alignment,
    /// Lengths of the estimate are multiplied by this before comparison.
    pub scale: f64,
    /// Unit of all lengths here.
    pub unit: Unit,
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
    /// Where both sides do not match in scale or frame: by how much, and what to try.
    pub mismatches: Vec<String>,
}

/// Median factor between the depths of both sides from which they are not of one scale.
const MAX_DEPTH_FACTOR: f64 = 2.0;

/// A number in a sentence.
fn number(value: f64) -> String {
    if (0.01..1e4).contains(&value) {
        format!("{value:.3}")
    } else {
        format!("{value:.2e}")
    }
}

fn mismatches(
    alignment: Alignment,
    errors: &[(String, PixelErrors)],
    cloud: Option<&CloudComparison>,
    unit: Unit,
) -> Vec<String> {
    let remedy = match alignment {
        Alignment::Sim3 => {
            "the cameras of both sides were aligned, so that on one of them cameras and surface are in \
             different units or frames"
        }
        Alignment::None | Alignment::Se3 => {
            "try --align sim3, which finds frame and scale from the cameras, and check the unit of both"
        }
    };
    let mut found = Vec::new();
    let depths = errors.iter().flat_map(|(_, view)| &view.depths);
    let mut factors: Vec<f64> = depths.map(|[z, t]| f64::from(*z) / f64::from(*t)).collect();
    if let Some(factor) = median(&mut factors)
        && !(1.0 / MAX_DEPTH_FACTOR..=MAX_DEPTH_FACTOR).contains(&factor)
    {
        let factor = number(factor);
        found.push(format!(
            "the depths are {factor} times the true ones: they do not match in scale; {remedy}"
        ));
    }
    if let Some(apart) = cloud.and_then(|cloud| cloud.apart) {
        let [cloud, surface, offset] = [apart.cloud_size, apart.surface_size, apart.offset]
            .map(|v| format!("{} {}", number(v), unit.words()));
        found.push(format!(
            "the cloud is {cloud} across, the true surface {surface}, and their middles lie {offset} apart: \
             they do not match in scale or frame; {remedy}"
        ));
    }
    found
}

/// Gathers an evaluation from poses, per-view errors (of [`super::compare_maps`] after
/// [`super::align`] gave the scale) and an optional cloud with the true surface; the appearance is
/// left to the caller, who knows the images.
///
/// # Errors
/// Those of the alignment.
pub fn evaluate(
    (estimated, truth): (&[NamedPose], &[NamedPose]),
    unit: Unit,
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
    let mismatches = mismatches(similarity.alignment, &errors, cloud.as_ref(), unit);
    Ok(Evaluation {
        alignment: similarity.alignment,
        scale: similarity.scale,
        unit,
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
        mismatches,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::NormalSource;

    #[test]
    fn depths_of_another_scale_are_told_with_the_factor_and_what_to_try() {
        let told = |factor: f32, alignment| {
            let errors = PixelErrors {
                num_truth: 3,
                num_estimated: 3,
                normal_deg: Vec::new(),
                depth_rel: Vec::new(),
                depths: [1.0, 1.1, 1.2].map(|z| [factor * z, z]).to_vec(),
                normal_source: NormalSource::Maps,
                regions: Default::default(),
                relief: Vec::new(),
            };
            mismatches(alignment, &[("a".to_owned(), errors)], None, Unit::Metre).join("; ")
        };
        assert_eq!(told(1.3, Alignment::None), "");
        for (factor, shown) in [(1000.0, "1000.000 times"), (0.001, "1.00e-3 times")] {
            let message = told(factor, Alignment::None);
            let parts = [shown, "do not match in scale", "--align sim3"];
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
        // What was done already is no advice.
        assert!(!told(1000.0, Alignment::Sim3).contains("--align"));
    }
}
