//! A point cloud against the true surface.
//!
//! * Accuracy: distance of every cloud point to the surface, `d(p, M)`; its median, and the share
//!   `P(τ)` within a threshold τ.
//! * Completeness `C(τ)`: share of the surface's area with a cloud point within τ. What no camera
//!   saw is nobody's to reconstruct: with the truth's depth maps given, only the surface that at
//!   least two views see counts.
//! * `F = 2 P C / (P + C)`.
//!
//! A cloud in another scale or frame than the surface's has no accuracy worth the name, and every
//! search for the nearest has to look far. Where most points lie farther than a quarter of the
//! surface's diagonal from it, or are a tenth of its size, some stand for all, and the comparison
//! says so.
//!
//! Steps: samples on the triangles no farther apart than τ/3; the nearest samples; the
//! exact distance to the triangles of the nearest eight samples.

use super::align::Similarity;
use super::distance::{MeshDistance, Samples, corners};
use super::nearest::PointTree;
use super::truth::TruthView;
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{CloudPoint, Mesh, RigidTransform};
use serde::Serialize;

/// Threshold as a share of the surface's bounding-box diagonal: half a millimetre for an object a
/// hand wide.
const THRESHOLD_SHARE: f64 = 1.0 / 500.0;
/// Points that are tried first, to see whether the two sides lie near each other at all, and that
/// stand for all where they do not.
const NUM_PROBES: usize = 1000;
/// Points of the other side that these are tried against: as fine as the question, and few enough
/// to look at all of them, as a search from the middle of a ball does.
const NUM_COARSE: usize = 20_000;
/// Share of the surface's diagonal from which the two sides do not lie near each other.
const FAR_SHARE: f64 = 0.25;
/// Size of a cloud over the surface's below which it is no part of it, but the whole at another
/// scale.
const SMALL_SHARE: f64 = 0.1;
/// A surface point counts as seen where the depth map agrees within a pixel footprint along the
/// normal, and within this share of the depth: at grazing incidence the normal alone lets pass what
/// lies far behind.
const SEEN_TOLERANCE: f64 = 5e-3;
/// Cosine of the angle of incidence from which a surface counts as seen: 80 degrees.
const MIN_SEEN_COSINE: f64 = 0.17;

/// A cloud against the true surface, lengths in the truth's unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CloudComparison {
    /// Median distance of the points from the surface.
    pub accuracy_median: f64,
    /// 90 % quantile of it.
    pub accuracy_p90: f64,
    /// Mean distance.
    pub accuracy_mean: f64,
    /// Share of the points within the threshold.
    pub precision: f64,
    /// Share of the surface (that two views see, where depth maps are given) within the threshold
    /// of a point.
    pub completeness: f64,
    /// Harmonic mean of precision and completeness.
    pub f_score: f64,
    /// The threshold.
    pub threshold: f64,
    /// Share of the whole surface that `completeness` is measured on.
    pub counted_surface: f64,
    /// Mean distance of the counted surface from the nearest point.
    pub completeness_mean: f64,
    /// Chamfer distance, L1: mean of `accuracy_mean` and `completeness_mean`.
    pub chamfer_l1: f64,
    /// Chamfer distance, L2: mean of both mean squared distances, truth's unit squared.
    pub chamfer_l2: f64,
    /// The larger of both directions' 95 % quantiles of the distance.
    pub hausdorff_95: f64,
    /// The same shares at other thresholds.
    pub at: Vec<ThresholdShares>,
    /// Where both sides lie so far apart that these numbers mean little, and are of some points
    /// only.
    pub apart: Option<Apart>,
}

/// Two sides that do not match in scale or frame, lengths in the truth's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Apart {
    /// Extent of the cloud, without its outermost twentieths.
    pub cloud_size: f64,
    /// Extent of the surface, alike.
    pub surface_size: f64,
    /// Distance between the middles of both.
    pub offset: f64,
}

/// Shares at one threshold.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ThresholdShares {
    /// The threshold, truth's unit.
    pub threshold: f64,
    /// Share of the points within it.
    pub precision: f64,
    /// Share of the counted surface within it of a point.
    pub completeness: f64,
    /// Harmonic mean of the two.
    pub f_score: f64,
}

/// Other thresholds that are reported, as multiples of the threshold.
const OTHER_THRESHOLDS: [f64; 4] = [0.25, 0.5, 2.0, 4.0];

fn harmonic_mean(a: f64, b: f64) -> f64 {
    if a + b > 0.0 {
        2.0 * a * b / (a + b)
    } else {
        0.0
    }
}

