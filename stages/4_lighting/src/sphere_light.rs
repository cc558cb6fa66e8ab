//! Lighting from the reference spheres beside the object.
//!
//! # Steps
//! 1. Usable pixels of the spheres in every view ([`crate::side`]).
//! 2. Gains of the photos and the kind of light from the spheres alone ([`crate::gains`],
//!    [`crate::kind`]).
//! 3. Of several spheres, those that see one light ([`crate::agreement`]).
//! 4. World: one robust fit over all views and spheres, normals turned into the world and
//!    intensities divided by the gains; rotated into each camera and multiplied by its gain
//!    ([`crate::environment`]). Camera: one fit per view; a view without a usable sphere takes the
//!    lighting of the nearest one, and says so.
//! 5. A calibration photo ([`crate::calibration`]) replaces step 4's fit; the spheres beside the
//!    object still give the gains.

use crate::calibration::from_calibration;
use crate::environment::{
    describe, gains_of, ones, pool_in_world, report_gains, views_from_environment,
};
use crate::error::LightingError;
use crate::error::warn;
use crate::pool::Pool;
use crate::report::LightingReport;
use crate::residual::residual_in;
use crate::side::{Side, collect};
use crate::{agreement, kind, light_samples, place};
use nalgebra::UnitQuaternion;
use rilievo_photometry::harmonics::LightingFit;
use rilievo_photometry::surface_check::MAX_SAMPLES;
use rilievo_scene::{
    LightKind, LightSource, LightingCalibration, Observer, PhotoSet, PosedViews, SphereRequest,
    ViewIdx, ViewLighting,
};

pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    request: &SphereRequest,
    min_num_pixels: usize,
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
    let side = collect(photos, posed, min_num_pixels, observer, &mut report)?;
    report.kind_check = kind::check(&side, request.light);
    report.kind = kind::settled(request.light, report.kind_check.as_ref());
    for message in wrong_kind(&report).into_iter().chain(place::odd(posed)) {
        warn(observer, message)?;
    }
    if request.calibration.is_empty() {
        if side.views.is_empty() {
            return Err(LightingError::SphereUnusable {
                reasons: reasons(&report),
            });
        }
        match report.kind {
            LightKind::World => from_side_world(posed, side, report, observer),
            LightKind::Camera => from_side_camera(posed, side, report, observer),
        }
    } else {
        report.source = LightSource::CalibrationPhoto;
        from_calibration(photos, posed, request, &side, report, observer)
    }
}

fn reasons(report: &LightingReport) -> Vec<String> {
    report
        .views
        .iter()
        .filter_map(|v| Some(format!("{}: {}", v.name, v.left_out.as_ref()?)))
        .collect()
}

/// Warning of a stated kind of light that the spheres contradict.
fn wrong_kind(report: &LightingReport) -> Option<String> {
    let check = report.kind_check.as_ref().filter(|c| c.contradicts)?;
    let (stated, fits) = (check.stated?, check.fits?);
    let word = |kind| match kind {
        LightKind::World => "fixed in the world (\"world\")",
        LightKind::Camera => "fixed to the camera (\"camera\")",
    };
    Some(format!(
        "the light is stated as {}, but the sphere's brightness scatters by {:.1} % at equal \
         normals in the world and by {:.1} % at equal normals in the camera: it is {}",
        word(stated),
        100.0 * check.scatter_world,
        100.0 * check.scatter_camera,
        word(fits)
    ))
}

fn from_side_world(
    posed: &PosedViews,
    mut side: Side,
    mut report: LightingReport,
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let gains = gains_of(&side)?;
    let num_channels = gains.gain[0].len();
    let applied = report_gains(posed, &side, &gains, num_channels, &mut report, observer)?;
    let in_side: Vec<Vec<f64>> = side.views.iter().map(|&v| applied[v].clone()).collect();
    agreement::judge(&mut side, &in_side, LightKind::World, &mut report, observer)?;
    let fit = pool_in_world(&side, &in_side).fit("the sphere")?;
    describe(&fit, &mut report, observer)?;
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
    mut report: LightingReport,
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let gains = vec![ones(side.num_channels()); side.views.len()];
    agreement::judge(&mut side, &gains, LightKind::Camera, &mut report, observer)?;
    let mut fits: Vec<(usize, LightingFit)> = Vec::new();
    for &view in &side.views {
        let patches = side.counted_in(view);
        if patches.is_empty() {
            report.views[view].left_out = Some("its spheres see another light".to_owned());
            continue;
        }
        let mut pool = Pool::default();
        let share = MAX_SAMPLES / patches.len();
        for (patch, paint) in &patches {
            pool.add(
                &patch.samples.readings,
                &UnitQuaternion::identity(),
                paint,
                share,
            );
        }
        match pool.fit(&posed.views[view].name) {
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
    describe(&worst.clone(), &mut report, observer)?;
    let mut views = Vec::with_capacity(posed.views.len());
    for idx in 0..posed.views.len() {
        let Some((source, fit)) = fits.iter().min_by_key(|(view, _)| view.abs_diff(idx)) else {
            continue;
        };
        if *source != idx {
            let message = format!(
                "{}: no usable sphere, lighting taken from {}; right only if nothing changed \
                 between the two",
                posed.views[idx].name, posed.views[*source].name
            );
            warn(observer, message)?;
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
