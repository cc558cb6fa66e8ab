//! Circle candidates by voting.
//!
//! Every edge pixel votes for the centres that lie along its gradient, on both sides, but only as
//! far as the way there is free of stronger edges: a matte sphere is smooth inside, a textured
//! ground is not, and its votes end after a few pixels. The outline of a sphere is an ellipse of
//! small eccentricity; a vote's blur of one pixel and the search that follows take that up.

use super::edges::Edges;
use rilievo_scene::Raster;

/// A circle in full-size pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Circle {
    pub center: [f64; 2],
    pub radius: f64,
}

/// An edge that this many times exceeds the voting edge, or any edge of half its size after the
/// first pixels, ends the vote.
const BLOCKING: f32 = 0.6;

pub(super) fn circles(edges: &Edges, radius_px: [f64; 2], max_num: usize) -> Vec<Circle> {
    let (width, height) = (edges.edge.width, edges.edge.height);
    let low = (radius_px[0] / edges.reduction as f64).max(5.0);
    let high = (radius_px[1] / edges.reduction as f64).max(low + 1.0);
    // Centres may lie outside the frame by half a radius: a sphere cut by the frame.
    let border = (0.7 * high) as usize;
    let mut votes = Raster::filled(width + 2 * border, height + 2 * border, 0.0_f32);
    for_each_vote(edges, high, |_, r, cx, cy| {
        if r >= low {
            let (x, y) = (cx + border as f64, cy + border as f64);
            if x >= 0.0 && y >= 0.0 && x + 0.5 < votes.width as f64 && y + 0.5 < votes.height as f64
            {
                // The perimeter grows with the radius, so that each voter counts less.
                *votes.at_mut((x + 0.5) as usize, (y + 0.5) as usize) += (1.0 / r) as f32;
            }
        }
    });
    let votes = blur(&votes);
    let mut peaks = Vec::new();
    for y in 2..votes.height - 2 {
        for x in 2..votes.width - 2 {
            let here = *votes.at(x, y);
            let is_peak = here > 0.5
                && (y - 2..=y + 2)
                    .all(|v| (x - 2..=x + 2).all(|u| (u, v) == (x, y) || *votes.at(u, v) <= here));
            if is_peak {
                peaks.push((here, x as f64 - border as f64, y as f64 - border as f64));
            }
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(4 * max_num);
    radii(edges, &peaks, low, high, max_num)
}

/// Calls back with (edge index, radius, centre) for every vote.
fn for_each_vote(edges: &Edges, high: f64, mut vote: impl FnMut(usize, f64, f64, f64)) {
    let (width, height) = (edges.edge.width, edges.edge.height);
    for y in 0..height {
        for x in 0..width {
            let g = *edges.edge.at(x, y);
            let size = g[0].hypot(g[1]);
            if size == 0.0 {
                continue;
            }
            let (ux, uy) = (f64::from(g[0] / size), f64::from(g[1] / size));
            for sign in [1.0, -1.0] {
                let mut r = 1.0;
                while r <= high {
                    let (cx, cy) = (x as f64 + sign * r * ux, y as f64 + sign * r * uy);
                    let inside = cx >= 0.0
                        && cy >= 0.0
                        && cx + 0.5 < width as f64
                        && cy + 0.5 < height as f64;
                    // The first pixels still belong to the edge's own blur.
                    if inside
                        && r > 3.0
                        && *edges.magnitude.at((cx + 0.5) as usize, (cy + 0.5) as usize)
                            > BLOCKING * size
                    {
                        break;
                    }
                    vote(y * width + x, r, cx, cy);
                    r += 1.0;
                }
            }
        }
    }
}

fn blur(votes: &Raster<f32>) -> Raster<f32> {
    Raster::from_fn(votes.width, votes.height, |x, y| {
        let mut sum = 0.0;
        for dy in -2..=2_isize {
            for dx in -2..=2_isize {
                sum += votes
                    .get(x as isize + dx, y as isize + dy)
                    .copied()
                    .unwrap_or(0.0);
            }
        }
        sum
    })
}

/// The radius at each peak: the one with the largest share of its circle on edges that point to it.
fn radii(
    edges: &Edges,
    peaks: &[(f32, f64, f64)],
    low: f64,
    high: f64,
    max_num: usize,
) -> Vec<Circle> {
    let num_bins = high as usize + 4;
    let mut histograms = vec![vec![0.0_f64; num_bins]; peaks.len()];
    for y in 0..edges.edge.height {
        for x in 0..edges.edge.width {
            let g = *edges.edge.at(x, y);
            let size = f64::from(g[0].hypot(g[1]));
            if size == 0.0 {
                continue;
            }
            for (histogram, (_, cx, cy)) in histograms.iter_mut().zip(peaks) {
                let (dx, dy) = (cx - x as f64, cy - y as f64);
                let r = dx.hypot(dy);
                if r < low - 1.0 || r > high + 1.0 {
                    continue;
                }
                let along = (dx * f64::from(g[0]) + dy * f64::from(g[1])).abs() / (r * size);
                if along > 0.94 {
                    histogram[(r + 0.5) as usize] += 1.0;
                }
            }
        }
    }
    let mut found: Vec<(f64, Circle)> = Vec::new();
    for (histogram, (_, cx, cy)) in histograms.iter().zip(peaks) {
        // Two radii a peak: an outline and a stronger ring of something else may compete.
        let mut scores: Vec<(f64, usize)> = (low as usize..num_bins - 1)
            .map(|r| {
                let count = histogram[r - 1] + histogram[r] + histogram[r + 1];
                (count / (std::f64::consts::TAU * r as f64), r)
            })
            .collect();
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut kept: Vec<usize> = Vec::new();
        for (score, r) in scores {
            if kept.len() == 2 {
                break;
            }
            if kept.iter().all(|k| k.abs_diff(r) > 3) {
                kept.push(r);
                let circle = Circle {
                    center: [edges.full(*cx), edges.full(*cy)],
                    radius: r as f64 * edges.reduction as f64,
                };
                found.push((score, circle));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut circles: Vec<Circle> = Vec::new();
    for (_, circle) in found {
        let near = circles.iter().any(|other| {
            let distance = (circle.center[0] - other.center[0])
                .hypot(circle.center[1] - other.center[1])
                + (circle.radius - other.radius).abs();
            distance < 0.08 * other.radius
        });
        if !near {
            circles.push(circle);
            if circles.len() == max_num {
                break;
            }
        }
    }
    circles
}
