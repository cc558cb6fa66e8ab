//! The course of a run through the pyramid: search, laps at the coarse level, finer levels, output.

use super::course::{Course, Probe};
use super::lap::{LapWeights, PHOTOS_ONLY, lap_weights};
use super::light::Light;
use super::options::PhotoOptions;
use super::output;
use super::report::PhotoReport;
use super::views::Scene;
use crate::error::ShadingError;
use rilievo_scene::{LightingCalibration, Observer, PosedViews, ShadedViews};

/// Solves a loaded scene.
pub(crate) fn solve(
    scene: Scene,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &PhotoOptions,
    observer: &dyn Observer,
    probe: Option<&Probe>,
) -> Result<(ShadedViews, PhotoReport), ShadingError> {
    let mut course = Course {
        scene,
        options,
        observer,
        report: PhotoReport::default(),
        sigma_match: 0.0,
        probe,
    };
    if course.scene.frames.len() < 2 {
        return Err(ShadingError::NoDepth {
            view: course.scene.frames[0].name.clone(),
        });
    }
    let exposure = course.find_exposure(posed)?;
    let mut depths = course.find_surface(posed, &exposure)?;
    let mut at = course.scene.coarse;
    course.show(at, "start", &depths);
    let mut solvers = course.solvers(at)?;
    let rounds = options.max_num_rounds;
    course.lap(
        at,
        &solvers,
        &mut depths,
        &PHOTOS_ONLY,
        None,
        "photos",
        rounds,
    )?;
    let ground = course.ground(at, &depths, posed);
    let mut light = None;
    let mut last = PHOTOS_ONLY;
    for lap in 0..options.num_laps {
        depths = course.fused(at, &depths)?;
        course.show(at, "fused", &depths);
        light = course.light(at, &depths, posed, lighting.kind, ground.as_ref())?;
        let residual = light.as_ref().map_or(1.0, Light::residual);
        last = lap_weights(lap, residual);
        if lap + 1 == options.num_laps {
            course.validate(at, &solvers, &depths, light.as_mut(), &last)?;
        }
        course.lap(
            at,
            &solvers,
            &mut depths,
            &last,
            light.as_ref(),
            "light and shape",
            5,
        )?;
    }
    if options.num_laps == 0 {
        depths = course.fused(at, &depths)?;
        course.lap(
            at,
            &solvers,
            &mut depths,
            &PHOTOS_ONLY,
            None,
            "photos, fused",
            3,
        )?;
    }
    let mut final_weights = last;
    while at > 0 && course.scene.pyramid[at - 1].mean_pixels() <= options.max_fine_pixels {
        at -= 1;
        solvers = course.solvers(at)?;
        depths = course.descend(at, &solvers, &depths)?;
        course.show(at, "finer start", &depths);
        light = light.map(|light| course.finer_light(at, &depths, &light));
        let mut weights = LapWeights {
            consensus_px: 0.9,
            visible_px: 3.5,
            plate_knee: 0.05,
            ..last
        };
        if let Some(shading) = &mut weights.shading {
            // Single pixels of the finer level are noisier.
            shading.sigma *= 1.4;
            shading.correction_px = 12.0;
        }
        let rounds = options.num_fine_rounds;
        final_weights = weights;
        course.lap(
            at,
            &solvers,
            &mut depths,
            &weights,
            light.as_ref(),
            "finer",
            rounds,
        )?;
    }
    let appearances = course.appearance(at, &depths, light.as_ref(), &final_weights);
    let shaded = output::maps(&course.scene, at, &depths, &appearances);
    Ok((shaded, course.report))
}
