//! Normals at the depth anchors: a rough shape that owes nothing to shading.
//!
//! # Equations
//! At an anchor `X` the normal is the direction of least spread of its `k` nearest anchors: the
//! eigenvector of the smallest eigenvalue of `Σ w (X_j − m)(X_j − m)ᵀ`, with weights that fall
//! with distance and, in a second round, with the distance from the first plane. It is turned
//! towards the cameras that see the anchor. Flat neighbourhoods only: where the spread along the
//! normal exceeds a share of the spread across, the anchor is left out (edges, outliers).

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use rilievo_photometry::harmonics::Reading;
use rilievo_scene::{LinearImage, PosedViews};

/// Nearest anchors of a plane. Fewer follow the noise, more round the shape off.
const NEIGHBOURS: usize = 14;
/// Anchors that stand together in the list are often neighbours, whose normals share their errors:
/// blocks of this many go to the same half.
const BLOCK: usize = 16;
/// Largest ratio of the deviation along the normal to that across it.
const MAX_FLATNESS: f64 = 0.25;
/// Anchors considered; more change nothing but the time, which grows with the square.
const MAX_ANCHORS: usize = 12_000;

/// An anchor with a normal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OrientedAnchor {
    /// Index into [`PosedViews::anchors`].
    pub anchor: usize,
    /// Unit normal in the world, towards the cameras.
    pub normal_in_world: Vector3<f64>,
}

/// Normals of all anchors whose neighbourhood is flat enough.
pub(crate) fn orient(posed: &PosedViews) -> Vec<OrientedAnchor> {
    let stride = posed.anchors.len().div_ceil(MAX_ANCHORS).max(1);
    let chosen: Vec<usize> = (0..posed.anchors.len()).step_by(stride).collect();
    let positions: Vec<Point3<f64>> = chosen
        .iter()
        .map(|&k| Point3::from(posed.anchors[k].position))
        .collect();
    let centers: Vec<Point3<f64>> = posed
        .views
        .iter()
        .map(|view| view.cam_from_world.center_in_source())
        .collect();
    chosen
        .par_iter()
        .enumerate()
        .filter_map(|(at, &anchor)| {
            let normal = plane_normal(&positions, at)?;
            let towards: Vector3<f64> = posed.anchors[anchor]
                .observations
                .iter()
                .filter_map(|o| centers.get(o.view.0))
                .map(|c| (c - positions[at]).normalize())
                .sum();
            let normal_in_world = if normal.dot(&towards) >= 0.0 {
                normal
            } else {
                -normal
            };
            Some(OrientedAnchor {
                anchor,
                normal_in_world,
            })
        })
        .collect()
}

fn plane_normal(positions: &[Point3<f64>], at: usize) -> Option<Vector3<f64>> {
    if positions.len() <= NEIGHBOURS {
        return None;
    }
    let here = positions[at];
    let mut distances: Vec<(f64, usize)> = positions
        .iter()
        .enumerate()
        .map(|(k, p)| ((p - here).norm_squared(), k))
        .collect();
    distances.select_nth_unstable_by(NEIGHBOURS, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut near: Vec<(f64, usize)> = distances[..=NEIGHBOURS].to_vec();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let reach = near[NEIGHBOURS].0.max(f64::MIN_POSITIVE);
    let mut weights: Vec<f64> = near.iter().map(|(d2, _)| 1.0 - 0.5 * d2 / reach).collect();
    let mut result = None;
    for _ in 0..2 {
        let total: f64 = weights.iter().sum();
        let mean = near
            .iter()
            .zip(&weights)
            .map(|((_, k), w)| positions[*k].coords * *w)
            .sum::<Vector3<f64>>()
            / total;
        let mut spread = Matrix3::zeros();
        for ((_, k), w) in near.iter().zip(&weights) {
            let d = positions[*k].coords - mean;
            spread += d * d.transpose() * *w;
        }
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let normal: Vector3<f64> = eigen.eigenvectors.column(least).into_owned();
        let along = (eigen.eigenvalues[least].max(0.0) / total).sqrt();
        let middle = eigen.eigenvalues.sum() - eigen.eigenvalues.max() - eigen.eigenvalues[least];
        let across = (middle.max(0.0) / total).sqrt();
        let is_flat = across > 0.0 && along < MAX_FLATNESS * across;
        result = is_flat.then_some(normal);
        for ((_, k), w) in near.iter().zip(weights.iter_mut()) {
            let off = (positions[*k].coords - mean).dot(&normal) / along.max(1e-12);
            *w /= 1.0 + off * off;
        }
    }
    result
}

/// An anchor as one view sees it: its normal in the camera, and the mean of 3 by 3 pixels.
#[derive(Clone, Debug)]
pub(crate) struct AnchorReading {
    /// The anchor.
    pub anchor: usize,
    /// What the view shows of it.
    pub reading: Reading,
}

/// The sightings of every other block of anchors; an anchor is in the same half in all views.
pub(crate) fn half(seen: &[AnchorReading], parity: usize) -> Vec<AnchorReading> {
    let in_half = |seen: &&AnchorReading| seen.anchor / BLOCK % 2 == parity;
    seen.iter().filter(in_half).cloned().collect()
}

/// All anchors that one view sees.
pub(crate) fn seen_by(
    posed: &PosedViews,
    oriented: &[OrientedAnchor],
    view: usize,
    image: &LinearImage,
    clip_limit: f64,
) -> Vec<AnchorReading> {
    let rotation: UnitQuaternion<f64> = posed.views[view].cam_from_world.rotation;
    let seen = oriented.iter().filter_map(|entry| {
        let mut observations = posed.anchors[entry.anchor].observations.iter();
        let seen = observations.find(|o| o.view.0 == view)?;
        let normal = rotation * entry.normal_in_world;
        Some(AnchorReading {
            anchor: entry.anchor,
            reading: around(image, seen.pixel, clip_limit, normal)?,
        })
    });
    seen.collect()
}

/// Mean of the 3 by 3 pixels around a position, with the channels that are unclipped in all of them.
fn around(
    image: &LinearImage,
    pixel: [f64; 2],
    clip_limit: f64,
    normal: Vector3<f64>,
) -> Option<Reading> {
    let (x, y) = (pixel[0].round(), pixel[1].round());
    if !(x >= 1.0 && y >= 1.0 && x + 1.5 < image.width as f64 && y + 1.5 < image.height as f64) {
        return None;
    }
    let (x, y) = (x as usize, y as usize);
    let mut values = vec![0.0; image.channels];
    let mut usable = vec![true; image.channels];
    for v in y - 1..=y + 1 {
        for u in x - 1..=x + 1 {
            for (channel, &value) in image.pixel(u, v).iter().enumerate() {
                let value = f64::from(value);
                values[channel] += value / 9.0;
                usable[channel] &= value.is_finite() && value < clip_limit;
            }
        }
    }
    Some(Reading {
        normal,
        values,
        usable,
    })
}
