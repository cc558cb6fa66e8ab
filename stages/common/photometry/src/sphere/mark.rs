//! From a mark (mask, ellipse, circle, points) to the cone of the outline in one view.
//!
//! # Steps
//! 1. Outline points. Of a mask: the cracks between inside and outside pixels, taken along the
//!    rows where the outline runs steeply and along the columns where it runs flat; across such a
//!    crack the true edge is uniformly distributed, so the points are unbiased (0.3 px). Cracks at
//!    the frame are cuts, not outline, and are left out.
//! 2. Robust cone: the best of many cones through three points each (an occluder's edge or a
//!    shadow cut may be a third of the outline), then re-weighted least squares of the distances
//!    in pixels.
//! 3. Points on a line or a short arc lie on many cones. With `φ_i` the angles of the points around
//!    their circle in the picture, rows `(cos φ_i, sin φ_i, 1)` of `J` (two shifts and a widening)
//!    and `σ` the error of a point, its radius has the standard deviation `σ √((JᵀJ)⁻¹)₃₃`; it must
//!    be small.

use super::cone::{EllipsePx, OutlineCone};
use super::error::SphereError;
use nalgebra::{Matrix3, Point2, Vector2, Vector3};
use rilievo_numerics::{random, robust};
use rilievo_scene::{Intrinsics, Mask, SphereMark};
use serde::{Deserialize, Serialize};

/// A cone with the outline points that agree with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkFit {
    /// The cone.
    pub cone: OutlineCone,
    /// Outline points on it, pixels.
    pub inliers: Vec<Point2<f64>>,
    /// Their share among all outline points.
    pub inlier_share: f64,
    /// Their distance from the cone, RMS, pixels.
    pub rms_px: f64,
}

/// Outline points of a mark, pixels.
pub fn outline_of_mark(mark: &SphereMark) -> Vec<Point2<f64>> {
    match mark {
        SphereMark::Mask(mask) => outline_of_mask(mask),
        SphereMark::Ellipse {
            center_px,
            semi_axes_px,
            angle_rad,
        } => {
            let ellipse = EllipsePx {
                center: *center_px,
                semi_axes: *semi_axes_px,
                angle_rad: *angle_rad,
            };
            around(|angle| ellipse.point(angle))
        }
        SphereMark::Circle {
            center_px,
            radius_px,
        } => around(|angle| {
            Point2::new(
                center_px[0] + radius_px * angle.cos(),
                center_px[1] + radius_px * angle.sin(),
            )
        }),
        SphereMark::Points(points) => points.iter().map(|p| Point2::new(p[0], p[1])).collect(),
    }
}

fn around(point: impl Fn(f64) -> Point2<f64>) -> Vec<Point2<f64>> {
    // Enough for a smooth curve that is exact in itself.
    (0..96)
        .map(|k| point(std::f64::consts::TAU * f64::from(k) / 96.0))
        .collect()
}

fn outline_of_mask(mask: &Mask) -> Vec<Point2<f64>> {
    let count = mask.count();
    if count == 0 {
        return Vec::new();
    }
    let (mut sum_x, mut sum_y) = (0.0, 0.0);
    for y in 0..mask.height {
        for x in 0..mask.width {
            if *mask.at(x, y) {
                sum_x += x as f64;
                sum_y += y as f64;
            }
        }
    }
    let center = Point2::new(sum_x / count as f64, sum_y / count as f64);
    let mut points = Vec::new();
    for y in 0..mask.height {
        for x in 0..mask.width {
            for (dx, dy) in [(1, 0), (0, 1)] {
                let (x2, y2) = (x + dx, y + dy);
                if x2 >= mask.width || y2 >= mask.height || mask.at(x, y) == mask.at(x2, y2) {
                    continue;
                }
                let point = Point2::new(0.5 * (x + x2) as f64, 0.5 * (y + y2) as f64);
                let from_center = point - center;
                let steep = from_center.x.abs() >= from_center.y.abs();
                if steep == (dx == 1) {
                    points.push(point);
                }
            }
        }
    }
    points
}

/// Fits the cone of a mark.
///
/// # Errors
/// [`SphereError::TooFewPoints`], [`SphereError::NotADisc`] and [`SphereError::OpenOutline`].
pub fn cone_from_mark(mark: &SphereMark, intrinsics: &Intrinsics) -> Result<MarkFit, SphereError> {
    cone_from_points(&outline_of_mark(mark), intrinsics, MIN_INLIER_SHARE)
}

