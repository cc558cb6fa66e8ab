//! The order of a run's phases: first surface, outer iterations at the coarse level, finer levels,
//! relief, output.

use super::contradiction;
use super::light::Light;
use super::options::PhotoOptions;
use super::output::ShapedViews;
use super::progress::{Outcome, OuterIterations, Phase, Progress, ReliefRounds};
use super::report::PhotoReport;
use super::schedule::{IterationWeights, PHOTOS_ONLY};
use super::shape::{Shape, Surface};
use super::solver::{Probe, Solver};
use super::steps::PhotoStep;
use super::views::Scene;
use crate::error::ShadingError;
use crate::surroundings::Surroundings;
use rilievo_scene::{LightSource, LightingCalibration, PosedViews};

/// Outer iterations stop once one turns the normals by more than this share of the turn before it,
/// under the same weights: they no longer converge.
const SETTLING: f64 = 0.8;
/// Mean turn of the normals in the last planned outer iteration, degrees, above which another one
/// follows at full weight: light and shape still change each other.
const OUTER_TURN_DEG: f64 = 2.0;

/// Distance within which solved surfaces are fused, footprints: a few times what they lie apart.
pub(crate) const FUSION_PX: f64 = 4.0;

/// Sharpness below which a photo is warned of.
const BLURRED: f64 = 0.6;
/// Ratio of a channel's gain against green's between photos above which it is warned of: a tenth is
/// a visible tint.
const DRIFTING_COLORS: f64 = 1.1;

/// Cap of the shading correction, in median residuals of the light. Less bends the surface into
/// what neither light nor pigment explains: stains, the light in a deep hole.
const MAX_CORRECTION: f64 = 7.0;

/// Solves a loaded scene, from the kept state if there is one.
pub(crate) fn solve(
    scene: Scene,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &PhotoOptions,
    around: Surroundings<'_>,
    probe: Option<&Probe<'_>>,
) -> Result<(ShapedViews, PhotoReport), ShadingError> {
    let mut solver = Solver {
        scene,
        options,
        around,
        report: PhotoReport::default(),
        probe,
        warnings: Vec::new(),
        exact: None,
        certainty: None,
        fine: None,
    };
    if solver.scene.frames.len() < 2 {
        return Err(ShadingError::NoDepth {
            view: solver.scene.frames[0].name.clone(),
        });
    }
    let (mut progress, mut light) = match solver.resume()? {
        Some(kept) => kept,
        None => (solver.first_surface(posed, lighting)?, None),
    };
    loop {
        let shape = &mut progress.shape;
        let outcome = match progress.phase {
            Phase::Outer(outer) => solver.outer(shape, outer, posed, lighting)?,
            Phase::Finer(last) if shape.at == solver.scene.finest => {
                Outcome::relief(solver.begin_relief(shape, light.as_ref(), last)?)
            }
            Phase::Finer(last) => solver.finer(shape, light.take(), last, posed)?,
            Phase::Relief(rounds) => {
                Outcome::relief(solver.relief(shape, light.as_ref(), rounds)?)
            }
        };
        let new_light = outcome.light.is_some();
        if new_light {
            light = outcome.light;
        }
        let Some(phase) = outcome.next else { break };
        progress.phase = phase;
        solver.keep(&progress, light.as_ref(), new_light)?;
    }
    solver.warn_of_blur()?;
    solver.warn_of_white_balance()?;
    // Light and pigment are known at the finest level that was solved as a whole.
    let at = solver.scene.finest;
    let (surface, reduced): (Box<dyn Surface>, _) = match solver.fine.take() {
        Some(fine) => {
            solver.clean_fine(&fine)?;
            let reduced = solver.reduced_fine(&fine, at)?;
            (Box::new(fine), reduced)
        }
        None => {
            let Shape { at, depths } = progress.shape;
            let depths = solver.without_specks(at, depths);
            let reduced = depths.clone();
            (Box::new(Shape { at, depths }), reduced)
        }
    };
    solver.use_sharpness(at);
    if let Some(light) = &light {
        solver.report_light(light);
    }
    let shaped = ShapedViews::new(solver.scene, surface, reduced, light);
    Ok((shaped, solver.report))
}

