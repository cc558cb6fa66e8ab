//! Lighting from the reference sphere beside the object.
//!
//! # Steps
//! 1. Usable pixels of the sphere in every view ([`crate::samples`]).
//! 2. Gains of the photos and the kind of light from the sphere alone ([`crate::gains`],
//!    [`crate::kind`]).
//! 3. World: one robust fit over all views, normals turned into the world and intensities divided
//!    by the gains; rotated into each camera and multiplied by its gain. Camera: one fit per view;
//!    a view without a usable sphere takes the lighting of the nearest one, and says so.
//! 4. A calibration photo ([`crate::calibration`]) replaces step 3's fit; the sphere beside the object still gives the gains.

use crate::calibration::from_calibration;
use crate::gains::{self, Gains};
use crate::options::GainMode;
use crate::report::{ChannelReport, LightingReport, ViewLightReport};
use crate::samples::{SphereSamples, of_sphere};
use crate::{LightingError, LightingOptions, kind, place};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rilievo_photometry::harmonics::{LightingFit, dominant_direction, fit_lighting, rotate};
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_scene::{
    Event, Flow, LightKind, LightSource, Lighting, LightingCalibration, Observer, PhotoSet,
    PosedViews, SphereRequest, StageId, ViewIdx, ViewLighting,
};

pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    request: &SphereRequest,
    options: &LightingOptions,
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    if posed.sphere.is_none() && request.calibration.is_empty() {
        return Err(LightingError::NoSphere);
    }
    let mut report = LightingReport {
        source: LightSource::Sphere,
        kind: request.light,
        ..LightingReport::default()
    };
    let side = collect_views(photos, posed, options, observer, &mut report)?;
    let rotations: Vec<_> = side
        .views
        .iter()
        .map(|&v| posed.views[v].cam_from_world.rotation.inverse())
        .collect();
    report.kind_check = kind::check(&side.samples, &rotations, request.light);
    warn_of_kind(&mut report);
    report.warnings.extend(place::warn(posed));
    if request.calibration.is_empty() {
        if side.views.is_empty() {
            return Err(LightingError::SphereUnusable {
                reasons: reasons(&report),
            });
        }
        match request.light {
            LightKind::World => from_side_world(posed, &side, &rotations, options, report),
            LightKind::Camera => from_side_camera(posed, &side, options, report),
        }
    } else {
        report.source = LightSource::CalibrationPhoto;
        from_calibration(photos, posed, request, (&side, &rotations), options, report)
    }
}

/// The sphere in the views that show enough of it.
pub(crate) struct Side {
    /// Indices of those views.
    pub views: Vec<usize>,
    /// Their samples.
    pub samples: Vec<SphereSamples>,
}

fn collect_views(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &LightingOptions,
    observer: &dyn Observer,
    report: &mut LightingReport,
) -> Result<Side, LightingError> {
    let mut side = Side {
        views: Vec::new(),
        samples: Vec::new(),
    };
    for (idx, view) in posed.views.iter().enumerate() {
        let flow = observer.event(Event::Progress {
            stage: StageId::Lighting,
            step: "reading the sphere".to_owned(),
            done: idx,
            total: posed.views.len(),
        });
        if flow == Flow::Stop {
            return Err(LightingError::Interrupted);
        }
        let mut facts = ViewLightReport::named(&view.name);
        if let Some(sphere) = &posed.sphere {
            let photo = &photos.photos[view.photo.0];
            let in_camera = SphereInCamera {
                center: view
                    .cam_from_world
                    .apply(&Point3::from(sphere.center_in_world)),
                radius: sphere.radius,
            };
            // Where the outline was looked for and not found, something hides the sphere.
            let hidden = !sphere.seen_in.is_empty()
                && sphere.seen_in.iter().all(|(photo, _)| *photo != view.photo);
            if in_camera.cone().is_none() {
                facts.left_out = Some("the sphere lies behind the camera".to_owned());
            } else if hidden {
                facts.left_out = Some("the sphere's outline is not seen in it".to_owned());
            } else {
                let image = photo.pixels.load()?;
                let samples = of_sphere(
                    &image,
                    photo.mask.as_deref(),
                    photo.clip_level,
                    &view.intrinsics,
                    &in_camera,
                    options,
                );
                facts.num_pixels = samples.num_usable();
                facts.clipped_share = samples.clipped_share;
                facts.hidden_share = samples.hidden_share;
                facts.radius_px = Some(samples.radius_px);
                if facts.num_pixels >= options.min_num_pixels {
                    side.views.push(idx);
                    side.samples.push(samples);
                } else {
                    facts.left_out = Some(format!(
                        "{} usable pixels of the sphere ({:.0} % hidden, {:.0} % clipped)",
                        facts.num_pixels,
                        100.0 * facts.hidden_share,
                        100.0 * facts.clipped_share
                    ));
                }
            }
        }
        report.views.push(facts);
    }
    Ok(side)
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
    let word = |kind| match kind {
        LightKind::World => "fixed in the world (\"world\")",
        LightKind::Camera => "fixed to the camera (\"camera\")",
    };
    let fits = match check.stated {
        LightKind::World => LightKind::Camera,
        LightKind::Camera => LightKind::World,
    };
    report.warnings.push(format!(
        "the light is stated as {}, but the sphere's brightness scatters by {:.1} % at equal \
         normals in the world and by {:.1} % at equal normals in the camera: it is {}",
        word(check.stated),
        100.0 * check.scatter_world,
        100.0 * check.scatter_camera,
        word(fits)
    ));
}

