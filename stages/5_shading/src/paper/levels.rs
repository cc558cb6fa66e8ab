//! A view on a ladder of resolutions, and the transfer of its surface between them.
//!
//! Coarse pixel `(x, y)` covers fine pixels `(2x, 2y)` to `(2x+1, 2y+1)` of the image, so that
//! coarse nodes are every second fine node. The unknown is measured in pixels of its own level:
//! halving the resolution halves it, and slopes keep their values.

use super::pixels::{Pixels, parents};
use rilievo_numerics::corner_grid::CornerGrid;
use rilievo_numerics::corner_poisson::PointConstraint;
use rilievo_scene::Mask;

/// Fewest pixels of a coarse level: below, setting it up costs more than it saves.
const MIN_PIXELS: usize = 600;

/// Share of white by which pixels under a coarse one may differ before it loses weight: the mean
/// over a crease or an edge is not the shading of the mean normal.
const UNLIKE: f32 = 0.07;

/// One resolution of a view.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    pub(crate) grid: CornerGrid,
    pub(crate) pixels: Pixels,
    /// 1 at the image's resolution, 2, 4, … on coarser levels.
    pub(crate) scale: f32,
}

/// The ladder, finest first; `white` is the unit of intensities.
pub(crate) fn ladder(
    grid: CornerGrid,
    pixels: Pixels,
    max_levels: usize,
    white: f64,
) -> Vec<Level> {
    let mut levels = vec![Level {
        grid,
        pixels,
        scale: 1.0,
    }];
    while levels.len() < max_levels {
        let Some(fine) = levels.last() else { break };
        if fine.grid.num_cells < 4 * MIN_PIXELS {
            break;
        }
        let width = (fine.grid.origin_x + fine.grid.width).div_ceil(2);
        let height = (fine.grid.origin_y + fine.grid.height).div_ceil(2);
        let mut mask = Mask::filled(width, height, false);
        for (x, y) in fine.grid.pixels() {
            *mask.at_mut(x / 2, y / 2) = true;
        }
        let Some(grid) = CornerGrid::new(&mask) else {
            break;
        };
        let parents = parents(&fine.grid, &grid);
        let pixels = fine
            .pixels
            .coarsen(&parents, grid.num_cells, UNLIKE * white as f32);
        let scale = 2.0 * fine.scale;
        levels.push(Level {
            grid,
            pixels,
            scale,
        });
    }
    levels
}

/// Calls `visit(position in padded raster, image column, image row)` for every node of the crop.
fn for_nodes(grid: &CornerGrid, mut visit: impl FnMut(usize, usize, usize)) {
    for y in 0..=grid.height {
        for x in 0..=grid.width {
            visit(grid.index(x, y), x + grid.origin_x, y + grid.origin_y);
        }
    }
}

/// Node values continued linearly by one ring beyond the nodes of the mask's pixels.
fn extended(grid: &CornerGrid, y: &[f32]) -> Vec<f32> {
    let s = grid.stride as isize;
    let mut active = vec![false; y.len()];
    for span in grid.spans() {
        active[span.cell..span.cell + span.len + 1].fill(true);
        active[span.cell + grid.stride..span.cell + grid.stride + span.len + 1].fill(true);
    }
    let is_active = |at: isize| at >= 0 && active.get(at as usize).copied().unwrap_or(false);
    let mut out = y.to_vec();
    for (at, value) in out.iter_mut().enumerate() {
        if active[at] {
            continue;
        }
        let (mut linear, mut constant) = ((0.0, 0.0), (0.0, 0.0));
        for step in [1, -1, s, -s, s + 1, s - 1, 1 - s, -1 - s] {
            let one = at as isize + step;
            if is_active(one) {
                let near = y[one as usize];
                if is_active(one + step) {
                    linear = (
                        linear.0 + 2.0 * near - y[(one + step) as usize],
                        linear.1 + 1.0,
                    );
                }
                constant = (constant.0 + near, constant.1 + 1.0);
            }
        }
        *value = if linear.1 > 0.0 {
            linear.0 / linear.1
        } else if constant.1 > 0.0 {
            constant.0 / constant.1
        } else {
            *value
        };
    }
    out
}

/// Node values of a coarse level from those of the next finer one.
pub(crate) fn restrict_nodes(fine: &CornerGrid, y: &[f32], coarse: &CornerGrid) -> Vec<f32> {
    let y = extended(fine, y);
    let mut out = vec![0.0; coarse.padded_len()];
    // Coarse pixels may reach one fine node beyond the crop, which the border of rasters holds.
    let place =
        |c: usize, origin: usize, size: usize| (2 * c + 1).saturating_sub(origin).min(size + 2);
    for_nodes(coarse, |at, cx, cy| {
        let x = place(cx, fine.origin_x, fine.width);
        let row = place(cy, fine.origin_y, fine.height);
        out[at] = 0.5 * y[row * fine.stride + x];
    });
    out
}

/// Adds the coarse level's change, interpolated bilinearly, to the fine node values.
pub(crate) fn add_change(
    coarse: &CornerGrid,
    before: &[f32],
    after: &[f32],
    fine: &CornerGrid,
    y: &mut [f32],
) {
    let change = |cx: usize, cy: usize| {
        let x = cx.clamp(coarse.origin_x, coarse.origin_x + coarse.width) - coarse.origin_x;
        let row = cy.clamp(coarse.origin_y, coarse.origin_y + coarse.height) - coarse.origin_y;
        let at = coarse.index(x, row);
        after[at] - before[at]
    };
    for_nodes(fine, |at, x, row| {
        let (x0, y0) = (x / 2, row / 2);
        let (x1, y1) = (x.div_ceil(2), row.div_ceil(2));
        y[at] += 0.5 * (change(x0, y0) + change(x1, y0) + change(x0, y1) + change(x1, y1));
    });
}

/// A point constraint of the finest level on a coarser one; its weight counts squared differences
/// in the finest level's pixels and is kept by the caller's normalisation.
pub(crate) fn place_constraint(
    grid: &CornerGrid,
    scale: f32,
    pixel: [f64; 2],
    weight: f32,
    value: f32,
) -> Option<PointConstraint> {
    let s = f64::from(scale);
    // Pixel centre (0, 0) of a level with scale s lies at (s − 1)/2 of the finest level.
    let on_level = |v: f64| (v - 0.5 * (s - 1.0)) / s;
    let (cell, corners) = grid.locate(on_level(pixel[0]), on_level(pixel[1]))?;
    Some(PointConstraint {
        cell,
        corners,
        weight,
        value: value / scale,
    })
}
