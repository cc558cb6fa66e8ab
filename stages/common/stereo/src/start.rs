//! Start surface: what the views' dense depths agree on, continued by a robust thin plate.

use crate::edges;
use crate::level::{Level, LevelView};
use crate::plate;
use rayon::prelude::*;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::{Functional, OUTSIDE, PlateError, PlateSystem};
use rilievo_numerics::robust::{log_weight, median};

/// Difference within which two views' depths agree, pixel footprints.
pub(crate) const AGREEMENT_PX: f64 = 2.7;
/// Difference beyond which two views' depths belong to different surfaces, pixel footprints.
const MAX_SCATTER_PX: f64 = 10.0;

/// Weight of a depth that the sources in the bits `agreeing` confirm: 1 for two of them, ½ for one,
/// else 0.
pub fn confirmed_weight(agreeing: u8) -> f64 {
    match agreeing.count_ones() {
        0 => 0.0,
        1 => 0.5,
        _ => 1.0,
    }
}

/// Compares log depths between the views: per view and masked pixel, bit `k` is set where the
/// `k`-th source agrees within a few pixel footprints. A depth that is not a number agrees with none.
pub fn agreement(level: &Level, depths: &[Vec<f64>]) -> Vec<Vec<u8>> {
    let tolerance = AGREEMENT_PX / level.focal();
    (0..level.views.len())
        .into_par_iter()
        .map(|i| {
            let agrees = |p: usize, k: usize| {
                difference(level, depths, i, k, p).is_some_and(|apart| apart < tolerance)
            };
            let of_pixel = |p: usize| {
                let sources = 0..level.sources[i].len();
                sources.fold(0, |bits, k| bits | u8::from(agrees(p, k)) << k)
            };
            (0..depths[i].len()).map(of_pixel).collect()
        })
        .collect()
}

/// Difference of log depth between a pixel's point and the nearest pixel of source `k` where it
/// lands. Searched depths are noisy: no mean over pixels is one of them.
fn difference(level: &Level, depths: &[Vec<f64>], i: usize, k: usize, p: usize) -> Option<f64> {
    let at = level.landing(i, k, p, depths[i][p])?;
    let j = level.sources[i][k].0;
    let pixels = &level.views[j].pixels;
    let (u, v) = (at.u.round(), at.v.round());
    if u < 0.0 || v < 0.0 || u >= pixels.width as f64 || v >= pixels.height as f64 {
        return None;
    }
    let number = pixels.number[v as usize * pixels.width + u as usize];
    (number != OUTSIDE).then(|| (at.zeta - depths[j][number as usize]).abs())
}

/// How far the views' searched depths lie apart: the median difference of log depth times the focal
/// length, in pixel footprints. Differences beyond ten footprints are occluders.
pub fn scatter(level: &Level, depths: &[Vec<f64>]) -> f64 {
    let focal = level.focal();
    let mut all: Vec<f64> = (0..level.views.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let pairs = (0..level.sources[i].len())
                .flat_map(move |k| (0..depths[i].len()).map(move |p| (k, p)));
            pairs.filter_map(move |(k, p)| {
                let apart = difference(level, depths, i, k, p)? * focal;
                (apart < MAX_SCATTER_PX).then_some(apart)
            })
        })
        .collect();
    median(&mut all).unwrap_or(0.0)
}

/// The start surface of one view: a robust plate through the confirmed depths, which breaks where a
/// nearer surface hides a farther one.
///
/// Where other views look past an edge they cannot confirm what lies beside it: such a gap belongs to
/// the farther side. A plate alone would bridge it with a ramp along their lines of sight.
/// A depth that is not a number is unknown and hidden by nothing: the plate goes on through it.
/// `footprint` is a pixel's relative footprint, the standard deviation of a confirmed log depth.
pub fn continued(
    view: &LevelView,
    solver: &PlateSolver,
    depth: &[f64],
    weight: &[f64],
    footprint: f64,
) -> Result<Vec<f64>, PlateError> {
    const PLATE_WEIGHT: f64 = 10.0;
    // A gap's farther rim is known, what lies behind the edge only about.
    const GAP_WEIGHT: f64 = 0.01;
    let gaps = edges::hidden_gaps(view, depth, weight, footprint);
    let (mut depth, mut weight) = (depth.to_vec(), weight.to_vec());
    for (p, gap) in gaps.iter().enumerate() {
        if let Some(far) = gap {
            (depth[p], weight[p]) = (*far, GAP_WEIGHT);
        }
    }
    let plate = |is_cut: &dyn Fn(&Functional) -> bool| {
        fill(
            view,
            solver,
            &depth,
            &weight,
            footprint,
            PLATE_WEIGHT,
            is_cut,
        )
    };
    // A plate without breaks decides on which side unconfirmed pixels outside gaps lie.
    let mut surface = plate(&|_| false)?;
    for p in 0..surface.len() {
        if weight[p] > 0.0 {
            surface[p] = depth[p];
        }
    }
    plate(&|f| edges::is_cut(f, &gaps, &surface, footprint))
}

