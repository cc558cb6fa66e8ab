//! The course of a run through the pyramid: search, outer iterations at the coarse level, finer levels, output.

use super::contradiction;
use super::course::{Course, Probe};
use super::iteration::{IterationWeights, PHOTOS_ONLY, iteration_weights};
use super::light::Light;
use super::options::PhotoOptions;
use super::output::ShapedViews;
use super::progress::{After, Next, OuterIterations, Progress};
use super::report::PhotoReport;
use super::shape::{FoundShape, Shape};
use super::views::Scene;
use crate::error::ShadingError;
use crate::surroundings::Surroundings;
use rilievo_scene::{LightSource, LightingCalibration, PosedViews};

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

/// Factor of the increments in every other round at finer levels: without it they end half-way to where the views
/// agree. A surface that was searched again is rough, and longer steps would follow its noise.
const LONG_STEP: f64 = 2.0;

/// Sharpness below which a photo is worth a word.
const BLURRED: f64 = 0.6;
/// Ratio of a channel's gain against green's between photos from which it is told: a tenth is a visible tint.
const DRIFTING_COLORS: f64 = 1.1;

/// What the light misses of single places, in units of its median residual, that still counts as the light's or the
/// pigment's. Less bends the surface into what neither explains: stains, the light in a deep hole.
const LARGEST_MISS: f64 = 7.0;

/// Solves a loaded scene, from the kept state if there is one.
pub(crate) fn solve(
    scene: Scene,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &PhotoOptions,
    surroundings: Surroundings<'_>,
    probe: Option<&Probe<'_>>,
) -> Result<(ShapedViews, PhotoReport), ShadingError> {
    let mut course = Course {
        scene,
        options,
        observer: surroundings.observer,
        checkpoint: surroundings.checkpoint,
        scratch: surroundings.scratch,
        report: PhotoReport::default(),
        probe,
        warnings: Vec::new(),
        solvers: None,
        fine: None,
    };
    if course.scene.frames.len() < 2 {
        return Err(ShadingError::NoDepth {
            view: course.scene.frames[0].name.clone(),
        });
    }
    let (mut progress, mut light) = match course.resume()? {
        Some(kept) => kept,
        None => course.first_surface(posed, lighting)?,
    };
    loop {
        let shape = &mut progress.shape;
        let after = match progress.next {
            Next::Outer(outer) => course.outer(shape, outer, posed, lighting)?,
            Next::Finer(last) if shape.at == course.scene.finest => {
                course.begin_relief(shape, light.as_ref(), last)?
            }
            Next::Finer(last) => course.finer(shape, light.take(), last, posed)?,
            Next::Relief(rounds) => course.relief(shape, light.as_ref(), rounds)?,
        };
        let new_light = after.light.is_some();
        if new_light {
            light = after.light;
        }
        let Some(next) = after.next else { break };
        progress.next = next;
        course.keep(&progress, light.as_ref(), new_light)?;
    }
    course.tell_of_blur()?;
    course.tell_of_white_balance()?;
    // Light and pigment are known at the finest level that was solved as a whole.
    let at = course.scene.finest;
    let (shape, reduced) = match course.fine.take() {
        Some(fine) => {
            course.clean_fine(&fine)?;
            let reduced = course.reduced_fine(&fine, at)?;
            (FoundShape::Fine(fine), reduced)
        }
        None => {
            let Shape { at, depths } = progress.shape;
            let depths = course.without_specks(at, depths);
            let reduced = depths.clone();
            (FoundShape::Whole(Shape { at, depths }), reduced)
        }
    };
    course.use_sharpness(at);
    if let Some(light) = &light {
        course.report_light(light);
    }
    let shaped = ShapedViews::new(course.scene, shape, reduced, light);
    Ok((shaped, course.report))
}

