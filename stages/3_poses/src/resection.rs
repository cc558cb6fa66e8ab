//! Pose of a photo from points that are already known.
//!
//! RANSAC over three-point samples, scored by the truncated squared reprojection error
//! (MSAC: Torr and Zisserman 2000), the best refined over its inliers with a Cauchy loss. The
//! random stream comes from the run's seed and the photo, so that threads cannot change it.

use crate::p3p;
use crate::projection::{CenteredPose, project_with_jacobian};
use nalgebra::{Point2, Point3, SMatrix, SVector, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rilievo_numerics::least_squares::{LeastSquaresOptions, LeastSquaresProblem, minimize};
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::Intrinsics;

/// Upper bound on RANSAC samples: 30 % inliers are found with certainty 0.9999.
const MAX_NUM_SAMPLES: usize = 2000;
/// Certainty at which sampling stops early.
const CONFIDENCE: f64 = 0.9999;

pub(crate) struct Resection {
    pub pose: CenteredPose,
    /// Indices of the correspondences within the threshold.
    pub inliers: Vec<usize>,
}

fn error_px(camera: &Intrinsics, pose: &CenteredPose, pixel: &Point2<f64>, p: &Point3<f64>) -> f64 {
    camera
        .project(&pose.apply(p))
        .map_or(f64::INFINITY, |seen| (seen - pixel).norm())
}

/// Finds the pose of a camera that sees world points at pixels; `None` when no sample finds
/// at least six that agree.
pub(crate) fn resect(
    camera: &Intrinsics,
    pixels: &[Point2<f64>],
    points: &[Point3<f64>],
    max_error_px: f64,
    seed: [u64; 2],
) -> Option<Resection> {
    let num = pixels.len();
    if num < 6 {
        return None;
    }
    let rays: Vec<Vector3<f64>> = pixels.iter().map(|p| camera.ray(p).normalize()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed[0]);
    rng.set_stream(seed[1]);
    let limit = max_error_px * max_error_px;
    let mut best: Option<(f64, CenteredPose)> = None;
    let mut needed = MAX_NUM_SAMPLES;
    let mut sample_idx = 0;
    while sample_idx < needed {
        sample_idx += 1;
        let a = rng.random_range(0..num);
        let b = rng.random_range(0..num);
        let c = rng.random_range(0..num);
        if a == b || b == c || a == c {
            continue;
        }
        for pose in p3p::solve(
            &[rays[a], rays[b], rays[c]],
            &[points[a], points[b], points[c]],
        ) {
            let pose = CenteredPose::from(pose);
            let bound = best.as_ref().map_or(f64::INFINITY, |(score, _)| *score);
            let (mut score, mut num_inliers) = (0.0, 0_usize);
            for (pixel, point) in pixels.iter().zip(points) {
                let squared = error_px(camera, &pose, pixel, point).powi(2);
                num_inliers += usize::from(squared < limit);
                score += squared.min(limit);
                if score >= bound {
                    break;
                }
            }
            if score < bound {
                best = Some((score, pose));
                let share = num_inliers as f64 / num as f64;
                let wanted = (1.0 - CONFIDENCE).ln() / (1.0 - share.powi(3)).ln();
                needed = (wanted.ceil().max(20.0) as usize).min(MAX_NUM_SAMPLES);
            }
        }
    }
    let (_, mut pose) = best?;
    let inliers_of = |pose: &CenteredPose| -> Vec<usize> {
        (0..num)
            .filter(|&k| error_px(camera, pose, &pixels[k], &points[k]) <= max_error_px)
            .collect()
    };
    let mut inliers = inliers_of(&pose);
    for _ in 0..3 {
        if inliers.len() < 6 {
            return None;
        }
        pose = refine(camera, pixels, points, &inliers, pose, max_error_px);
        inliers = inliers_of(&pose);
    }
    (inliers.len() >= 6).then_some(Resection { pose, inliers })
}

struct PoseProblem<'a> {
    camera: &'a Intrinsics,
    pixels: &'a [Point2<f64>],
    points: &'a [Point3<f64>],
    inliers: &'a [usize],
    loss: RobustLoss,
}

impl LeastSquaresProblem<6> for PoseProblem<'_> {
    type State = CenteredPose;

    fn linearize(&self, pose: &CenteredPose) -> (SMatrix<f64, 6, 6>, SVector<f64, 6>) {
        let (mut hessian, mut gradient) = (SMatrix::zeros(), SVector::zeros());
        for &k in self.inliers {
            let Some((pixel, j)) = project_with_jacobian(self.camera, pose, &self.points[k]) else {
                continue;
            };
            let residual = pixel - self.pixels[k];
            let weight = self.loss.weight(residual.norm());
            hessian += j.by_pose.transpose() * j.by_pose * weight;
            gradient += j.by_pose.transpose() * residual * weight;
        }
        (hessian, gradient)
    }

    fn cost(&self, pose: &CenteredPose) -> f64 {
        let mut cost = 0.0;
        for &k in self.inliers {
            let error = error_px(self.camera, pose, &self.pixels[k], &self.points[k]);
            if error.is_infinite() {
                return f64::INFINITY;
            }
            cost += self.loss.cost(error);
        }
        cost
    }

    fn retract(&self, pose: &CenteredPose, step: &SVector<f64, 6>) -> CenteredPose {
        pose.retract(step.as_slice())
    }
}

fn refine(
    camera: &Intrinsics,
    pixels: &[Point2<f64>],
    points: &[Point3<f64>],
    inliers: &[usize],
    start: CenteredPose,
    max_error_px: f64,
) -> CenteredPose {
    let problem = PoseProblem {
        camera,
        pixels,
        points,
        inliers,
        loss: RobustLoss::Cauchy(0.3 * max_error_px),
    };
    let options = LeastSquaresOptions {
        max_num_iterations: 20,
        relative_cost_change: 1e-7,
        ..LeastSquaresOptions::default()
    };
    minimize(&problem, start, &options).map_or(start, |(pose, _)| pose)
}
