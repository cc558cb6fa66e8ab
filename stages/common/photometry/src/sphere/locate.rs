//! One sphere from outlines in many posed views, and with it the scale of the world.
//!
//! # Problem
//! Views `v` with poses `(R_v, t_v)` in a world of unknown scale see the outline of one sphere of
//! known radius `R` (metres). Unknown: its centre `C` and radius `r` in the world's unit,
//! ```text
//! min over C, r of Σ_v Σ_i ρ( s_i (angle(d_i, C_v) − asin(r / |C_v|)) ),   C_v = R_v C + t_v
//! ```
//! with `d_i` the rays of the outline points and `s_i` pixels per radian there. One world unit is
//! then `R / r` metres. Where the world is metric already, `r = R` is kept and only `C` is sought.
//!
//! # Steps
//! 1. A cone per view ([`super::cone_from_points`]).
//! 2. Every pair of views proposes a sphere: the axes' nearest points give the centre, the
//!    half-angles the radius; the proposal that most views agree with wins, so that one bad mark
//!    is outvoted.
//! 3. Levenberg–Marquardt over the outline points of the agreeing views, Huber loss.
//! 4. Covariance: `σ_p² (JᵀJ)⁻¹` with neighbouring points counted as one per pixel of blur, plus
//!    the outline's systematic offset: moved, it does not average out within a view; wider, not over the views either.

use super::cone::{OutlineCone, SphereInCamera};
use super::confirm::MarkEvidence;
use super::error::SphereError;
use super::mark::{MarkFit, cone_from_points, distance_px};
use super::options::SphereOptions;
use nalgebra::{Matrix3, Matrix4, Point2, Point3, Vector3, Vector4};
use rilievo_scene::{Intrinsics, LocatedSphere, MarkedSphere, PhotoIdx, PosedView, RigidTransform};
use serde::{Deserialize, Serialize};

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

/// Whether the world's unit is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldScale {
    /// Unit unknown: the sphere's radius gives it.
    Free,
    /// The world is metric; the radius is kept.
    Metric,
}

/// How one view agrees with the common sphere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewAgreement {
    /// The photo.
    pub photo: PhotoIdx,
    /// Whether it took part in the fit.
    pub used: bool,
    /// Distance of its outline from the common sphere's, RMS over its good points, pixels.
    pub rms_px: f64,
    /// Mean signed distance, positive where the observed outline is larger, pixels.
    pub bias_px: f64,
    /// Share of its outline points on its own best cone.
    pub inlier_share: f64,
    /// Why it was left out.
    pub reason: Option<String>,
}

/// Metres per unit of the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaleEstimate {
    /// Stated radius over the radius that the outlines show.
    pub metres_per_unit: f64,
    /// Its relative standard deviation.
    pub relative_sigma: f64,
}

/// The sphere in the world, and what it says of the scale.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SphereFit {
    /// Centre and radius in the world's unit, as it was given.
    pub sphere: LocatedSphere,
    /// What its outlines and its stated radius say of the world's unit; `None` with fewer than two
    /// views. Far from 1 with [`WorldScale::Metric`], the stated radius or the poses' unit is wrong.
    pub scale: Option<ScaleEstimate>,
    /// Every view that had a mark.
    pub views: Vec<ViewAgreement>,
    /// Photos whose own mark was left out, with the reason; their outline may have been found on the
    /// image all the same.
    pub unused_marks: Vec<(PhotoIdx, String)>,
    /// What the photos whose marks were used show of it, where its outline was refined on them.
    pub evidence: Vec<MarkEvidence>,
}

