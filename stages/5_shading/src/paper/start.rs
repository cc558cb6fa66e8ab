//! Start shapes: node values of the unknown from a depth map, a plane, or anchors.

use super::prepare::Geometry;
use super::problem::{DepthAnchor, DepthPrior};
use rilievo_numerics::corner_grid::CornerGrid;
use rilievo_numerics::corner_poisson::CornerPoisson;
use rilievo_numerics::plate_system::PlateError;
use rilievo_numerics::thin_plate::{ScatteredValue, ThinPlate};
use rilievo_scene::DepthMap;

/// A start from anchors.
pub(crate) struct PlateStart {
    /// Node values.
    pub(crate) nodes: Vec<f32>,
    /// Which anchors the plate took for true.
    pub(crate) inliers: Vec<bool>,
}

/// A thin plate through anchors; `None` when no anchor lies on the grid.
pub(crate) fn plate(
    grid: &CornerGrid,
    geometry: &Geometry,
    anchors: &[DepthAnchor],
) -> Result<Option<PlateStart>, PlateError> {
    let points: Vec<ScatteredValue> = anchors
        .iter()
        .map(|anchor| ScatteredValue {
            position: anchor.pixel,
            value: geometry.unknown(anchor.depth),
            sigma: geometry.sigma(anchor.depth, anchor.sigma_ln_depth),
        })
        .collect();
    let low = [grid.origin_x as f64 - 0.5, grid.origin_y as f64 - 0.5];
    let high = [low[0] + grid.width as f64, low[1] + grid.height as f64];
    let Some(plate) = ThinPlate::fit(low, high, &points)? else {
        return Ok(None);
    };
    let mut y = vec![0.0; grid.padded_len()];
    for row in 0..=grid.height {
        for x in 0..=grid.width {
            let position = [low[0] + x as f64, low[1] + row as f64];
            y[grid.index(x, row)] = plate.at(position) as f32;
        }
    }
    Ok(Some(PlateStart {
        nodes: y,
        inliers: plate.inliers,
    }))
}

/// Nodal masses and wanted unknowns of a depth prior: `μ (ln z − ln z₀)²` per pixel with a value.
pub(crate) fn prior(
    grid: &CornerGrid,
    geometry: &Geometry,
    prior: &DepthPrior,
) -> (Vec<f32>, Vec<f32>) {
    let weight = (prior.weight / (geometry.focal * geometry.focal)) as f32;
    let mut mass = vec![0.0; grid.padded_len()];
    for ((x, row), cell) in grid.pixels().zip(
        grid.spans()
            .iter()
            .flat_map(|span| span.cell..span.cell + span.len),
    ) {
        if *prior.depth.at(x, row) > 0.0 {
            for node in [cell, cell + 1, cell + grid.stride, cell + grid.stride + 1] {
                mass[node] += 0.25 * weight;
            }
        }
    }
    (mass, from_depth(grid, geometry, &prior.depth))
}

/// Node values of a depth map; where it has no value, the smoothest continuation.
pub(crate) fn from_depth(grid: &CornerGrid, geometry: &Geometry, depth: &DepthMap) -> Vec<f32> {
    let mut y = vec![0.0; grid.padded_len()];
    let mut known = vec![0.0; grid.padded_len()];
    let mut missing = false;
    let value = |x: usize, row: usize| {
        depth
            .get(x as isize, row as isize)
            .filter(|&&z| z > 0.0 && z.is_finite())
            .map(|&z| geometry.unknown(f64::from(z)))
    };
    let mut inside = vec![false; grid.padded_len()];
    for span in grid.spans() {
        inside[span.cell..span.cell + span.len].fill(true);
    }
    for row in 0..=grid.height {
        for x in 0..=grid.width {
            let at = grid.index(x, row);
            let (mut sum, mut count) = (0.0, 0);
            let mut touches = false;
            for (dx, dy) in [(1, 1), (0, 1), (1, 0), (0, 0)] {
                let cell = at - dx - dy * grid.stride;
                if !inside[cell] {
                    continue;
                }
                touches = true;
                if let Some(v) = value(grid.origin_x + x - dx, grid.origin_y + row - dy) {
                    sum += v;
                    count += 1;
                }
            }
            if count > 0 {
                y[at] = (sum / f64::from(count)) as f32;
                known[at] = 1.0;
            } else if touches {
                missing = true;
            }
        }
    }
    // A border node averages fewer pixels, whose mean lies inside: continue the slope outwards.
    extrapolate_border(grid, &inside, &known, &mut y);
    if missing && known.iter().any(|&k| k > 0.0) {
        let mass: Vec<f32> = known.iter().map(|k| 100.0 * k).collect();
        let mut system = CornerPoisson::new(grid, &vec![1.0; grid.num_cells], 0.3);
        system.set_constraints(Some(&mass), &[]);
        let rhs: Vec<f32> = mass.iter().zip(&y).map(|(m, y)| m * y).collect();
        system.solve(&rhs, &mut y, 1e-3, 50);
    }
    y
}

/// Corrects nodes that average fewer than four pixels by the slope of full neighbours.
fn extrapolate_border(grid: &CornerGrid, inside: &[bool], known: &[f32], y: &mut [f32]) {
    let s = grid.stride;
    let full = |at: usize| {
        [at, at - 1, at - s, at - s - 1]
            .iter()
            .all(|&cell| inside[cell])
    };
    let interior: Vec<bool> = (0..y.len())
        .map(|at| {
            let (x, row) = (at % s, at / s);
            x > 0 && row > 0 && x + 2 < s && at + s < y.len() && full(at) && known[at] > 0.0
        })
        .collect();
    let source = y.to_vec();
    for row in 0..=grid.height {
        for x in 0..=grid.width {
            let at = grid.index(x, row);
            if interior[at] || known[at] == 0.0 {
                continue;
            }
            let (mut sum, mut count) = (0.0, 0.0);
            for step in [
                1,
                -1,
                s as isize,
                -(s as isize),
                1 + s as isize,
                1 - s as isize,
                s as isize - 1,
                -1 - s as isize,
            ] {
                let one = at as isize + step;
                let two = one + step;
                if one >= 0
                    && two >= 0
                    && (two as usize) < y.len()
                    && (one as usize) < y.len()
                    && interior[one as usize]
                    && interior[two as usize]
                {
                    sum += 2.0 * source[one as usize] - source[two as usize];
                    count += 1.0;
                }
            }
            if count > 0.0 {
                y[at] = sum / count;
            }
        }
    }
}
