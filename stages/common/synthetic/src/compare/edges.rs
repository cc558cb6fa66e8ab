//! Depth edges, and what lies within a distance of marked pixels.

use super::truth::is_depth;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::{DepthMap, Raster};

/// A step of log depth that is so many times the median one is an edge.
const EDGE_FACTOR: f32 = 8.0;
/// A step of log depth that is none: what single precision leaves.
const MIN_EDGE: f32 = 1e-6;

/// Pixels on both sides of every depth edge: where log depth steps by much more than it usually
/// does.
pub(super) fn depth_edges(depth: &DepthMap) -> Raster<bool> {
    let (width, height) = (depth.width, depth.height);
    let log = |x: usize, y: usize| {
        let z = *depth.at(x, y);
        is_depth(z).then(|| z.ln())
    };
    let mut edges = Raster::filled(width, height, false);
    for (dx, dy) in [(1, 0), (0, 1)] {
        let step = |x: usize, y: usize| {
            if x + dx >= width || y + dy >= height {
                return None;
            }
            Some((log(x + dx, y + dy)? - log(x, y)?).abs())
        };
        let positions = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let mut steps: Vec<f64> = positions()
            .filter_map(|(x, y)| step(x, y).map(f64::from))
            .collect();
        let Some(typical) = median(&mut steps) else {
            continue;
        };
        // On a plane that faces the camera every step is rounding.
        let limit = (EDGE_FACTOR * typical as f32).max(MIN_EDGE);
        for (x, y) in positions() {
            if step(x, y).is_some_and(|s| s > limit) {
                *edges.at_mut(x, y) = true;
                *edges.at_mut(x + dx, y + dy) = true;
            }
        }
    }
    edges
}

/// Pixels whose disc of `radius` touches a blocked one; what lies beyond the raster counts as
/// `beyond` says.
pub(super) fn widened(blocked: &Raster<bool>, radius: f32, beyond: bool) -> Raster<bool> {
    let (width, height) = (blocked.width, blocked.height);
    let (square, radius) = ((radius * radius) as usize, radius as usize);
    // Distance along the row to the nearest blocked pixel or the end, up to the radius and one.
    let mut along = vec![0_usize; width * height];
    for y in 0..height {
        let row = &mut along[y * width..(y + 1) * width];
        for direction in [false, true] {
            let mut distance = if beyond { 0 } else { radius + 1 };
            for k in 0..width {
                let x = if direction { width - 1 - k } else { k };
                distance = if *blocked.at(x, y) {
                    0
                } else {
                    (distance + 1).min(radius + 1)
                };
                row[x] = if direction {
                    row[x].min(distance)
                } else {
                    distance
                };
            }
        }
    }
    let mut off = Raster::filled(width, height, false);
    off.data
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, off) in row.iter_mut().enumerate() {
                let touches = |dy: usize| {
                    let is_near = |y: usize| along[y * width + x].pow(2) + dy * dy <= square;
                    let above = y.checked_sub(dy);
                    let below = Some(y + dy).filter(|&y| y < height);
                    above.map_or(beyond, is_near) || below.map_or(beyond, is_near)
                };
                *off = (0..=radius).any(touches);
            }
        });
    off
}