impl Solver<'_> {
    /// The surface that the photos' agreement finds, fused, before any light.
    fn first_surface(
        &mut self,
        posed: &PosedViews,
        lighting: &LightingCalibration,
    ) -> Result<Progress, ShadingError> {
        let planes = self.find_exposure(posed, lighting.kind)?;
        let (mut depths, searched) = self.find_surface(posed, &planes)?;
        let at = self.scene.coarse;
        self.show(at, "start", &depths)?;
        let solvers = self.shared_solvers(at);
        let step = PhotoStep::Photos;
        self.rounds(at, &solvers, &mut depths, &PHOTOS_ONLY, None, step)?;
        depths = self.fused(at, &depths, FUSION_PX)?;
        self.show(at, "fused", &depths)?;
        if self.options.num_outer_iterations == 0 {
            self.rounds(at, &solvers, &mut depths, &PHOTOS_ONLY, None, step)?;
            return Ok(Progress {
                shape: Shape { at, depths },
                phase: Phase::Finer(PHOTOS_ONLY),
            });
        }
        self.refuse_contradicting_light(at, &depths, lighting)?;
        let ground = self.ground(at, &depths, posed);
        // From a noisy start the first iterations run at half the resolution: shading's false
        // minima are small dents then, and most are overlooked there.
        let effort = &self.options.effort;
        let is_noisy = self.report.search_scatter_px > effort.noisy_search_px;
        let num_half = if is_noisy && at + 1 < self.scene.num_levels() {
            effort.num_half_iterations
        } else {
            0
        };
        let mut outer = OuterIterations {
            ground,
            searched,
            num_done: 0,
            num_half,
            kept: None,
            residual: 1.0,
            turned_deg: f64::INFINITY,
        };
        let mut shape = Shape { at, depths };
        if num_half > 0 {
            let reduced = self.reduced(at, &shape.depths);
            outer.kept = Some([shape.depths, reduced.clone()]);
            shape = Shape {
                at: at + 1,
                depths: reduced,
            };
        }
        let progress = Progress {
            shape,
            phase: Phase::Outer(outer),
        };
        self.keep(&progress, None, false)?;
        Ok(progress)
    }

    /// Ends the run, or warns if the light is to be used all the same, where a light from elsewhere
    /// contradicts the photos.
    fn refuse_contradicting_light(
        &mut self,
        at: usize,
        depths: &[Vec<f64>],
        lighting: &LightingCalibration,
    ) -> Result<(), ShadingError> {
        if !matches!(
            lighting.source,
            LightSource::Given | LightSource::CalibrationPhoto
        ) {
            return Ok(());
        }
        let frames = self.scene.frames.iter();
        let names: Vec<&str> = frames.map(|frame| frame.name.as_str()).collect();
        let level = self.scene.level(at);
        match contradiction::refuse(level, &names, depths, lighting) {
            Err(_) if self.options.trust_lighting => self.warn(
                "the light from elsewhere contradicts the photos and is used all the same: normals err \
                 towards it"
                    .to_owned(),
            ),
            other => other,
        }
    }

    /// An outer iteration of light and shape. Those at half the coarse level's resolution come first.
    fn outer(
        &mut self,
        shape: &mut Shape,
        mut outer: OuterIterations,
        posed: &PosedViews,
        lighting: &LightingCalibration,
    ) -> Result<Outcome, ShadingError> {
        let options = self.options;
        let number = outer.num_done;
        // Those at half the resolution make up for the first one: the surface is no rough start any
        // more.
        let num_skipped = usize::from(outer.num_half > 0 && options.num_outer_iterations > 1);
        let num_planned = outer.num_half + options.num_outer_iterations - num_skipped;
        if number == outer.num_half
            && let Some([fine, before]) = outer.kept.take()
        {
            let at = shape.at - 1;
            let depths = self.raised(at, &fine, &before, &shape.depths);
            *shape = Shape { at, depths };
            self.show(at, "raised", &shape.depths)?;
        }
        let at = shape.at;
        if number > 0 {
            shape.depths = self.fused(at, &shape.depths, FUSION_PX)?;
            self.show(at, "fused", &shape.depths)?;
            if at == self.scene.coarse {
                // What the last light could not explain has bent the surface, and the next light would follow the bend.
                shape.depths = outer
                    .searched
                    .corrected(self.scene.level(at), &shape.depths);
                self.show(at, "corrected", &shape.depths)?;
            }
        }
        let solvers = self.shared_solvers(at);
        let mut light = self.light(at, &shape.depths, posed, lighting, outer.ground.as_ref())?;
        let found = light.as_ref().map_or(1.0, Light::residual);
        // What the finer surface adds to the residual at first is its own noise, not the light's.
        outer.residual = if number > 0 && number == outer.num_half {
            found.min(outer.residual)
        } else {
            found
        };
        let place = if number < outer.num_half {
            number
        } else {
            number - outer.num_half + num_skipped
        };
        let mut weights = IterationWeights::with_shading(place, outer.residual);
        if number + 1 >= num_planned {
            if self.is_last(at, light.as_ref()) {
                weights = weights.at_finest();
            }
            self.validate(at, &solvers, &shape.depths, light.as_mut(), &weights)?;
        }
        let step = PhotoStep::LightAndShape;
        let depths = &mut shape.depths;
        let turned_deg = self.rounds(at, &solvers, depths, &weights, light.as_ref(), step)?;
        outer.num_done += 1;
        if outer.num_done >= num_planned {
            let is_still = turned_deg < OUTER_TURN_DEG;
            let keeps_turning = turned_deg > SETTLING * outer.turned_deg;
            let most = num_planned + options.effort.max_more_iterations;
            if is_still || keeps_turning || outer.num_done >= most {
                return Ok(Outcome {
                    light,
                    next: Some(Phase::Finer(weights)),
                });
            }
            outer.turned_deg = turned_deg;
        }
        Ok(Outcome {
            light: None,
            next: Some(Phase::Outer(outer)),
        })
    }

    /// Warns of photos out of focus.
    fn warn_of_blur(&mut self) -> Result<(), ShadingError> {
        let views = self.report.views.iter();
        let blurred = views.filter(|view| view.sharpness < BLURRED).map(|view| {
            let share = 100.0 * view.sharpness;
            format!(
                "{} is blurred: its fine detail is {share:.0} % as strong as that of the sharpest photo, so that \
                 it counts less; take it again in focus, or leave it out",
                view.name
            )
        });
        let messages: Vec<String> = blurred.collect();
        let mut messages = messages.into_iter();
        messages.try_for_each(|message| self.warn(message))
    }

    /// Warns of colours that drift from photo to photo: one place of the surface is as red against green in all.
    fn warn_of_white_balance(&mut self) -> Result<(), ShadingError> {
        let tints = |channel: usize| {
            let views = self.report.views.iter();
            let tints = views.map(|view| view.gain[channel] / view.gain[1]);
            let (low, high) = tints.fold((f64::INFINITY, 0.0_f64), |(low, high), tint| {
                (low.min(tint), high.max(tint))
            });
            high / low
        };
        let spread = tints(0).max(tints(2));
        if spread.is_finite() && spread > DRIFTING_COLORS {
            let message = format!(
                "the white balance differs by a factor of {spread:.2} between the photos, and was evened out: fix it"
            );
            self.warn(message)?;
        }
        Ok(())
    }

    /// Whether no level finer than `at` brings the views' surfaces nearer to each other: it is the last one that is solved
    /// as a whole, and searched again, or not followed by tiles.
    fn is_last(&self, at: usize, light: Option<&Light>) -> bool {
        let is_followed = at > 0 && self.shapes_relief(light) && !self.photos_disagree();
        at == self.scene.finest && !is_followed
    }

    /// Whether the levels beyond are solved by tiles, as far as the photos hold detail there.
    fn shapes_relief(&self, light: Option<&Light>) -> bool {
        self.options.num_relief_rounds > 0 && light.is_some()
    }

    /// The start of relief at the levels that are not solved as a whole, if it is shaped.
    fn begin_relief(
        &mut self,
        shape: &Shape,
        light: Option<&Light>,
        last: IterationWeights,
    ) -> Result<Option<ReliefRounds>, ShadingError> {
        let is_shaped = shape.at > 0 && self.shapes_relief(light);
        is_shaped
            .then(|| self.next_relief_level(shape, shape.at, last))
            .transpose()
    }

    /// The next finer level that is solved as a whole, with the light of the one before and the
    /// weights of the last outer iteration.
    fn finer(
        &mut self,
        shape: &mut Shape,
        light: Option<Light>,
        last: IterationWeights,
        posed: &PosedViews,
    ) -> Result<Outcome, ShadingError> {
        // Those of the coarse level have done their work.
        self.exact = None;
        self.certainty = None;
        let at = shape.at - 1;
        let searches = self.options.effort.finer_search && self.photos_disagree();
        // Photos that disagree hold the surface weakly: too stiff a system for conjugate gradients.
        let solvers = if searches {
            self.exact_solvers(at)
        } else {
            self.iterative_solvers(at)
        };
        let mut depths = self.descend(at, &solvers, &shape.depths)?;
        self.measure_sharpness(at, &depths);
        self.show(at, "finer start", &depths)?;
        if searches {
            depths = self.search_again(at, &depths, posed)?;
        }
        let light = light.map(|light| self.finer_light(at, &depths, light));
        let shared_error = match (self.last_match(), &light) {
            (Some(last), Some(light)) => last.shared_error(light.residual()),
            _ => 1.0,
        };
        let is_finest = self.is_last(at, light.as_ref());
        let mut weights = last.finer(searches, is_finest, shared_error);
        if let (Some(shading), Some(light)) = (&mut weights.shading, &light) {
            let cap = MAX_CORRECTION * light.residual();
            shading.max_correction = shading.max_correction.max(cap);
        }
        let step = PhotoStep::Finer;
        self.rounds(at, &solvers, &mut depths, &weights, light.as_ref(), step)?;
        depths = self.fused(at, &depths, FUSION_PX)?;
        self.show(at, "fused", &depths)?;
        *shape = Shape { at, depths };
        Ok(Outcome {
            light,
            next: Some(Phase::Finer(last)),
        })
    }
}
