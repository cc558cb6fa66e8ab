//! What is adjusted: cameras, views, points and their sightings, with its cost and its residuals.

use crate::projection::{CenteredPose, NUM_INTRINSICS, PRINCIPAL_POINT, retract_intrinsics};
use nalgebra::{Point2, Point3, Vector2};
use rayon::prelude::*;
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::Intrinsics;
use std::sync::Arc;

/// Loss of the priors on intrinsics.
pub(super) const PRIOR_LOSS: RobustLoss = RobustLoss::Cauchy(2.0);

/// A camera shared by the views of its group.
#[derive(Clone, Debug)]
pub(crate) struct AdjustedCamera {
    /// Where the adjustment starts, and the mean of the priors.
    pub initial: Intrinsics,
    /// Deviation from it: `ln f, cx, cy, k1, k2, p1, p2, k3`.
    pub deviation: [f64; NUM_INTRINSICS],
    /// Standard deviation of each parameter's prior; `None` keeps it fixed.
    pub prior_sigma: [Option<f64>; NUM_INTRINSICS],
    /// The camera whose focal length and distortion this one has too, with one prior for both.
    pub lens_of: Option<usize>,
}

impl AdjustedCamera {
    /// A camera that stays as it is, to the bit.
    pub fn fixed(initial: Intrinsics) -> Self {
        Self {
            initial,
            deviation: [0.0; NUM_INTRINSICS],
            prior_sigma: [None; NUM_INTRINSICS],
            lens_of: None,
        }
    }

    /// Whether a parameter is its own, not the lens's that it shares.
    pub(super) fn is_own(&self, k: usize) -> bool {
        self.lens_of.is_none() || PRINCIPAL_POINT.contains(&k)
    }

    /// The parameters that it has a prior of its own for: index, deviation, standard deviation.
    pub(super) fn priors(&self) -> impl Iterator<Item = (usize, f64, f64)> {
        let own = (0..NUM_INTRINSICS).filter(|&k| self.is_own(k));
        own.filter_map(|k| Some((k, self.deviation[k], self.prior_sigma[k]?)))
    }

    /// The camera with its deviation applied.
    pub fn current(&self) -> Intrinsics {
        if self.deviation.iter().all(|&d| d == 0.0) {
            self.initial
        } else {
            retract_intrinsics(&self.initial, &self.deviation)
        }
    }
}

/// A view of the problem.
#[derive(Clone, Debug)]
pub(crate) struct AdjustedView {
    /// Index of its camera.
    pub camera: usize,
    pub pose: CenteredPose,
    /// Which of `(ω, δ)` may change.
    pub free: [bool; 6],
}

/// One sighting of a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub view: usize,
    pub pixel: Point2<f64>,
    /// Inverse variance, px⁻².
    pub weight: f64,
}

/// Cameras, views, points and what was seen of them.
#[derive(Clone, Debug)]
pub(crate) struct Bundle {
    pub cameras: Vec<AdjustedCamera>,
    pub views: Vec<AdjustedView>,
    /// In the world frame.
    pub points: Vec<Point3<f64>>,
    /// Of all points, one point after the other.
    pub observations: Arc<Vec<Observation>>,
    /// Where the observations of point `p` start; one more entry than points.
    pub offsets: Arc<Vec<usize>>,
}

/// Size of the residuals of a bundle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ResidualStatistics {
    /// Root mean square of the coordinates, pixels.
    pub rms_px: f64,
    /// Standard deviation of an observation's coordinate, degrees of freedom counted, pixels.
    pub sigma_px: f64,
    /// The same for residuals over their standard deviations: 1 where these are right.
    pub unit_sigma: f64,
}

