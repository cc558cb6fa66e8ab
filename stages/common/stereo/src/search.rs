//! Dense search over all views of a level, inside their visual hull, and what the views confirm of it.

use crate::hull::{self, Outline};
use crate::level::Level;
use crate::patchmatch::{self, PatchCost, PatchMatchOptions, Planes};
use crate::start::{self, Agreement};
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_numerics::plate_solver::SolverSet;
use rilievo_numerics::plate_system::PlateError;
use rilievo_scene::Mask;

/// Size of a search over all views.
#[derive(Clone, Copy, Debug)]
pub struct SearchOptions {
    /// How patches are compared.
    pub cost: PatchCost,
    /// Sweeps of a search without a start.
    pub num_sweeps: usize,
    /// Seed of the random trials.
    pub seed: u64,
}

impl SearchOptions {
    /// Size of a view's search; one with a start needs its planes spread and polished only.
    fn of_view(&self, num_sources: usize, is_started: bool) -> PatchMatchOptions {
        PatchMatchOptions {
            cost: self.cost,
            num_sweeps: if is_started {
                self.num_sweeps.div_ceil(2)
            } else {
                self.num_sweeps
            },
            num_trials: 6,
            // Beside an edge some sources see another surface: the better half tells depth (Kang, Szeliski,
            // Chai, CVPR 2001). Differences need more, and so does a search without a start.
            num_best: if is_started && self.cost == PatchCost::Correlation {
                num_sources.div_ceil(2)
            } else {
                3
            },
            seed: self.seed,
        }
    }
}

/// What `keep` takes of the planes of every view, which are compared with its sources; `start` gives earlier ones of a
/// view.
///
/// The object lies where the masks meet if all views are `masked`, else about `points` in the world. `None`
/// where neither tells.
pub fn search_views<T: Send>(
    level: &Level,
    masked: bool,
    points: &[Point3<f64>],
    start: Option<&(dyn Fn(usize) -> Planes + Sync)>,
    options: &SearchOptions,
    keep: impl Fn(Planes) -> T + Sync,
) -> Option<Vec<T>> {
    let outlines: Vec<Outline> = level.views.iter().map(|v| v.outline(masked)).collect();
    let ranges: Vec<_> = hull::object_ranges(&outlines, points)
        .into_iter()
        .collect::<Option<_>>()?;
    // A pixel of slack: masks of different views never meet exactly.
    let masks: Vec<Mask> = level
        .views
        .iter()
        .map(|v| hull::dilate(&v.mask, 1))
        .collect();
    let outlines: Vec<Outline> = outlines
        .iter()
        .zip(&masks)
        .map(|(outline, mask)| Outline { mask, ..*outline })
        .collect();
    let num_sources = level.sources.iter().map(Vec::len).max().unwrap_or(1);
    let options = options.of_view(num_sources, start.is_some());
    let kept = (0..level.views.len())
        .into_par_iter()
        .with_max_len(1)
        .map(|i| {
            let view = &level.views[i];
            let positions: Vec<_> = (0..view.pixels.len()).map(|p| view.xy(p)).collect();
            // The whole range where the masks contradict each other.
            let ranges: Vec<_> = hull::ranges_inside(&outlines, i, &positions, ranges[i])
                .into_iter()
                .map(|range| range.unwrap_or(ranges[i]))
                .collect();
            let start = start.map(|of_view| of_view(i));
            let found = patchmatch::search(level, i, &masks, &ranges, start.as_ref(), &options);
            keep(found)
        })
        .collect();
    Some(kept)
}

/// What a search found.
pub struct Found {
    /// Log depths of every view, continued over its mask.
    pub surface: Vec<Vec<f64>>,
    /// Which depths the views confirmed.
    pub agreement: Vec<Agreement>,
    /// Distance between the views' searched depths, pixel footprints.
    pub scatter_px: f64,
}

/// The surface through those searched log depths that views confirm; `solvers` are the views' own.
///
/// # Errors
/// The view whose plate has no solution, and why.
pub fn found(
    level: &Level,
    solvers: &SolverSet,
    depths: &[Vec<f64>],
) -> Result<Found, (usize, PlateError)> {
    let agreement = start::agreement(level, depths, agreement_tolerance(level));
    let footprint = 1.0 / level.focal();
    let surfaces: Vec<_> = level
        .views
        .par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(i, view)| {
            let weight = agreement[i].weights();
            let solver = solvers.of(i, &view.pixels)?;
            start::continued(view, &solver, &depths[i], &weight, footprint)
        })
        .collect();
    let surface = surfaces
        .into_iter()
        .enumerate()
        .map(|(i, r)| r.map_err(|e| (i, e)))
        .collect::<Result<_, _>>()?;
    Ok(Found {
        surface,
        scatter_px: start::scatter(level, depths),
        agreement,
    })
}

/// Relative depth within which two views' dense depths agree: a few pixels of the level.
pub fn agreement_tolerance(level: &Level) -> f64 {
    2.7 / level.focal()
}