/// What the cloud is compared with.
#[derive(Clone, Copy, Debug)]
pub struct TrueSurface<'a> {
    /// The surface.
    pub mesh: &'a Mesh,
    /// True views; empty: the whole surface counts.
    pub views: &'a [(RigidTransform, &'a TruthView)],
    /// Distance that still counts as found, truth's unit; `None` takes a five-hundredth of the
    /// surface's diagonal.
    pub threshold: Option<f64>,
}

/// Extent and middle of points: the diagonal of the box from the 5 % to the 95 % quantile of each
/// coordinate, which stray points do not move, and the medians.
fn extent(points: &[[f64; 3]]) -> Option<(f64, Point3<f64>)> {
    let (mut sides, mut middle) = (Vector3::zeros(), Point3::origin());
    for axis in 0..3 {
        let mut values: Vec<f64> = points.iter().map(|p| p[axis]).collect();
        sides[axis] = quantile(&mut values, 0.95)? - quantile(&mut values, 0.05)?;
        middle[axis] = quantile(&mut values, 0.5)?;
    }
    Some((sides.norm(), middle))
}

/// At most so many indices below `count`, evenly chosen.
fn thinned(count: usize, most: usize) -> impl Iterator<Item = usize> {
    (0..count).step_by(count.div_ceil(most).max(1))
}

/// A tree of some of the points.
fn coarse_tree(points: &[[f64; 3]]) -> PointTree {
    let chosen: Vec<[f64; 3]> = thinned(points.len(), NUM_COARSE)
        .map(|i| points[i])
        .collect();
    PointTree::new(&chosen)
}

/// How cloud and surface lie apart, with the distances of some points; `None` where they do not.
fn apart(points: &[[f64; 3]], samples: &Samples, diagonal: f64) -> Option<(Apart, Vec<f64>)> {
    let coarse = coarse_tree(&samples.points);
    let distances: Vec<f64> = thinned(points.len(), NUM_PROBES)
        .map(|i| coarse.nearest::<1>(&points[i])[0].0.sqrt())
        .collect();
    let (cloud_size, of_cloud) = extent(points)?;
    let (surface_size, of_surface) = extent(&samples.points)?;
    let is_far = quantile(&mut distances.clone(), 0.5)? > FAR_SHARE * diagonal;
    (is_far || cloud_size < SMALL_SHARE * surface_size).then(|| {
        let offset = (of_cloud - of_surface).norm();
        let apart = Apart {
            cloud_size,
            surface_size,
            offset,
        };
        (apart, distances)
    })
}

/// Length of the diagonal of a mesh's bounding box.
fn diagonal(mesh: &Mesh) -> f64 {
    let corners = mesh.bounds().unwrap_or_default();
    let [low, high] = corners.map(|corner| Vector3::from(corner.map(f64::from)));
    (high - low).norm()
}

/// Whether a point of the surface with a normal is the one that a view sees: the tangent plane
/// there holds the point that the view has in the nearest pixel.
fn sees(view: &(RigidTransform, &TruthView), p: &Point3<f64>, normal: &Vector3<f64>) -> bool {
    let (pose, truth) = view;
    let in_cam = pose.apply(p);
    let Some(pixel) = truth.intrinsics.project(&in_cam) else {
        return false;
    };
    let nearest = Point2::new(pixel.x.round(), pixel.y.round());
    let depth = truth.maps.depth();
    let depth = depth.and_then(|map| map.get(nearest.x as isize, nearest.y as isize));
    let Some(z) = depth.map(|&z| f64::from(z)).filter(|&z| z > 0.0) else {
        return false;
    };
    let normal = pose.rotation * normal;
    let cosine = normal.dot(&in_cam.coords).abs() / in_cam.coords.norm();
    let seen = truth.intrinsics.unproject(&nearest, z);
    cosine > MIN_SEEN_COSINE
        && normal.dot(&(seen - in_cam)).abs() <= z / truth.intrinsics.focal_px()
        && (z - in_cam.z).abs() <= SEEN_TOLERANCE * z
}

