//! How far the views' surfaces lie apart, as they come from stage 5.

use crate::error::FusionError;
use crate::report::Layering;
use crate::sight::{Candidate, DEPTH_TOLERANCE_PX, Sight, look, min_normal_cosine};
use crate::view::View;
use crate::views::LoadedViews;
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_numerics::robust::{SIGMA_FROM_MAD, median, quantile};
use rilievo_scene::PageCaches;

/// Views that each view is compared with: more only repeat what these say.
const NUM_NEIGHBOURS: usize = 4;
/// Pairs are drawn about this densely: enough that a window holds dozens, few enough to be quick.
const MAX_NUM_PAIRS: usize = 400_000;
/// Largest distance between views that still belongs to one surface, pixel footprints.
const MAX_DISTANCE_PX: f64 = 8.0;
/// Side of the windows whose means are the smooth part of the distances, pixels.
const WINDOW_PX: usize = 48;
/// Samples in a window below which its mean says nothing about an offset.
const MIN_WINDOW: usize = 8;
/// Standard deviations between views that still count as one surface.
const NUM_SIGMAS: f64 = 4.0;
/// Views within this many footprints count as one surface in any case: interpolation between
/// pixels errs by less.
const MIN_TOLERANCE_PX: f64 = 1.0;

/// Distance of two views on one surface.
struct Pair {
    /// The two views, and row and column of the window of the first that holds the pixel.
    window: [usize; 4],
    /// Distance along the normal, world's unit.
    distance: f64,
    /// Mean pixel footprint, world's unit.
    footprint: f64,
}

/// Measures the distances between neighbouring views.
pub(crate) fn measure(
    loaded: &LoadedViews,
    caches: &PageCaches<'_>,
) -> Result<Layering, FusionError> {
    let neighbours = neighbours(&loaded.views);
    let most = neighbours.iter().map(Vec::len).max().unwrap_or(0);
    let num_depths: usize = loaded.views.iter().map(|v| v.num_depths).sum();
    let wanted = (num_depths * most.max(1)) as f64 / MAX_NUM_PAIRS as f64;
    let stride = (wanted.sqrt().ceil() as usize).max(2);
    Ok(summary(&find_pairs(loaded, caches, &neighbours, stride)?))
}

/// For every view the others that look from nearby directions, nearest first.
fn neighbours(views: &[View]) -> Vec<Vec<usize>> {
    let directions: Vec<Vector3<f64>> = views.iter().map(|v| v.to_world(&Vector3::z())).collect();
    (0..views.len())
        .map(|i| {
            let towards = |j: usize| directions[i].dot(&directions[j]);
            let mut others: Vec<usize> = (0..views.len())
                .filter(|&j| j != i && towards(j) > 0.0)
                .collect();
            others.sort_by(|&a, &b| towards(b).total_cmp(&towards(a)).then(a.cmp(&b)));
            others.truncate(NUM_NEIGHBOURS);
            others
        })
        .collect()
}

/// Pairs of pixels on a grid of `stride` pixels, in the order of views, rows and columns. Only what
/// makes points counts: a distance at the border or at grazing incidence says nothing of either
/// view.
fn find_pairs(
    loaded: &LoadedViews,
    caches: &PageCaches<'_>,
    neighbours: &[Vec<usize>],
    stride: usize,
) -> Result<Vec<Pair>, FusionError> {
    let rows_of = |view: &View| (stride / 2..view.camera.height).step_by(stride);
    let rows: Vec<(&View, usize)> = (loaded.views.iter())
        .flat_map(|view| rows_of(view).map(move |y| (view, y)))
        .collect();
    let min_normal_cosine = min_normal_cosine();
    let found = rows.par_iter().map(|&(view, y)| {
        caches.with(|pixels| {
            let mut pairs = Vec::new();
            for x in (stride / 2..view.camera.width).step_by(stride) {
                let pixel = view.pixel(pixels, x, y);
                let Some(surface) = pixel.surface().filter(|s| s.makes_points) else {
                    continue;
                };
                let candidate = Candidate::of(view, &view.ray(x, y, &pixel), &surface);
                let tolerance = MAX_DISTANCE_PX * candidate.footprint;
                for &j in &neighbours[view.idx] {
                    let other = &loaded.views[j];
                    let (sight, _) = look(pixels, other, &candidate, tolerance, min_normal_cosine);
                    if let Sight::Same(seen) = sight
                        && seen.makes_points
                    {
                        pairs.push(Pair {
                            window: [view.idx, j, y / WINDOW_PX, x / WINDOW_PX],
                            distance: seen.distance,
                            footprint: 0.5 * (candidate.footprint + seen.footprint),
                        });
                    }
                }
            }
            pairs
        })
    });
    let found: Vec<Vec<Pair>> = found.collect::<Result<_, _>>()?;
    Ok(found.into_iter().flatten().collect())
}

