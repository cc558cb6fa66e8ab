//! Relief of a few pixels: the levels between the finest that is solved as a whole and the photos' own pixels.
//!
//! Shape and light stand when these levels begin. What they add is local, finer than what the coarser level resolves, so
//! each view is improved tile by tile (`relief_tiles`) under the light of the coarser level, interpolated: time is
//! proportional to the pixels, and the memory in work is that of the tiles. All tiles of a view
//! start from the same surfaces, and their increments are blended, so that neither tiles nor
//! threads show in the result; the views take turns. How much relief is to be expected follows from
//! the surface that the coarser level hands down (`turn_scale`).

use super::light::Light;
use super::matching::{self, Likeness};
use super::memory;
use super::progress::ReliefRounds;
use super::relief_tiles::{CoarseLight, TileError, TileStep, ViewAtLevel, sample_cores};
use super::report::StepReport;
use super::schedule::{IterationWeights, MatchLeft, PHOTOS_ONLY};
use super::shape::{FineShape, Shape, Surface};
use super::solve::FUSION_PX;
use super::solver::Solver;
use super::steps::PhotoStep;
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::ScratchError;
use rilievo_scene::team::divided;
use rilievo_stereo::consensus::fused_view;
use rilievo_stereo::stored::StoredSurface;
use rilievo_stereo::surfaces::Surfaces;
use rilievo_stereo::tile::{self, Tile};
use rilievo_stereo::{between_levels, plate, specks};
use std::time::Instant;

/// Tiles whose increments are in memory together; the same in all processes of a run, whatever
/// memory and threads they have.
const TILES_AT_A_TIME: usize = 8;
/// Factor of the increments: each round goes part of the way to where the views agree, since the others' surfaces
/// are held fixed meanwhile. Views take their turns one by one, so that less than 2 is stable.
const OVER_RELAXATION: f64 = 1.7;