/// Locates the sphere from outlines in posed views.
///
/// `radius` in metres. With [`WorldScale::Free`] the result's `sphere.radius` is in world units,
/// and scaling the world by its `scale` makes it metric. The sphere is called
/// [`MarkedSphere::ONLY`].
///
/// # Errors
/// [`SphereError::NoView`], [`SphereError::OneView`] (scale needs two),
/// [`SphereError::Contradiction`], [`SphereError::Radius`], [`SphereError::Impossible`].
pub fn locate(
    views: &[PosedOutline],
    radius: f64,
    scale: WorldScale,
    options: &SphereOptions,
) -> Result<SphereFit, SphereError> {
    options.validate()?;
    if !(radius > 0.0 && radius.is_finite()) {
        return Err(SphereError::Radius { radius });
    }
    let marks: Vec<Result<MarkFit, SphereError>> = views
        .iter()
        .map(|view| cone_from_points(&view.outline, &view.intrinsics, options))
        .collect();
    let marked = views.iter().zip(&marks).enumerate();
    let known: Vec<Known> = marked
        .filter_map(|(idx, (view, mark))| Some(Known::new(idx, view, mark.as_ref().ok()?)))
        .collect();
    if known.is_empty() {
        let first = marks.into_iter().find_map(Result::err);
        return Err(first.unwrap_or(SphereError::NoView));
    }
    if known.len() == 1 && scale == WorldScale::Free {
        return Err(SphereError::OneView);
    }
    if scale == WorldScale::Metric && known.len() > 1 {
        check_radius(&known, radius, options)?;
    }
    let (start, mut used) = consensus(&known, radius, scale, options)?;
    let mut state = start;
    let mut solution = None;
    // Twice: views that the refined sphere no longer explains leave, others come in.
    for _ in 0..3 {
        let refined = refine(
            state,
            &in_use(&known, &used),
            scale == WorldScale::Free,
            options,
        )?;
        state = refined.state;
        solution = Some(refined);
        let next: Vec<bool> = known
            .iter()
            .map(|k| k.agreement(&state).0 <= options.max_view_rms_px)
            .collect();
        if next == used
            || next.iter().filter(|&&u| u).count() < 1 + usize::from(scale == WorldScale::Free)
        {
            break;
        }
        used = next;
    }
    let Some(solution) = solution else {
        return Err(SphereError::NoView);
    };
    let agreements: Vec<ViewAgreement> = views
        .iter()
        .zip(&marks)
        .enumerate()
        .map(|(idx, (view, mark))| match mark {
            Err(error) => ViewAgreement {
                photo: view.photo,
                used: false,
                rms_px: f64::INFINITY,
                bias_px: 0.0,
                inlier_share: 0.0,
                reason: Some(error.to_string()),
            },
            Ok(mark) => {
                let position = known.iter().position(|k| k.view_idx == idx);
                let (rms_px, bias_px) =
                    position.map_or((f64::INFINITY, 0.0), |p| known[p].agreement(&state));
                let in_use = position.is_some_and(|p| used[p]);
                ViewAgreement {
                    photo: view.photo,
                    used: in_use,
                    rms_px,
                    bias_px,
                    inlier_share: mark.inlier_share,
                    reason: (!in_use).then(|| {
                        format!(
                            "its outline lies {rms_px:.1} px from the sphere that the other \
                             photos agree on"
                        )
                    }),
                }
            }
        })
        .collect();
    let seen_in = agreements
        .iter()
        .filter(|view| view.used)
        .map(|view| (view.photo, view.rms_px))
        .collect();
    let center_sigma = solution.center_sigma;
    let active = in_use(&known, &used);
    let with_radius = match scale {
        WorldScale::Free => Some(solution),
        // The outlines' own radius, whatever was stated.
        WorldScale::Metric if active.len() > 1 => refine(state, &active, true, options).ok(),
        WorldScale::Metric => None,
    };
    Ok(SphereFit {
        sphere: LocatedSphere {
            name: MarkedSphere::ONLY.to_owned(),
            center_in_world: state.center.coords.into(),
            radius: state.radius,
            center_sigma,
            seen_in,
        },
        scale: with_radius.map(|fit| ScaleEstimate {
            metres_per_unit: radius / fit.state.radius,
            relative_sigma: fit.radius_sigma / fit.state.radius,
        }),
        unused_marks: agreements
            .iter()
            .filter_map(|view| Some((view.photo, view.reason.clone()?)))
            .collect(),
        views: agreements,
        evidence: Vec::new(),
    })
}

