//! One environment in the world from spheres: the gains of the photos that show them, the samples
//! that it is fitted on, and the lighting of every view from it.

use crate::error::LightingError;
use crate::error::warn;
use crate::gains::{self, Gains};
use crate::pool::Pool;
use crate::report::{ChannelReport, LightingReport};
use crate::residual::residual_in;
use crate::side::Side;
use rilievo_photometry::harmonics::{LightingFit, dominant_direction, rotate};
use rilievo_photometry::surface_check::MAX_SAMPLES;
use rilievo_scene::{
    LightSource, Lighting, Observer, PosedView, PosedViews, ViewIdx, ViewLighting, first_and_more,
};

/// Gains of one.
pub(crate) fn ones(num_channels: usize) -> Vec<f64> {
    vec![1.0; num_channels]
}

/// Samples of all patches that count, in the world, brightness divided by gain and paint.
pub(crate) fn pool_in_world(side: &Side, gains: &[Vec<f64>]) -> Pool {
    let mut pool = Pool::default();
    let share = MAX_SAMPLES / side.counted().count().max(1);
    for (patch, paint) in side.counted() {
        let gain = &gains[patch.view];
        let scale: Vec<f64> = gain.iter().zip(paint).map(|(g, p)| g * p).collect();
        let rotation = &side.world_from_cam[patch.view];
        pool.add(&patch.samples.readings, rotation, &scale, share);
    }
    pool
}

/// Gains of the views in `side`, found in two rounds: the first fit estimates the slope of the light
/// within a cell of normals, the second comparison removes it.
pub(crate) fn gains_of(side: &Side) -> Result<Gains, LightingError> {
    let mut gains = gains::find(side, None);
    if side.views.len() < 2 {
        gains.apply = false;
        return Ok(gains);
    }
    for _ in 0..2 {
        let pool = pool_in_world(side, &gains.gain);
        let environment = pool.fit("the sphere")?;
        gains = gains::find(side, Some(&environment));
    }
    Ok(gains)
}

/// Writes gains into the report; returns the gain to apply per posed view.
pub(crate) fn report_gains(
    posed: &PosedViews,
    side: &Side,
    gains: &Gains,
    num_channels: usize,
    report: &mut LightingReport,
    observer: &dyn Observer,
) -> Result<Vec<Vec<f64>>, LightingError> {
    let mut applied = vec![ones(num_channels); posed.views.len()];
    for (k, &view) in side.views.iter().enumerate() {
        report.views[view].gain.clone_from(&gains.gain[k]);
        report.views[view].gain_sigma = gains.sigma[k];
        if gains.apply {
            applied[view].clone_from(&gains.gain[k]);
        }
    }
    report.gains_applied = gains.apply;
    if gains.apply {
        let unknown: Vec<&str> = (0..posed.views.len())
            .filter(|v| report.views[*v].gain_sigma.is_none())
            .map(|v| posed.views[v].name.as_str())
            .collect();
        if !unknown.is_empty() {
            let message = format!(
                "the photos' exposures differ, but the sphere does not tell the gain of {}: taken \
                 as 1; fix exposure and white balance, or keep the sphere in every photo",
                first_and_more(unknown).unwrap_or_default()
            );
            warn(observer, message)?;
        }
    }
    Ok(applied)
}

/// A lighting times a factor per channel.
pub(crate) fn scaled(mut lighting: Lighting, gain: &[f64]) -> Lighting {
    for (channel, g) in lighting.channels.iter_mut().zip(gain) {
        for l in &mut channel.0 {
            *l *= g;
        }
    }
    lighting
}

/// An environment in the world as a view sees it, at the photo's gain.
pub(crate) fn in_view(environment: &Lighting, view: &PosedView, gain: &[f64]) -> Lighting {
    scaled(rotate(environment, &view.cam_from_world.rotation), gain)
}

/// Lighting of every view from one environment in the world.
pub(crate) fn views_from_environment(
    posed: &PosedViews,
    environment: &Lighting,
    gains: &[Vec<f64>],
    side: &Side,
    report: &mut LightingReport,
) -> Vec<ViewLighting> {
    posed
        .views
        .iter()
        .enumerate()
        .map(|(idx, view)| {
            let lighting = in_view(environment, view, &gains[idx]);
            let residual = residual_in(&side.counted_in(idx), &lighting);
            if report.source == LightSource::CalibrationPhoto {
                report.views[idx].side_sphere_rms = residual;
            } else {
                report.views[idx].relative_rms = residual;
            }
            let residual = report.views[idx].relative_rms;
            ViewLighting {
                view: ViewIdx(idx),
                lighting,
                residual,
                gain: gains[idx].clone(),
            }
        })
        .collect()
}

/// Writes the fit of a light into the report.
pub(crate) fn describe(
    fit: &LightingFit,
    report: &mut LightingReport,
    observer: &dyn Observer,
) -> Result<(), LightingError> {
    report.channels = fit.channels.iter().map(ChannelReport::from).collect();
    report.dominant_direction = dominant_direction(&fit.lighting()).map(Into::into);
    if fit.channels.iter().any(|channel| channel.order == 1) {
        let message = "the sphere's pixels do not determine nine harmonics, four were fitted: show more of \
             it, or more views of it";
        warn(observer, message.to_owned())?;
    }
    Ok(())
}
