//! Lighting from the reference spheres beside the object.
//!
//! # Steps
//! 1. Usable pixels of the spheres in every view ([`crate::side`]).
//! 2. Gains of the photos and the kind of light from the spheres alone ([`crate::gains`],
//!    [`crate::kind`]).
//! 3. Of several spheres, those that see one light ([`crate::agreement`]).
//! 4. World: one robust fit over all views and spheres, normals turned into the world and
//!    intensities divided by the gains; rotated into each camera and multiplied by its gain. Camera:
//!    one fit per view; a view without a usable sphere takes the lighting of the nearest one, and
//!    says so.
//! 5. A calibration photo ([`crate::calibration`]) replaces step 4's fit; the spheres beside the
//!    object still give the gains.

use crate::calibration::from_calibration;
use crate::error::LightingError;
use crate::gains::{self, Gains};
use crate::options::{GainMode, LightingOptions};
use crate::pool::Pool;
use crate::report::{ChannelReport, LightingReport};
use crate::side::{Counted, Side, collect};
use crate::{agreement, kind, light_samples, place};
use nalgebra::UnitQuaternion;
use rilievo_photometry::harmonics::{LightingFit, dominant_direction, rotate};
use rilievo_scene::{
    LightKind, LightSource, Lighting, LightingCalibration, Observer, PhotoSet, PosedViews,
    SphereRequest, ViewIdx, ViewLighting,
};

pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    request: &SphereRequest,
    options: &LightingOptions,
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    if posed.spheres.is_empty() && request.calibration.is_empty() {
        return Err(LightingError::NoSphere {
            why: posed.no_sphere.clone(),
        });
    }
    let mut report = LightingReport {
        source: LightSource::Sphere,
        ..LightingReport::default()
    };
    let side = collect(photos, posed, options, observer, &mut report)?;
    report.kind_check = kind::check(&side, request.light);
    report.kind = kind::settled(request.light, report.kind_check.as_ref());
    warn_of_kind(&mut report);
    report.warnings.extend(place::warn(posed));
    if request.calibration.is_empty() {
        if side.views.is_empty() {
            return Err(LightingError::SphereUnusable {
                reasons: reasons(&report),
            });
        }
        match report.kind {
            LightKind::World => from_side_world(posed, side, options, report),
            LightKind::Camera => from_side_camera(posed, side, options, report),
        }
    } else {
        report.source = LightSource::CalibrationPhoto;
        from_calibration(photos, posed, request, &side, options, report)
    }
}

fn reasons(report: &LightingReport) -> Vec<String> {
    report
        .views
        .iter()
        .filter_map(|v| Some(format!("{}: {}", v.name, v.left_out.as_ref()?)))
        .collect()
}

fn warn_of_kind(report: &mut LightingReport) {
    let Some(check) = report.kind_check.as_ref().filter(|c| c.contradicts) else {
        return;
    };
    let (Some(stated), Some(fits)) = (check.stated, check.fits) else {
        return;
    };
    let word = |kind| match kind {
        LightKind::World => "fixed in the world (\"world\")",
        LightKind::Camera => "fixed to the camera (\"camera\")",
    };
    report.warnings.push(format!(
        "the light is stated as {}, but the sphere's brightness scatters by {:.1} % at equal \
         normals in the world and by {:.1} % at equal normals in the camera: it is {}",
        word(stated),
        100.0 * check.scatter_world,
        100.0 * check.scatter_camera,
        word(fits)
    ));
}

pub(crate) fn ones(num_channels: usize) -> Vec<f64> {
    vec![1.0; num_channels]
}

/// Relative residual of `(value, prediction)` pairs, over those within three deviations.
pub(crate) fn residual_of(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let (sizes, errors): (Vec<f64>, Vec<f64>) = pairs
        .map(|(value, predicted)| (value, (predicted - value).abs()))
        .unzip();
    let mut sorted = errors.clone();
    let limit = 3.0
        * rilievo_numerics::robust::SIGMA_FROM_MAD
        * rilievo_numerics::robust::median(&mut sorted)?;
    let (mut error, mut size) = (0.0, 0.0);
    for (e, s) in errors.iter().zip(&sizes) {
        if *e <= limit {
            error += e * e;
            size += s * s;
        }
    }
    (size > 0.0).then(|| (error / size).sqrt())
}

