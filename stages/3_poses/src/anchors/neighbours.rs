//! Which other views a view is compared with.
//!
//! At points of the view's cells, in the middle of their ranges of depth, the few views are counted whose rays lie
//! nearest within the allowed angles: those are the sources that patches there will take. The views that are counted
//! most are the neighbours. Few views are all neighbours; of many each has so many, so that time and memory of a view
//! do not grow with their number.

use super::grid::{CellRanges, Grid};
use super::pair::{MAX_SOURCES, ray_angle};
use super::working::WorkingView;
use rayon::prelude::*;

/// Neighbours of a view: sources of all its patches, and those that check them.
pub(super) const MAX_NEIGHBOURS: usize = 20;
/// Points of a view that are looked at.
const NUM_POINTS: usize = 100;

/// The neighbours of every view, ascending.
pub(super) fn neighbours(
    views: &[WorkingView],
    grids: &[Grid],
    ranges: &[CellRanges],
    angles_rad: (f64, f64),
) -> Vec<Vec<usize>> {
    (0..views.len())
        .into_par_iter()
        .map(|index| {
            let others = (0..views.len()).filter(|&other| other != index);
            if views.len() <= MAX_NEIGHBOURS + 1 {
                return others.collect();
            }
            let camera = &views[index].camera;
            let cells: Vec<(usize, (f64, f64))> = (ranges[index].iter().enumerate())
                .filter_map(|(cell, range)| Some((cell, (*range)?)))
                .collect();
            // How often a view was among the nearest, and the sum of its angles.
            let mut counted = vec![(0_usize, 0.0_f64); views.len()];
            for &(cell, (far, near)) in cells
                .iter()
                .step_by(cells.len().div_ceil(NUM_POINTS).max(1))
            {
                let (x, y) = grids[index].pixel(cell);
                let point = camera.unproject(x as f64, y as f64, 2.0 / (far + near));
                let mut angles: Vec<(f64, usize)> = others
                    .clone()
                    .map(|other| {
                        let center = &views[other].camera.center;
                        (ray_angle(&point, &camera.center, center), other)
                    })
                    .collect();
                for &(angle, other) in &angles {
                    counted[other].1 += angle;
                }
                angles.retain(|(angle, _)| (angles_rad.0..=angles_rad.1).contains(angle));
                angles.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                for &(_, other) in angles.iter().take(MAX_SOURCES) {
                    counted[other].0 += 1;
                }
            }
            let mut order: Vec<usize> = others.collect();
            order.sort_by(|&a, &b| {
                let ((na, sa), (nb, sb)) = (counted[a], counted[b]);
                nb.cmp(&na).then(sa.total_cmp(&sb)).then(a.cmp(&b))
            });
            order.truncate(MAX_NEIGHBOURS);
            order.sort_unstable();
            order
        })
        .collect()
}
