//! Relief of a few pixels: the levels between the finest that is solved as a whole and the photos' own pixels.
//!
//! Shape and light stand when these levels begin. What they add is local, so each view is improved tile by tile
//! (`rilievo_stereo::tile`) under the light of the coarser level, interpolated: time is proportional to the pixels,
//! and the memory in work is that of the tiles. All tiles of a view start from the same surfaces, and their
//! increments are blended, so that neither tiles nor threads show in the result; the views take turns. How much
//! relief is to be expected follows from the surface that the coarser level hands down (`turn_scale`).

use super::chroma::ChromaNoise;
use super::course::Course;
use super::iteration::{IterationWeights, MatchLeft, PHOTOS_ONLY, step_weights};
use super::light::Light;
use super::matching::{self, Likeness};
use super::memory;
use super::output::Shape;
use super::progress::{After, Next, ReliefRounds};
use super::report::StepReport;
use super::shading::{PixelHarmonics, PixelLight, ShadingTerm, ShadingWeights};
use super::solve::{FUSION_PX, finer_weights};
use super::step::{self, StepOptions};
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::PlateError;
use rilievo_numerics::robust::median;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::spread::Parents;
use rilievo_stereo::surfaces::{Reading, Surfaces};
use rilievo_stereo::tile::{self, Tile};
use rilievo_stereo::window::Window;
use rilievo_stereo::{between_levels, plate};
use std::time::Instant;

/// Side of the samples on which a view's noise is measured, pixels, and their largest number.
const SAMPLE_PX: usize = 128;
const MAX_NUM_SAMPLES: usize = 8;
/// Factor of the increments: each round goes part of the way to where the views agree, since the others' surfaces
/// are held fixed meanwhile.
const OVER_RELAXATION: f64 = 1.7;

/// What reports and progress call these steps.
const KIND: &str = "relief";

/// The light of a coarser level, to be read at finer ones.
pub(super) struct CoarseLight<'a> {
    light: &'a Light,
    at: usize,
    focal: f64,
    /// Per view.
    parents: Vec<Parents<'a>>,
}

/// The light of a tile's pixels.
struct TileLight {
    harmonics: Vec<PixelHarmonics>,
    pigment: Option<Vec<[f32; 3]>>,
    trust: Option<Vec<f32>>,
    mean_tolerance: f64,
    openness_exponent: f32,
}

/// What all tiles of one view at one level share.
pub(super) struct ViewAtLevel<'a> {
    pub level: &'a Level,
    pub at: usize,
    pub index: usize,
    pub reading: Reading,
    pub light: &'a CoarseLight<'a>,
    pub options: &'a StepOptions,
    pub shading: ShadingWeights,
}

/// What a tile's step gave.
pub(super) struct TileStep {
    /// Numbers of its pixels in the whole view.
    pub numbers: Vec<u32>,
    /// Share of each of them in the blend.
    pub shares: Vec<f32>,
    /// Increments of the log depths of its pixels.
    pub increment: Vec<f64>,
    /// Some of the relative residuals between the photos.
    pub residuals: Vec<f64>,
    /// How alike they are in neighbouring pixels.
    pub likeness: Likeness,
}

impl<'a> CoarseLight<'a> {
    pub(super) fn new(level: &'a Level, at: usize, light: &'a Light) -> Self {
        Self {
            light,
            at,
            focal: level.focal(),
            parents: level.views.par_iter().map(Parents::new).collect(),
        }
    }

