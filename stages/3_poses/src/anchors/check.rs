//! Cross-view check: patches of other views must predict a patch's depth.
//!
//! A patch of view `i` puts a point on the surface at its pixel `x` and inverse depth. Where a view `j` has a
//! patch near the image of that point, inverse depth is the linear function `n·(u, v, 1)` of its pixels on that
//! patch. With the warp `P = A x + q b` from `i` to `j` the patch cuts the ray of `x` at the inverse depth
//! `q' = n·A x / (1 − n·b)`. The difference in pixels of disparity says whether the two agree.
//! A point that `j` sees behind its own surface is hidden there, which is no contradiction.

use super::grid::Grid;
use super::grow::Node;
use rilievo_stereo::camera::Warp;

/// What one view says of another view's patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Support {
    pub view: usize,
    pub cell: usize,
    /// Inverse depth that it predicts along the ray.
    pub q: f64,
    /// Factor from that patch's inverse depth to the prediction's.
    pub gain: f64,
    /// Difference to the patch's own inverse depth, pixels of disparity.
    pub difference_px: f64,
}

/// Nearest patch of a view around a position, within a radius.
fn nearest(grid: &Grid, nodes: &[Option<Node>], x: f64, y: f64, radius: f64) -> Option<usize> {
    let center = grid.cell(x, y)?;
    let reach = (radius / grid.spacing as f64).ceil() as isize;
    let mut best: Option<(f64, usize)> = None;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let Some(cell) = grid.neighbour(center, dx, dy) else {
                continue;
            };
            if nodes[cell].is_none() {
                continue;
            }
            let (u, v) = grid.pixel(cell);
            let distance = (u as f64 - x).hypot(v as f64 - y);
            if distance <= radius && best.is_none_or(|(d, _)| distance < d) {
                best = Some((distance, cell));
            }
        }
    }
    best.map(|(_, cell)| cell)
}

/// What the other views say of a patch; `warps` lead to them, `radius` is in working pixels there.
pub(super) fn supports(
    warps: &[(usize, Warp)],
    grids: &[Grid],
    nodes: &[Vec<Option<Node>>],
    node: &Node,
    radius: f64,
) -> Vec<Support> {
    let plane = &node.alignment.plane;
    let (x, y) = (plane.x as f64, plane.y as f64);
    let mut out = Vec::new();
    for &(view, ref warp) in warps {
        let landing = warp.at(x, y, plane.q);
        if landing.z.is_nan() || landing.z <= 0.0 {
            continue;
        }
        let pixel = landing / landing.z;
        let found = nearest(&grids[view], &nodes[view], pixel.x, pixel.y, radius);
        let Some((cell, there)) = found.and_then(|cell| Some((cell, nodes[view][cell].as_ref()?)))
        else {
            continue;
        };
        let n = there.alignment.plane.of_pixel();
        let denominator = 1.0 - n.dot(&warp.b);
        let q = n.dot(&warp.at(x, y, 0.0)) / denominator;
        if !q.is_finite() || q <= 0.0 {
            continue;
        }
        // Compared where the other view measures: along its own ray, in its widest pair.
        let difference = plane.q / landing.z - n.dot(&pixel);
        out.push(Support {
            view,
            cell,
            q,
            // One unit of the other patch's inverse depth moves n by e₃.
            gain: warp.at(x, y, q).z / denominator,
            difference_px: difference * there.alignment.px_per_q,
        });
    }
    out
}