impl Solver<'_> {
    /// The start of relief at the level below that of the surface so far (`shape`, or the finer one that is out of core),
    /// under the light of level `coarse`, the finest that was solved as a whole: the surface interpolated, and what is
    /// measured of it.
    pub fn next_relief_level(
        &mut self,
        shape: &Shape,
        coarse: usize,
        last: IterationWeights,
    ) -> Result<ReliefRounds, ShadingError> {
        let at = self.fine.as_ref().map_or(shape.at, |fine| fine.at) - 1;
        let scene = &self.scene;
        let surface = StoredSurface::new(&scene.stored, at, self.around.scratch)?;
        let from: &dyn Surface = match &self.fine {
            Some(fine) => fine,
            None => shape,
        };
        let turns = self.of_views(at, |i| {
            let stored = &scene.stored[i];
            let (parent, child) = (stored.grid(at + 1)?, stored.grid(at)?);
            let (values, known) = from.of_view(i, &parent)?;
            let (values, known) = between_levels::continued(&parent, &child, (&values, &known));
            surface.put(i, &child.pixels, &values, Some(&known))?;
            Ok(plate::typical_turn(&child, &values))
        })?;
        self.fine = Some(FineShape { at, surface });
        Ok(ReliefRounds {
            coarse,
            last,
            num_done: 0,
            noise: vec![None; self.scene.frames.len()],
            turn_scale: turn_scale(turns.into_iter().flatten().collect()),
            record: StepReport {
                level: at,
                step: PhotoStep::Relief,
                ..StepReport::default()
            },
        })
    }

    /// A round over all views at the level that is out of core; after the last one the next finer level begins. Returns
    /// where relief goes on. A level at which photos hold no more detail than at the one before ends it: it and all finer
    /// ones are interpolated.
    pub fn relief(
        &mut self,
        shape: &Shape,
        light: Option<&Light>,
        mut rounds: ReliefRounds,
    ) -> Result<Option<ReliefRounds>, ShadingError> {
        let (Some(light), Some(fine)) = (light, &self.fine) else {
            return Ok(None);
        };
        if rounds.num_done == 0 {
            self.measure_match(fine, &mut rounds.record)?;
            if MatchLeft::of(&rounds.record).is_some_and(|left| !left.has_detail()) {
                // The whole level's own surface says the same, not smoothed by going up and down again.
                if fine.at + 1 == rounds.coarse {
                    self.fine = None;
                }
                self.report.steps.push(rounds.record);
                return Ok(None);
            }
        }
        if !self.relief_round(fine, light, &mut rounds)? {
            return Ok(Some(rounds));
        }
        let (coarse, last) = (rounds.coarse, rounds.last);
        self.report.steps.push(rounds.record);
        self.fuse_fine()?;
        if let Some(fine) = &self.fine {
            self.show_surface(PhotoStep::Relief.message(), fine)?;
        }
        let is_finest = self.fine.as_ref().is_none_or(|fine| fine.at == 0);
        (!is_finest)
            .then(|| self.next_relief_level(shape, coarse, last))
            .transpose()
    }

    /// All views' surfaces out of core made one.
    fn fuse_fine(&mut self) -> Result<(), ShadingError> {
        let Some(fine) = &self.fine else {
            return Ok(());
        };
        let (at, scene) = (fine.at, &self.scene);
        self.progress(PhotoStep::Fusion, 0, 1)?;
        let sharpness = self.report.sharpness();
        let level = scene.stored_level(fine, &sharpness);
        let truncation = FUSION_PX / level.focal();
        let reading = self.reading();
        let at_once = self.budget().tiles();
        let team = self.observer().team();
        let fused = StoredSurface::new(&scene.stored, at, self.around.scratch)?;
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
    pub fn clean_fine(&mut self, fine: &FineShape) -> Result<(), ShadingError> {
        let scene = &self.scene;
        let shares = self.of_views(fine.at, |i| {
            let grid = scene.stored[i].grid(fine.at)?;
            let cleaned = specks::remove(&grid, &fine.surface.get(i, &grid.pixels)?);
            fine.surface.put(i, &grid.pixels, &cleaned.depth, None)?;
            Ok(cleaned.shares)
        })?;
        for (view, shares) in self.report.views.iter_mut().zip(shares) {
            view.specks = shares;
        }
        Ok(())
    }

    /// Log depths at level `at`, solved as a whole, of the surface out of core.
    pub fn reduced_fine(&self, fine: &FineShape, at: usize) -> Result<Vec<Vec<f64>>, ShadingError> {
        Ok(self.of_views(fine.at, |i| {
            let stored = &self.scene.stored[i];
            let mut grid = stored.grid(fine.at)?;
            let mut depth = fine.surface.get(i, &grid.pixels)?;
            for coarser in fine.at + 1..=at {
                let parent = stored.grid(coarser)?;
                depth = between_levels::reduce(&grid, &parent, &depth);
                grid = parent;
            }
            Ok(depth)
        })?)
    }

    /// The residual between the photos before the first round at a level, on samples.
    fn measure_match(&self, fine: &FineShape, record: &mut StepReport) -> Result<(), ShadingError> {
        let began = Instant::now();
        let sharpness = self.report.sharpness();
        let level = &self.scene.stored_level(fine, &sharpness);
        let options = PHOTOS_ONLY.of_step(level.focal(), self.report.sigma_match);
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
                    let matches =
                        matching::terms(&tile.level, 0, depth, rasters, &options.matching);
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
        record.seconds = began.elapsed().as_secs_f64();
        Ok(())
    }

    /// A round over all views of the surface out of core; returns whether it was the last one at
    /// its level.
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
        let left = MatchLeft::of(&rounds.record);
        let shared_error = left.map_or(1.0, |left| left.shared_error(light.residual()));
        let weights = rounds.last.finer(false, at == 0, shared_error);
        let weights = weights.with_turns(rounds.turn_scale);
        let sigma_match = left.map_or(self.report.sigma_match, MatchLeft::sigma);
        let options = weights.of_step(level.focal(), sigma_match);
        let coarse = rounds.coarse;
        let Some(shading) = weights.shading else {
            return Ok(true);
        };
        let num_views = level.views.len();
        let num_rounds = self.options.num_relief_rounds;
        let team = self.observer().team();
        let at_once = self.budget().tiles();
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
                self.progress(PhotoStep::Relief, num_done, total)?;
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

/// Typical turn of the normals from a pixel to the next, radians, from that of every view: the
/// scale of their Laplace distribution. So much relief is expected at the next level: noise makes
/// none on a plain object, and none is smoothed away on a carved one.
fn turn_scale(mut turns: Vec<f64>) -> Option<f64> {
    // Finer than this, a twentieth of a degree, depth itself is rounded.
    const LEAST: f64 = 1e-3;
    let scale = median(&mut turns)? / std::f64::consts::LN_2;
    Some(scale.max(LEAST))
}