    /// The light of a tile of view `index`, cut at level `at` of focal length `focal`.
    fn of(&self, tile: &Tile, index: usize, at: usize, focal: f64) -> TileLight {
        let light = self.light;
        let (pigment, trust) = (light.pigment_of(index), light.trust.get(index));
        let scale = f64::from(1_u32 << (self.at - at)).recip();
        let view = &tile.level.views[0];
        let rows: Vec<[f32; 31]> = (0..view.pixels.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|p| {
                let (x, y) = view.xy(p);
                let coarse = |v: f64, corner: usize| (v + corner as f64 + 0.5) * scale - 0.5;
                let (x, y) = (coarse(x, tile.corner.0), coarse(y, tile.corner.1));
                self.parents[index].at(x, y, |parent| {
                    let mut row = [0.0; 31];
                    for (c, l) in light.harmonics[index][parent].iter().enumerate() {
                        row[9 * c..9 * c + 9].copy_from_slice(l);
                    }
                    if let Some(pigment) = pigment {
                        row[27..30].copy_from_slice(&pigment[parent]);
                    }
                    if let Some(trust) = trust {
                        row[30] = trust[parent];
                    }
                    row
                })
            })
            .collect();
        TileLight {
            harmonics: rows
                .iter()
                .map(|r| std::array::from_fn(|c| std::array::from_fn(|k| r[9 * c + k])))
                .collect(),
            pigment: pigment.map(|_| rows.iter().map(|r| [r[27], r[28], r[29]]).collect()),
            trust: trust.map(|_| rows.iter().map(|r| r[30]).collect()),
            mean_tolerance: light.mean_tolerance * self.focal / focal,
            openness_exponent: light.openness_exponent.unwrap_or(0.0),
        }
    }
}

impl TileLight {
    fn of_pixels(&self) -> PixelLight<'_> {
        PixelLight {
            harmonics: &self.harmonics,
            pigment: self.pigment.as_deref(),
            trust: self.trust.as_deref(),
            mean_tolerance: self.mean_tolerance,
            openness_exponent: self.openness_exponent,
        }
    }
}