/// Compares the cloud, moved by `similarity`, with the true surface; `None` when either is empty.
pub fn compare_cloud(
    cloud: &[CloudPoint],
    truth: &TrueSurface<'_>,
    similarity: &Similarity,
) -> Option<CloudComparison> {
    let diagonal = diagonal(truth.mesh);
    let threshold = truth.threshold.unwrap_or(THRESHOLD_SHARE * diagonal);
    let surface = MeshDistance::new(truth.mesh, threshold / 3.0)?;
    let points: Vec<[f64; 3]> = cloud
        .iter()
        .map(|p| similarity.apply(&Point3::from(p.position.map(f64::from))))
        .filter(|p| p.iter().all(|c| c.is_finite()))
        .map(Into::into)
        .collect();
    if points.is_empty() {
        return None;
    }
    let samples = surface.samples();
    let (apart, mut distances, chosen, tree) = match apart(&points, samples, diagonal) {
        Some((apart, probed)) => {
            let chosen = thinned(samples.points.len(), NUM_PROBES).collect();
            (Some(apart), probed, chosen, coarse_tree(&points))
        }
        None => {
            let exact = |p: &[f64; 3]| surface.nearest(&Point3::from(*p)).0;
            let chosen: Vec<usize> = (0..samples.points.len()).collect();
            let distances = points.par_iter().map(exact).collect();
            (None, distances, chosen, PointTree::new(&points))
        }
    };
    let num = distances.len() as f64;
    let precision_at = |limit: f64| distances.iter().filter(|&&d| d <= limit).count() as f64 / num;
    let accuracy_mean = distances.iter().sum::<f64>() / num;
    let accuracy_square = distances.iter().map(|d| d * d).sum::<f64>() / num;

    // Distance from the nearest point, where the surface is counted.
    let gap = |&i: &usize| {
        let p = Point3::from(samples.points[i]);
        let [a, b, c] = corners(truth.mesh, samples.triangles[i] as usize);
        let normal = (b - a).cross(&(c - a)).normalize();
        let views = truth.views.iter();
        let num_seen = views.filter(|view| sees(view, &p, &normal)).count();
        if !truth.views.is_empty() && num_seen < 2 {
            return None;
        }
        let [(squared, _)] = tree.nearest(&samples.points[i]);
        Some(squared.sqrt())
    };
    let gaps: Vec<Option<f64>> = chosen.par_iter().map(gap).collect();
    let area_of = |k: usize| samples.areas[chosen[k]];
    // Weighted by the area that a sample stands for.
    let sum_of = |weight: &dyn Fn(f64) -> f64| -> f64 {
        let counted = gaps.iter().enumerate();
        counted
            .filter_map(|(k, gap)| Some(weight((*gap)?) * area_of(k)))
            .sum()
    };
    let counted = sum_of(&|_| 1.0);
    let mean_of = |weight: &dyn Fn(f64) -> f64| {
        if counted > 0.0 {
            sum_of(weight) / counted
        } else {
            0.0
        }
    };
    let shares = |limit: f64| {
        let precision = precision_at(limit);
        let completeness = mean_of(&|gap| f64::from(u8::from(gap <= limit)));
        ThresholdShares {
            threshold: limit,
            precision,
            completeness,
            f_score: harmonic_mean(precision, completeness),
        }
    };
    let main = shares(threshold);
    let at = OTHER_THRESHOLDS
        .map(|factor| shares(factor * threshold))
        .to_vec();
    let completeness_mean = mean_of(&|gap| gap);
    let mut gaps_counted: Vec<f64> = gaps.iter().flatten().copied().collect();
    // Samples of the surface stand for nearly equal areas, so that a plain quantile serves.
    let gap_95 = quantile(&mut gaps_counted, 0.95).unwrap_or(0.0);
    Some(CloudComparison {
        accuracy_median: quantile(&mut distances, 0.5)?,
        accuracy_p90: quantile(&mut distances, 0.9)?,
        accuracy_mean,
        precision: main.precision,
        completeness: main.completeness,
        f_score: main.f_score,
        threshold,
        counted_surface: counted / (0..chosen.len()).map(area_of).sum::<f64>(),
        completeness_mean,
        chamfer_l1: 0.5 * (accuracy_mean + completeness_mean),
        chamfer_l2: 0.5 * (accuracy_square + mean_of(&|gap| gap * gap)),
        hausdorff_95: quantile(&mut distances, 0.95)?.max(gap_95),
        at,
        apart,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The unit square in `z = 0`, two triangles.
    fn square() -> Mesh {
        Mesh {
            vertices: vec![
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0],
                [0.0, 1.0, 0.0],
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    fn cloud(lift: f32, columns: usize) -> Vec<CloudPoint> {
        (0..100 * columns)
            .map(|i| CloudPoint {
                position: [
                    ((i % columns) as f32 + 0.5) / 100.0,
                    ((i / columns) as f32 + 0.5) / 100.0,
                    lift,
                ],
                normal: [0.0, 0.0, 1.0],
                color: [0; 3],
                confidence: 1.0,
                num_views: 2,
            })
            .collect()
    }

    fn surface(mesh: &Mesh) -> TrueSurface<'_> {
        TrueSurface {
            mesh,
            views: &[],
            threshold: Some(0.02),
        }
    }

    #[test]
    fn a_lifted_half_plane_has_the_lift_as_accuracy_and_half_the_surface() {
        let mesh = square();
        let whole = compare_cloud(
            &cloud(0.003, 50),
            &surface(&mesh),
            &Similarity::identity("test"),
        )
        .expect("neither is empty");
        assert!((whole.accuracy_median - 0.003).abs() < 1e-8, "{whole:?}");
        assert_eq!(whole.precision, 1.0);
        // The threshold reaches 0.015 beyond the last column.
        assert!((whole.completeness - 0.515).abs() < 0.01, "{whole:?}");
        let expected = 2.0 * whole.completeness / (1.0 + whole.completeness);
        assert!((whole.f_score - expected).abs() < 1e-12, "{whole:?}");
        // Half of the surface lies on average a quarter away, the other under the points.
        assert!((whole.completeness_mean - 0.128).abs() < 0.005, "{whole:?}");
        let l1 = 0.5 * (whole.accuracy_mean + whole.completeness_mean);
        assert!((whole.chamfer_l1 - l1).abs() < 1e-12, "{whole:?}");
        // The mean square of 0 to 1/2 over half of the surface, and half of that.
        assert!((whole.chamfer_l2 - 0.5 / 24.0).abs() < 1e-3, "{whole:?}");
        assert!((whole.hausdorff_95 - 0.45).abs() < 0.02, "{whole:?}");
        let growing = whole
            .at
            .windows(2)
            .all(|w| w[0].completeness < w[1].completeness);
        assert!(growing && whole.at.len() == 4, "{whole:?}");
    }

    #[test]
    fn a_cloud_in_another_scale_or_frame_is_told_soon() {
        // A ball is the worst: from its middle all of its surface is equally near.
        const ROWS: u32 = 100;
        let at = |row: u32, column: u32| row * 2 * ROWS + column % (2 * ROWS);
        let ball: Vec<[f32; 3]> = (0..ROWS * 2 * ROWS)
            .map(|k| {
                let step = std::f32::consts::PI / ROWS as f32;
                let (polar, turn) = (
                    step * ((k / (2 * ROWS)) as f32 + 0.5),
                    step * (k % (2 * ROWS)) as f32,
                );
                [
                    polar.sin() * turn.cos(),
                    polar.sin() * turn.sin(),
                    polar.cos(),
                ]
            })
            .collect();
        let squares = (0..ROWS - 1).flat_map(|row| (0..2 * ROWS).map(move |column| (row, column)));
        let mesh = Mesh {
            vertices: ball.clone(),
            triangles: squares
                .flat_map(|(r, c)| {
                    let (a, b) = (at(r, c), at(r, c + 1));
                    let (d, e) = (at(r + 1, c), at(r + 1, c + 1));
                    [[a, d, b], [b, d, e]]
                })
                .collect(),
            ..Mesh::default()
        };
        let moved = |scale: f32, shift: f32| -> Vec<CloudPoint> {
            let place = |p: &[f32; 3]| [scale * p[0] + shift, scale * p[1], scale * p[2]];
            ball.iter()
                .map(|p| CloudPoint {
                    position: place(p),
                    ..cloud(0.0, 1)[0]
                })
                .collect()
        };
        let truth = TrueSurface {
            mesh: &mesh,
            views: &[],
            threshold: None,
        };
        let compare = |scale, shift| {
            let began = std::time::Instant::now();
            let compared =
                compare_cloud(&moved(scale, shift), &truth, &Similarity::identity("test"));
            let seconds = began.elapsed().as_secs_f64();
            assert!(seconds < 20.0, "{seconds} s at {scale}, {shift}");
            compared.expect("neither is empty")
        };
        assert_eq!(compare(1.0, 0.0).apart, None);
        for (scale, shift) in [(1000.0, 0.0), (0.001, 0.0), (1.0, 3e4)] {
            let compared = compare(scale, shift);
            let apart = compared.apart.expect("they do not match");
            let ratio = apart.cloud_size / apart.surface_size;
            // The vertices crowd at the poles, the surface does not.
            assert!((ratio / f64::from(scale) - 1.0).abs() < 0.05, "{apart:?}");
            assert!(
                (apart.offset - f64::from(shift)).abs() < 0.2 * f64::from(scale).max(1.0),
                "{apart:?}"
            );
            assert!(compared.f_score < 0.1, "{compared:?}");
        }
    }

    #[test]
    fn an_empty_cloud_or_surface_has_no_comparison() {
        let (mesh, empty) = (square(), Mesh::default());
        let identity = Similarity::identity("test");
        assert_eq!(compare_cloud(&[], &surface(&mesh), &identity), None);
        assert_eq!(
            compare_cloud(&cloud(0.0, 3), &surface(&empty), &identity),
            None
        );
    }
}