impl Course<'_> {
    /// The surface that the photos' agreement finds, fused, before any light.
    fn first_surface(
        &mut self,
        posed: &PosedViews,
        lighting: &LightingCalibration,
    ) -> Result<(Progress, Option<Light>), ShadingError> {
        let planes = self.find_exposure(posed, lighting.kind)?;
        let mut depths = self.find_surface(posed, &planes)?;
        let at = self.scene.coarse;
        self.show(at, "start", &depths)?;
        let solvers = self.shared_solvers(at);
        self.outer_iteration(at, &solvers, &mut depths, &PHOTOS_ONLY, None, "photos")?;
        depths = self.fused(at, &depths, FUSION_PX)?;
        self.show(at, "fused", &depths)?;
        let options = self.options;
        if options.num_outer_iterations == 0 {
            self.outer_iteration(
                at,
                &solvers,
                &mut depths,
                &PHOTOS_ONLY,
                None,
                "photos, fused",
            )?;
            let shape = Shape { at, depths };
            let next = Next::Finer(PHOTOS_ONLY);
            return Ok((Progress { shape, next }, None));
        }
        self.refuse_contradicting_light(at, &depths, lighting)?;
        let ground = self.ground(at, &depths, posed);
        // From a noisy start the first iterations run at half the resolution: shading's false minima are small dents
        // then, and most are overlooked there.
        let is_noisy = self.report.search_scatter_px > options.noisy_search_px;
        let num_half = if is_noisy && at + 1 < self.scene.num_levels() {
            options.num_half_iterations
        } else {
            0
        };
        let mut outer = OuterIterations {
            ground,
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
            next: Next::Outer(outer),
        };
        self.keep(&progress, None, false)?;
        Ok((progress, None))
    }

    /// Iterations at full resolution that those at half of it make up for: the surface is no rough start any more.
    fn num_skipped(&self, outer: &OuterIterations) -> usize {
        usize::from(outer.num_half > 0 && self.options.num_outer_iterations > 1)
    }

    /// Ends the run, or warns if the light is to be used all the same, where a light from elsewhere contradicts the
    /// photos.
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
    ) -> Result<After, ShadingError> {
        let (number, num_skipped) = (outer.num_done, self.num_skipped(&outer));
        // Those that are done in any case.
        let num_planned = outer.num_half + self.options.num_outer_iterations - num_skipped;
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
        let mut weights = if number < outer.num_half {
            iteration_weights(number, outer.residual)
        } else {
            iteration_weights(number - outer.num_half + num_skipped, outer.residual)
        };
        if number + 1 >= num_planned {
            if self.is_last(at, light.as_ref()) {
                weights.consensus_px = FINEST_CONSENSUS_PX;
            }
            self.validate(at, &solvers, &shape.depths, light.as_mut(), &weights)?;
        }
        let turned_deg = self.outer_iteration(
            at,
            &solvers,
            &mut shape.depths,
            &weights,
            light.as_ref(),
            "light and shape",
        )?;
        outer.num_done += 1;
        let options = self.options;
        if outer.num_done >= num_planned {
            let is_still = turned_deg < options.outer_turn_deg;
            let keeps_turning = turned_deg > SETTLING * outer.turned_deg;
            if is_still
                || keeps_turning
                || outer.num_done >= num_planned + options.max_more_iterations
            {
                return Ok(After {
                    light,
                    next: Some(Next::Finer(weights)),
                });
            }
            outer.turned_deg = turned_deg;
        }
        Ok(After {
            light: None,
            next: Some(Next::Outer(outer)),
        })
    }

    /// Warns of photos out of focus.
    fn tell_of_blur(&mut self) -> Result<(), ShadingError> {
        let views = self.report.views.iter();
        let told: Vec<String> = views
            .filter(|view| view.sharpness < BLURRED)
            .map(|view| {
                let share = 100.0 * view.sharpness;
                format!(
                    "{} is blurred: its fine detail is {share:.0} % as strong as that of the sharpest photo, so that \
                     it counts less; take it again in focus, or leave it out",
                    view.name
                )
            })
            .collect();
        told.into_iter().try_for_each(|message| self.warn(message))
    }

    /// Warns of colours that drift from photo to photo: one place of the surface is as red against green in all.
    fn tell_of_white_balance(&mut self) -> Result<(), ShadingError> {
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

    /// Whether no finer level than `at` is solved, be it as a whole or by tiles.
    fn is_last(&self, at: usize, light: Option<&Light>) -> bool {
        at == self.scene.finest && (at == 0 || !self.shapes_relief(light))
    }

    /// Whether the levels beyond are solved by tiles: under a light, where the photos agree on it. Where they do not,
    /// single pixels tell more of gloss and dirt than of relief.
    fn shapes_relief(&self, light: Option<&Light>) -> bool {
        self.options.num_relief_rounds > 0 && light.is_some() && !self.photos_disagree()
    }

    /// The start of relief at the levels that are not solved as a whole, if it is shaped.
    fn begin_relief(
        &mut self,
        shape: &Shape,
        light: Option<&Light>,
        last: IterationWeights,
    ) -> Result<After, ShadingError> {
        let is_shaped = shape.at > 0 && self.shapes_relief(light);
        let next = is_shaped.then(|| self.next_relief_level(shape, shape.at, last));
        Ok(After {
            light: None,
            next: next.transpose()?.map(Next::Relief),
        })
    }

    /// The next finer level that is solved as a whole, with the light of the one before and the weights of the last
    /// outer iteration.
    fn finer(
        &mut self,
        shape: &mut Shape,
        light: Option<Light>,
        last: IterationWeights,
        posed: &PosedViews,
    ) -> Result<After, ShadingError> {
        // Those of the coarse level have done their work.
        self.solvers = None;
        let at = shape.at - 1;
        let searches = self.options.finer_search && self.photos_disagree();
        // Photos that disagree hold the surface weakly: too stiff a system for conjugate gradients.
        let solvers = if searches {
            self.solvers(at)
        } else {
            self.finer_solvers(at)
        };
        let mut depths = self.descend(at, &solvers, &shape.depths)?;
        self.measure_sharpness(at, &depths);
        self.show(at, "finer start", &depths)?;
        if searches {
            depths = self.search_again(at, &solvers, &depths, posed)?;
        }
        let light = light.map(|light| self.finer_light(at, &depths, light));
        let shared_error = match (self.last_match(), &light) {
            (Some(last), Some(light)) => last.shared_error(light.residual()),
            _ => 1.0,
        };
        let is_finest = self.is_last(at, light.as_ref());
        let mut weights = finer_weights(&last, searches, is_finest, shared_error);
        if let (Some(shading), Some(light)) = (&mut weights.shading, &light) {
            let miss = LARGEST_MISS * light.residual();
            shading.max_correction = shading.max_correction.max(miss);
        }
        self.outer_iteration(at, &solvers, &mut depths, &weights, light.as_ref(), "finer")?;
        depths = self.fused(at, &depths, FUSION_PX)?;
        self.show(at, "fused", &depths)?;
        *shape = Shape { at, depths };
        Ok(After {
            light,
            next: Some(Next::Finer(last)),
        })
    }
}

/// Weights at a level finer than that of the outer iterations, from those of the `last` of them; `is_searched` tells
/// whether depth was searched there again, `shared_error` is [`MatchLeft::shared_error`](super::iteration::MatchLeft::shared_error).
pub(crate) fn finer_weights(
    last: &IterationWeights,
    is_searched: bool,
    is_finest: bool,
    shared_error: f64,
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
        long_step: if is_searched { 1.0 } else { LONG_STEP },
        plate_threshold: 0.05,
        ..*last
    };
    if let Some(shading) = &mut weights.shading {
        // Single pixels of the finer level are noisier. Chroma keeps to its own noise, which is measured per level.
        shading.sigma *= 1.4 * shared_error;
        shading.chroma_share *= 1.4;
        shading.correction_px = 12.0;
    }
    weights
}