/// Outline points farther than this from a cone are not of it, pixels. Marks by hand are good to
/// about a pixel; more lets an occluder's edge in.
pub(super) const INLIER_PX: f64 = 1.5;
/// Share of a mark's outline that must lie on one cone; below it the mark is no disc.
pub(super) const MIN_INLIER_SHARE: f64 = 0.4;
/// Systematic uncertainty of an outline, pixels: where the edge of a matte sphere is seen depends
/// on blur, gamma and background, alike along the whole outline and in all photos.
pub(super) const OUTLINE_BIAS_PX: f64 = 0.1;
/// Outline points needed for a cone with a check: three determine it.
const MIN_POINTS: usize = 5;

/// Largest relative standard deviation of an outline's radius: the sphere's distance from the
/// camera, and with it the model's size, is as uncertain.
const MAX_SIZE_SIGMA: f64 = 0.1;
/// Error of a point that is marked by hand, pixels.
const HAND_SIGMA_PX: f64 = 1.0;

/// Relative standard deviation of the radius of the circle through points with an error of
/// `sigma_px`; infinite where they leave it open. In the picture, where a line is straight: to a
/// camera it is a cone of a right angle, whose size is well determined.
fn size_sigma(points: &[Point2<f64>], sigma_px: f64) -> f64 {
    let mean = points.iter().map(|p| p.coords).sum::<Vector2<f64>>() / points.len() as f64;
    let centred = || points.iter().map(|p| p.coords - mean);
    let size = centred().map(|p| p.norm()).fold(0.0, f64::max);
    // The circle |p|² = 2 c·p + k by least squares, around the mean, where it is well scaled.
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for p in centred().map(|p| p / size) {
        let row = Vector3::new(2.0 * p.x, 2.0 * p.y, 1.0);
        matrix += row * row.transpose();
        right += row * p.norm_squared();
    }
    let Some(inverse) = matrix.try_inverse() else {
        return f64::INFINITY;
    };
    let circle = inverse * right;
    let center = circle.xy();
    let radius_px = size * (circle.z + center.norm_squared()).sqrt();
    let mut matrix = Matrix3::zeros();
    for p in centred() {
        let around = (p / size - center).normalize();
        let row = Vector3::new(around.x, around.y, 1.0);
        matrix += row * row.transpose();
    }
    let variance = matrix.try_inverse().map(|inverse| inverse[(2, 2)]);
    // Rounding makes a nearly singular inverse negative, and a circle of points on a line no
    // number.
    let sigma = variance
        .filter(|v| *v > 0.0)
        .map(|v| sigma_px * v.sqrt() / radius_px);
    sigma.filter(|s| s.is_finite()).unwrap_or(f64::INFINITY)
}

/// Whether points marked by hand determine an outline, whatever the camera. One stray point among
/// good ones passes: only the camera's cone reveals it.
///
/// # Errors
/// [`SphereError::TooFewPoints`] where fewer than five differ, [`SphereError::OpenOutline`].
pub fn check_marked_points(points: &[Point2<f64>]) -> Result<(), SphereError> {
    let mut distinct = points.to_vec();
    distinct.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    distinct.dedup();
    let available = distinct.len();
    if available < MIN_POINTS {
        return Err(SphereError::TooFewPoints {
            available,
            needed: MIN_POINTS,
        });
    }
    let relative_sigma = size_sigma(&distinct, HAND_SIGMA_PX);
    if relative_sigma <= MAX_SIZE_SIGMA {
        Ok(())
    } else {
        Err(SphereError::OpenOutline {
            available,
            relative_sigma,
            sigma_px: HAND_SIGMA_PX,
        })
    }
}

/// Robust cone through outline points.
///
/// # Errors
/// Those of [`cone_from_mark`].
pub fn cone_from_points(
    points: &[Point2<f64>],
    intrinsics: &Intrinsics,
    min_inlier_share: f64,
) -> Result<MarkFit, SphereError> {
    if points.len() < MIN_POINTS {
        return Err(SphereError::TooFewPoints {
            available: points.len(),
            needed: MIN_POINTS,
        });
    }
    let rays: Vec<Vector3<f64>> = points
        .iter()
        .map(|p| intrinsics.ray(p).normalize())
        .collect();
    let not_a_disc = |inlier_share: f64, rms_px: f64| SphereError::NotADisc {
        inlier_share,
        needed: min_inlier_share,
        rms_px,
    };
    let start =
        best_of_triples(&rays, intrinsics, INLIER_PX).ok_or(not_a_disc(0.0, f64::INFINITY))?;
    let mut cone = start;
    for _ in 0..10 {
        let weights: Vec<f64> = rays
            .iter()
            .map(|ray| {
                let r = distance_px(&cone, ray, intrinsics) / INLIER_PX;
                // Points beyond twice the threshold have no say.
                robust::tukey_weight(0.5 * r)
            })
            .collect();
        let Some(next) = OutlineCone::from_rays(&rays, &weights) else {
            break;
        };
        let change = (next.axis - cone.axis).norm() + (next.half_angle - cone.half_angle).abs();
        cone = next;
        if change < 1e-13 {
            break;
        }
    }
    let (mut inliers, mut sum) = (Vec::new(), 0.0);
    for (point, ray) in points.iter().zip(&rays) {
        let r = distance_px(&cone, ray, intrinsics);
        if r.abs() <= INLIER_PX {
            inliers.push(*point);
            sum += r * r;
        }
    }
    let inlier_share = inliers.len() as f64 / points.len() as f64;
    let rms_px = (sum / inliers.len().max(1) as f64).sqrt();
    if inliers.len() < MIN_POINTS || inlier_share < min_inlier_share {
        return Err(not_a_disc(inlier_share, rms_px));
    }
    // No outline is seen better than its systematic uncertainty, however well its points agree.
    let sigma_px = rms_px.max(OUTLINE_BIAS_PX);
    let relative_sigma = size_sigma(&inliers, sigma_px);
    if relative_sigma > MAX_SIZE_SIGMA {
        return Err(SphereError::OpenOutline {
            available: inliers.len(),
            relative_sigma,
            sigma_px,
        });
    }
    Ok(MarkFit {
        cone,
        inliers,
        inlier_share,
        rms_px,
    })
}

