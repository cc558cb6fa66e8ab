//! What the steps of a run share: views, options, observer, report.

use super::memory;
use super::options::PhotoOptions;
use super::output;
use super::report::PhotoReport;
use super::shape::{FineShape, FoundShape, Shape};
use super::views::Scene;
use crate::error::{ShadingError, warn};
use rayon::prelude::*;
use rilievo_numerics::plate_system::PlateError;
use rilievo_numerics::solver_set::SolverSet;
use rilievo_scene::team::divided;
use rilievo_scene::{Checkpoint, Event, Flow, Observer, Scratch, ShadedViews, StageId};
use rilievo_stereo::between_levels;
use rilievo_stereo::consensus;
use rilievo_stereo::surfaces::Reading;
use rilievo_stereo::{sharpness, specks, spread, start};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// Receives the shape after each step, for measurement.
pub type Probe<'a> = dyn Fn(&str, &ShadedViews) + Sync + 'a;

/// Everything that the steps of a run share.
pub(crate) struct Course<'a> {
    pub scene: Scene,
    pub options: &'a PhotoOptions,
    pub observer: &'a dyn Observer,
    pub checkpoint: &'a dyn Checkpoint,
    pub scratch: &'a dyn Scratch,
    pub report: PhotoReport,
    /// What was warned of, to be told again when a stopped run goes on.
    pub warnings: Vec<String>,
    /// Exact solvers of the level at which outer iterations run.
    pub solvers: Option<(usize, Arc<SolverSet>)>,
    /// The surface at a level that is out of core, once relief has begun.
    pub fine: Option<FineShape>,
    pub probe: Option<&'a Probe<'a>>,
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

    /// Tells the user of something; the run goes on.
    pub(crate) fn warn(&mut self, message: String) -> Result<(), ShadingError> {
        self.warnings.push(message.clone());
        warn(self.observer, message)
    }

    /// Works on all views, divided among the processes of the run, as many at once as the memory allows when each takes
    /// `bytes_each`.
    pub(crate) fn divided<T: Serialize + DeserializeOwned + Send>(
        &self,
        bytes_each: f64,
        work: impl Fn(usize) -> Result<T, ShadingError> + Sync,
    ) -> Result<Vec<T>, ShadingError> {
        let views: Vec<usize> = (0..self.scene.frames.len()).collect();
        self.divided_among(&views, bytes_each, work)
    }

    /// [`Self::divided`], of some views.
    pub(crate) fn divided_among<T: Serialize + DeserializeOwned + Send>(
        &self,
        views: &[usize],
        bytes_each: f64,
        work: impl Fn(usize) -> Result<T, ShadingError> + Sync,
    ) -> Result<Vec<T>, ShadingError> {
        let at_once = memory::at_once(self.options, self.scene.bytes(), bytes_each);
        divided(self.observer.team(), views.len(), at_once, |k| {
            work(views[k])
        })
    }

    /// Notes once what the data could not tell.
    pub(crate) fn note(&mut self, note: &str) {
        if !self.report.notes.iter().any(|n| n == note) {
            self.report.notes.push(note.to_owned());
        }
    }

    pub(crate) fn failed(&self, view: usize, error: &PlateError) -> ShadingError {
        ShadingError::Numerics {
            view: self.scene.frames[view].name.clone(),
            reason: error.to_string(),
        }
    }

    /// Exact solvers of a level: where values have to reach across what no view knows.
    pub(crate) fn solvers(&self, at: usize) -> SolverSet {
        let keeps = memory::keeps_solvers(self.scene.level(at), self.options, self.scene.bytes());
        SolverSet::direct(self.scene.frames.len(), keeps)
    }

    /// [`Self::solvers`], analysed once for all outer iterations at a level.
    pub(crate) fn shared_solvers(&mut self, at: usize) -> Arc<SolverSet> {
        if let Some((of, solvers)) = &self.solvers
            && *of == at
        {
            return solvers.clone();
        }
        // Those of another level go first: they take a good part of the memory.
        self.solvers = None;
        let solvers = Arc::new(self.solvers(at));
        self.solvers = Some((at, solvers.clone()));
        solvers
    }

    /// Solvers of a finer level: its surface is about right from the start.
    pub(crate) fn finer_solvers(&self, at: usize) -> SolverSet {
        let keeps = memory::keeps_solvers(self.scene.level(at), self.options, self.scene.bytes());
        SolverSet::iterative(self.scene.frames.len(), keeps)
    }

    /// How the views' surfaces are read: where photos disagree depth is noisy down to single pixels.
    pub(crate) fn reading(&self) -> Reading {
        if self.photos_disagree() {
            Reading::Bilinear
        } else {
            Reading::Cubic
        }
    }

    /// Measures how sharp the photos are against each other at a level.
    pub(crate) fn measure_sharpness(&mut self, at: usize, depths: &[Vec<f64>]) {
        let found = sharpness::measure(self.scene.level(at), depths);
        for (view, sharpness) in self.report.views.iter_mut().zip(found) {
            view.sharpness = sharpness;
        }
        self.use_sharpness(at);
    }

    /// Gives the views of a level the sharpness that was measured last.
    pub(crate) fn use_sharpness(&mut self, at: usize) {
        let views = &mut self.scene.level_mut(at).views;
        for (view, report) in views.iter_mut().zip(&self.report.views) {
            view.sharpness = report.sharpness;
        }
    }

    /// All views' surfaces made one, from depths up to `truncation_px` footprints apart.
    pub(crate) fn fused(
        &self,
        at: usize,
        depths: &[Vec<f64>],
        truncation_px: f64,
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let level = self.scene.level(at);
        self.tell("fusing views", 0, 1)?;
        let truncation = truncation_px / level.focal();
        Ok(consensus::fuse(level, depths, truncation, self.reading()))
    }

    /// The surface without specks; their share in each view before and after is reported.
    pub(crate) fn without_specks(&mut self, at: usize, depths: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let views = &self.scene.level(at).views;
        views
            .par_iter()
            .with_max_len(1)
            .zip(depths)
            .zip(&mut self.report.views)
            .map(|((view, depth), report)| {
                let cleaned = specks::remove(view, &depth);
                report.specks = cleaned.shares;
                cleaned.depth
            })
            .collect()
    }

    /// The surface at the next finer level.
    pub(crate) fn descend(
        &self,
        at: usize,
        solvers: &SolverSet,
        depths: &[Vec<f64>],
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let (fine, coarse) = (self.scene.level(at), self.scene.level(at + 1));
        self.divided(memory::solve_bytes(fine), |i| {
            let (coarse, fine) = (&coarse.views[i], &fine.views[i]);
            let (values, known) = between_levels::upsample(coarse, fine, &depths[i]);
            let weight: Vec<f64> = known.iter().map(|&k| f64::from(u8::from(k))).collect();
            solvers
                .of(i, &fine.pixels)
                .and_then(|solver| {
                    start::fill(fine, &solver, &values, &weight, 1.0, 1e-5, |_| false)
                })
                .map_err(|e| self.failed(i, &e))
        })
    }

    /// The surface at the next coarser level.
    pub(crate) fn reduced(&self, at: usize, depths: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (fine, coarse) = (self.scene.level(at), self.scene.level(at + 1));
        (0..fine.views.len())
            .into_par_iter()
            .map(|i| between_levels::reduce(&fine.views[i], &coarse.views[i], &depths[i]))
            .collect()
    }

    /// The surface at level `at` moved by what has changed at the next coarser level, from `before`
    /// to `after`: what only the finer level resolves stays.
    pub(crate) fn raised(
        &self,
        at: usize,
        depths: &[Vec<f64>],
        before: &[Vec<f64>],
        after: &[Vec<f64>],
    ) -> Vec<Vec<f64>> {
        let (fine, coarse) = (self.scene.level(at), self.scene.level(at + 1));
        (0..depths.len())
            .into_par_iter()
            .map(|i| {
                let change: Vec<[f32; 1]> = after[i]
                    .iter()
                    .zip(&before[i])
                    .map(|(a, b)| [(a - b) as f32])
                    .collect();
                spread::spread(&coarse.views[i], &fine.views[i], &change)
                    .iter()
                    .zip(&depths[i])
                    .map(|(change, depth)| depth + f64::from(change[0]))
                    .collect()
            })
            .collect()
    }

    /// Shows the current surface to the probe, at the photos' resolution.
    pub(crate) fn show(
        &self,
        at: usize,
        step: &str,
        depths: &[Vec<f64>],
    ) -> Result<(), ShadingError> {
        if self.probe.is_none() {
            return Ok(());
        }
        let depths = depths.to_vec();
        self.show_shape(step, &FoundShape::Whole(Shape { at, depths }))
    }

    /// [`Self::show`] of the surface out of core.
    pub(crate) fn show_fine(&mut self, step: &str) -> Result<(), ShadingError> {
        let Some(fine) = self.fine.take() else {
            return Ok(());
        };
        let shape = FoundShape::Fine(fine);
        self.show_shape(step, &shape)?;
        if let FoundShape::Fine(fine) = shape {
            self.fine = Some(fine);
        }
        Ok(())
    }

    fn show_shape(&self, step: &str, shape: &FoundShape) -> Result<(), ShadingError> {
        if let Some(probe) = self.probe {
            let scene = &self.scene;
            let views = (0..scene.frames.len())
                .into_par_iter()
                .map(|i| output::maps(scene, shape, i, None))
                .collect::<Result<_, _>>()?;
            probe(step, &ShadedViews { views });
        }
        Ok(())
    }
}
