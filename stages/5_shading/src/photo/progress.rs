//! The state between two phases, kept after each of them, so that a stopped run resumes there and
//! ends with the bytes of an undisturbed one.
//!
//! The views' images are not kept: they are loaded again and divided by the gains that the kept report holds. A surface
//! out of core is a part of the state for each view.

use super::chroma::ChromaNoise;
use super::light::Light;
use super::report::{PhotoReport, StepReport};
use super::schedule::IterationWeights;
use super::shape::{FineShape, Shape};
use super::solver::Solver;
use crate::error::ShadingError;
use rilievo_photometry::visibility::Ground;
use rilievo_scene::StatePart;
use rilievo_stereo::searched_depths::SearchedDepths;
use rilievo_stereo::stored::StoredSurface;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::io::{self, BufWriter, Read, Write};

/// Part of the kept state that holds the light; it changes seldom.
const LIGHT: &str = "light";
/// Part that holds everything else.
const STATE: &str = "state";

/// The surface so far, and the next phase.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Progress {
    pub shape: Shape,
    pub phase: Phase,
}

/// A phase of a run.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum Phase {
    /// An outer iteration of light and shape.
    Outer(OuterIterations),
    /// The next finer level that is solved as a whole, under the kept light, with the weights of the last outer
    /// iteration.
    Finer(IterationWeights),
    /// A round of relief, under the kept light.
    Relief(ReliefRounds),
}

/// What a phase leaves beside the surface.
pub(crate) struct Outcome {
    /// Light to go on with, where it is a new one.
    pub light: Option<Light>,
    /// The next phase; none when the surface is found.
    pub next: Option<Phase>,
}

impl Outcome {
    /// Of a phase after which relief goes on, or nothing.
    pub fn relief(next: Option<ReliefRounds>) -> Self {
        Self {
            light: None,
            next: next.map(Phase::Relief),
        }
    }
}

/// Where the outer iterations are.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct OuterIterations {
    pub ground: Option<Ground>,
    /// What the search at the coarse level found.
    pub searched: SearchedDepths,
    /// Those that are done.
    pub num_done: usize,
    /// The first of them, which run at half the coarse level's resolution.
    pub num_half: usize,
    /// Log depths of all views before the iterations at half the coarse level's resolution: at the coarse level, and
    /// reduced.
    pub kept: Option<[Vec<Vec<f64>>; 2]>,
    /// The light's residual in the last one.
    pub residual: f64,
    /// Mean turn of the normals in the last one, degrees.
    pub turned_deg: f64,
}

/// Where relief at the photos' own pixels is.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct ReliefRounds {
    /// The level of the kept light.
    pub coarse: usize,
    /// Weights of the last outer iteration.
    pub last: IterationWeights,
    /// Rounds at the shape's level that are done.
    pub num_done: usize,
    /// Noise of every view's chroma at this level: that of its photo, measured once.
    pub noise: Vec<Option<ChromaNoise>>,
    /// Typical turn of the normals of the surface that the coarser level handed down, radians.
    pub turn_scale: Option<f64>,
    pub record: StepReport,
}

/// Everything but the light: whether there is one, warnings, report and progress. It is written
/// from references in the same order.
type State = (bool, Vec<String>, PhotoReport, Progress);

/// Writes the surface of a view.
type WriteView<'a> = Box<dyn Fn(&mut dyn Write) -> io::Result<()> + Sync + 'a>;

/// Part that holds the surface of a view at a level out of core.
fn part_of_view(index: usize) -> String {
    format!("view{index}")
}

impl Solver<'_> {
    /// Keeps the state; the light is written only when it is a new one.
    pub(crate) fn keep(
        &self,
        progress: &Progress,
        light: Option<&Light>,
        is_new: bool,
    ) -> Result<(), ShadingError> {
        let state = (light.is_some(), &self.warnings, &self.report, progress);
        let write_state = |to: &mut dyn Write| write(&state, to);
        let write_light = |to: &mut dyn Write| write(&light, to);
        let mut parts = vec![StatePart {
            name: STATE,
            write: &write_state,
        }];
        let fine: Vec<(String, WriteView<'_>)> = match &self.fine {
            Some(fine) => (0..self.scene.frames.len())
                .map(|i| {
                    let write: WriteView<'_> =
                        Box::new(move |to: &mut dyn Write| fine.surface.save(i, to));
                    (part_of_view(i), write)
                })
                .collect(),
            None => Vec::new(),
        };
        parts.extend(fine.iter().map(|(name, write)| StatePart { name, write }));
        if is_new {
            parts.push(StatePart {
                name: LIGHT,
                write: &write_light,
            });
        }
        Ok(self.around.checkpoint.keep(&parts)?)
    }

    /// The kept state with its light, where there is one and it belongs to the loaded views; its
    /// warnings are repeated.
    pub(crate) fn resume(&mut self) -> Result<Option<(Progress, Option<Light>)>, ShadingError> {
        let Some(((_, warnings, report, progress), light)) = self.kept() else {
            return Ok(None);
        };
        let gains: Vec<_> = report.views.iter().map(|view| view.gain).collect();
        self.scene.divide_by_gains(&gains);
        self.report = report;
        for message in warnings {
            self.warn(message)?;
        }
        Ok(Some((progress, light)))
    }

    fn kept(&mut self) -> Option<(State, Option<Light>)> {
        let state: State = read(self.around.checkpoint.read(STATE)?)?;
        let (has_light, _, report, progress) = &state;
        if !self.fits(report, &progress.shape) {
            return None;
        }
        if let Phase::Outer(outer) = &progress.phase
            && !outer.searched.fits(self.scene.level(self.scene.coarse))
        {
            return None;
        }
        let light: Option<Light> = if *has_light {
            self.around.checkpoint.read(LIGHT).and_then(read)?
        } else {
            None
        };
        if let Phase::Relief(rounds) = &progress.phase {
            self.fine = Some(self.restored(rounds.record.level)?);
        }
        Some((state, light))
    }

    /// The kept surface at a level out of core.
    fn restored(&self, at: usize) -> Option<FineShape> {
        if at >= self.scene.finest {
            return None;
        }
        let surface = StoredSurface::new(&self.scene.stored, at, self.around.scratch).ok()?;
        for i in 0..self.scene.frames.len() {
            let mut from = self.around.checkpoint.read(&part_of_view(i))?;
            surface.restore(i, &mut from).ok()?;
        }
        Some(FineShape { at, surface })
    }

    /// Whether a kept state is of the loaded views.
    fn fits(&self, report: &PhotoReport, shape: &Shape) -> bool {
        if !(self.scene.finest..self.scene.num_levels()).contains(&shape.at) {
            return false;
        }
        let views = &self.scene.level(shape.at).views;
        let num_pixels = views.iter().map(|view| view.pixels.len());
        report.views.len() == views.len() && num_pixels.eq(shape.depths.iter().map(Vec::len))
    }
}

fn write(value: &impl Serialize, to: &mut dyn Write) -> io::Result<()> {
    let mut to = BufWriter::with_capacity(1 << 20, to);
    postcard::to_io(value, &mut to).map_err(io::Error::other)?;
    to.flush()
}

fn read<T: DeserializeOwned>(from: Box<dyn Read>) -> Option<T> {
    let mut from = io::BufReader::with_capacity(1 << 20, from);
    // As long as the longest text.
    let mut scratch = vec![0; 1 << 16];
    let found = postcard::from_io((&mut from, &mut scratch));
    found.ok().map(|(value, _)| value)
}
