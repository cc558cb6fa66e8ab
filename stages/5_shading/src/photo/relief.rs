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
use super::progress::{After, Next, ReliefRounds};
use super::report::StepReport;
use super::shading::{PixelHarmonics, PixelLight, ShadingTerm, ShadingWeights};
use super::shape::{FineShape, Shape};
use super::solve::{FUSION_PX, finer_weights};
use super::step::{self, StepOptions};
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::PlateError;
use rilievo_numerics::robust::median;
use rilievo_scene::ScratchError;
use rilievo_scene::team::divided;
use rilievo_stereo::consensus::fused_view;
use rilievo_stereo::level::{Level, ViewGrid};
use rilievo_stereo::spread::Parents;
use rilievo_stereo::stored::{StoredLevel, StoredSurface};
use rilievo_stereo::surfaces::{Reading, Surfaces};
use rilievo_stereo::tile::{self, Tile};
use rilievo_stereo::window::Window;
use rilievo_stereo::{between_levels, plate, specks};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::time::Instant;

/// Side of the samples on which a view's noise is measured, pixels, and their largest number.
const SAMPLE_PX: usize = 128;
const MAX_NUM_SAMPLES: usize = 8;
/// Tiles whose increments are in memory together; the same in all processes of a run, whatever memory and threads they
/// have.
const TILES_AT_A_TIME: usize = 8;
/// Factor of the increments: each round goes part of the way to where the views agree, since the others' surfaces
/// are held fixed meanwhile. Views take their turns one by one, so that less than 2 is stable.
const OVER_RELAXATION: f64 = 1.7;

/// What reports and progress call these steps.
const KIND: &str = "relief";

/// The light of a view at a coarser level, to be read at finer ones.
pub(super) struct CoarseLight<'a> {
    light: &'a Light,
    index: usize,
    at: usize,
    focal: f64,
    harmonics: Cow<'a, [PixelHarmonics]>,
    parents: Parents<'a>,
}

/// The light of a tile's pixels.
struct TileLight {
    harmonics: Vec<PixelHarmonics>,
    pigment: Option<Vec<[f32; 3]>>,
    trust: Option<Vec<f32>>,
    mean_tolerance: f64,
    openness_exponent: f32,
}

/// Why a tile's step failed.
#[derive(Debug, thiserror::Error)]
pub(super) enum TileError {
    #[error(transparent)]
    Plate(#[from] PlateError),
    #[error(transparent)]
    Scratch(#[from] ScratchError),
}

/// What all tiles of one view at one level share.
pub(super) struct ViewAtLevel<'a> {
    pub level: &'a StoredLevel<'a>,
    pub index: usize,
    pub reading: Reading,
    pub light: &'a CoarseLight<'a>,
    pub options: &'a StepOptions,
    pub shading: ShadingWeights,
}

/// What a tile's step gave.
#[derive(Serialize, Deserialize)]
pub(super) struct TileStep {
    /// Places of its pixels in the whole view's raster.
    pub places: Vec<u32>,
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
    /// The light of view `index`, whose `harmonics` are of `level`, number `at`.
    pub(super) fn new(
        level: &'a Level,
        at: usize,
        index: usize,
        light: &'a Light,
        harmonics: Cow<'a, [PixelHarmonics]>,
    ) -> Self {
        Self {
            light,
            index,
            at,
            focal: level.focal(),
            harmonics,
            parents: Parents::new(&level.views[index]),
        }
    }

