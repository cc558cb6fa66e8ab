//! The course of a run through the pyramid: search, outer iterations at the coarse level, finer levels, output.

use super::contradiction;
use super::course::{Course, Probe};
use super::iteration::{IterationWeights, PHOTOS_ONLY, iteration_weights};
use super::light::Light;
use super::options::PhotoOptions;
use super::output::{self, Shape};
use super::report::PhotoReport;
use super::views::Scene;
use crate::error::ShadingError;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_scene::{
    Event, Flow, LightSource, LightingCalibration, Observer, PosedViews, ShadedViews, StageId,
};

/// An outer iteration that turns normals by more than this share of what the outer iteration before it did under the same weights
/// is the last: light and shape oscillate, or pixels beside edges change sides.
const SETTLING: f64 = 0.8;

/// Distance within which solved surfaces are fused, footprints: a few times what they lie apart.
pub(crate) const FUSION_PX: f64 = 4.0;

/// σ_c of the last outer iterations at the finest level of all, footprints: tight, since
/// only noise separates the views there, and averaging removes it. Less flattens fine detail.
const FINEST_CONSENSUS_PX: f64 = 0.3;

/// Factor of σ_m around a searched surface, a ninth of the weight of small residuals and a third of that of
/// large ones: the patch search
/// has fixed the depth, and residuals of single pixels are noisy.
const SEARCHED_SIGMA_MATCH_FACTOR: f64 = 3.0;

/// What the light misses of single places, in units of its median residual, that still counts as the light's or the
/// pigment's. Less bends the surface into what neither explains: stains, the light in a deep hole.
const LARGEST_MISS: f64 = 7.0;

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
    let planes = course.find_exposure(posed, lighting.kind)?;
    let mut depths = course.find_surface(posed, &planes)?;
    let mut at = course.scene.coarse;
    course.show(at, "start", &depths);
    let mut solvers = course.solvers(at)?;
    course.outer_iteration(at, &solvers, &mut depths, &PHOTOS_ONLY, None, "photos")?;
    let (light, last) =
        course.iterate_light_and_shape(&mut at, &mut solvers, &mut depths, posed, lighting)?;
    let light = course.finer_levels(&mut at, &mut depths, light, last, posed)?;
    let mut shape = match &light {
        Some(light) if course.shapes_relief(Some(light)) => {
            course.relief(at, depths, light, &last)?
        }
        _ => Shape::new(at, depths),
    };
    shape.depths = course.without_specks(shape.at, shape.depths);
    let appearances = course.appearance(at, &course.at_level(at, &shape), light.as_ref());
    let shaded = output::maps(&course.scene, &shape, (at, &appearances));
    Ok((shaded, course.report))
}