/// Robust thin plate through weighted log depths: `Σ w ρ(ζ − ζ₀) + α |D² ζ|²`, slopes in units of
/// the focal length; points farther than `sigma` (log depth) from the plate lose their weight.
/// Cut bends hardly count; neither does a log depth of weight zero, which may be unknown (not a number).
pub fn fill(
    view: &LevelView,
    solver: &PlateSolver,
    depth: &[f64],
    weight: &[f64],
    sigma: f64,
    plate_weight: f64,
    is_cut: impl Fn(&Functional) -> bool,
) -> Result<Vec<f64>, PlateError> {
    // Re-weightings: the plate settles within a few.
    const NUM_ITERATIONS: usize = 4;
    let n = view.pixels.len();
    let base = {
        let mut known: Vec<f64> = depth
            .iter()
            .zip(weight)
            .filter(|&(_, &w)| w > 0.0)
            .map(|(&d, _)| d)
            .collect();
        median(&mut known).unwrap_or(0.0)
    };
    let known = |(&d, &w): (&f64, &f64)| if w > 0.0 { d - base } else { 0.0 };
    let targets: Vec<f64> = depth.iter().zip(weight).map(known).collect();
    let mut system = PlateSystem::new(n);
    let mut current = weight
        .iter()
        .map(|w| w / (sigma * sigma))
        .collect::<Vec<_>>();
    let mut plate = Vec::new();
    for _ in 0..NUM_ITERATIONS {
        system.clear();
        plate::add_plate(view, &mut system, plate_weight, &is_cut);
        for i in 0..n {
            system.add_point(i, current[i] + 1e-9, targets[i]);
        }
        plate = solver.solve(&system)?;
        for i in 0..n {
            let r = (plate[i] - targets[i]).abs() * weight[i].sqrt() / sigma;
            current[i] = weight[i] / (sigma * sigma) * log_weight(r);
        }
    }
    for value in &mut plate {
        *value += base;
    }
    Ok(plate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;

    const FOCAL: f64 = 100.0;

    /// A near block before a far plane, six pixels of the plane beside it unconfirmed: log depths, and whether pixels
    /// lie in the gap.
    fn block(view: &LevelView) -> (Vec<f64>, Vec<bool>) {
        let depth = |x: u32| if x < 30 { 0.0 } else { 0.25 };
        let xs = view.pixels.xs.iter();
        xs.map(|&x| (depth(x), (30..36).contains(&x))).unzip()
    }

    /// What `depth` is continued to without breaks, and with them.
    fn continuations(view: &LevelView, depth: &[f64], is_gap: &[bool]) -> [Vec<f64>; 2] {
        let weight = is_gap.iter().map(|&is_gap| f64::from(u8::from(!is_gap)));
        let weight: Vec<f64> = weight.collect();
        let surfaces = PlateSolver::direct(&view.pixels).and_then(|solver| {
            let plain = fill(view, &solver, depth, &weight, 0.01, 10.0, |_| false)?;
            let broken = continued(view, &solver, depth, &weight, 1.0 / FOCAL)?;
            Ok([plain, broken])
        });
        match surfaces {
            Ok(surfaces) => surfaces,
            Err(error) => panic!("the plate has no solution: {error:?}"),
        }
    }

    #[test]
    fn a_hidden_gap_continues_the_farther_side() {
        let view = flat_view(60, 24, FOCAL);
        let (truth, is_gap) = block(&view);
        let [plain, broken] = continuations(&view, &truth, &is_gap);
        let worst = |depth: &[f64]| {
            (0..truth.len())
                .filter(|&p| is_gap[p])
                .map(|p| (depth[p] - truth[p]).abs())
                .fold(0.0, f64::max)
        };
        assert!(worst(&plain) > 0.05, "a plate bridges: {}", worst(&plain));
        assert!(worst(&broken) < 0.02, "the gap breaks: {}", worst(&broken));
    }

    #[test]
    fn an_unknown_gap_is_bridged_smoothly() {
        let view = flat_view(60, 24, FOCAL);
        let (mut depth, is_gap) = block(&view);
        for (depth, _) in depth.iter_mut().zip(&is_gap).filter(|(_, is_gap)| **is_gap) {
            *depth = f64::NAN;
        }
        let [_, broken] = continuations(&view, &depth, &is_gap);
        assert!(broken.iter().all(|d| d.is_finite()));
        // In a row amid: seven equal steps of a ramp would be .036 each.
        let row: Vec<f64> = (0..broken.len())
            .filter(|&p| view.pixels.ys[p] == 12)
            .map(|p| broken[p])
            .collect();
        let steepest = row.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
        assert!(steepest < 0.05, "a step of {steepest}");
    }
}
