//! What the lighting is to be taken from, and the case where it is given.

use crate::error::LightingError;
use crate::light_samples;
use crate::report::{LightingReport, ViewLightReport};
use rilievo_photometry::harmonics::rotate;
use rilievo_scene::{
    DepthMap, LightKind, LightSource, Lighting, LightingCalibration, PosedViews, SphereRequest,
    ViewIdx, ViewLighting,
};

/// Where the lighting comes from.
#[derive(Clone, Debug)]
pub enum LightingRequest {
    /// The reference spheres that stage 3 located ([`PosedViews::spheres`]), or the calibration
    /// photos of the request.
    Sphere(SphereRequest),
    /// Known depth of some views: one lighting per view, the shape is used for nothing else.
    Shape(Vec<(ViewIdx, DepthMap)>),
    /// Coefficients in each view's camera frame by the view's name, with or without ending; a
    /// single entry named `*` serves every view. What the light is fixed to follows from them.
    Given(Vec<(String, Lighting)>),
    /// The depth anchors that stage 3 found: uncalibrated.
    OwnShape,
}

/// The name that stands for every view.
const EVERY_VIEW: &str = "*";

pub(crate) fn given(
    posed: &PosedViews,
    lightings: &[(String, Lighting)],
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let mut views = Vec::with_capacity(posed.views.len());
    let mut missing = Vec::new();
    for (idx, view) in posed.views.iter().enumerate() {
        let found = lightings
            .iter()
            .find(|(name, _)| *name == view.name || *name == view.file_name)
            .or_else(|| lightings.iter().find(|(name, _)| name == EVERY_VIEW));
        match found {
            Some((_, lighting)) if !lighting.channels.is_empty() => views.push(ViewLighting {
                view: ViewIdx(idx),
                lighting: lighting.clone(),
                residual: None,
                gain: vec![1.0; lighting.channels.len()],
            }),
            _ => missing.push(view.name.clone()),
        }
    }
    if !missing.is_empty() {
        return Err(LightingError::GivenMissing { views: missing });
    }
    let kind = fixed_to(posed, &views);
    let samples = light_samples::of_harmonics(&views, kind, posed);
    let environment_in_world = (kind == LightKind::World)
        .then(|| {
            let first = &posed.views.first()?;
            let world_from_cam = first.cam_from_world.rotation.inverse();
            Some(rotate(&views.first()?.lighting, &world_from_cam))
        })
        .flatten();
    let report = LightingReport {
        source: LightSource::Given,
        kind,
        views: posed
            .views
            .iter()
            .map(|view| ViewLightReport::named(&view.name))
            .collect(),
        ..LightingReport::default()
    };
    Ok((
        LightingCalibration {
            source: LightSource::Given,
            kind,
            environment_in_world,
            views,
            spheres: Vec::new(),
            samples,
        },
        report,
    ))
}

/// What a light is fixed to whose lightings are given view by view: to the world if they agree better
/// there, up to a gain each, than in the cameras' frames.
fn fixed_to(posed: &PosedViews, views: &[ViewLighting]) -> LightKind {
    let scatter = |in_world: bool| -> f64 {
        let rows: Vec<Vec<f64>> = views
            .iter()
            .map(|entry| {
                let world_from_cam = posed.views[entry.view.0].cam_from_world.rotation.inverse();
                let lighting = if in_world {
                    rotate(&entry.lighting, &world_from_cam)
                } else {
                    entry.lighting.clone()
                };
                let row: Vec<f64> = lighting.channels.iter().flat_map(|l| l.0).collect();
                let length = row.iter().map(|v| v * v).sum::<f64>().sqrt();
                row.iter()
                    .map(|v| v / length.max(f64::MIN_POSITIVE))
                    .collect()
            })
            .collect();
        let num_rows = rows.len().max(1) as f64;
        let num_columns = rows.iter().map(Vec::len).min().unwrap_or(0);
        (0..num_columns)
            .map(|k| {
                let mean = rows.iter().map(|row| row[k]).sum::<f64>() / num_rows;
                rows.iter().map(|row| (row[k] - mean).powi(2)).sum::<f64>()
            })
            .sum()
    };
    // One light for every view's own frame leaves no scatter there, but for rounding.
    if scatter(true) < scatter(false) {
        LightKind::World
    } else {
        LightKind::Camera
    }
}