/// The views that take part.
fn in_use<'a, 'b>(known: &'a [Known<'b>], used: &[bool]) -> Vec<&'a Known<'b>> {
    let views = known.iter().zip(used);
    views.filter_map(|(k, &used)| used.then_some(k)).collect()
}

/// Sphere in the world, the state of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct State {
    center: Point3<f64>,
    radius: f64,
}

/// A view with its own cone and the rays of its good outline points.
struct Known<'a> {
    view_idx: usize,
    view: &'a PosedOutline,
    cone: OutlineCone,
    rays: Vec<Vector3<f64>>,
    /// Weight of a point so that the whole outline counts as its independent samples.
    point_weight: f64,
}

impl<'a> Known<'a> {
    fn new(view_idx: usize, view: &'a PosedOutline, mark: &MarkFit) -> Self {
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

    fn in_camera(&self, state: &State) -> SphereInCamera {
        SphereInCamera {
            center: self.view.cam_from_world.apply(&state.center),
            radius: state.radius,
        }
    }

    /// RMS and mean distance of the outline from the sphere's, pixels.
    fn agreement(&self, state: &State) -> (f64, f64) {
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

/// A stated radius further from what the outlines give than this is a mistake, not noise.
const MAX_RADIUS_RATIO: f64 = 1.25;

/// In a metric world the outlines tell the radius themselves: refuses one that is far off.
fn check_radius(known: &[Known], radius: f64, options: &SphereOptions) -> Result<(), SphereError> {
    let Ok((free, used)) = consensus(known, radius, WorldScale::Free, options) else {
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
fn consensus(
    known: &[Known],
    radius: f64,
    scale: WorldScale,
    options: &SphereOptions,
) -> Result<(State, Vec<bool>), SphereError> {
    let mut proposals = Vec::new();
    if scale == WorldScale::Metric {
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
                    radius: if scale == WorldScale::Metric {
                        radius
                    } else {
                        pair.radius
                    },
                    ..pair
                }));
            }
        }
    }
    // A proposal is coarser than the fit it starts: three times the tolerance, and capped costs.
    let limit = 3.0 * options.max_view_rms_px;
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
    let across = axes.map(|d| Matrix3::identity() - d * d.transpose());
    let pull = across[0] * eyes[0].coords + across[1] * eyes[1].coords;
    let center = Point3::from((across[0] + across[1]).try_inverse()? * pull);
    let from = eyes.map(|eye| center - eye);
    Some(Crossing {
        center,
        radii: [0, 1].map(|k| from[k].norm() * cones[k].half_angle.sin()),
        gap: (across[0] * from[0]).norm() + (across[1] * from[1]).norm(),
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

struct Refined {
    state: State,
    center_sigma: [f64; 3],
    radius_sigma: f64,
}

/// Derivatives of `angle(d, C) − asin(r/|C|)` by `C` (camera frame) and `r`, with its value.
pub(super) fn residual(
    sphere: &SphereInCamera,
    ray: &Vector3<f64>,
) -> Option<(f64, Vector3<f64>, f64)> {
    let c = sphere.center.coords;
    let rho = c.norm();
    let axis = c / rho;
    let along = ray.dot(&axis);
    let across = ray - axis * along;
    let sin = across.norm();
    let tangent = (rho * rho - sphere.radius * sphere.radius).sqrt();
    if !(tangent > 0.0 && sin > 0.0) {
        return None;
    }
    let value = sin.atan2(along) - (sphere.radius / rho).asin();
    // Moving C towards the ray lessens the angle; moving it away shrinks the cone.
    let by_center = -across / (sin * rho) + axis * (sphere.radius / (rho * tangent));
    Some((value, by_center, -1.0 / tangent))
}

/// Share of a pixel beyond which an outline point's pull no longer grows.
const HUBER_PX: f64 = 0.5;

fn refine(
    start: State,
    known: &[&Known],
    free_radius: bool,
    options: &SphereOptions,
) -> Result<Refined, SphereError> {
    let mut state = start;
    let mut damping = 1e-4;
    let evaluate = |state: &State| -> Option<Normal> {
        let mut normal = Normal::default();
        let mut wider = Vector4::zeros();
        for k in known {
            let sphere = k.in_camera(state);
            let axis = sphere.cone()?.axis;
            let to_world = k.view.cam_from_world.rotation.inverse();
            let mut bias_rows = [Vector4::zeros(); 3];
            for ray in &k.rays {
                let (value, by_center, by_radius) = residual(&sphere, ray)?;
                let px = k.view.intrinsics.focal_px() / ray.z.max(0.1).powf(1.5);
                let r = px * value;
                let huber = (HUBER_PX / r.abs()).min(1.0);
                let w = k.point_weight * huber;
                let world = to_world * by_center;
                let row = Vector4::new(world.x, world.y, world.z, by_radius) * px;
                normal.matrix += row * row.transpose() * w;
                normal.right += row * (w * r);
                normal.cost += k.point_weight
                    * if r.abs() <= HUBER_PX {
                        0.5 * r * r
                    } else {
                        HUBER_PX * (r.abs() - 0.5 * HUBER_PX)
                    };
                normal.square += w * r * r;
                normal.weight += w;
                // An offset of the whole outline: wider, or moved along either axis.
                let around = (ray - axis * ray.dot(&axis)).xy().normalize();
                for (bias, amplitude) in bias_rows.iter_mut().zip([1.0, around.x, around.y]) {
                    *bias += row * (w * amplitude);
                }
            }
            wider += bias_rows[0];
            for moved in &bias_rows[1..] {
                normal.bias += moved * moved.transpose();
            }
        }
        normal.bias += wider * wider.transpose();
        Some(normal)
    };
    let unused = usize::from(!free_radius);
    let solve = |matrix: &Matrix4<f64>, right: &Vector4<f64>| -> Option<Vector4<f64>> {
        if unused == 0 {
            return Some(matrix.try_inverse()? * right);
        }
        let top =
            matrix.fixed_view::<3, 3>(0, 0).into_owned().try_inverse()? * right.fixed_rows::<3>(0);
        Some(Vector4::new(top.x, top.y, top.z, 0.0))
    };
    let mut current = evaluate(&state).ok_or(SphereError::Impossible)?;
    for _ in 0..50 {
        let mut damped = current.matrix;
        for k in 0..4 {
            damped[(k, k)] *= 1.0 + damping;
        }
        let Some(step) = solve(&damped, &current.right) else {
            break;
        };
        let candidate = State {
            center: state.center - step.xyz(),
            radius: state.radius - step.w,
        };
        match evaluate(&candidate).filter(|next| next.cost <= current.cost) {
            Some(next) => {
                let converged = step.norm() < 1e-12 * state.center.coords.norm().max(state.radius);
                (state, current, damping) = (candidate, next, damping * 0.1);
                if converged {
                    break;
                }
            }
            None if damping > 1e8 => break,
            None => damping *= 10.0,
        }
    }
    let variance = current.square / (current.weight - 4.0).max(1.0);
    let inverse = {
        let mut matrix = current.matrix;
        if !free_radius {
            // A radius that does not move: its row and column decouple.
            for k in 0..4 {
                matrix[(k, 3)] = 0.0;
                matrix[(3, k)] = 0.0;
            }
            matrix[(3, 3)] = 1.0;
        }
        matrix.try_inverse().ok_or(SphereError::Impossible)?
    };
    let bias = inverse * current.bias * inverse * options.outline_bias_px.powi(2);
    let covariance = inverse * variance + bias;
    let sigma = |k: usize| covariance[(k, k)].max(0.0).sqrt();
    Ok(Refined {
        state,
        center_sigma: [sigma(0), sigma(1), sigma(2)],
        radius_sigma: sigma(3),
    })
}

/// Sums of the normal equations.
#[derive(Default)]
struct Normal {
    matrix: Matrix4<f64>,
    right: Vector4<f64>,
    cost: f64,
    square: f64,
    weight: f64,
    /// Outer products of summed rows: what offsets common to a whole outline do. Moved it is by each view's own
    /// offset; wider by one of all views, since what makes a matte sphere seem larger or smaller (its own falling
    /// brightness, blur, gamma, the ground) is the same in all of them and does not average out.
    bias: Matrix4<f64>,
}
