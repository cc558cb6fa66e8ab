//! The course of a run: search, exposure, start, laps, finer levels, output.

use super::consensus;
use super::gains::{self, Exposure};
use super::hull;
use super::level::{self, Level};
use super::light::{self, Light, LightScene};
use super::matching::MatchOptions;
use super::options::PhotoOptions;
use super::output;
use super::patchmatch::{self, PatchCost, PatchMatchOptions, Planes};
use super::report::{LapReport, PhotoReport, PhotoViewReport};
use super::shading::{ShadingTerm, ShadingWeights};
use super::start;
use super::step::{self, StepOptions};
use super::surround;
use super::views::Scene;
use crate::error::ShadingError;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_numerics::plate_system::{PlateError, PlateSolver};
use rilievo_numerics::robust::median;
use rilievo_photometry::visibility::Ground;
use rilievo_scene::{
    Event, Flow, LightKind, LightingCalibration, Mask, Observer, PosedViews, ShadedViews, StageId,
};
use std::time::Instant;

/// Relative noise of 8-bit photographs: no photos agree better than this.
const MIN_DISAGREEMENT: f64 = 0.012;
/// Beyond this the photos hardly show the same object.
const MAX_DISAGREEMENT: f64 = 0.2;
/// The match term's σ as a share of the photos' disagreement: the rest varies slowly over the
/// surface and moves nothing.
const SIGMA_SHARE: f64 = 0.4;

/// Receives the shape after each step, for measurement.
pub type Probe<'a> = dyn Fn(&str, &ShadedViews) + 'a;

/// Everything that the steps of a run share.
pub(crate) struct Course<'a> {
    pub scene: Scene,
    pub options: &'a PhotoOptions,
    pub observer: &'a dyn Observer,
    pub report: PhotoReport,
    pub sigma_match: f64,
    pub probe: Option<&'a Probe<'a>>,
}

/// Weights of one lap.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LapWeights {
    /// Standard deviation of the depth against the other views, pixel footprints.
    pub consensus_px: f64,
    /// Depth difference to a view that sees the point, pixel footprints.
    pub visible_px: f64,
    /// Weight of squared bends.
    pub plate: f64,
    /// Bend at which the plate turns linear.
    pub plate_knee: f64,
    /// Shading, where it takes part.
    pub shading: Option<ShadingWeights>,
}

/// Agreement alone.
const PHOTOS_ONLY: LapWeights = LapWeights {
    consensus_px: 0.9,
    visible_px: 3.5,
    plate: 30.0,
    plate_knee: 0.05,
    shading: None,
};

/// Weights of the laps with shading: it starts weak, on a light fitted to a rough shape, and grows.
///
/// `σ_s = share · r (1 + (r/r₀)²)` of the light's median residual `r`: where the light explains the
/// photos as well as it can (2 to 3 %), shading weighs fully; at a residual of 20 % (pigment, dirt,
/// gloss) it has lost its say, because what it would explain by relief is not relief.
fn lap_weights(lap: usize, residual: f64) -> LapWeights {
    // Residual at which the model's error outweighs relief.
    const RESIDUAL_KNEE: f64 = 0.08;
    // Share, correction's bell in pixels, plate, its knee, consensus and visibility in footprints.
    let table = [
        (0.57, 0.0, 30.0, 0.02, 0.9, 3.5),
        (0.6, 0.0, 30.0, 0.02, 0.9, 3.5),
        (0.5, 8.0, 60.0, 0.05, 0.62, 3.5),
        (0.4, 6.0, 100.0, 0.1, 0.45, 1.8),
    ];
    let (share, correction_px, plate, plate_knee, consensus_px, visible_px) =
        table[lap.min(table.len() - 1)];
    LapWeights {
        consensus_px,
        visible_px,
        plate,
        plate_knee,
        shading: Some(ShadingWeights {
            sigma: share * residual * (1.0 + (residual / RESIDUAL_KNEE).powi(2)),
            knee: 2.0,
            correction_px,
            max_correction: 0.15,
            mean_tolerance: 1.8,
        }),
    }
}

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
    while at > 0 && course.scene.pyramid[at - 1].mean_pixels() <= options.max_fine_pixels {
        at -= 1;
        solvers = course.solvers(at)?;
        depths = course.descend(at, &solvers, &depths)?;
        course.show(at, "finer start", &depths);
        light = light.map(|light| course.finer_light(at, &light));
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
    if let Some(light) = &light {
        for (view, residual) in course.report.views.iter_mut().zip(&light.residuals) {
            view.light_residual = Some(*residual);
        }
    }
    let shaded = output::maps(&course.scene, at, &depths);
    Ok((shaded, course.report))
}