/// Distance in footprints up to which two views see one surface, from the spread of the data.
pub(crate) fn tolerance_px(median: f64, footprint: f64) -> f64 {
    let spread = if footprint > 0.0 {
        SIGMA_FROM_MAD * median / footprint
    } else {
        0.0
    };
    (NUM_SIGMAS * spread).clamp(MIN_TOLERANCE_PX, DEPTH_TOLERANCE_PX)
}

/// Statistics of the distances between views on one surface; pairs beyond the tolerance are
/// different surfaces (one hides the other), and only counted.
fn summary(pairs: &[Pair]) -> Layering {
    if pairs.is_empty() {
        return Layering::default();
    }
    let mut all: Vec<f64> = pairs.iter().map(|p| p.distance.abs()).collect();
    let median_of_all = median(&mut all).unwrap_or_default();
    let footprint = pairs.iter().map(|p| p.footprint).sum::<f64>() / pairs.len() as f64;
    let tolerance = tolerance_px(median_of_all, footprint);
    let is_same = |p: &&Pair| p.distance.abs() <= tolerance * p.footprint;
    let mut same: Vec<&Pair> = pairs.iter().filter(is_same).collect();
    let mut distances: Vec<f64> = same.iter().map(|p| p.distance.abs()).collect();
    let mean_square = distances.iter().map(|d| d * d).sum::<f64>() / distances.len().max(1) as f64;
    // A stable sort keeps the order of the sums.
    same.sort_by_key(|p| p.window);
    let (mut square, mut weight) = (0.0, 0.0);
    for window in same.chunk_by(|a, b| a.window == b.window) {
        if window.len() >= MIN_WINDOW {
            let count = window.len() as f64;
            let mean = window.iter().map(|p| p.distance).sum::<f64>() / count;
            square += mean * mean * count;
            weight += count;
        }
    }
    Layering {
        num_pairs: same.len(),
        num_apart: pairs.len() - same.len(),
        rms: mean_square.sqrt(),
        median: quantile(&mut distances, 0.5).unwrap_or_default(),
        p90: quantile(&mut distances, 0.9).unwrap_or_default(),
        smooth_rms: if weight > 0.0 {
            f64::sqrt(square / weight)
        } else {
            0.0
        },
        footprint,
        tolerance: tolerance * footprint,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::testing::load;
    use nalgebra::{Point2, UnitQuaternion};
    use rilievo_scene::{Intrinsics, PosedViews, RigidTransform, ShadedViews};
    use rilievo_synthetic::testing::{Maps, posed_view};

    /// Distances between two views of the plane `n·X = -2`, the depths of the second multiplied by
    /// `factor`.
    fn distances(factor: f64) -> Layering {
        let camera = Intrinsics::pinhole(64, 48, 90.0, 31.5, 23.5);
        let normal = Vector3::new(0.2, -0.1, -1.0).normalize();
        let mut posed = PosedViews::default();
        let mut shaded = ShadedViews::default();
        for (v, factor) in [1.0, factor].into_iter().enumerate() {
            let pose = RigidTransform {
                rotation: UnitQuaternion::from_euler_angles(0.0, 0.15 * v as f64, 0.05),
                translation: Vector3::new(0.3 * v as f64, 0.0, 0.0),
            };
            let normal_in_cam = pose.rotation * normal;
            let offset = normal_in_cam.dot(&pose.translation) - 2.0;
            let name = format!("IMG_{v}");
            posed.views.push(posed_view(v, &name, camera, pose));
            let maps = Maps::of(&camera, |[x, y]| {
                let ray = camera.ray(&Point2::new(x, y));
                let depth = factor * offset / normal_in_cam.dot(&ray);
                Some((depth, normal_in_cam))
            });
            shaded.views.push(maps.shaded(v, &name));
        }
        let loaded = load(&posed, &shaded);
        measure(&loaded, &PageCaches::new(&loaded.store, 8)).expect("room in memory")
    }

    #[test]
    fn distances_are_measured_along_the_normal() {
        let exact = distances(1.0);
        assert!(exact.num_pairs > 100, "{exact:?}");
        assert!(exact.rms < 2e-6, "{exact:?}");
        // The second camera stands 1.984 from the plane along its normal.
        let moved = distances(1.001);
        let expected = 1e-3 * 1.984;
        for found in [moved.rms, moved.median, moved.smooth_rms] {
            assert!((found / expected - 1.0).abs() < 0.01, "{moved:?}");
        }
    }
}