/// Samples of several views in one frame, intensities divided by the gains where they apply.
#[derive(Default)]
pub(crate) struct Pool {
    normals: Vec<Vector3<f64>>,
    values: Vec<Vec<f64>>,
    usable: Vec<Vec<bool>>,
}

impl Pool {
    pub fn add(
        &mut self,
        samples: &SphereSamples,
        rotation: &UnitQuaternion<f64>,
        gain: &[f64],
        max_num: usize,
    ) {
        let stride = samples.normals.len().div_ceil(max_num.max(1)).max(1);
        for k in (0..samples.normals.len()).step_by(stride) {
            self.normals.push(rotation * samples.normals[k]);
            let values = samples.values[k].iter().zip(gain).map(|(v, g)| v / g);
            self.values.push(values.collect());
            self.usable.push(samples.usable[k].clone());
        }
    }

    pub fn fit(&self, of: &str, options: &LightingOptions) -> Result<LightingFit, LightingError> {
        fit_lighting(&self.normals, &self.values, &self.usable, &options.fit).map_err(|source| {
            LightingError::Fit {
                of: of.to_owned(),
                source,
            }
        })
    }
}

pub(crate) fn ones(num_channels: usize) -> Vec<f64> {
    vec![1.0; num_channels]
}

/// Relative residual of a lighting on samples, over the pixels within three deviations.
pub(crate) fn residual_of(samples: &SphereSamples, lighting: &Lighting) -> Option<f64> {
    let (mut errors, mut sizes) = (Vec::new(), Vec::new());
    for k in 0..samples.normals.len() {
        for (channel, light) in lighting.channels.iter().enumerate() {
            if samples.usable[k][channel] {
                let value = samples.values[k][channel];
                errors.push((light.evaluate(&samples.normals[k]) - value).abs());
                sizes.push(value);
            }
        }
    }
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

/// Gains of the views in `side`, found in two rounds: the first fit tells the slope of the light
/// within a cell of normals, the second comparison removes it.
pub(crate) fn gains_of(
    side: &Side,
    rotations: &[UnitQuaternion<f64>],
    options: &LightingOptions,
) -> Result<Gains, LightingError> {
    let mut gains = gains::find(&side.samples, rotations, None, options.gains);
    if options.gains == GainMode::Off || side.views.len() < 2 {
        gains.apply = false;
        return Ok(gains);
    }
    for _ in 0..2 {
        let mut pool = Pool::default();
        for ((samples, rotation), gain) in side.samples.iter().zip(rotations).zip(&gains.gain) {
            let share = options.max_num_samples / side.views.len();
            pool.add(samples, rotation, gain, share);
        }
        let environment = pool.fit("the sphere", options)?;
        gains = gains::find(&side.samples, rotations, Some(&environment), options.gains);
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

fn scaled(lighting: Lighting, gain: &[f64]) -> Lighting {
    let mut lighting = lighting;
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
            let residual = side
                .views
                .iter()
                .position(|&v| v == idx)
                .and_then(|k| residual_of(&side.samples[k], &lighting));
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
    side: &Side,
    rotations: &[UnitQuaternion<f64>],
    options: &LightingOptions,
    mut report: LightingReport,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let gains = gains_of(side, rotations, options)?;
    let num_channels = gains.gain[0].len();
    let applied = report_gains(posed, side, &gains, num_channels, &mut report);
    let mut pool = Pool::default();
    for (k, &view) in side.views.iter().enumerate() {
        let share = options.max_num_samples / side.views.len();
        pool.add(&side.samples[k], &rotations[k], &applied[view], share);
    }
    let fit = pool.fit("the sphere", options)?;
    describe(&fit, &mut report);
    let environment = fit.lighting();
    let views = views_from_environment(posed, &environment, &applied, side, &mut report);
    Ok((
        LightingCalibration {
            source: LightSource::Sphere,
            kind: LightKind::World,
            environment_in_world: Some(environment),
            views,
        },
        report,
    ))
}

fn from_side_camera(
    posed: &PosedViews,
    side: &Side,
    options: &LightingOptions,
    mut report: LightingReport,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let mut fits: Vec<(usize, LightingFit)> = Vec::new();
    for (samples, &view) in side.samples.iter().zip(&side.views) {
        let mut pool = Pool::default();
        let num_channels = samples.values.first().map_or(1, Vec::len);
        pool.add(
            samples,
            &UnitQuaternion::identity(),
            &ones(num_channels),
            options.max_num_samples,
        );
        match pool.fit(&posed.views[view].name, options) {
            Ok(fit) => {
                report.views[view].relative_rms = residual_of(samples, &fit.lighting());
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
        },
        report,
    ))
}
