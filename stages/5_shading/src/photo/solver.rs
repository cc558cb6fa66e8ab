//! The state of a run, and what its phases share.
//!
//! The phases are methods of [`Solver`] in files of their own: the first surface in `search`,
//! rounds of shape in `rounds`, the light in `relight`, levels out of core in `relief`, their order
//! in `solve`, and the state that a stopped run resumes from in `progress`.

use super::memory::{self, Budget};
use super::options::PhotoOptions;
use super::output;
use super::report::PhotoReport;
use super::shape::{FineShape, Shape, Surface};
use super::steps::PhotoStep;
use super::views::Scene;
use crate::error::{ShadingError, warn};
use crate::surroundings::Surroundings;
use rayon::prelude::*;
use rilievo_numerics::plate_system::PlateError;
use rilievo_numerics::solver_set::SolverSet;
use rilievo_scene::team::divided;
use rilievo_scene::{Observer, ScratchError, ShadedViews, StageId};
use rilievo_stereo::surfaces::Reading;
use rilievo_stereo::{between_levels, consensus, sharpness, specks, spread, start};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// Receives the shape after each step, for measurement.
pub type Probe<'a> = dyn Fn(&str, &ShadedViews) + Sync + 'a;

/// The state of a run.
pub(crate) struct Solver<'a> {
    pub scene: Scene,
    pub options: &'a PhotoOptions,
    pub around: Surroundings<'a>,
    pub report: PhotoReport,
    /// All warnings so far, repeated when a stopped run goes on.
    pub warnings: Vec<String>,
    /// Exact solvers of the level at which outer iterations run.
    pub exact: Option<(usize, Arc<SolverSet>)>,
    /// How certain the depths are that the level at hand starts from, per view and pixel, if they were searched.
    pub certainty: Option<Vec<Vec<f32>>>,
    /// The surface at a level that is out of core, once relief has begun.
    pub fine: Option<FineShape>,
    pub probe: Option<&'a Probe<'a>>,
}

