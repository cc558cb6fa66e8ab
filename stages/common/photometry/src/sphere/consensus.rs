//! The sphere that most outlines agree on, so that one bad mark is outvoted.
//!
//! Every pair of views proposes a sphere: the axes' nearest points give the centre, the half-angles
//! the radius. In a metric world every single view proposes one too, at the distance of the stated
//! radius.

use super::cone::OutlineCone;
use super::error::SphereError;
use super::known::{Known, State};
use nalgebra::Point3;
use rilievo_numerics::lines::nearest_point;
use rilievo_scene::{PhotoIdx, RigidTransform};

/// A view whose outline misses the common sphere by more than this (RMS) is left out, pixels.
pub(super) const MAX_VIEW_RMS_PX: f64 = 2.0;
/// A stated radius further from what the outlines give than this is a mistake, not noise.
const MAX_RADIUS_RATIO: f64 = 1.25;

/// In a metric world the outlines show the radius themselves: refuses one that is far off.
pub(super) fn check_radius(known: &[Known], radius: f64) -> Result<(), SphereError> {
    let Ok((free, used)) = consensus(known, radius, false) else {
        return Ok(());
    };
    let ratio = free.radius / radius;
    let agreeing = used.iter().filter(|&&u| u).count();
    if agreeing > 1 && !(1.0 / MAX_RADIUS_RATIO..MAX_RADIUS_RATIO).contains(&ratio) {
        return Err(SphereError::RadiusMismatch {
            stated: radius,
            observed: free.radius,
            views: agreeing,
        });
    }
    Ok(())
}

/// The proposal of a pair (or of one view in a metric world) that most views agree with.
pub(super) fn consensus(
    known: &[Known],
    radius: f64,
    is_metric: bool,
) -> Result<(State, Vec<bool>), SphereError> {
    let mut proposals = Vec::new();
    if is_metric {
        proposals.extend(known.iter().map(|k| {
            let world_from_cam = k.view.cam_from_world.inverse();
            let center = world_from_cam.apply(&k.cone.sphere(radius).center);
            State { center, radius }
        }));
    }
    // Many views: pairs a few steps apart suffice and bound the work.
    let step = (known.len() * known.len() / 2000).max(1);
    let mut counter = 0;
    for (i, a) in known.iter().enumerate() {
        for b in &known[i + 1..] {
            counter += 1;
            if counter % step == 0 {
                proposals.extend(from_pair(a, b).map(|pair| State {
                    radius: if is_metric { radius } else { pair.radius },
                    ..pair
                }));
            }
        }
    }
    // A proposal is coarser than the fit it starts: three times the tolerance, and capped costs.
    let limit = 3.0 * MAX_VIEW_RMS_PX;
    let cost = |state: &State| -> f64 {
        known
            .iter()
            .map(|k| k.agreement(state).0.min(2.0 * limit))
            .sum()
    };
    let best = proposals
        .into_iter()
        .map(|state| (cost(&state), state))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .ok_or(SphereError::Impossible)?
        .1;
    let used: Vec<bool> = known
        .iter()
        .map(|k| k.agreement(&best).0 <= limit)
        .collect();
    let agreeing = used.iter().filter(|&&u| u).count();
    let needed = if known.len() == 1 {
        1
    } else {
        2.max(known.len().div_ceil(2))
    };
    if agreeing < needed {
        let worst = known
            .iter()
            .map(|k| (k.agreement(&best).0, k.view.photo))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, PhotoIdx(0)));
        return Err(SphereError::Contradiction {
            agreeing,
            total: known.len(),
            worst: worst.1,
            worst_px: worst.0,
        });
    }
    Ok((best, used))
}

/// Where the axes of two outlines come nearest to each other.
pub(super) struct Crossing {
    /// The place, world frame.
    pub center: Point3<f64>,
    /// The radius that each half-angle gives there.
    pub radii: [f64; 2],
    /// Sum of its distances from both axes.
    pub gap: f64,
    /// Sine of the angle between the axes.
    pub sine: f64,
}

/// The crossing of two outlines' axes, each with its camera's pose; `None` where they are parallel.
pub(super) fn crossing(
    cam_from_world: [&RigidTransform; 2],
    cones: [&OutlineCone; 2],
) -> Option<Crossing> {
    let eyes = cam_from_world.map(RigidTransform::center_in_source);
    let axis = |k: usize| cam_from_world[k].rotation.inverse() * cones[k].axis;
    let axes = [axis(0), axis(1)];
    let center = nearest_point([0, 1].map(|k| (eyes[k], axes[k])))?;
    let from = eyes.map(|eye| center - eye);
    Some(Crossing {
        center,
        radii: [0, 1].map(|k| from[k].norm() * cones[k].half_angle.sin()),
        gap: (0..2).map(|k| from[k].cross(&axes[k]).norm()).sum(),
        sine: axes[0].cross(&axes[1]).norm(),
    })
}

/// The sphere that two outlines propose.
fn from_pair(a: &Known, b: &Known) -> Option<State> {
    let poses = [&a.view.cam_from_world, &b.view.cam_from_world];
    let Crossing { center, radii, .. } = crossing(poses, [&a.cone, &b.cone])?;
    let radius = 0.5 * (radii[0] + radii[1]);
    let in_front = poses.iter().all(|pose| pose.apply(&center).z > 0.0);
    (in_front && radius.is_finite() && radius > 0.0).then_some(State { center, radius })
}