impl Course<'_> {
    /// Outer iterations of light and shape from the coarse level `at`, which `at` is again afterwards.
    ///
    /// Where the searched depths are noisy the first ones run at half the resolution: shading's false
    /// minima are small dents then, and most are overlooked there. Returns the last light and weights.
    fn iterate_light_and_shape(
        &mut self,
        at: &mut usize,
        solvers: &mut Vec<PlateSolver>,
        depths: &mut Vec<Vec<f64>>,
        posed: &PosedViews,
        lighting: &LightingCalibration,
    ) -> Result<(Option<Light>, IterationWeights), ShadingError> {
        let options = self.options;
        *depths = self.fused(*at, depths, FUSION_PX)?;
        self.show(*at, "fused", depths);
        if options.num_outer_iterations == 0 {
            self.outer_iteration(*at, solvers, depths, &PHOTOS_ONLY, None, "photos, fused")?;
            return Ok((None, PHOTOS_ONLY));
        }
        let is_from_elsewhere = matches!(
            lighting.source,
            LightSource::Given | LightSource::CalibrationPhoto
        );
        if is_from_elsewhere {
            let frames = self.scene.frames.iter();
            let names: Vec<&str> = frames.map(|frame| frame.name.as_str()).collect();
            let level = &self.scene.pyramid[*at];
            match contradiction::refuse(level, &names, depths, lighting) {
                Err(_) if options.trust_lighting => {
                    let flow = self.observer.event(Event::Warning {
                        stage: StageId::Shading,
                        message:
                            "the light from elsewhere contradicts the photos and is used all the same: \
                                  normals err towards it"
                                .to_owned(),
                    });
                    if flow == Flow::Stop {
                        return Err(ShadingError::Interrupted);
                    }
                }
                other => other?,
            }
        }
        let ground = self.ground(*at, depths, posed);
        let is_noisy = self.report.search_scatter_px > options.noisy_search_px;
        let num_half = if is_noisy && *at + 1 < self.scene.pyramid.len() {
            options.num_half_iterations
        } else {
            0
        };
        // After them the surface is no rough start any more.
        let first_full = usize::from(num_half > 0 && options.num_outer_iterations > 1);
        let num_planned = num_half + options.num_outer_iterations - first_full;
        let mut kept = None;
        if num_half > 0 {
            let reduced = self.reduced(*at, depths);
            kept = Some((std::mem::replace(depths, reduced.clone()), reduced));
            *at += 1;
            *solvers = self.solvers(*at)?;
        }
        let mut residual = 1.0_f64;
        let mut iteration = 0;
        let mut turned_before = f64::INFINITY;
        loop {
            if iteration == num_half
                && let Some((fine, before)) = kept.take()
            {
                *at -= 1;
                *solvers = self.solvers(*at)?;
                *depths = self.raised(*at, &fine, &before, depths);
                self.show(*at, "raised", depths);
            }
            if iteration > 0 {
                *depths = self.fused(*at, depths, FUSION_PX)?;
                self.show(*at, "fused", depths);
            }
            let mut light = self.light(*at, depths, posed, lighting, ground.as_ref())?;
            let found = light.as_ref().map_or(1.0, Light::residual);
            // What the finer surface adds to the residual at first is its own noise, not the light's.
            residual = if iteration > 0 && iteration == num_half {
                found.min(residual)
            } else {
                found
            };
            let mut weights = if iteration < num_half {
                iteration_weights(iteration, residual)
            } else {
                iteration_weights(iteration - num_half + first_full, residual)
            };
            if iteration + 1 >= num_planned {
                if self.is_last(*at, light.as_ref()) {
                    weights.consensus_px = FINEST_CONSENSUS_PX;
                }
                self.validate(*at, solvers, depths, light.as_mut(), &weights)?;
            }
            let turned_deg = self.outer_iteration(
                *at,
                solvers,
                depths,
                &weights,
                light.as_ref(),
                "light and shape",
            )?;
            iteration += 1;
            if iteration >= num_planned {
                let is_still = turned_deg < options.outer_turn_deg;
                let keeps_turning = turned_deg > SETTLING * turned_before;
                if is_still
                    || keeps_turning
                    || iteration >= num_planned + options.max_more_iterations
                {
                    return Ok((light, weights));
                }
                turned_before = turned_deg;
            }
        }
    }

    /// Whether no finer level than `at` is solved as a whole.
    fn is_finest(&self, at: usize) -> bool {
        at == 0 || self.scene.pyramid[at - 1].mean_pixels() > self.options.max_fine_pixels
    }

    /// Whether no finer level than `at` is solved, be it as a whole or by tiles.
    fn is_last(&self, at: usize, light: Option<&Light>) -> bool {
        self.is_finest(at) && (at == 0 || !self.shapes_relief(light))
    }

    /// Whether the levels beyond are solved by tiles: under a light, where the photos agree on it. Where they do not,
    /// single pixels tell more of gloss and dirt than of relief.
    fn shapes_relief(&self, light: Option<&Light>) -> bool {
        self.options.num_relief_rounds > 0 && light.is_some() && !self.photos_disagree()
    }

    /// From level `at` to the finest that is solved as a whole, each with the light and weights of the last outer iteration.
    /// Returns the finest level's.
    fn finer_levels(
        &mut self,
        at: &mut usize,
        depths: &mut Vec<Vec<f64>>,
        mut light: Option<Light>,
        last: IterationWeights,
        posed: &PosedViews,
    ) -> Result<Option<Light>, ShadingError> {
        while !self.is_finest(*at) {
            *at -= 1;
            let searches = self.options.finer_search && self.photos_disagree();
            // Photos that disagree hold the surface weakly: too stiff a system for conjugate gradients.
            let solvers = if searches {
                self.solvers(*at)?
            } else {
                self.finer_solvers(*at)
            };
            let finer = self.descend(*at, &solvers, depths)?;
            *depths = finer;
            self.show(*at, "finer start", depths);
            if searches {
                *depths = self.search_again(*at, &solvers, depths, posed)?;
            }
            light = light.map(|light| self.finer_light(*at, depths, &light));
            let mut weights = finer_weights(&last, searches, self.is_last(*at, light.as_ref()));
            if let (Some(shading), Some(light)) = (&mut weights.shading, &light) {
                let miss = LARGEST_MISS * light.residual();
                shading.max_correction = shading.max_correction.max(miss);
            }
            self.outer_iteration(*at, &solvers, depths, &weights, light.as_ref(), "finer")?;
            *depths = self.fused(*at, depths, FUSION_PX)?;
            self.show(*at, "fused", depths);
        }
        Ok(light)
    }
}

/// Weights at a level finer than that of the outer iterations, from those of the `last` of them; `is_searched` tells
/// whether depth was searched there again.
pub(crate) fn finer_weights(
    last: &IterationWeights,
    is_searched: bool,
    is_finest: bool,
) -> IterationWeights {
    let mut weights = IterationWeights {
        sigma_match_factor: if is_searched {
            SEARCHED_SIGMA_MATCH_FACTOR
        } else {
            1.0
        },
        consensus_px: if is_finest {
            FINEST_CONSENSUS_PX
        } else {
            PHOTOS_ONLY.consensus_px
        },
        visible_px: 3.5,
        plate_threshold: 0.05,
        ..*last
    };
    if let Some(shading) = &mut weights.shading {
        // Single pixels of the finer level are noisier.
        shading.sigma *= 1.4;
        shading.chroma_share *= 1.4;
        shading.correction_px = 12.0;
    }
    weights
}