/// Relative residual of a view's lighting on the spheres that it shows.
fn residual_in(view: &[Counted<'_>], lighting: &Lighting) -> Option<f64> {
    residual_of(view.iter().flat_map(|(patch, paint)| {
        let samples = &patch.samples;
        (0..samples.normals.len()).flat_map(move |k| {
            let channels = lighting.channels.iter().enumerate();
            let usable = channels.filter(move |(channel, _)| samples.usable[k][*channel]);
            usable.map(move |(channel, light)| {
                let predicted = light.evaluate(&samples.normals[k]) * paint[channel];
                (samples.values[k][channel], predicted)
            })
        })
    }))
}

/// Samples of all patches that count, in the world, brightness divided by gain and paint.
fn pool_in_world(side: &Side, gains: &[Vec<f64>], options: &LightingOptions) -> Pool {
    let mut pool = Pool::default();
    let share = options.max_num_samples / side.counted().count().max(1);
    for (patch, paint) in side.counted() {
        let gain = &gains[patch.view];
        let scale: Vec<f64> = gain.iter().zip(paint).map(|(g, p)| g * p).collect();
        let rotation = &side.world_from_cam[patch.view];
        pool.add(&patch.samples, rotation, &scale, share);
    }
    pool
}

/// Gains of the views in `side`, found in two rounds: the first fit tells the slope of the light
/// within a cell of normals, the second comparison removes it.
pub(crate) fn gains_of(side: &Side, options: &LightingOptions) -> Result<Gains, LightingError> {
    let mut gains = gains::find(side, None, options.gains);
    if options.gains == GainMode::Off || side.views.len() < 2 {
        gains.apply = false;
        return Ok(gains);
    }
    for _ in 0..2 {
        let pool = pool_in_world(side, &gains.gain, options);
        let environment = pool.fit("the sphere", options)?;
        gains = gains::find(side, Some(&environment), options.gains);
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
) -> Vec<Vec<f64>> {
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
        let untold: Vec<&str> = (0..posed.views.len())
            .filter(|v| report.views[*v].gain_sigma.is_none())
            .map(|v| posed.views[v].name.as_str())
            .collect();
        if !untold.is_empty() {
            report.warnings.push(format!(
                "the photos' exposures differ, but the sphere does not tell the gain of {}: taken \
                 as 1; fix exposure and white balance, or keep the sphere in every photo",
                untold.join(", ")
            ));
        }
    }
    applied
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
            let in_camera = rotate(environment, &view.cam_from_world.rotation);
            let lighting = scaled(in_camera, &gains[idx]);
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

pub(crate) fn describe(fit: &LightingFit, report: &mut LightingReport) {
    report.channels = fit.channels.iter().map(ChannelReport::from).collect();
    report.dominant_direction = dominant_direction(&fit.lighting()).map(Into::into);
    if fit.channels.iter().any(|channel| channel.order == 1) {
        report.warnings.push(
            "the sphere's pixels do not determine nine harmonics, four were fitted: show more of \
             it, or more views of it"
                .to_owned(),
        );
    }
}

fn from_side_world(
    posed: &PosedViews,
    mut side: Side,
    options: &LightingOptions,
    mut report: LightingReport,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let gains = gains_of(&side, options)?;
    let num_channels = gains.gain[0].len();
    let applied = report_gains(posed, &side, &gains, num_channels, &mut report);
    let in_side: Vec<Vec<f64>> = side.views.iter().map(|&v| applied[v].clone()).collect();
    agreement::judge(&mut side, &in_side, LightKind::World, options, &mut report);
    let fit = pool_in_world(&side, &in_side, options).fit("the sphere", options)?;
    describe(&fit, &mut report);
    let environment = fit.lighting();
    let views = views_from_environment(posed, &environment, &applied, &side, &mut report);
    Ok((
        LightingCalibration {
            source: LightSource::Sphere,
            kind: LightKind::World,
            environment_in_world: Some(environment),
            views,
            spheres: side.verdicts(posed),
            samples: light_samples::of_spheres(&side),
        },
        report,
    ))
}

fn from_side_camera(
    posed: &PosedViews,
    mut side: Side,
    options: &LightingOptions,
    mut report: LightingReport,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let gains = vec![ones(side.num_channels()); side.views.len()];
    agreement::judge(&mut side, &gains, LightKind::Camera, options, &mut report);
    let mut fits: Vec<(usize, LightingFit)> = Vec::new();
    for &view in &side.views {
        let patches = side.counted_in(view);
        if patches.is_empty() {
            report.views[view].left_out = Some("its spheres see another light".to_owned());
            continue;
        }
        let mut pool = Pool::default();
        let share = options.max_num_samples / patches.len();
        for (patch, paint) in &patches {
            pool.add(&patch.samples, &UnitQuaternion::identity(), paint, share);
        }
        match pool.fit(&posed.views[view].name, options) {
            Ok(fit) => {
                report.views[view].relative_rms = residual_in(&patches, &fit.lighting());
                fits.push((view, fit));
            }
            Err(error) => report.views[view].left_out = Some(error.to_string()),
        }
    }
    let Some((_, worst)) = fits
        .iter()
        .max_by(|a, b| a.1.relative_rms().total_cmp(&b.1.relative_rms()))
    else {
        return Err(LightingError::SphereUnusable {
            reasons: reasons(&report),
        });
    };
    describe(&worst.clone(), &mut report);
    let mut views = Vec::with_capacity(posed.views.len());
    for idx in 0..posed.views.len() {
        let Some((source, fit)) = fits.iter().min_by_key(|(view, _)| view.abs_diff(idx)) else {
            continue;
        };
        if *source != idx {
            report.warnings.push(format!(
                "{}: no usable sphere, lighting taken from {}; right only if nothing changed \
                 between the two",
                posed.views[idx].name, posed.views[*source].name
            ));
        }
        let lighting = fit.lighting();
        views.push(ViewLighting {
            view: ViewIdx(idx),
            residual: report.views[idx].relative_rms,
            gain: ones(lighting.channels.len()),
            lighting,
        });
    }
    Ok((
        LightingCalibration {
            source: LightSource::Sphere,
            kind: LightKind::Camera,
            environment_in_world: None,
            views,
            spheres: side.verdicts(posed),
            samples: light_samples::of_spheres(&side),
        },
        report,
    ))
}
