//! Lighting from a photo of a sphere in the object's place.
//!
//! The calibration sphere stands where the object stood, so that nothing of the object's shadow or
//! bounce light is missing or added. Its photo was taken by the camera of one view; normals need
//! only the outline, whatever its radius. Spheres beside the object, where there are any, still
//! give the gains of the photos.

use crate::environment::{describe, gains_of, ones, report_gains, views_from_environment};
use crate::error::LightingError;
use crate::light_samples;
use crate::pool::Pool;
use crate::report::LightingReport;
use crate::side::Side;
use nalgebra::UnitQuaternion;
use rilievo_photometry::samples::{Shot, SphereSamples};
use rilievo_photometry::sphere::{cone_from_mark, detect_in_photo};
use rilievo_photometry::surface_check::MAX_SAMPLES;
use rilievo_scene::{
    LightKind, LightSource, LightingCalibration, Observer, PhotoSet, PosedViews, SphereCalibration,
    SphereRequest, ViewIdx, ViewLighting,
};

pub(crate) fn from_calibration(
    photos: &PhotoSet,
    posed: &PosedViews,
    request: &SphereRequest,
    side: &Side,
    mut report: LightingReport,
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let mut pool = Pool::default();
    let mut points = light_samples::of_spheres(side);
    let mut num_channels = 1;
    for calibration in &request.calibration {
        let (samples, camera) = calibration_samples(photos, posed, calibration)?;
        let world_from_cam = posed.views[camera.0].cam_from_world.rotation.inverse();
        num_channels = calibration.image.channels;
        let frame = match report.kind {
            LightKind::World => world_from_cam,
            LightKind::Camera => UnitQuaternion::identity(),
        };
        let share = MAX_SAMPLES / request.calibration.len();
        pool.add(&samples.readings, &frame, &ones(num_channels), share);
        points.extend(light_samples::of_calibration(
            &samples,
            camera,
            report.kind,
            posed,
        ));
    }
    let fit = pool.fit("the calibration photo")?;
    describe(&fit, &mut report, observer)?;
    let (environment_in_world, views) = match report.kind {
        LightKind::World => {
            let applied = if side.views.len() > 1 {
                let gains = gains_of(side)?;
                report_gains(posed, side, &gains, num_channels, &mut report, observer)?
            } else {
                vec![ones(num_channels); posed.views.len()]
            };
            let environment = fit.lighting();
            let views = views_from_environment(posed, &environment, &applied, side, &mut report);
            (Some(environment), views)
        }
        LightKind::Camera => {
            let views = (0..posed.views.len()).map(|idx| ViewLighting {
                view: ViewIdx(idx),
                lighting: fit.lighting(),
                residual: Some(fit.relative_rms()),
                gain: ones(num_channels),
            });
            (None, views.collect())
        }
    };
    Ok((
        LightingCalibration {
            source: LightSource::CalibrationPhoto,
            kind: report.kind,
            environment_in_world,
            views,
            spheres: Vec::new(),
            samples: points,
        },
        report,
    ))
}

/// Samples of a calibration sphere, with the view of its camera.
fn calibration_samples(
    photos: &PhotoSet,
    posed: &PosedViews,
    calibration: &SphereCalibration,
) -> Result<(SphereSamples, ViewIdx), LightingError> {
    let of_sphere_error = |source| LightingError::Sphere {
        of: calibration.name.clone(),
        source,
    };
    let (idx, camera) = posed
        .views
        .iter()
        .enumerate()
        .find(|(_, view)| view.photo == calibration.same_camera_as)
        .ok_or_else(|| LightingError::CalibrationCamera {
            name: calibration.name.clone(),
            camera: photos
                .photos
                .get(calibration.same_camera_as.0)
                .map_or_else(String::new, |photo| photo.file_name.clone()),
        })?;
    let photo = &photos.photos[camera.photo.0];
    let num_channels = photo.linear()?.channels;
    if calibration.image.channels != num_channels {
        return Err(LightingError::CalibrationChannels {
            name: calibration.name.clone(),
            found: calibration.image.channels,
            photos: num_channels,
        });
    }
    let clip_level = photo.clip_level;
    let intrinsics = &camera.intrinsics;
    let cone = match &calibration.mark {
        Some(mark) => cone_from_mark(mark, intrinsics).map(|fit| fit.cone),
        None => detect_in_photo(&calibration.image, intrinsics, clip_level),
    }
    .map_err(of_sphere_error)?;
    // Normals do not depend on the radius: any serves.
    let shot = Shot {
        image: &calibration.image,
        object: None,
        clip_level,
        intrinsics,
    };
    let samples = shot.samples(&cone.sphere(1.0), &[]);
    Ok((samples, ViewIdx(idx)))
}