impl Course<'_> {
    /// The start of relief at the level below the shape's, under the light of level `coarse`, the finest that was solved
    /// as a whole: the shape interpolated, and what is measured of it.
    pub(super) fn next_relief_level(
        &self,
        shape: &mut Shape,
        coarse: usize,
        last: IterationWeights,
    ) -> ReliefRounds {
        *shape = self.interpolated(shape);
        let level = &self.scene.pyramid[shape.at];
        ReliefRounds {
            coarse,
            last,
            num_done: 0,
            noise: vec![None; level.views.len()],
            turn_scale: turn_scale(level, &shape.depths),
            record: StepReport {
                level: shape.at,
                kind: KIND.to_owned(),
                ..StepReport::default()
            },
        }
    }

    /// The surface at the next finer level.
    fn interpolated(&self, shape: &Shape) -> Shape {
        let at = shape.at - 1;
        let (fine, coarse) = (&self.scene.pyramid[at], &self.scene.pyramid[at + 1]);
        let (depths, known) = (0..fine.views.len())
            .into_par_iter()
            .with_max_len(1)
            .map(|i| {
                let of_view = (shape.depths[i].as_slice(), shape.known[i].as_slice());
                between_levels::continued(&coarse.views[i], &fine.views[i], of_view)
            })
            .unzip();
        Shape { at, depths, known }
    }

    /// A round over all views at the shape's level; after the last one the next finer level begins.
    pub(super) fn relief(
        &mut self,
        shape: &mut Shape,
        light: Option<&Light>,
        mut rounds: ReliefRounds,
    ) -> Result<After, ShadingError> {
        let mut next = None;
        // Noise of single pixels would pass for detail here.
        self.use_sharpness(shape.at);
        let finished = match light {
            Some(light) => self.relief_round(shape, light, &mut rounds)?,
            None => true,
        };
        if finished {
            let (coarse, last) = (rounds.coarse, rounds.last);
            self.report.steps.push(rounds.record);
            shape.depths = self.fused(shape.at, &shape.depths, FUSION_PX)?;
            self.show_shape(KIND, shape);
            if shape.at > 0 {
                next = Some(self.next_relief_level(shape, coarse, last));
            }
        } else {
            next = Some(rounds);
        }
        Ok(After {
            light: None,
            next: next.map(Next::Relief),
        })
    }

    /// What is left between the photos before the first round at a level, on samples.
    fn look_between(&self, level: &Level, depths: &[Vec<f64>], record: &mut StepReport) {
        let options = step_weights(level, self.report.sigma_match, &PHOTOS_ONLY).matching;
        let reading = self.reading();
        let samples: Vec<(usize, Window)> = (0..level.views.len())
            .flat_map(|i| {
                sample_cores(&level.views[i])
                    .into_iter()
                    .map(move |core| (i, core))
            })
            .collect();
        let found: Vec<(Vec<f64>, Likeness)> = samples
            .par_iter()
            .map(|(i, core)| {
                let tile = Tile::cut(level, *i, depths, core);
                let surfaces = Surfaces::new(&tile.level, &tile.depths, reading);
                let rasters = &surfaces.rasters;
                let matches = matching::terms(&tile.level, 0, &tile.depths[0], rasters, &options);
                (matches.some_residuals().collect(), matches.likeness)
            })
            .collect();
        let (mut residuals, mut likeness) = (Vec::new(), Likeness::default());
        for (of_tile, of_neighbours) in found {
            residuals.extend(of_tile);
            likeness.add(of_neighbours);
        }
        record.match_residual = median(&mut residuals);
        record.match_correlation = likeness.correlation();
    }

    /// A round over all views at the shape's level; tells whether it was the last one there.
    fn relief_round(
        &self,
        shape: &mut Shape,
        light: &Light,
        rounds: &mut ReliefRounds,
    ) -> Result<bool, ShadingError> {
        let began = Instant::now();
        let at = shape.at;
        let level = &self.scene.pyramid[at];
        if rounds.record.match_residual.is_none() {
            self.look_between(level, &shape.depths, &mut rounds.record);
        }
        let left = MatchLeft::of(&rounds.record);
        let shared_error = left.map_or(1.0, |left| left.shared_error(light.residual()));
        let mut weights = finer_weights(&rounds.last, false, at == 0, shared_error);
        if let Some(scale) = rounds.turn_scale {
            (weights.plate, weights.plate_threshold) = (0.5 / (scale * scale), scale);
        }
        let sigma_match = left.map_or(self.report.sigma_match, MatchLeft::sigma);
        let options = step_weights(level, sigma_match, &weights);
        let coarse = rounds.coarse;
        let light = CoarseLight::new(&self.scene.pyramid[coarse], coarse, light);
        let Some(shading) = weights.shading else {
            return Ok(true);
        };
        let num_views = level.views.len();
        let cores: Vec<Vec<Window>> = level
            .views
            .iter()
            .map(|view| tile::cores(view, memory::CORE_PX))
            .collect();
        let num_rounds = self.options.num_relief_rounds;
        let num_tiles = cores.iter().map(Vec::len).sum::<usize>();
        let mut num_done = rounds.num_done * num_tiles;
        let at_once = memory::tiles_at_once(self.options, self.scene.bytes());
        let (mut moved, mut turned, mut residuals) = (0.0, 0.0, Vec::new());
        let mut likeness = Likeness::default();
        // Even views first, as in the outer iterations.
        for i in (0..num_views).step_by(2).chain((1..num_views).step_by(2)) {
            let mut view = ViewAtLevel {
                level,
                at,
                index: i,
                reading: self.reading(),
                light: &light,
                options: &options,
                shading,
            };
            if rounds.noise[i].is_none() {
                rounds.noise[i] = view.chroma_noise(&shape.depths);
            }
            view.shading.chroma_noise = rounds.noise[i];
            let mut improved = shape.depths[i].clone();
            for cores in cores[i].chunks(at_once) {
                self.tell(KIND, num_done, num_rounds * num_tiles)?;
                let steps: Vec<Result<TileStep, PlateError>> = cores
                    .par_iter()
                    .with_max_len(1)
                    .map(|core| view.step(&shape.depths, core))
                    .collect();
                for step in steps {
                    let step = step.map_err(|e| self.failed(i, &e))?;
                    for (p, &number) in step.numbers.iter().enumerate() {
                        let share = OVER_RELAXATION * f64::from(step.shares[p]);
                        improved[number as usize] += share * step.increment[p];
                    }
                    residuals.extend(step.residuals);
                    likeness.add(step.likeness);
                }
                num_done += cores.len();
            }
            moved += plate::mean_move(&shape.depths[i], &improved);
            turned += plate::mean_turn(&level.views[i], &shape.depths[i], &improved);
            shape.depths[i] = improved;
        }
        let per_view = 1.0 / num_views as f64;
        let turned_deg = (turned * per_view).to_degrees();
        let record = &mut rounds.record;
        rounds.num_done += 1;
        *record = StepReport {
            moved_px: moved * per_view * level.focal(),
            turned_deg,
            turned_in_all_deg: record.turned_in_all_deg + turned_deg,
            num_rounds: rounds.num_done,
            sigma_match: options.matching.sigma,
            sigma_shading: shading.sigma,
            match_residual: median(&mut residuals),
            match_correlation: likeness.correlation(),
            seconds: record.seconds + began.elapsed().as_secs_f64(),
            ..std::mem::take(record)
        };
        Ok(rounds.num_done >= num_rounds)
    }
}

