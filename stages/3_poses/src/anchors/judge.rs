//! From patches to estimates: noise factor, combination over views, and what is believed.
//!
//! **Noise factor.** Residuals of neighbouring samples are correlated, so least squares claims a
//! deviation `σ` that is several times too small. How many times is measured on the photos
//! themselves: two views' patches of the same surface differ by `q_i − q_j`, and with true
//! deviations `κ σ` and a correlation `ρ` between the two
//! `κ = P₆₈(|q_i − q_j| / √((σ_i² + σ_j²)(1 − ρ)))`, `P₆₈` the 68th percentile over all pairs. Two
//! estimates correlate because they rest on the same photos, like means with common terms:
//! `ρ = ρ₁ |S_i ∩ S_j| / √(|S_i| |S_j|)`, `S` a patch's own photo and those it is aligned with.
//! To this is added a floor for what is not noise (interpolation, curvature inside a patch).
//!
//! **Combination.** A patch and the predictions of the views that agree with it are averaged with
//! weights `1/σ²`; with correlation `ρ`, the mean over these views, the variance is
//! `ρ (Σ w σ)² + (1 − ρ) Σ w² σ²` for weights that sum to 1.
//!
//! **Belief.** More views agree than look through the point, and its doubt is at most
//! [`MAX_DOUBT_PX`]:
//!
//! `doubt = √(d² + (½ s)²) · (1 + 0.6 tan τ) · (1 + 0.08 m) · a · (0.92 + 1.5 (1 − r))`, pixels of
//! disparity, with
//!
//! - `d = ¼σ + ¾σ₁` of the combined deviation `σ` and the patch's own `σ₁`: a view that rests on
//!   the same photos agrees with their errors too;
//! - `s` the largest step to a neighbour, `½ [(q + g·d − q_n) + (q − (q_n − g_n·d))]`, in which
//!   curvature cancels, so that it shows depth edges;
//! - `τ` the tilt, `m` how many of the eight neighbours failed, and `a` = 1.5, 1.2, 1 for one, two,
//!   more views that agree;
//! - `r` the mean correlation with the sources: what no plane, offset and gain explain is relief,
//!   an edge, or shading that moved.
//!
//! The factors are no model: they were fitted to the outliers of rendered and real objects with
//! known depth.

use super::check::{Support, supports};
use super::grid::Grid;
use super::grow::Node;
use super::pair::MAX_SOURCES;
use super::working::WorkingView;
use rayon::prelude::*;
use rilievo_numerics::robust::quantile;
use rilievo_stereo::camera::Warp;

/// Correlation between two views' estimates of one depth that rest on the same photos. Raw errors
/// correlate by 0.76 to 0.9 on rendered objects; with this value predicted and true errors agree there.
const SAME_PHOTOS_CORRELATION: f64 = 0.64;
/// Deviation that remains without noise, working pixels of disparity; set with the correlation, by
/// the errors of the surest fifth of the anchors.
const FLOOR_PX: f64 = 0.37;
/// Noise factor of too few pairs; plain surfaces give 5 to 8.
const DEFAULT_NOISE_FACTOR: f64 = 7.0;
/// Fewest pairs that measure it.
const MIN_PAIRS: usize = 50;
/// Two views agree within this disparity, working pixels.
const AGREE_PX: f64 = 1.0;
/// A view looks through a point that lies this far in front of its own surface, working pixels.
const CONTRADICT_PX: f64 = 3.0;

/// Steps beyond this say no more.
const MAX_STEP_PX: f64 = 6.0;

/// Largest doubt, working pixels of disparity. Smaller leaves fewer and better anchors.
const MAX_DOUBT_PX: f64 = 3.35;

/// A believed surface point of a view.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    /// Working-view index.
    pub view: usize,
    /// Cell of the view's grid.
    pub cell: usize,
    /// Combined inverse depth.
    pub q: f64,
    /// Its standard deviation.
    pub sigma_q: f64,
    /// The same in pixels of disparity.
    pub sigma_px: f64,
    /// Views that agree.
    pub agreeing: Vec<usize>,
}

/// Everything the views say of each other's patches: one list per patch, by view and cell.
type SupportLists = Vec<Vec<Vec<Support>>>;

/// Collects what the neighbours of each view say of its patches.
pub(super) fn all_supports(
    views: &[WorkingView],
    neighbours: &[Vec<usize>],
    grids: &[Grid],
    nodes: &[Vec<Option<Node>>],
    radius_px: f64,
) -> SupportLists {
    (0..views.len())
        .into_par_iter()
        .map(|view| {
            let warps: Vec<(usize, Warp)> = (neighbours[view].iter())
                .filter_map(|&other| {
                    Some((
                        other,
                        Warp::between(&views[view].camera, &views[other].camera)?,
                    ))
                })
                .collect();
            nodes[view]
                .iter()
                .map(|node| match node {
                    Some(node) => supports(&warps, grids, nodes, node, radius_px),
                    None => Vec::new(),
                })
                .collect()
        })
        .collect()
}

/// The noise factor `κ`, measured; `None` where too few pairs of patches agree.
pub(super) fn noise_factor(nodes: &[Vec<Option<Node>>], lists: &SupportLists) -> Option<f64> {
    let mut scaled = Vec::new();
    for (view, list) in lists.iter().enumerate() {
        for (cell, supports) in list.iter().enumerate() {
            let Some(node) = &nodes[view][cell] else {
                continue;
            };
            for support in supports {
                let Some(there) = &nodes[support.view][support.cell] else {
                    continue;
                };
                if support.difference_px.abs() < CONTRADICT_PX {
                    let sigma = node
                        .alignment
                        .sigma_q
                        .hypot(there.alignment.sigma_q * support.gain);
                    let apart = 1.0 - correlation((view, node), (support.view, there));
                    scaled
                        .push((support.q - node.alignment.plane.q).abs() / (sigma * apart.sqrt()));
                }
            }
        }
    }
    if scaled.len() < MIN_PAIRS {
        return None;
    }
    Some(quantile(&mut scaled, 0.6827)?.max(1.0))
}

