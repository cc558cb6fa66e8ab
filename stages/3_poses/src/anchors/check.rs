//! Cross-view check: patches of other views must predict a patch's depth.
//!
//! A patch of view `i` puts a point `X` on the surface. Where a view `j` has a patch near the image
//! of `X`, that patch's plane `m·X_j = 1` (`X_j` in `j`'s camera frame; `m = Kᵀ (q_x, q_y, q − q_x x −
//! q_y y)`, since inverse depth is affine in the pixel) cuts the ray of `i` at the inverse depth
//! `q' = m·R r / (1 − m·t)`. The difference in pixels of disparity says whether the two agree.
//! A point that `j` sees behind its own surface is hidden there, which is no contradiction.

use super::grow::Node;
use super::hull::Grid;
use super::plane::PatchPlane;
use super::working::WorkingView;
use nalgebra::Vector3;

/// What one view says of another view's patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Support {
    /// The other view.
    pub view: usize,
    /// Its cell.
    pub cell: usize,
    /// Inverse depth that it predicts along the ray.
    pub q: f64,
    /// Factor from that patch's inverse depth to the prediction's.
    pub gain: f64,
    /// Difference to the patch's own inverse depth, pixels of disparity.
    pub difference_px: f64,
}

/// Plane of a patch in its camera frame, `m·X = 1`.
pub(super) fn plane_in_camera(view: &WorkingView, plane: &PatchPlane) -> Vector3<f64> {
    let at_origin = plane.q - plane.qx * plane.x as f64 - plane.qy * plane.y as f64;
    view.k.transpose() * Vector3::new(plane.qx, plane.qy, at_origin)
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

/// What the other views say of a patch; `radius` in working pixels of the other view.
pub(super) fn supports(
    views: &[WorkingView],
    grids: &[Grid],
    nodes: &[Vec<Option<Node>>],
    view_idx: usize,
    node: &Node,
    radius: f64,
    out: &mut Vec<Support>,
) {
    out.clear();
    let view = &views[view_idx];
    let plane = &node.alignment.plane;
    let point = view.point(plane.x as f64, plane.y as f64, plane.q);
    for (other_idx, other) in views.iter().enumerate() {
        if other_idx == view_idx {
            continue;
        }
        let Some((u, v, z)) = other.project(&point) else {
            continue;
        };
        let Some(cell) = nearest(&grids[other_idx], &nodes[other_idx], u, v, radius) else {
            continue;
        };
        let Some(there) = nodes[other_idx][cell].as_ref() else {
            continue;
        };
        let m = plane_in_camera(other, &there.alignment.plane);
        let other_from_view = other.cam_from_world.compose(&view.cam_from_world.inverse());
        let ray = other_from_view.rotation * view.ray(plane.x as f64, plane.y as f64);
        let t = other_from_view.translation;
        let denominator = 1.0 - m.dot(&t);
        let q = m.dot(&ray) / denominator;
        if !q.is_finite() || q <= 0.0 {
            continue;
        }
        // One unit of the other patch's inverse depth moves m by e₃.
        let gain = (ray.z + q * t.z) / denominator;
        // Compared where the other view measures: along its own ray, in its widest pair.
        let there_q = there.alignment.plane.q
            + there.alignment.plane.qx * (u - there.alignment.plane.x as f64)
            + there.alignment.plane.qy * (v - there.alignment.plane.y as f64);
        let difference_px = (1.0 / z - there_q) * there.alignment.px_per_q;
        out.push(Support {
            view: other_idx,
            cell,
            q,
            gain,
            difference_px,
        });
    }
}
