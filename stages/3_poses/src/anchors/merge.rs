//! One anchor per surface point, seen by all views that agree on it.
//!
//! Estimates are taken in order of their deviation, the surest first. One that falls into a cell
//! already observed is the same surface point again and is dropped; otherwise it becomes an anchor
//! with an observation in its own view and in every agreeing view, at the projection of its
//! position, unless that cell is observed already or the view has no patch there (a depth edge, or
//! something in front).
//!
//! The error of an anchor lies along the ray of its own view. Displaced along it, the point leaves
//! the surface by `|n·r_i|` of the displacement, and the depth that view `j` should see there is
//! off by that over `|n·r_j|`: `σ(ln z_j) = σ(ln z_i) · D_i |n·r_i| / (D_j |n·r_j|)`, `D` the
//! distance, `r` the unit rays, `n` the patch's normal.

use super::grid::Grid;
use super::grow::Node;
use super::judge::Estimate;
use super::working::WorkingView;
use nalgebra::{Matrix3, Point3, Vector3};
use rilievo_scene::{Anchor, AnchorObservation, ViewIdx};
use rilievo_stereo::camera::Camera;

/// Deviation across the ray, working pixels: the position is defined on the ray of a whole pixel;
/// this keeps the covariance invertible.
const LATERAL_SIGMA_PX: f64 = 0.1;
/// Observations more uncertain than the anchor's own by this factor graze the surface.
const MAX_SIGMA_GROWTH: f64 = 2.0;

/// Builds the anchors; `ids` gives the views their index among the posed views.
pub(super) fn merge(
    views: &[WorkingView],
    ids: &[ViewIdx],
    grids: &[Grid],
    nodes: &[Vec<Option<Node>>],
    mut estimates: Vec<Estimate>,
) -> Vec<Anchor> {
    estimates.sort_by(|a, b| {
        a.sigma_px
            .total_cmp(&b.sigma_px)
            .then(a.view.cmp(&b.view))
            .then(a.cell.cmp(&b.cell))
    });
    let mut observed: Vec<Vec<bool>> = grids.iter().map(|grid| vec![false; grid.len()]).collect();
    let mut anchors = Vec::new();
    for estimate in &estimates {
        let (own, cell) = (estimate.view, estimate.cell);
        let Some(node) = nodes[own][cell].as_ref().filter(|_| !observed[own][cell]) else {
            continue;
        };
        observed[own][cell] = true;
        let view = &views[own];
        let plane = &node.alignment.plane;
        let (x, y) = (plane.x as f64, plane.y as f64);
        let position = view.camera.unproject(x, y, 1.0 / estimate.q);
        // m·X = 1 with m towards the surface: the normal up to sign and length.
        let normal = view
            .camera
            .rotation
            .tr_mul(&plane.in_camera(&view.camera))
            .normalize();
        let lever = |center: &Point3<f64>| (position - center).dot(&normal).abs();
        let own_sigma = estimate.sigma_q / estimate.q;
        let pixel = view.photo_pixel(x, y);
        let mut observations = vec![AnchorObservation {
            view: ids[own],
            pixel: [pixel.x, pixel.y],
            depth: 1.0 / estimate.q,
            sigma_ln_depth: own_sigma,
        }];
        for &other_idx in &estimate.agreeing {
            let other = &views[other_idx];
            let Some((u, v, depth)) = other.camera.project(&position) else {
                continue;
            };
            let sigma = own_sigma * lever(&view.camera.center) / lever(&other.camera.center);
            let Some(there) = grids[other_idx].cell(u, v) else {
                continue;
            };
            if observed[other_idx][there]
                || nodes[other_idx][there].is_none()
                || !other.on_object(u, v)
                || sigma.is_nan()
                || sigma > MAX_SIGMA_GROWTH * own_sigma
            {
                continue;
            }
            observed[other_idx][there] = true;
            let pixel = other.photo_pixel(u, v);
            observations.push(AnchorObservation {
                view: ids[other_idx],
                pixel: [pixel.x, pixel.y],
                depth,
                sigma_ln_depth: sigma,
            });
        }
        observations.sort_by_key(|o| o.view);
        anchors.push(Anchor {
            position: [position.x, position.y, position.z],
            covariance: covariance(&view.camera, &position, 1.0 / estimate.q, own_sigma),
            origin: node.origin,
            observations,
        });
    }
    anchors
}

/// Covariance of a point of a camera's depth, known along its ray.
fn covariance(
    camera: &Camera,
    position: &Point3<f64>,
    depth: f64,
    sigma_ln_depth: f64,
) -> [f64; 6] {
    let offset: Vector3<f64> = position - camera.center;
    let distance = offset.norm();
    let ray = offset / distance;
    let along = (distance * sigma_ln_depth).powi(2);
    let across = (LATERAL_SIGMA_PX * depth / camera.focal()).powi(2);
    let c = Matrix3::identity() * across + ray * ray.transpose() * (along - across).max(0.0);
    [
        c[(0, 0)],
        c[(0, 1)],
        c[(0, 2)],
        c[(1, 1)],
        c[(1, 2)],
        c[(2, 2)],
    ]
}
