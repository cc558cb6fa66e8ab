//! Whether the light was the right one for the surface that was found under it.
//!
//! For every view three residuals, relative to the photo (root mean square over the unclipped
//! pixels of the surface): with the light that was used; with the same light times the best gain;
//! with nine harmonics fitted on the surface itself, the best that any distant light can do. A
//! sphere in the object's shadow or bounce light shows as a large first against a small third
//! number, worst in the views from the side that the object hides from the sphere. What the third
//! number leaves is the object's own shadow and bounce light.
//!
//! All three are distant lights. Where the shape came from a model that allows for shadow and bounce, and
//! that explains the photo, they hurt nothing, and nothing is said of a sphere's light or an estimated
//! one. Light from elsewhere that does not fit is told all the same: it is not the light of these photos.

use crate::report::{SurfaceReport, ViewSurfaceReport};
use crate::shape::{fit_on_normals, surface_pixels};
use crate::{LightingError, LightingOptions};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_photometry::harmonics::dominant_direction;
use rilievo_scene::{
    Event, Flow, LightSource, Lighting, LightingCalibration, LinearImage, Observer, PhotoSet,
    PosedViews, ShadedView, ShadedViews, StageId,
};

/// Residual below which a light is good enough whatever a refit could do.
const SMALLEST_GAP: f64 = 0.04;
/// A pixel further than this from the best distant light is not explained by it.
const UNEXPLAINED: f64 = 0.1;
/// Logarithm of an albedo ratio worth a word.
const OTHER_ALBEDO: f64 = 0.15;
/// Share of unexplained surface worth a word.
const MUCH_UNEXPLAINED: f64 = 0.4;

pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    calibration: &LightingCalibration,
    shaded: &ShadedViews,
    is_explained: &dyn Fn(&str) -> bool,
    options: &LightingOptions,
    observer: &dyn Observer,
) -> Result<SurfaceReport, LightingError> {
    let flow = observer.event(Event::Progress {
        stage: StageId::Lighting,
        step: "comparing the light with the surface".to_owned(),
        done: 0,
        total: shaded.views.len(),
    });
    if flow == Flow::Stop {
        return Err(LightingError::Interrupted);
    }
    let views: Vec<Option<ViewSurfaceReport>> = shaded
        .views
        .par_iter()
        .map(|view| {
            let Some(used) = calibration.views.iter().find(|l| l.view == view.view) else {
                return Ok(None);
            };
            if observer.flow() == Flow::Stop {
                return Err(LightingError::Interrupted);
            }
            let photo = &photos.photos[posed.views[view.view.0].photo.0];
            let image = photo.linear()?;
            let mask = photo.mask.as_deref();
            let limit = f64::from(photo.clip_level) * options.clip_share;
            let pixels = surface_pixels(&image, mask, &view.normal, options.max_num_samples);
            if pixels.len() < options.min_num_pixels {
                return Ok(None);
            }
            let refit = fit_on_normals(&image, mask, &view.normal, photo.clip_level, options)
                .ok()
                .map(|(lighting, _)| lighting);
            Ok(one_view(
                view,
                &image,
                &pixels,
                limit,
                (&used.lighting, refit.as_ref()),
            ))
        })
        .collect::<Result<_, LightingError>>()?;
    let mut views: Vec<ViewSurfaceReport> = views.into_iter().flatten().collect();
    let mut gains: Vec<f64> = views.iter().map(|v| v.best_gain).collect();
    let albedo_factor = rilievo_numerics::robust::median(&mut gains);
    for view in &mut views {
        view.explained = is_explained(&view.name);
        let common = albedo_factor.unwrap_or(1.0) / view.best_gain;
        // |g S − I|² grows quadratically around the best gain; S there explains all but the rest.
        let rest = view.used_rms_after_gain.powi(2);
        view.used_rms_after_albedo = (rest + (common - 1.0).powi(2) * (1.0 - rest)).sqrt();
        view.suffers = view.used_rms_after_albedo > options.advice_ratio * view.refitted_rms
            && view.used_rms_after_albedo > view.refitted_rms + SMALLEST_GAP;
    }
    let advice = advice(calibration.source, &views, albedo_factor);
    Ok(SurfaceReport {
        views,
        albedo_factor,
        advice,
    })
}

/// Sums of a light's agreement with a photo.
struct Agreement {
    rms: f64,
    rms_after_gain: f64,
    gain: f64,
    unexplained: f64,
}