/// Correlation of the estimates of two patches of different views.
fn correlation((view, node): (usize, &Node), (other_view, other): (usize, &Node)) -> f64 {
    let photos = |view: usize, node: &Node| {
        let alignment = &node.alignment;
        let mut set = [view; 1 + MAX_SOURCES];
        for (slot, (source, _)) in set[1..]
            .iter_mut()
            .zip(&alignment.offsets[..alignment.num_sources])
        {
            *slot = *source;
        }
        (set, 1 + alignment.num_sources)
    };
    let ((mine, num_mine), (theirs, num_theirs)) = (photos(view, node), photos(other_view, other));
    let shared = mine[..num_mine]
        .iter()
        .filter(|photo| theirs[..num_theirs].contains(photo))
        .count();
    SAME_PHOTOS_CORRELATION * shared as f64 / ((num_mine * num_theirs) as f64).sqrt()
}

/// Honest deviation of a patch's own inverse depth.
fn own_sigma(node: &Node, noise_factor: f64) -> f64 {
    (noise_factor * node.alignment.sigma_q).hypot(FLOOR_PX / node.alignment.px_per_q)
}

/// Largest step of depth to the eight neighbours, pixels of disparity as between neighbours eight
/// pixels apart, and the number of neighbours; curvature cancels.
fn neighbourhood(grid: &Grid, nodes: &[Option<Node>], cell: usize, node: &Node) -> (f64, usize) {
    let plane = &node.alignment.plane;
    let (mut largest, mut count) = (0.0_f64, 0);
    for dy in -1..=1 {
        for dx in -1..=1 {
            let Some(other) = grid
                .neighbour(cell, dx, dy)
                .filter(|&other| other != cell)
                .and_then(|other| nodes[other].as_ref())
            else {
                continue;
            };
            count += 1;
            let there = &other.alignment.plane;
            let (x, y) = (
                there.x as f64 - plane.x as f64,
                there.y as f64 - plane.y as f64,
            );
            let slope = 0.5 * ((plane.qx + there.qx) * x + (plane.qy + there.qy) * y);
            largest = largest.max((plane.q + slope - there.q).abs() * node.alignment.px_per_q);
        }
    }
    // Relief steps more between patches that lie further apart.
    let scale = (8.0 / grid.spacing as f64).min(1.0);
    ((largest * scale).min(MAX_STEP_PX), count)
}

/// The believed points of one view of a focal length in working pixels.
pub(super) fn judge(
    view: usize,
    focal_px: f64,
    grid: &Grid,
    nodes: &[Vec<Option<Node>>],
    lists: &SupportLists,
    noise_factor: Option<f64>,
) -> Vec<Estimate> {
    let factor = noise_factor.unwrap_or(DEFAULT_NOISE_FACTOR);
    let mut believed = Vec::new();
    for (cell, node) in nodes[view].iter().enumerate() {
        let Some(node) = node else { continue };
        let own = own_sigma(node, factor);
        let (mut weight, mut sum) = (own.powi(-2), node.alignment.plane.q * own.powi(-2));
        // Σ w σ and Σ w² σ² before normalisation: w σ = 1/σ, w² σ² = 1/σ².
        let mut inverse_sigmas = 1.0 / own;
        let mut correlations = 0.0;
        let (mut agreeing, mut contradicting) = (Vec::new(), 0);
        for support in &lists[view][cell] {
            if support.difference_px >= CONTRADICT_PX {
                contradicting += 1;
            }
            if support.difference_px.abs() >= AGREE_PX {
                continue;
            }
            let Some(there) = &nodes[support.view][support.cell] else {
                continue;
            };
            let sigma = own_sigma(there, factor) * support.gain.abs();
            agreeing.push(support.view);
            correlations += correlation((view, node), (support.view, there));
            weight += sigma.powi(-2);
            sum += support.q * sigma.powi(-2);
            inverse_sigmas += 1.0 / sigma;
        }
        let rho = correlations / agreeing.len().max(1) as f64;
        let variance = rho * (inverse_sigmas / weight).powi(2) + (1.0 - rho) / weight;
        let sigma_q = variance.sqrt();
        let sigma_px = sigma_q * node.alignment.px_per_q;
        let plane = &node.alignment.plane;
        let tilt = plane.qx.hypot(plane.qy) / plane.q * focal_px;
        let (step, neighbours) = neighbourhood(grid, &nodes[view], cell, node);
        let lonely = 1.0 + 0.08 * (8 - neighbours) as f64;
        let few = match agreeing.len() {
            0 | 1 => 1.5,
            2 => 1.2,
            _ => 1.0,
        };
        let unexplained = 0.92 + 1.5 * (1.0 - node.alignment.correlation);
        let own_px = own * node.alignment.px_per_q;
        let deviation_px = 0.25 * sigma_px + 0.75 * own_px;
        let doubt =
            deviation_px.hypot(0.5 * step) * (1.0 + 0.6 * tilt) * lonely * few * unexplained;
        if agreeing.len() > contradicting && doubt <= MAX_DOUBT_PX {
            believed.push(Estimate {
                view,
                cell,
                q: sum / weight,
                sigma_q,
                sigma_px,
                agreeing,
            });
        }
    }
    believed
}
