//! What one view shows of the common sphere: its own cone, and the rays of its good outline points.

use super::cone::{OutlineCone, SphereInCamera};
use super::mark::{MarkFit, distance_px};
use nalgebra::{Point2, Point3, Vector3};
use rilievo_scene::{Intrinsics, PhotoIdx, PosedView, RigidTransform};

/// Outline of the sphere in one posed view.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedOutline {
    /// The photo, for messages.
    pub photo: PhotoIdx,
    /// Its camera.
    pub intrinsics: Intrinsics,
    /// Its pose, in the world's unit.
    pub cam_from_world: RigidTransform,
    /// Outline points, pixels (at least five, [`super::outline_of_mark`]).
    pub outline: Vec<Point2<f64>>,
}

impl PosedOutline {
    /// The outline in a view.
    pub fn of(view: &PosedView, outline: Vec<Point2<f64>>) -> Self {
        Self {
            photo: view.photo,
            intrinsics: view.intrinsics,
            cam_from_world: view.cam_from_world,
            outline,
        }
    }
}

/// Sphere in the world, the state of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    pub center: Point3<f64>,
    pub radius: f64,
}

/// A view with its own cone and the rays of its good outline points.
pub(super) struct Known<'a> {
    pub view_idx: usize,
    pub view: &'a PosedOutline,
    pub cone: OutlineCone,
    pub rays: Vec<Vector3<f64>>,
    /// Weight of a point so that the whole outline counts as its independent samples.
    pub point_weight: f64,
}

impl<'a> Known<'a> {
    pub fn new(view_idx: usize, view: &'a PosedOutline, mark: &MarkFit) -> Self {
        let rays: Vec<_> = mark
            .inliers
            .iter()
            .map(|p| view.intrinsics.ray(p).normalize())
            .collect();
        // Points closer than two pixels share their noise.
        let perimeter = std::f64::consts::TAU
            * mark.cone.sphere(1.0).radius_px(&view.intrinsics)
            * mark.inlier_share;
        let independent = (0.5 * perimeter).max(3.0).min(rays.len() as f64);
        Self {
            view_idx,
            view,
            cone: mark.cone,
            point_weight: independent / rays.len() as f64,
            rays,
        }
    }

    pub fn in_camera(&self, state: &State) -> SphereInCamera {
        SphereInCamera {
            center: self.view.cam_from_world.apply(&state.center),
            radius: state.radius,
        }
    }

    /// RMS and mean distance of the outline from the sphere's, pixels.
    pub fn agreement(&self, state: &State) -> (f64, f64) {
        let Some(cone) = self.in_camera(state).cone() else {
            return (f64::INFINITY, 0.0);
        };
        let (mut square, mut sum) = (0.0, 0.0);
        for ray in &self.rays {
            let d = distance_px(&cone, ray, &self.view.intrinsics);
            square += d * d;
            sum += d;
        }
        let n = self.rays.len() as f64;
        ((square / n).sqrt(), sum / n)
    }
}
