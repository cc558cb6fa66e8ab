//! Cells of a view, and the range of depth at each of them.
//!
//! The range is that of the visual hull, or of the sparse points in the world where there are no
//! masks.

use super::working::WorkingView;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::Mask;
use rilievo_stereo::hull::{self, Outline};

/// Masks are widened before the test: outlines and poses are not exact.
const MASK_TOLERANCE_PX: usize = 3;
/// Cells on the object of a view at most: more anchors would cost time and add little, since
/// neighbours' errors correlate.
const MAX_CELLS: f64 = 6000.0;

/// Regular cells over a working view; anchors lie at their centres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Grid {
    /// Distance between neighbouring anchors, working pixels.
    pub spacing: usize,
    pub columns: usize,
    pub rows: usize,
}

impl Grid {
    /// Cells over a view.
    pub fn new(view: &WorkingView, spacing: usize) -> Self {
        Self {
            spacing,
            columns: view.camera.width / spacing,
            rows: view.camera.height / spacing,
        }
    }

    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Pixel at the centre of a cell.
    pub fn pixel(&self, cell: usize) -> (usize, usize) {
        let half = self.spacing / 2;
        (
            (cell % self.columns) * self.spacing + half,
            (cell / self.columns) * self.spacing + half,
        )
    }

    pub fn cell(&self, x: f64, y: f64) -> Option<usize> {
        if x.is_nan() || y.is_nan() || x < 0.0 || y < 0.0 {
            return None;
        }
        let (column, row) = (x as usize / self.spacing, y as usize / self.spacing);
        (column < self.columns && row < self.rows).then(|| row * self.columns + column)
    }

    /// Cell at an offset in columns and rows.
    pub fn neighbour(&self, cell: usize, dx: isize, dy: isize) -> Option<usize> {
        let column = (cell % self.columns) as isize + dx;
        let row = (cell / self.columns) as isize + dy;
        (column >= 0 && row >= 0 && column < self.columns as isize && row < self.rows as isize)
            .then(|| row as usize * self.columns + column as usize)
    }
}

/// Distance between cells: the wanted one, or more where the object is so large in the photos that
/// a view would get more than a few thousand anchors.
pub(super) fn grid_spacing(views: &[WorkingView], wanted_px: f64) -> usize {
    let largest = views.iter().map(|view| view.object.count()).max();
    let needed = (largest.unwrap_or(0) as f64 / MAX_CELLS).sqrt();
    wanted_px.max(needed).round() as usize
}

/// Views whose masks bound the depth of a cell: more, evenly spread, hardly cut anything off.
const MAX_CARVING: usize = 48;

/// Views to carve with: all, or of many each the farthest from those before it.
fn carving(views: &[WorkingView]) -> Vec<usize> {
    if views.len() <= MAX_CARVING {
        return (0..views.len()).collect();
    }
    let mut chosen = vec![0];
    let mut distances = vec![f64::INFINITY; views.len()];
    while chosen.len() < MAX_CARVING {
        let last = &views[chosen[chosen.len() - 1]].camera.center;
        let mut farthest = 0;
        for (v, distance) in distances.iter_mut().enumerate() {
            *distance = distance.min((views[v].camera.center - last).norm());
        }
        for v in 1..views.len() {
            if distances[v] > distances[farthest] {
                farthest = v;
            }
        }
        chosen.push(farthest);
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// Range of inverse depth (far, near) per cell; `None` off the object and outside the hull.
pub(super) type CellRanges = Vec<Option<(f64, f64)>>;

/// Ranges of every view; `None` where neither masks nor the sparse `points` place the object.
pub(super) fn depth_ranges(
    views: &[WorkingView],
    grids: &[Grid],
    points: &[Point3<f64>],
) -> Option<Vec<CellRanges>> {
    let outlines: Vec<Outline> = views.iter().map(|v| v.outline(&v.object)).collect();
    let whole = hull::object_ranges(&outlines, points);
    if whole.iter().all(Option::is_none) {
        return None;
    }
    let carving = carving(views);
    let widened: Vec<Mask> = carving
        .par_iter()
        .map(|&v| hull::dilate(&views[v].object, MASK_TOLERANCE_PX))
        .collect();
    let outlines: Vec<(usize, Outline)> = carving
        .iter()
        .zip(&widened)
        .map(|(&v, mask)| (v, views[v].outline(mask)))
        .collect();
    let ranges = (0..views.len())
        .into_par_iter()
        .map(|index| {
            let (view, grid) = (&views[index], &grids[index]);
            let mut ranges = vec![None; grid.len()];
            let Some(whole) = whole[index] else {
                return ranges;
            };
            let (cells, positions): (Vec<usize>, Vec<(f64, f64)>) = (0..grid.len())
                .map(|cell| {
                    let (x, y) = grid.pixel(cell);
                    (cell, (x as f64, y as f64))
                })
                .filter(|&(_, (x, y))| view.on_object(x, y))
                .unzip();
            // The view's own outline says nothing of depth; only its camera counts.
            let mut cutting = vec![view.outline(&view.object)];
            cutting.extend(outlines.iter().filter(|(v, _)| *v != index).map(|o| o.1));
            let inside = hull::ranges_inside(&cutting, 0, &positions, whole);
            for (cell, range) in cells.into_iter().zip(inside) {
                ranges[cell] = range.map(|r| {
                    let far = r.low.max(0.5 * whole.low);
                    (f64::from(far), f64::from(r.high))
                });
            }
            ranges
        })
        .collect();
    Some(ranges)
}