impl Course<'_> {
    /// Tells a step; ends the run when asked to.
    pub(crate) fn tell(&self, step: &str, done: usize, total: usize) -> Result<(), ShadingError> {
        match self.observer.event(Event::Progress {
            stage: StageId::Shading,
            step: step.to_owned(),
            done,
            total,
        }) {
            Flow::Continue => Ok(()),
            Flow::Stop => Err(ShadingError::Interrupted),
        }
    }

    fn failed(&self, view: usize, error: &PlateError) -> ShadingError {
        ShadingError::Numerics {
            view: self.scene.frames[view].name.clone(),
            reason: error.to_string(),
        }
    }

    /// Factorisations of a level, one per view.
    pub(crate) fn solvers(&self, at: usize) -> Result<Vec<PlateSolver>, ShadingError> {
        let results: Vec<_> = self.scene.pyramid[at]
            .views
            .par_iter()
            .map(|view| PlateSolver::new(&view.pixels))
            .collect();
        results
            .into_iter()
            .enumerate()
            .map(|(i, r)| r.map_err(|e| self.failed(i, &e)))
            .collect()
    }

    fn dense_search(
        &self,
        at: usize,
        posed: &PosedViews,
        cost: PatchCost,
        start: Option<&[Planes]>,
    ) -> Result<Vec<Planes>, ShadingError> {
        let level = &self.scene.pyramid[at];
        let points: Vec<Point3<f64>> = posed
            .points
            .iter()
            .map(|p| Point3::from(p.position))
            .chain(posed.anchors.iter().map(|a| Point3::from(a.position)))
            .collect();
        let ranges =
            hull::object_ranges(&level.views, self.scene.masked, &points).ok_or_else(|| {
                ShadingError::NoDepth {
                    view: self.scene.frames[0].name.clone(),
                }
            })?;
        // A pixel of slack: masks of different views never meet exactly.
        let masks: Vec<Mask> = level
            .views
            .iter()
            .map(|v| hull::dilate(&v.mask, 1))
            .collect();
        let options = PatchMatchOptions {
            cost,
            radius_px: 6,
            stride_px: 2,
            // A start needs its planes spread and polished only.
            num_sweeps: if start.is_some() {
                self.options.num_sweeps.div_ceil(2)
            } else {
                self.options.num_sweeps
            },
            num_trials: 6,
            num_best: 3,
            seed: self.options.seed,
        };
        Ok((0..level.views.len())
            .into_par_iter()
            .with_max_len(1)
            .map(|i| {
                let ranges = hull::pixel_ranges(&level.views, &masks, i, ranges[i]);
                patchmatch::search(level, i, &masks, &ranges, start.map(|s| &s[i]), &options)
            })
            .collect())
    }

    /// Gains of the photos, divided out of every level, and the weight of the match term.
    fn find_exposure(
        &mut self,
        posed: &PosedViews,
    ) -> Result<(Exposure, Vec<Planes>), ShadingError> {
        let began = Instant::now();
        let at = (self.scene.coarse + 1).min(self.scene.pyramid.len() - 1);
        self.tell("comparing exposures", 0, 1)?;
        let planes = self.dense_search(at, posed, PatchCost::Correlation, None)?;
        let level = &self.scene.pyramid[at];
        let depths: Vec<Vec<f64>> = planes.iter().map(start::log_depths).collect();
        let agreement = start::agreement(level, &depths, agreement_tolerance(level));
        let exposure = gains::estimate(level, &depths, &agreement);
        for level in &mut self.scene.pyramid {
            for (view, gain) in level.views.iter_mut().zip(&exposure.gains) {
                view.divide_by_gain(*gain);
            }
        }
        for (photo, gain) in self.scene.small.iter_mut().zip(&exposure.gains) {
            photo.divide_by_gain(*gain);
        }
        let disagreement = exposure
            .disagreement
            .clamp(MIN_DISAGREEMENT, MAX_DISAGREEMENT);
        self.sigma_match = SIGMA_SHARE * disagreement;
        self.report.disagreement = exposure.disagreement;
        self.report.sigma_match = self.sigma_match;
        self.report.laps.push(LapReport {
            level: at,
            kind: "exposure".to_owned(),
            seconds: began.elapsed().as_secs_f64(),
            ..LapReport::default()
        });
        self.report.views = self
            .scene
            .frames
            .iter()
            .enumerate()
            .map(|(i, frame)| PhotoViewReport {
                name: frame.name.clone(),
                num_pixels: self.scene.pyramid[0].views[i].pixels.len(),
                sources: self.scene.sources[i]
                    .iter()
                    .map(|&j| self.scene.frames[j].name.clone())
                    .collect(),
                gain: exposure.gains[i],
                disagreement: exposure.per_view[i],
                ..PhotoViewReport::default()
            })
            .collect();
        Ok((exposure, planes))
    }

    /// The surface that the views agree on, continued over their masks.
    fn find_surface(
        &mut self,
        posed: &PosedViews,
        (exposure, planes): &(Exposure, Vec<Planes>),
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let began = Instant::now();
        let at = self.scene.coarse;
        self.tell("searching depth", 0, 1)?;
        // Where brightness is as good as constant, differences tell more than correlation.
        let cost = if exposure.disagreement < 0.055 {
            PatchCost::SquaredDifferences {
                sigma: (2.7 * self.sigma_match) as f32,
            }
        } else {
            PatchCost::Correlation
        };
        let start: Option<Vec<Planes>> = self.scene.pyramid.get(at + 1).map(|coarse| {
            coarse
                .views
                .iter()
                .zip(&self.scene.pyramid[at].views)
                .zip(planes)
                .map(|((coarse, fine), planes)| patchmatch::refine_start(coarse, fine, planes))
                .collect()
        });
        let planes = self.dense_search(at, posed, cost, start.as_deref())?;
        let solvers = self.solvers(at)?;
        let level = &self.scene.pyramid[at];
        let depths: Vec<Vec<f64>> = planes.iter().map(start::log_depths).collect();
        let agreement = start::agreement(level, &depths, agreement_tolerance(level));
        let filled: Vec<_> = level
            .views
            .par_iter()
            .enumerate()
            .map(|(i, view)| {
                let weight: Vec<f64> = agreement[i]
                    .count
                    .iter()
                    .map(|&c| match c {
                        0 => 0.0,
                        1 => 0.5,
                        _ => 1.0,
                    })
                    .collect();
                start::fill(
                    view,
                    &solvers[i],
                    &depths[i],
                    &weight,
                    1.0 / level.focal(),
                    10.0,
                )
            })
            .collect();
        for (i, agreement) in agreement.iter().enumerate() {
            let confirmed = agreement.count.iter().filter(|&&c| c > 0).count();
            self.report.views[i].confirmed = confirmed as f64 / agreement.count.len().max(1) as f64;
        }
        self.report.laps.push(LapReport {
            level: at,
            kind: "search".to_owned(),
            seconds: began.elapsed().as_secs_f64(),
            ..LapReport::default()
        });
        filled
            .into_iter()
            .enumerate()
            .map(|(i, r)| r.map_err(|e| self.failed(i, &e)))
            .collect()
    }

    /// Weights of a step; lengths in footprints of a pixel.
    fn step_options(&self, at: usize, weights: &LapWeights) -> StepOptions {
        let footprint = 1.0 / self.scene.pyramid[at].focal();
        StepOptions {
            matching: MatchOptions {
                sigma: self.sigma_match,
                knee: 2.0,
                visible_tolerance: weights.visible_px * footprint,
                gain_field_px: 8.0,
                left_out: None,
            },
            sigma_consensus: weights.consensus_px * footprint,
            plate_weight: weights.plate,
            plate_knee: weights.plate_knee,
            max_step: 9.0 * footprint,
        }
    }

    /// Gauss-Newton rounds over all views. Views of even and odd number take turns, so that two
    /// views never swap their surfaces.
    #[allow(clippy::too_many_arguments)] // what a lap works on, its weights, and its name in the report
    pub(crate) fn lap(
        &mut self,
        at: usize,
        solvers: &[PlateSolver],
        depths: &mut [Vec<f64>],
        weights: &LapWeights,
        light: Option<&Light>,
        kind: &str,
        num_rounds: usize,
    ) -> Result<(), ShadingError> {
        let began = Instant::now();
        let options = self.step_options(at, weights);
        let mut record = LapReport {
            level: at,
            kind: kind.to_owned(),
            sigma_shading: weights.shading.map_or(0.0, |s| s.sigma),
            ..LapReport::default()
        };
        for round in 0..num_rounds {
            self.tell(kind, round, num_rounds)?;
            let level = &self.scene.pyramid[at];
            let (mut change, mut residuals) = (0.0, Vec::new());
            for parity in 0..2 {
                let rasters = level::depth_rasters(level, depths);
                let outcomes: Vec<_> = (parity..level.views.len())
                    .step_by(2)
                    .collect::<Vec<_>>()
                    .into_par_iter()
                    .with_max_len(1)
                    .map(|i| {
                        let term = light.zip(weights.shading).map(|(light, mut weights)| {
                            weights.mean_tolerance /= level.focal();
                            ShadingTerm::new(
                                level,
                                i,
                                depths,
                                &rasters,
                                &light.harmonics[i],
                                None,
                                &weights,
                            )
                        });
                        let outcome = step::improve(
                            level,
                            i,
                            &solvers[i],
                            depths,
                            &rasters,
                            term.as_ref(),
                            &options,
                        );
                        (i, outcome)
                    })
                    .collect();
                for (i, outcome) in outcomes {
                    let outcome = outcome.map_err(|e| self.failed(i, &e))?;
                    depths[i] = outcome.depth;
                    change += outcome.change.powi(2);
                    residuals.extend(
                        outcome
                            .matches
                            .residual
                            .iter()
                            .zip(&outcome.matches.num_visible)
                            .step_by(7)
                            .filter(|&(_, &n)| n > 0)
                            .map(|(&r, _)| f64::from(r)),
                    );
                    let alone = outcome
                        .matches
                        .num_visible
                        .iter()
                        .filter(|&&n| n == 0)
                        .count();
                    self.report.views[i].seen_alone =
                        alone as f64 / outcome.matches.num_visible.len().max(1) as f64;
                }
            }
            let level = &self.scene.pyramid[at];
            record.last_change = (change / level.views.len() as f64).sqrt() * level.focal();
            record.match_residual = median(&mut residuals).unwrap_or(f64::NAN);
            record.num_rounds = round + 1;
            if record.last_change < self.options.round_tolerance {
                break;
            }
        }
        record.seconds = began.elapsed().as_secs_f64();
        self.report.laps.push(record);
        self.show(at, kind, depths);
        Ok(())
    }

    /// All views' surfaces made one.
    pub(crate) fn fused(
        &self,
        at: usize,
        depths: &[Vec<f64>],
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let level = &self.scene.pyramid[at];
        self.tell("fusing views", 0, 1)?;
        Ok(consensus::fuse(level, depths, 4.0 / level.focal()))
    }

    /// The ground under the object, where sparse points show one.
    fn ground(&self, at: usize, depths: &[Vec<f64>], posed: &PosedViews) -> Option<Ground> {
        let level = &self.scene.pyramid[at];
        let points: Vec<Point3<f64>> = posed
            .points
            .iter()
            .map(|p| Point3::from(p.position))
            .collect();
        let mut object = Vec::new();
        for (view, depth) in level.views.iter().zip(depths) {
            for p in (0..view.pixels.len()).step_by(29) {
                let (x, y) = view.xy(p);
                object.push(view.camera.unproject(x, y, depth[p].exp()));
            }
        }
        surround::find_ground(&points, &object, &self.scene.small)
    }

    /// The light on the current shape: with visibility, or else distant.
    fn light(
        &mut self,
        at: usize,
        depths: &[Vec<f64>],
        posed: &PosedViews,
        kind: LightKind,
        ground: Option<&Ground>,
    ) -> Result<Option<Light>, ShadingError> {
        let began = Instant::now();
        self.tell("fitting light", 0, 1)?;
        let level = &self.scene.pyramid[at];
        let rays_at = self.scene.pyramid.get(at + 1).unwrap_or(level);
        let scene = LightScene {
            photos: &self.scene.small,
            sphere: posed.sphere.as_ref(),
            ground,
            num_rays: self.options.num_rays,
        };
        // A light fixed to the camera moves over the object: rays into one environment do not hold.
        let seen = if kind == LightKind::World && self.options.visibility {
            light::visible(level, depths, rays_at, &scene)
        } else {
            None
        };
        let used = seen.is_some();
        let light = seen.or_else(|| light::distant(level, depths, kind));
        self.report.shading = match (used, light.is_some()) {
            (true, _) => "light with visibility".to_owned(),
            (false, true) => "distant light".to_owned(),
            (false, false) => "no light could be fitted".to_owned(),
        };
        self.report.laps.push(LapReport {
            level: at,
            kind: format!(
                "light, residual {:.4}{}",
                light.as_ref().map_or(f64::NAN, Light::residual),
                if ground.is_some() { ", ground" } else { "" }
            ),
            seconds: began.elapsed().as_secs_f64(),
            ..LapReport::default()
        });
        Ok(light)
    }

    fn finer_light(&self, at: usize, light: &Light) -> Light {
        let (fine, coarse) = (&self.scene.pyramid[at], &self.scene.pyramid[at + 1]);
        Light {
            harmonics: (0..fine.views.len())
                .map(|i| light::spread(&coarse.views[i], &fine.views[i], &light.harmonics[i]))
                .collect(),
            residuals: light.residuals.clone(),
        }
    }

    /// The surface at the next finer level.
    fn descend(
        &self,
        at: usize,
        solvers: &[PlateSolver],
        depths: &[Vec<f64>],
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let (fine, coarse) = (&self.scene.pyramid[at], &self.scene.pyramid[at + 1]);
        let filled: Vec<_> = (0..fine.views.len())
            .into_par_iter()
            .with_max_len(1)
            .map(|i| {
                let (values, known) = level::upsample(&coarse.views[i], &fine.views[i], &depths[i]);
                let weight: Vec<f64> = known.iter().map(|&k| f64::from(u8::from(k))).collect();
                start::fill(&fine.views[i], &solvers[i], &values, &weight, 1.0, 1e-5)
            })
            .collect();
        filled
            .into_iter()
            .enumerate()
            .map(|(i, r)| r.map_err(|e| self.failed(i, &e)))
            .collect()
    }

    /// Shows the current surface to the probe, at the photos' resolution.
    fn show(&self, at: usize, step: &str, depths: &[Vec<f64>]) {
        if let Some(probe) = self.probe {
            probe(step, &output::maps(&self.scene, at, depths));
        }
    }
}

/// Relative depth within which two views' dense depths agree: a few pixels of the level.
fn agreement_tolerance(level: &Level) -> f64 {
    2.7 / level.focal()
}