    /// The light of a tile of the view, cut at level `at` of focal length `focal`.
    fn of(&self, tile: &Tile, at: usize, focal: f64) -> TileLight {
        let light = self.light;
        let (pigment, trust) = (light.pigment_of(self.index), light.trust.get(self.index));
        let scale = f64::from(1_u32 << (self.at - at)).recip();
        let view = &tile.level.views[0];
        let rows: Vec<[f32; 31]> = (0..view.pixels.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|p| {
                let (x, y) = view.xy(p);
                let coarse = |v: f64, corner: usize| (v + corner as f64 + 0.5) * scale - 0.5;
                let (x, y) = (coarse(x, tile.corner.0), coarse(y, tile.corner.1));
                self.parents.at(x, y, |parent| {
                    let mut row = [0.0; 31];
                    for (c, l) in self.harmonics[parent].iter().enumerate() {
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
    /// The start of relief at the level below that of the surface so far (`shape`, or the finer one that is out of core),
    /// under the light of level `coarse`, the finest that was solved as a whole: the surface interpolated, and what is
    /// measured of it.
    pub(super) fn next_relief_level(
        &mut self,
        shape: &Shape,
        coarse: usize,
        last: IterationWeights,
    ) -> Result<ReliefRounds, ShadingError> {
        let at = self.fine.as_ref().map_or(shape.at, |fine| fine.at) - 1;
        let scene = &self.scene;
        let surface = StoredSurface::new(&scene.stored, at, self.scratch)?;
        let mut turns = Vec::new();
        for views in self.views_at_once(at) {
            let found: Vec<Result<Option<f64>, ScratchError>> = views
                .into_par_iter()
                .with_max_len(1)
                .map(|i| {
                    let stored = &scene.stored[i];
                    let (parent, child) = (stored.grid(at + 1)?, stored.grid(at)?);
                    let (values, known) = match &self.fine {
                        Some(fine) => fine.of_view(i, &parent)?,
                        None => shape.of_view(i),
                    };
                    let (values, known) =
                        between_levels::continued(&parent, &child, (&values, &known));
                    surface.put(i, &child.pixels, &values, Some(&known))?;
                    Ok(plate::typical_turn(&child, &values))
                })
                .collect();
            for turn in found {
                turns.extend(turn?);
            }
        }
        self.fine = Some(FineShape { at, surface });
        Ok(ReliefRounds {
            coarse,
            last,
            num_done: 0,
            noise: vec![None; self.scene.frames.len()],
            turn_scale: turn_scale(turns),
            record: StepReport {
                level: at,
                kind: KIND.to_owned(),
                ..StepReport::default()
            },
        })
    }

    /// Views in groups that are worked on at once.
    fn views_at_once(&self, at: usize) -> Vec<Vec<usize>> {
        let at_once =
            memory::views_at_once(&self.scene.stored, at, self.options, self.scene.bytes());
        let views: Vec<usize> = (0..self.scene.frames.len()).collect();
        views.chunks(at_once).map(<[usize]>::to_vec).collect()
    }

    /// A round over all views at the level that is out of core; after the last one the next finer level begins.
    pub(super) fn relief(
        &mut self,
        shape: &Shape,
        light: Option<&Light>,
        mut rounds: ReliefRounds,
    ) -> Result<After, ShadingError> {
        let mut next = None;
        let finished = match (light, &self.fine) {
            (Some(light), Some(fine)) => self.relief_round(fine, light, &mut rounds)?,
            _ => true,
        };
        if finished {
            let (coarse, last) = (rounds.coarse, rounds.last);
            self.report.steps.push(rounds.record);
            self.fuse_fine()?;
            self.show_fine(KIND)?;
            if self.fine.as_ref().is_some_and(|fine| fine.at > 0) {
                next = Some(self.next_relief_level(shape, coarse, last)?);
            }
        } else {
            next = Some(rounds);
        }
        Ok(After {
            light: None,
            next: next.map(Next::Relief),
        })
    }

    /// All views' surfaces out of core made one.
    fn fuse_fine(&mut self) -> Result<(), ShadingError> {
        let Some(fine) = &self.fine else {
            return Ok(());
        };
        let (at, scene) = (fine.at, &self.scene);
        self.tell("fusing views", 0, 1)?;
        let sharpness = self.report.sharpness();
        let level = scene.stored_level(fine, &sharpness);
        let truncation = FUSION_PX / level.focal();
        let reading = self.reading();
        let at_once = memory::tiles_at_once(self.options, scene.bytes());
        let team = self.observer.team();
        let fused = StoredSurface::new(&scene.stored, at, self.scratch)?;
        for i in 0..scene.frames.len() {
            let grid = scene.stored[i].grid(at)?;
            let (mut values, known) = fine.of_view(i, &grid)?;
            let cores = tile::cores(&grid, memory::CORE_PX);
            let parts = divided(team, cores.len(), at_once, |k| {
                let tile = Tile::cut(&level, i, &cores[k])?;
                let surfaces = Surfaces::new(&tile.level, &tile.depths, reading);
                let found = fused_view(&surfaces, 0, &tile.depths[0], truncation);
                let places = tile.places.iter().zip(found).enumerate();
                let inside = places.filter(|(p, _)| tile.is_in(&cores[k], *p));
                let part: Vec<(u32, f64)> = inside.map(|(_, (&p, value))| (p, value)).collect();
                Ok::<_, ShadingError>(part)
            })?;
            for (place, value) in parts.into_iter().flatten() {
                values[grid.pixels.number[place as usize] as usize] = value;
            }
            fused.put(i, &grid.pixels, &values, Some(&known))?;
        }
        self.fine = Some(FineShape { at, surface: fused });
        Ok(())
    }

    /// The surface out of core without specks; their share in each view before and after is reported.
    pub(super) fn clean_fine(&mut self, fine: &FineShape) -> Result<(), ShadingError> {
        for views in self.views_at_once(fine.at) {
            let scene = &self.scene;
            let found: Vec<Result<(usize, [f64; 2]), ScratchError>> = views
                .into_par_iter()
                .with_max_len(1)
                .map(|i| {
                    let grid = scene.stored[i].grid(fine.at)?;
                    let cleaned = specks::remove(&grid, &fine.surface.get(i, &grid.pixels)?);
                    fine.surface.put(i, &grid.pixels, &cleaned.depth, None)?;
                    Ok((i, cleaned.shares))
                })
                .collect();
            for of_view in found {
                let (i, shares) = of_view?;
                self.report.views[i].specks = shares;
            }
        }
        Ok(())
    }

    /// Log depths at level `at`, solved as a whole, of the surface out of core.
    pub(super) fn reduced_fine(
        &self,
        fine: &FineShape,
        at: usize,
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let (scene, mut reduced) = (&self.scene, Vec::new());
        for views in self.views_at_once(fine.at) {
            let found: Vec<Result<Vec<f64>, ScratchError>> = views
                .into_par_iter()
                .with_max_len(1)
                .map(|i| {
                    let stored = &scene.stored[i];
                    let mut grid = stored.grid(fine.at)?;
                    let mut depth = fine.surface.get(i, &grid.pixels)?;
                    for coarser in fine.at + 1..=at {
                        let parent = stored.grid(coarser)?;
                        depth = between_levels::reduce(&grid, &parent, &depth);
                        grid = parent;
                    }
                    Ok(depth)
                })
                .collect();
            for depth in found {
                reduced.push(depth?);
            }
        }
        Ok(reduced)
    }

    /// What is left between the photos before the first round at a level, on samples.
    fn look_between(
        &self,
        level: &StoredLevel<'_>,
        record: &mut StepReport,
    ) -> Result<(), ShadingError> {
        let options = step_weights(level.focal(), self.report.sigma_match, &PHOTOS_ONLY).matching;
        let reading = self.reading();
        let (mut residuals, mut likeness) = (Vec::new(), Likeness::default());
        for i in 0..level.views.len() {
            let samples = sample_cores(&level.views[i].grid(level.at)?);
            let found: Vec<Result<_, ScratchError>> = samples
                .par_iter()
                .map(|core| {
                    let tile = Tile::cut(level, i, core)?;
                    let surfaces = Surfaces::new(&tile.level, &tile.depths, reading);
                    let (depth, rasters) = (&tile.depths[0], &surfaces.rasters);
                    let matches = matching::terms(&tile.level, 0, depth, rasters, &options);
                    let some: Vec<f64> = matches.some_residuals().collect();
                    Ok((some, matches.likeness))
                })
                .collect();
            for sample in found {
                let (of_tile, of_neighbours) = sample?;
                residuals.extend(of_tile);
                likeness.add(of_neighbours);
            }
        }
        record.match_residual = median(&mut residuals);
        record.match_correlation = likeness.correlation();
        Ok(())
    }

    /// A round over all views of the surface out of core; tells whether it was the last one at its level.
    fn relief_round(
        &self,
        fine: &FineShape,
        light: &Light,
        rounds: &mut ReliefRounds,
    ) -> Result<bool, ShadingError> {
        let began = Instant::now();
        let (at, scene) = (fine.at, &self.scene);
        // Noise of single pixels would pass for detail here.
        let sharpness = self.report.sharpness();
        let level = scene.stored_level(fine, &sharpness);
        if rounds.record.match_residual.is_none() {
            self.look_between(&level, &mut rounds.record)?;
        }
        let left = MatchLeft::of(&rounds.record);
        let shared_error = left.map_or(1.0, |left| left.shared_error(light.residual()));
        let mut weights = finer_weights(&rounds.last, false, at == 0, shared_error);
        if let Some(scale) = rounds.turn_scale {
            (weights.plate, weights.plate_threshold) = (0.5 / (scale * scale), scale);
        }
        let sigma_match = left.map_or(self.report.sigma_match, MatchLeft::sigma);
        let options = step_weights(level.focal(), sigma_match, &weights);
        let coarse = rounds.coarse;
        let Some(shading) = weights.shading else {
            return Ok(true);
        };
        let num_views = level.views.len();
        let num_rounds = self.options.num_relief_rounds;
        let team = self.observer.team();
        let at_once = memory::tiles_at_once(self.options, scene.bytes());
        let (mut moved, mut turned, mut residuals) = (0.0, 0.0, Vec::new());
        let mut likeness = Likeness::default();
        // Even views first, as in the outer iterations.
        let order = (0..num_views).step_by(2).chain((1..num_views).step_by(2));
        for (place, i) in order.enumerate() {
            let harmonics = scene.harmonics(light, i, coarse);
            let of_view = CoarseLight::new(scene.level(coarse), coarse, i, light, harmonics);
            let mut view = ViewAtLevel {
                level: &level,
                index: i,
                reading: self.reading(),
                light: &of_view,
                options: &options,
                shading,
            };
            let grid = scene.stored[i].grid(at)?;
            if rounds.noise[i].is_none() {
                rounds.noise[i] = view.chroma_noise(&sample_cores(&grid))?;
            }
            view.shading.chroma_noise = rounds.noise[i];
            let before = fine.surface.get(i, &grid.pixels)?;
            let mut improved = before.clone();
            let cores = tile::cores(&grid, memory::CORE_PX);
            // Progress counts tiles, as if all views had as many.
            let total = num_rounds * num_views * cores.len();
            let mut num_done = (rounds.num_done * num_views + place) * cores.len();
            for cores in cores.chunks(TILES_AT_A_TIME.max(2 * team.size())) {
                self.tell(KIND, num_done, total)?;
                let steps: Vec<TileStep> = divided(team, cores.len(), at_once, |k| {
                    view.step(&cores[k]).map_err(|error| match error {
                        TileError::Plate(error) => self.failed(i, &error),
                        TileError::Scratch(error) => ShadingError::from(error),
                    })
                })?;
                for step in steps {
                    for (p, &place) in step.places.iter().enumerate() {
                        let share = OVER_RELAXATION * f64::from(step.shares[p]);
                        let number = grid.pixels.number[place as usize] as usize;
                        improved[number] += share * step.increment[p];
                    }
                    residuals.extend(step.residuals);
                    likeness.add(step.likeness);
                }
                num_done += cores.len();
            }
            moved += plate::mean_move(&before, &improved);
            turned += plate::mean_turn(&grid, &before, &improved);
            fine.surface.put(i, &grid.pixels, &improved, None)?;
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
pub(super) fn sample_cores(view: &ViewGrid) -> Vec<Window> {
    let cores = tile::cores(view, SAMPLE_PX);
    let is_full = |core: &Window| core.cut(&view.mask).data.iter().all(|&is| is);
    let (full, cut): (Vec<Window>, Vec<Window>) = cores.into_iter().partition(is_full);
    let inner = if full.is_empty() { cut } else { full };
    let step = inner.len().div_ceil(MAX_NUM_SAMPLES).max(1);
    inner.into_iter().step_by(step).collect()
}

/// Typical turn of the normals from a pixel to the next, radians, from that of every view: the scale of their Laplace
/// distribution. What the
/// surface shows at a level tells how much relief to expect there, so that noise makes none on a plain object and none
/// is smoothed away on a carved one.
fn turn_scale(mut turns: Vec<f64>) -> Option<f64> {
    // Finer than this, a twentieth of a degree, depth itself is rounded and shading tells nothing.
    const LEAST: f64 = 1e-3;
    let scale = median(&mut turns)? / std::f64::consts::LN_2;
    Some(scale.max(LEAST))
}

impl ViewAtLevel<'_> {
    /// One Gauss-Newton step of a tile.
    pub(super) fn step(&self, core: &Window) -> Result<TileStep, TileError> {
        let tile = Tile::cut(self.level, self.index, core)?;
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
            places: tile.places,
            shares: tile.shares,
            increment,
            residuals,
            likeness: outcome.matches.likeness,
        })
    }

    fn light_of(&self, tile: &Tile) -> TileLight {
        let focal = self.level.focal();
        self.light.of(tile, self.level.at, focal)
    }

    /// Noise of the view's chroma, from samples all over the object.
    pub(super) fn chroma_noise(
        &self,
        samples: &[Window],
    ) -> Result<Option<ChromaNoise>, ScratchError> {
        let parts = samples
            .par_iter()
            .map(|core| {
                let tile = Tile::cut(self.level, self.index, core)?;
                let rasters = rilievo_stereo::level::depth_rasters(&tile.level, &tile.depths);
                let light = self.light_of(&tile);
                let term = ShadingTerm::new(
                    &tile.level,
                    0,
                    &tile.depths[0],
                    &rasters,
                    &light.of_pixels(),
                    &self.shading,
                );
                Ok(term.chroma_noise)
            })
            .collect::<Result<Vec<ChromaNoise>, ScratchError>>()?;
        Ok(ChromaNoise::median_of(&parts))
    }
}