impl Solver<'_> {
    pub fn observer(&self) -> &dyn Observer {
        self.around.observer
    }

    /// Reports progress; ends the run when asked to.
    pub fn progress(&self, step: PhotoStep, done: usize, total: usize) -> Result<(), ShadingError> {
        let observer = self.observer();
        let flow = observer.progress(StageId::Shading, step.message(), (done, total));
        flow.ok_or(ShadingError::Interrupted)
    }

    /// Warns the user; the run goes on.
    pub fn warn(&mut self, message: String) -> Result<(), ShadingError> {
        self.warnings.push(message.clone());
        warn(self.observer(), message)
    }

    /// Notes once what the data could not show.
    pub fn note(&mut self, note: &str) {
        if !self.report.notes.iter().any(|n| n == note) {
            self.report.notes.push(note.to_owned());
        }
    }

    pub fn failed(&self, view: usize, error: &PlateError) -> ShadingError {
        ShadingError::Numerics {
            view: self.scene.frames[view].name.clone(),
            reason: error.to_string(),
        }
    }

    pub fn budget(&self) -> Budget {
        Budget {
            given: self.options.memory,
            in_use: self.scene.bytes(),
        }
    }

    /// Works on all views, divided among the processes of the run, as many at once as the memory
    /// allows when each takes `bytes_each`.
    pub fn divided<T: Serialize + DeserializeOwned + Send>(
        &self,
        bytes_each: f64,
        work: impl Fn(usize) -> Result<T, ShadingError> + Sync,
    ) -> Result<Vec<T>, ShadingError> {
        let views: Vec<usize> = (0..self.scene.frames.len()).collect();
        self.divided_among(&views, bytes_each, work)
    }

    /// [`Self::divided`], of some views.
    pub fn divided_among<T: Serialize + DeserializeOwned + Send>(
        &self,
        views: &[usize],
        bytes_each: f64,
        work: impl Fn(usize) -> Result<T, ShadingError> + Sync,
    ) -> Result<Vec<T>, ShadingError> {
        let at_once = self.budget().at_once(bytes_each);
        divided(self.observer().team(), views.len(), at_once, |k| {
            work(views[k])
        })
    }

    /// Works on all views in this process, as many at once as fit into memory with all that they
    /// have at a level.
    pub fn of_views<T: Send>(
        &self,
        at: usize,
        work: impl Fn(usize) -> Result<T, ScratchError> + Sync,
    ) -> Result<Vec<T>, ScratchError> {
        let scene = &self.scene;
        let at_once = self.budget().views(&scene.stored, at);
        let views: Vec<usize> = (0..scene.frames.len()).collect();
        let mut all = Vec::with_capacity(views.len());
        for some in views.chunks(at_once) {
            let found = some.par_iter().with_max_len(1).map(|&i| work(i));
            for of_view in found.collect::<Vec<_>>() {
                all.push(of_view?);
            }
        }
        Ok(all)
    }

    /// Exact solvers of a level: where values have to reach across what no view knows.
    pub fn exact_solvers(&self, at: usize) -> SolverSet {
        SolverSet::direct(
            self.scene.frames.len(),
            self.budget().keeps_solvers(self.scene.level(at)),
        )
    }

    /// [`Self::exact_solvers`], analysed once for all outer iterations at a level.
    pub fn shared_solvers(&mut self, at: usize) -> Arc<SolverSet> {
        if let Some((of, solvers)) = &self.exact
            && *of == at
        {
            return solvers.clone();
        }
        // Those of another level go first: they take a good part of the memory.
        self.exact = None;
        let solvers = Arc::new(self.exact_solvers(at));
        self.exact = Some((at, solvers.clone()));
        solvers
    }

    /// Solvers of a finer level: its surface is about right from the start.
    pub fn iterative_solvers(&self, at: usize) -> SolverSet {
        SolverSet::iterative(
            self.scene.frames.len(),
            self.budget().keeps_solvers(self.scene.level(at)),
        )
    }

    /// How the views' surfaces are read: where photos disagree depth is noisy down to single
    /// pixels.
    pub fn reading(&self) -> Reading {
        if self.photos_disagree() {
            Reading::Bilinear
        } else {
            Reading::Cubic
        }
    }

    /// Measures how sharp the photos are against each other at a level.
    pub fn measure_sharpness(&mut self, at: usize, depths: &[Vec<f64>]) {
        let found = sharpness::measure(self.scene.level(at), depths);
        for (view, sharpness) in self.report.views.iter_mut().zip(found) {
            view.sharpness = sharpness;
        }
        self.use_sharpness(at);
    }

    /// Gives the views of a level the sharpness that was measured last.
    pub fn use_sharpness(&mut self, at: usize) {
        let views = &mut self.scene.level_mut(at).views;
        for (view, report) in views.iter_mut().zip(&self.report.views) {
            view.sharpness = report.sharpness;
        }
    }

    /// All views' surfaces made one, from depths up to `truncation_px` footprints apart.
    pub fn fused(
        &self,
        at: usize,
        depths: &[Vec<f64>],
        truncation_px: f64,
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let level = self.scene.level(at);
        self.progress(PhotoStep::Fusion, 0, 1)?;
        let truncation = truncation_px / level.focal();
        Ok(consensus::fuse(level, depths, truncation, self.reading()))
    }

    /// The surface without specks; reports their share in each view before and after.
    pub fn without_specks(&mut self, at: usize, depths: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
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
    pub fn descend(
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
            let solver = solvers.of(i, &fine.pixels);
            let filled = solver.and_then(|solver| {
                start::fill(fine, &solver, &values, &weight, 1.0, 1e-5, |_| false)
            });
            filled.map_err(|e| self.failed(i, &e))
        })
    }

    /// The surface at the next coarser level.
    pub fn reduced(&self, at: usize, depths: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (fine, coarse) = (self.scene.level(at), self.scene.level(at + 1));
        (0..fine.views.len())
            .into_par_iter()
            .map(|i| between_levels::reduce(&fine.views[i], &coarse.views[i], &depths[i]))
            .collect()
    }

    /// The surface at level `at` moved by the change at the next coarser level, from `before` to
    /// `after`: what only the finer level resolves stays.
    pub fn raised(
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
                let change = after[i].iter().zip(&before[i]);
                let change: Vec<[f32; 1]> = change.map(|(a, b)| [(a - b) as f32]).collect();
                let change = spread::spread(&coarse.views[i], &fine.views[i], &change);
                let moved = change.iter().zip(&depths[i]);
                moved.map(|(c, depth)| depth + f64::from(c[0])).collect()
            })
            .collect()
    }

    /// Shows a surface in memory to the probe.
    pub fn show(&self, at: usize, step: &str, depths: &[Vec<f64>]) -> Result<(), ShadingError> {
        if self.probe.is_none() {
            return Ok(());
        }
        let depths = depths.to_vec();
        self.show_surface(step, &Shape { at, depths })
    }

    /// Shows a surface to the probe, at the photos' resolution.
    pub fn show_surface(&self, step: &str, surface: &dyn Surface) -> Result<(), ShadingError> {
        if let Some(probe) = self.probe {
            let views = (0..self.scene.frames.len())
                .into_par_iter()
                .map(|i| output::maps(&self.scene, surface, i, None))
                .collect::<Result<_, _>>()?;
            probe(step, &ShadedViews { views });
        }
        Ok(())
    }
}
