//! A point from its rays.
//!
//! The start minimises the distances from the rays, `Σ (I − d_i d_iᵀ)(X − C_i) = 0` with unit
//! directions `d_i` and centres `C_i`; then the reprojection errors are minimised
//! (`Σ ρ(|π_i(X) − x_i|)`, Cauchy). For a track with wrong sightings every pair of its rays
//! proposes a point and the one that most sightings support wins.

use crate::projection::{CenteredPose, project_with_jacobian};
use nalgebra::{Point2, Point3, SMatrix, SVector, Vector3};
use rilievo_numerics::least_squares::{LeastSquaresOptions, LeastSquaresProblem, minimize};
use rilievo_numerics::lines::normal_equations;
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::Intrinsics;

pub(crate) use rilievo_scene::MIN_TRIANGULATION_ANGLE_DEG;

/// A sighting: camera, pose and pixel.
#[derive(Clone, Copy)]
pub(crate) struct Sighting<'a> {
    pub camera: &'a Intrinsics,
    pub pose: &'a CenteredPose,
    pub pixel: Point2<f64>,
}

impl Sighting<'_> {
    /// Unit ray in the world frame.
    pub fn ray(&self) -> Vector3<f64> {
        self.pose.rotation.inverse() * self.camera.ray(&self.pixel).normalize()
    }

    /// Reprojection error in pixels, infinite behind the camera.
    pub fn error_px(&self, point: &Point3<f64>) -> f64 {
        self.camera
            .project(&self.pose.apply(point))
            .map_or(f64::INFINITY, |p| (p - self.pixel).norm())
    }
}

/// What a triangulated point must fulfil.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangulationLimits {
    /// Largest reprojection error of a sighting, pixels.
    pub max_error_px: f64,
    /// Smallest of the widest angles between two of its rays, radians.
    pub min_angle_rad: f64,
}

impl TriangulationLimits {
    /// Whether rays from these centres hold a point: two or more, and not too nearly parallel.
    pub fn hold(&self, point: &Point3<f64>, centers: &[Point3<f64>]) -> bool {
        centers.len() >= 2 && widest_angle(point, centers) >= self.min_angle_rad
    }
}

/// Point nearest to all rays.
fn nearest_to_rays(centers: &[Point3<f64>], rays: &[Vector3<f64>]) -> Option<Point3<f64>> {
    let (normal, right) = normal_equations(centers.iter().copied().zip(rays.iter().copied()));
    let solution = normal.cholesky()?.solve(&right);
    solution
        .iter()
        .all(|v| v.is_finite())
        .then(|| Point3::from(solution))
}

/// Widest angle at a point between the directions to two centres, radians.
pub(crate) fn widest_angle(point: &Point3<f64>, centers: &[Point3<f64>]) -> f64 {
    let rays: Vec<Vector3<f64>> = centers.iter().map(|c| (point - c).normalize()).collect();
    let mut least_cosine = 1.0_f64;
    for (k, a) in rays.iter().enumerate() {
        for b in &rays[k + 1..] {
            least_cosine = least_cosine.min(a.dot(b));
        }
    }
    least_cosine.clamp(-1.0, 1.0).acos()
}

struct PointProblem<'a> {
    sightings: &'a [Sighting<'a>],
    loss: RobustLoss,
}

impl LeastSquaresProblem<3> for PointProblem<'_> {
    type State = Point3<f64>;

    fn linearize(&self, point: &Point3<f64>) -> (SMatrix<f64, 3, 3>, SVector<f64, 3>) {
        let (mut hessian, mut gradient) = (SMatrix::zeros(), SVector::zeros());
        for sighting in self.sightings {
            let Some((pixel, j)) = project_with_jacobian(sighting.camera, sighting.pose, point)
            else {
                continue;
            };
            let residual = pixel - sighting.pixel;
            let weight = self.loss.weight(residual.norm());
            hessian += j.by_point.transpose() * j.by_point * weight;
            gradient += j.by_point.transpose() * residual * weight;
        }
        (hessian, gradient)
    }

    fn cost(&self, point: &Point3<f64>) -> f64 {
        self.sightings
            .iter()
            .map(|s| {
                let error = s.error_px(point);
                if error.is_finite() {
                    self.loss.cost(error)
                } else {
                    f64::INFINITY
                }
            })
            .sum()
    }

    fn retract(&self, point: &Point3<f64>, step: &SVector<f64, 3>) -> Point3<f64> {
        point + step
    }
}

/// Minimises the reprojection errors from a start.
pub(crate) fn refine_point(
    sightings: &[Sighting<'_>],
    start: Point3<f64>,
    loss: RobustLoss,
) -> Point3<f64> {
    let options = LeastSquaresOptions {
        max_num_iterations: 20,
        relative_cost_change: 1e-8,
        ..LeastSquaresOptions::default()
    };
    minimize(&PointProblem { sightings, loss }, start, &options).map_or(start, |(point, _)| point)
}

/// Point of a track with the indices of the sightings that support it; `None` when fewer than two
/// do, or their rays are too nearly parallel.
pub(crate) fn triangulate(
    sightings: &[Sighting<'_>],
    limits: &TriangulationLimits,
) -> Option<(Point3<f64>, Vec<usize>)> {
    let rays: Vec<Vector3<f64>> = sightings.iter().map(Sighting::ray).collect();
    let centers: Vec<Point3<f64>> = sightings.iter().map(|s| s.pose.center).collect();
    let supporters = |point: &Point3<f64>| -> Vec<usize> {
        (0..sightings.len())
            .filter(|&k| sightings[k].error_px(point) <= limits.max_error_px)
            .collect()
    };
    // All sightings together are right for most tracks.
    let mut best: Option<(Point3<f64>, Vec<usize>)> =
        nearest_to_rays(&centers, &rays).map(|point| (point, supporters(&point)));
    let complete = |found: &Option<(Point3<f64>, Vec<usize>)>| {
        found
            .as_ref()
            .is_some_and(|(_, support)| support.len() == sightings.len())
    };
    if !complete(&best) && sightings.len() > 2 {
        'pairs: for a in 0..sightings.len() {
            for b in a + 1..sightings.len() {
                let pair = [a, b];
                let of_pair = pair.map(|k| centers[k]);
                let Some(point) = nearest_to_rays(&of_pair, &pair.map(|k| rays[k]))
                    .filter(|point| limits.hold(point, &of_pair))
                else {
                    continue;
                };
                let support = supporters(&point);
                if best
                    .as_ref()
                    .is_none_or(|(_, found)| support.len() > found.len())
                {
                    best = Some((point, support));
                }
                if complete(&best) {
                    break 'pairs;
                }
            }
        }
    }
    let (start, support) = best?;
    if support.len() < 2 {
        return None;
    }
    let chosen: Vec<Sighting<'_>> = support.iter().map(|&k| sightings[k]).collect();
    let point = refine_point(
        &chosen,
        start,
        RobustLoss::Cauchy(0.5 * limits.max_error_px),
    );
    let support = supporters(&point);
    let used: Vec<Point3<f64>> = support.iter().map(|&k| centers[k]).collect();
    limits.hold(&point, &used).then_some((point, support))
}
