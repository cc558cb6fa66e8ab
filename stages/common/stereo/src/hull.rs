//! Where along its ray a pixel's surface point may lie: inside every view's mask.
//!
//! The range of the whole object comes first: the point nearest to the rays through the masks'
//! centroids, and the largest extent that a mask subtends there; or, without masks, the depths of
//! the sparse points. Per pixel, inverse depths are sampled and kept while all masks contain them.

use crate::camera::{Camera, Warp};
use crate::level::LevelView;
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::quantile;
use rilievo_scene::Mask;

/// Samples along a ray.
const NUM_SAMPLES: usize = 256;

/// Inverse depths between which a view's surface lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthRange {
    /// That of the farthest point, one over the world's unit.
    pub low: f32,
    /// That of the nearest point.
    pub high: f32,
}

/// Range of each view from masks (`masked`) or from points in the world.
pub fn object_ranges(
    views: &[LevelView],
    masked: bool,
    points: &[Point3<f64>],
) -> Option<Vec<InverseDepthRange>> {
    if masked && views.len() > 1 {
        let (center, radius) = object_ball(views)?;
        views
            .iter()
            .map(|view| {
                let (_, _, depth) = view.camera.project(&center)?;
                let near = (depth - 1.3 * radius).max(0.15 * depth);
                Some(InverseDepthRange {
                    low: (1.0 / (depth + 1.3 * radius)) as f32,
                    high: (1.0 / near) as f32,
                })
            })
            .collect()
    } else {
        views
            .iter()
            .map(|view| range_of_points(&view.camera, &view.mask, points))
            .collect()
    }
}

/// Centre and radius of a ball around the object, from the masks.
pub fn object_ball(views: &[LevelView]) -> Option<(Point3<f64>, f64)> {
    let mut normal = Matrix3::zeros();
    let mut rhs = Vector3::zeros();
    let mut extents = Vec::new();
    for view in views {
        let n = view.pixels.len();
        if n == 0 {
            continue;
        }
        let mean = |values: &[u32]| values.iter().map(|&v| f64::from(v)).sum::<f64>() / n as f64;
        let (x, y) = (mean(&view.pixels.xs), mean(&view.pixels.ys));
        let camera = &view.camera;
        let direction = camera.rotation.tr_mul(&camera.ray(x, y)).normalize();
        let across = Matrix3::identity() - direction * direction.transpose();
        normal += across;
        rhs += across * camera.center.coords;
        let farthest = (0..n)
            .map(|i| {
                let (px, py) = view.xy(i);
                ((px - x) / camera.fx).hypot((py - y) / camera.fy)
            })
            .fold(0.0, f64::max);
        extents.push((camera.clone(), farthest));
    }
    let center = Point3::from(normal.try_inverse()? * rhs);
    let mut radius = 0.0_f64;
    for (camera, farthest) in extents {
        let (_, _, depth) = camera.project(&center)?;
        radius = radius.max(farthest * depth);
    }
    Some((center, radius))
}

fn range_of_points(
    camera: &Camera,
    mask: &Mask,
    points: &[Point3<f64>],
) -> Option<InverseDepthRange> {
    let mut inverse: Vec<f64> = points
        .iter()
        .filter_map(|p| camera.project(p))
        .filter(|&(x, y, _)| mask.contains(x.round() as isize, y.round() as isize))
        .map(|(_, _, z)| 1.0 / z)
        .collect();
    if inverse.len() < 3 {
        return None;
    }
    let (low, high) = (quantile(&mut inverse, 0.01)?, quantile(&mut inverse, 0.99)?);
    let margin = 0.3 * (high - low) + 0.02 * high;
    Some(InverseDepthRange {
        low: (low - margin).max(0.2 * low) as f32,
        high: (high + margin) as f32,
    })
}

/// Range of every masked pixel of view `index`; the whole range where the masks contradict.
pub fn pixel_ranges(
    views: &[LevelView],
    masks: &[Mask],
    index: usize,
    range: InverseDepthRange,
) -> Vec<InverseDepthRange> {
    let view = &views[index];
    let others: Vec<(Warp, &Mask)> = views
        .iter()
        .enumerate()
        .filter(|&(j, _)| j != index)
        .filter_map(|(j, other)| {
            Warp::between(&view.camera, &other.camera).map(|warp| (warp, &masks[j]))
        })
        .collect();
    let step = (range.high - range.low) / (NUM_SAMPLES - 1) as f32;
    (0..view.pixels.len())
        .into_par_iter()
        .map(|i| {
            let (x, y) = view.xy(i);
            let bases: Vec<Vector3<f64>> = others
                .iter()
                .map(|(warp, _)| warp.a * Vector3::new(x, y, 1.0))
                .collect();
            let inverse_depth = |k: usize| range.low + step * k as f32;
            let is_seen = |&k: &usize| {
                let w = f64::from(inverse_depth(k));
                others.iter().zip(&bases).all(|((warp, mask), base)| {
                    let p = base + warp.b * w;
                    let (u, v) = (p.x / p.z + 0.5, p.y / p.z + 0.5);
                    p.z > 0.0 && u >= 0.0 && v >= 0.0 && mask.contains(u as isize, v as isize)
                })
            };
            let first = (0..NUM_SAMPLES).find(is_seen);
            let last = first.and_then(|first| (first..NUM_SAMPLES).rev().find(is_seen));
            match (first, last) {
                (Some(low), Some(high)) => InverseDepthRange {
                    low: inverse_depth(low) - 2.0 * step,
                    high: inverse_depth(high) + 2.0 * step,
                },
                _ => range,
            }
        })
        .collect()
}

/// A mask grown by `radius` pixels (square neighbourhood).
pub fn dilate(mask: &Mask, radius: usize) -> Mask {
    let mut rows = mask.clone();
    for y in 0..mask.height {
        for x in 0..mask.width {
            let range = x.saturating_sub(radius)..=(x + radius).min(mask.width - 1);
            *rows.at_mut(x, y) = range.into_iter().any(|a| *mask.at(a, y));
        }
    }
    let mut out = rows.clone();
    for y in 0..mask.height {
        let range = y.saturating_sub(radius)..=(y + radius).min(mask.height - 1);
        for x in 0..mask.width {
            *out.at_mut(x, y) = range.clone().any(|b| *rows.at(x, b));
        }
    }
    out
}