impl Bundle {
    /// Fixes the gauge: the first free view entirely, and one coordinate of the centre farthest
    /// from it. Does nothing where two views are fixed already.
    pub fn fix_gauge(&mut self) {
        let fixed = |v: &AdjustedView| v.free.iter().all(|f| !f);
        let num_fixed = self.views.iter().filter(|v| fixed(v)).count();
        if num_fixed >= 2 || self.views.is_empty() {
            return;
        }
        let anchor = self.views.iter().position(fixed).unwrap_or(0);
        self.views[anchor].free = [false; 6];
        let origin = self.views[anchor].pose.center;
        let mut farthest = (0.0, anchor);
        for (k, view) in self.views.iter().enumerate() {
            let distance = (view.pose.center - origin).norm();
            if distance > farthest.0 {
                farthest = (distance, k);
            }
        }
        if farthest.1 != anchor {
            let axis = (self.views[farthest.1].pose.center - origin).iamax();
            self.views[farthest.1].free[3 + axis] = false;
        }
    }

    /// Current intrinsics, per camera.
    pub(super) fn intrinsics(&self) -> Vec<Intrinsics> {
        self.cameras.iter().map(AdjustedCamera::current).collect()
    }

    /// What was seen of a point.
    pub(super) fn seen(&self, point: usize) -> &[Observation] {
        &self.observations[self.offsets[point]..self.offsets[point + 1]]
    }

    /// Difference of a point's image from what was observed, pixels; `None` behind the camera.
    fn residual(
        &self,
        cameras: &[Intrinsics],
        point: usize,
        observation: &Observation,
    ) -> Option<Vector2<f64>> {
        let view = &self.views[observation.view];
        let seen = cameras[view.camera].project(&view.pose.apply(&self.points[point]))?;
        Some(seen - observation.pixel)
    }

    /// Cost at the current state, infinite when a point lies behind a camera that sees it.
    pub(super) fn cost(&self, loss: RobustLoss) -> f64 {
        let cameras = self.intrinsics();
        let chunks: Vec<f64> = self
            .point_chunks()
            .into_par_iter()
            .map(|range| {
                let mut sum = 0.0;
                for p in range {
                    for o in self.seen(p) {
                        let Some(residual) = self.residual(&cameras, p, o) else {
                            return f64::INFINITY;
                        };
                        sum += loss.cost(o.weight.sqrt() * residual.norm());
                    }
                }
                sum
            })
            .collect();
        chunks.iter().sum::<f64>() + self.prior_cost()
    }

    fn prior_cost(&self) -> f64 {
        let priors = self.cameras.iter().flat_map(AdjustedCamera::priors);
        priors.map(|(_, d, s)| PRIOR_LOSS.cost(d / s)).sum()
    }

    /// Ranges of points, cut so that they do not depend on the number of threads.
    pub(super) fn point_chunks(&self) -> Vec<std::ops::Range<usize>> {
        const NUM_CHUNKS: usize = 8;
        let size = self.points.len().div_ceil(NUM_CHUNKS).max(1);
        (0..self.points.len())
            .step_by(size)
            .map(|start| start..(start + size).min(self.points.len()))
            .collect()
    }

    /// How large the residuals are.
    pub fn residual_statistics(&self) -> ResidualStatistics {
        let cameras = self.intrinsics();
        let (mut squares, mut weighted) = (0.0, 0.0);
        for p in 0..self.points.len() {
            for o in self.seen(p) {
                if let Some(residual) = self.residual(&cameras, p, o) {
                    squares += residual.norm_squared();
                    weighted += o.weight * residual.norm_squared();
                }
            }
        }
        let num_residuals = 2 * self.observations.len();
        let of_poses = self.views.iter().flat_map(|v| v.free);
        let num_free = 3 * self.points.len() + of_poses.filter(|&free| free).count();
        let degrees = num_residuals.saturating_sub(num_free).max(1);
        ResidualStatistics {
            rms_px: (squares / num_residuals.max(1) as f64).sqrt(),
            sigma_px: (squares / degrees as f64).sqrt(),
            unit_sigma: (weighted / degrees as f64).sqrt(),
        }
    }
}