/// Some windows spread over a view's object, where there are such that it fills.
fn sample_cores(view: &LevelView) -> Vec<Window> {
    let cores = tile::cores(view, SAMPLE_PX);
    let is_full = |core: &Window| core.cut(&view.mask).data.iter().all(|&is| is);
    let (full, cut): (Vec<Window>, Vec<Window>) = cores.into_iter().partition(is_full);
    let inner = if full.is_empty() { cut } else { full };
    let step = inner.len().div_ceil(MAX_NUM_SAMPLES).max(1);
    inner.into_iter().step_by(step).collect()
}

/// Typical turn of the normals from a pixel to the next, radians, the scale of their Laplace distribution: what the
/// surface shows at a level tells how much relief to expect there, so that noise makes none on a plain object and none
/// is smoothed away on a carved one.
fn turn_scale(level: &Level, depths: &[Vec<f64>]) -> Option<f64> {
    // Finer than this, a twentieth of a degree, depth itself is rounded and shading tells nothing.
    const LEAST: f64 = 1e-3;
    let mut turns: Vec<f64> = level
        .views
        .iter()
        .zip(depths)
        .filter_map(|(view, depth)| plate::typical_turn(view, depth))
        .collect();
    let scale = median(&mut turns)? / std::f64::consts::LN_2;
    Some(scale.max(LEAST))
}

impl ViewAtLevel<'_> {
    /// One Gauss-Newton step of a tile, from log depths of all views.
    pub(super) fn step(&self, depths: &[Vec<f64>], core: &Window) -> Result<TileStep, PlateError> {
        let tile = Tile::cut(self.level, self.index, depths, core);
        let surfaces = Surfaces::new(&tile.level, &tile.depths, self.reading);
        let light = self.light_of(&tile);
        let term = ShadingTerm::new(
            &tile.level,
            0,
            &tile.depths[0],
            &surfaces.rasters,
            &light.of_pixels(),
            &self.shading,
        );
        let solver = PlateSolver::iterative(&tile.level.views[0].pixels);
        let depth = &tile.depths[0];
        let outcome = step::improve(&surfaces, 0, &solver, depth, Some(&term), self.options)?;
        let increment = outcome
            .depth
            .iter()
            .zip(depth)
            .map(|(after, before)| after - before)
            .collect();
        let residuals = outcome.matches.some_residuals().collect();
        Ok(TileStep {
            numbers: tile.numbers,
            shares: tile.shares,
            increment,
            residuals,
            likeness: outcome.matches.likeness,
        })
    }

    fn light_of(&self, tile: &Tile) -> TileLight {
        let focal = self.level.focal();
        self.light.of(tile, self.index, self.at, focal)
    }

    /// Noise of the view's chroma, from samples all over the object.
    pub(super) fn chroma_noise(&self, depths: &[Vec<f64>]) -> Option<ChromaNoise> {
        let parts: Vec<ChromaNoise> = sample_cores(&self.level.views[self.index])
            .par_iter()
            .map(|core| {
                let tile = Tile::cut(self.level, self.index, depths, core);
                let rasters = rilievo_stereo::level::depth_rasters(&tile.level, &tile.depths);
                let light = self.light_of(&tile);
                ShadingTerm::new(
                    &tile.level,
                    0,
                    &tile.depths[0],
                    &rasters,
                    &light.of_pixels(),
                    &self.shading,
                )
                .chroma_noise
            })
            .collect();
        ChromaNoise::median_of(&parts)
    }
}