fn agreement(
    image: &LinearImage,
    pixels: &[(usize, usize, Vector3<f64>)],
    limit: f64,
    lighting: &Lighting,
) -> Option<Agreement> {
    let (mut ss, mut si, mut ii, mut far, mut count) = (0.0, 0.0, 0.0, 0_usize, 0_usize);
    for (x, y, normal) in pixels {
        for (light, &value) in lighting.channels.iter().zip(image.pixel(*x, *y)) {
            let value = f64::from(value);
            if value >= limit {
                continue;
            }
            let predicted = light.evaluate(normal);
            ss += predicted * predicted;
            si += predicted * value;
            ii += value * value;
            far += usize::from((predicted - value).abs() > UNEXPLAINED * value);
            count += 1;
        }
    }
    if count == 0 || ii <= 0.0 || ss <= 0.0 {
        return None;
    }
    let square = |gain: f64| ((gain * gain * ss - 2.0 * gain * si + ii).max(0.0) / ii).sqrt();
    let gain = si / ss;
    Some(Agreement {
        rms: square(1.0),
        rms_after_gain: square(gain),
        gain,
        unexplained: far as f64 / count as f64,
    })
}

fn one_view(
    view: &ShadedView,
    image: &LinearImage,
    pixels: &[(usize, usize, Vector3<f64>)],
    limit: f64,
    (used, refit): (&Lighting, Option<&Lighting>),
) -> Option<ViewSurfaceReport> {
    let with_used = agreement(image, pixels, limit, used)?;
    let with_refit = refit.and_then(|l| agreement(image, pixels, limit, l));
    let refitted_rms = with_refit.as_ref().map_or(with_used.rms, |a| a.rms);
    let direction_change_deg = refit
        .and_then(|l| Some((dominant_direction(l)?, dominant_direction(used)?)))
        .map(|(a, b)| a.angle(&b).to_degrees());
    Some(ViewSurfaceReport {
        name: view.name.clone(),
        used_rms: with_used.rms,
        used_rms_after_gain: with_used.rms_after_gain,
        best_gain: with_used.gain,
        refitted_rms,
        direction_change_deg,
        unexplained_share: with_refit.map_or(with_used.unexplained, |a| a.unexplained),
        used_rms_after_albedo: with_used.rms,
        suffers: false,
        explained: false,
    })
}

fn advice(
    source: LightSource,
    views: &[ViewSurfaceReport],
    albedo_factor: Option<f64>,
) -> Vec<String> {
    let mut advice = Vec::new();
    if let Some(factor) = albedo_factor.filter(|f| f.ln().abs() > OTHER_ALBEDO) {
        advice.push(format!(
            "the object is {factor:.2} times as bright as the light predicts, in all photos alike: \
             its albedo differs from the sphere's, or it is dirty or in its own shadow"
        ));
    }
    let is_of_this_scene = matches!(source, LightSource::Sphere | LightSource::OwnShape);
    let suffering: Vec<String> = views
        .iter()
        .filter(|v| v.suffers && !(v.explained && is_of_this_scene))
        .map(|v| {
            format!(
                "{} ({:.0} % against {:.0} %)",
                v.name,
                100.0 * v.used_rms_after_albedo,
                100.0 * v.refitted_rms
            )
        })
        .collect();
    if !suffering.is_empty() {
        let remedy = match source {
            LightSource::Sphere => {
                "the sphere stands in the object's shadow or bounce light: move it away, or take \
                 a calibration photo of a sphere in the object's place"
            }
            LightSource::CalibrationPhoto => {
                "the light changed between the calibration photo and these, or their exposure did"
            }
            LightSource::Given | LightSource::Shape => {
                "the light given is not the light of these photos; check file, frame and exposure"
            }
            LightSource::OwnShape => {
                "the light is an estimate; put a matte sphere beside the object"
            }
        };
        advice.push(format!(
            "the light does not fit the object in {}: {remedy}",
            suffering.join(", ")
        ));
    }
    let shadowed: Vec<&str> = views
        .iter()
        .filter(|v| v.unexplained_share > MUCH_UNEXPLAINED && !v.explained)
        .map(|v| v.name.as_str())
        .collect();
    if !shadowed.is_empty() {
        advice.push(format!(
            "no distant light explains more than {:.0} % of the object in {}: its own shadow, \
             bounce light, gloss or stains. The photo model allows for shadow and bounce light, the paper's \
             model does not; softer light from several sides helps both",
            100.0 * (1.0 - MUCH_UNEXPLAINED),
            shadowed.join(", ")
        ));
    }
    advice
}
