//! What the lighting is to be taken from, and the case where it is given.

use crate::LightingError;
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
    /// single entry named `*` serves every view.
    Given(Vec<(String, Lighting)>, LightKind),
    /// The depth anchors that stage 3 found: uncalibrated.
    OwnShape,
}

/// The name that stands for every view.
const EVERY_VIEW: &str = "*";

pub(crate) fn given(
    posed: &PosedViews,
    lightings: &[(String, Lighting)],
    kind: LightKind,
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
        },
        report,
    ))
}