/// Distance of a ray from the cone in pixels, across the outline, positive outside.
#[inline]
pub(super) fn distance_px(cone: &OutlineCone, ray: &Vector3<f64>, intrinsics: &Intrinsics) -> f64 {
    cone.angle_outside(ray) * px_per_radian(ray, intrinsics)
}

/// Pixels per radian at a ray. Radially an angle is stretched by 1/cos² of the ray's angle off the
/// axis, around by 1/cos; their mean serves everywhere, as it only weighs residuals.
#[inline]
pub(super) fn px_per_radian(ray: &Vector3<f64>, intrinsics: &Intrinsics) -> f64 {
    intrinsics.focal_px() / ray.z.max(0.1).powf(1.5)
}

fn best_of_triples(
    rays: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    threshold_px: f64,
) -> Option<OutlineCone> {
    let stride = rays.len().div_ceil(400);
    let mut best: Option<(f64, OutlineCone)> = None;
    // With 40 % of the points good, 300 triples contain an all-good one with certainty (1 − 4e-9).
    for triple in random::triples(rays.len()).take(300) {
        let picked = triple.map(|k| rays[k]);
        let Some(cone) = OutlineCone::from_rays(&picked, &[1.0; 3]) else {
            continue;
        };
        if !(cone.half_angle < 1.2 && cone.axis.z > 0.0) {
            continue;
        }
        let cost: f64 = rays
            .iter()
            .step_by(stride)
            .map(|ray| distance_px(&cone, ray, intrinsics).abs().min(threshold_px))
            .sum();
        if best.as_ref().is_none_or(|(lowest, _)| cost < *lowest) {
            best = Some((cost, cone));
        }
    }
    best.map(|(_, cone)| cone)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sphere::SphereInCamera;
    use nalgebra::Point3;
    use rilievo_scene::Distortion;

    fn camera() -> Intrinsics {
        Intrinsics {
            distortion: Distortion {
                k1: -0.08,
                k2: 0.02,
                p1: 5e-4,
                p2: -3e-4,
                k3: 0.0,
                ..Distortion::default()
            },
            ..Intrinsics::pinhole(1600, 1200, 1500.0, 799.5, 599.5)
        }
    }

    fn mask_of(sphere: &SphereInCamera, camera: &Intrinsics) -> Mask {
        let mut mask = Mask::filled(camera.width, camera.height, false);
        for pixel in sphere.pixels(camera, 0.0) {
            *mask.at_mut(pixel.x, pixel.y) = true;
        }
        mask
    }

    #[test]
    fn exact_outline_gives_the_exact_center_through_a_distorting_lens() {
        let sphere = SphereInCamera {
            center: Point3::new(0.25, -0.1, 0.9),
            radius: 0.04,
        };
        let points = sphere.outline(&camera(), 40);
        let fit = cone_from_points(&points, &camera(), MIN_INLIER_SHARE).unwrap();
        let found = fit.cone.sphere(0.04).center;
        let error = (found - sphere.center).norm();
        assert!(error < 1e-9, "centre off by {error} m");
    }

    #[test]
    fn ellipse_runs_through_the_projected_outline() {
        let camera = Intrinsics {
            fy: 1430.0,
            distortion: Distortion::default(),
            ..camera()
        };
        for center in [
            Point3::new(0.0, 0.0, 0.8),
            Point3::new(0.2, 0.1, 0.7),
            Point3::new(-0.3, 0.35, 0.6),
        ] {
            let sphere = SphereInCamera {
                center,
                radius: 0.05,
            };
            let ellipse = sphere.ellipse(&camera).unwrap();
            let (s, c) = ellipse.angle_rad.sin_cos();
            for point in sphere.outline(&camera, 30) {
                let (dx, dy) = (point.x - ellipse.center[0], point.y - ellipse.center[1]);
                let value = ((c * dx + s * dy) / ellipse.semi_axes[0]).powi(2)
                    + ((c * dy - s * dx) / ellipse.semi_axes[1]).powi(2);
                assert!((value - 1.0).abs() < 1e-9, "{center:?}: {value}");
            }
        }
    }

    #[test]
    fn mask_cut_by_the_frame_and_by_an_occluder_still_gives_the_center() {
        let camera = camera();
        for (center, occluded_from) in [
            (Point3::new(0.0, 0.05, 0.7), usize::MAX),
            (Point3::new(0.36, 0.1, 0.7), usize::MAX),
            (Point3::new(0.1, 0.0, 0.7), 1050),
        ] {
            let sphere = SphereInCamera {
                center,
                radius: 0.04,
            };
            let mut mask = mask_of(&sphere, &camera);
            for y in 0..mask.height {
                for x in occluded_from.min(mask.width)..mask.width {
                    *mask.at_mut(x, y) = false;
                }
            }
            let mark = SphereMark::Mask(mask);
            let fit = cone_from_mark(&mark, &camera).unwrap();
            let found = fit.cone.sphere(0.04).center;
            let across = (found - center).xy().norm();
            let along = (found.z - center.z).abs() / center.z;
            assert!(across < 1e-4, "{center:?}: across {across} m");
            assert!(along < 2e-3, "{center:?}: along {along} relative");
        }
    }

    /// Points of a circle of 60 px between two angles, rounded to whole pixels as a hand sets them.
    fn arc(num: usize, from_deg: f64, to_deg: f64) -> Vec<Point2<f64>> {
        (0..num)
            .map(|k| {
                let share = k as f64 / (num as f64 - 1.0);
                let (s, c) = (from_deg + share * (to_deg - from_deg))
                    .to_radians()
                    .sin_cos();
                Point2::new((800.0 + 60.0 * c).round(), (600.0 + 60.0 * s).round())
            })
            .collect()
    }

    #[test]
    fn points_on_a_line_on_a_short_arc_or_in_one_place_are_no_outline() {
        let line = |bend: f64| -> Vec<Point2<f64>> {
            (0..5)
                .map(|k| Point2::new(700.0 + 20.0 * f64::from(k), 500.0 + bend * f64::from(k % 2)))
                .collect()
        };
        for points in [
            line(0.0),
            line(0.4),
            line(1.0),
            arc(5, 10.0, 40.0),
            arc(9, 200.0, 240.0),
        ] {
            let result = check_marked_points(&points);
            assert!(
                matches!(result, Err(SphereError::OpenOutline { relative_sigma, .. }) if relative_sigma > 0.1),
                "{points:?}: {result:?}"
            );
        }
        for points in [line(0.0), line(0.1)] {
            let result = cone_from_points(&points, &camera(), MIN_INLIER_SHARE);
            assert!(
                matches!(result, Err(SphereError::OpenOutline { .. })),
                "{result:?}"
            );
        }
        let mut twice = arc(5, 0.0, 288.0);
        twice[4] = twice[0];
        let result = check_marked_points(&twice);
        assert!(
            matches!(result, Err(SphereError::TooFewPoints { available: 4, .. })),
            "{result:?}"
        );
        for points in [arc(5, 0.0, 288.0), arc(5, 0.0, 150.0), arc(12, 30.0, 150.0)] {
            check_marked_points(&points).unwrap();
            cone_from_points(&points, &camera(), MIN_INLIER_SHARE).unwrap();
        }
    }

    #[test]
    fn a_square_is_no_disc_and_four_points_are_too_few() {
        let square = Mask::from_fn(400, 400, |x, y| {
            (100..300).contains(&x) && (100..300).contains(&y)
        });
        let camera = Intrinsics::pinhole(400, 400, 500.0, 199.5, 199.5);
        let result = cone_from_mark(&SphereMark::Mask(square), &camera);
        assert!(
            matches!(result, Err(SphereError::NotADisc { .. })),
            "{result:?}"
        );
        let few = SphereMark::Points(vec![[1.0, 2.0], [3.0, 4.0], [5.0, 1.0], [2.0, 2.0]]);
        let result = cone_from_mark(&few, &camera);
        assert!(
            matches!(result, Err(SphereError::TooFewPoints { .. })),
            "{result:?}"
        );
    }
}
