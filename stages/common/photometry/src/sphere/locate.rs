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
//! 1. A cone per view ([`super::mark`]).
//! 2. Every pair of views proposes a sphere: the axes' nearest points give the centre, the
//!    half-angles the radius; the proposal that most views agree with wins, so that one bad mark
//!    is outvoted.
//! 3. Levenberg–Marquardt over the outline points of the agreeing views, Huber loss.
//! 4. Covariance: `σ_p² (JᵀJ)⁻¹` with neighbouring points counted as one per pixel of blur, plus
//!    the outline's systematic offset: moved, it does not average out within a view; wider, not
//!    over the views either.

use super::confirm::MarkEvidence;
use super::consensus::{MAX_VIEW_RMS_PX, check_radius, consensus};
use super::error::SphereError;
use super::known::{Known, PosedOutline, State};
use super::mark::{MIN_INLIER_SHARE, MarkFit, OUTLINE_BIAS_PX, cone_from_points};
use super::outline_fit::{Refined, refine};
use rilievo_scene::{LocatedSphere, MarkedSphere, PhotoIdx};
use serde::{Deserialize, Serialize};

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
    /// views. Far from 1 with [`WorldScale::Metric`], the stated radius or the poses' unit is
    /// wrong.
    pub scale: Option<ScaleEstimate>,
    /// Every view that had a mark.
    pub views: Vec<ViewAgreement>,
    /// Photos whose own mark was left out, with the reason; their outline may have been found on
    /// the image all the same.
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
) -> Result<SphereFit, SphereError> {
    locate_with(views, radius, scale, OUTLINE_BIAS_PX)
}

/// [`locate`] under another systematic uncertainty of an outline.
pub(super) fn locate_with(
    views: &[PosedOutline],
    radius: f64,
    scale: WorldScale,
    bias_px: f64,
) -> Result<SphereFit, SphereError> {
    if !(radius > 0.0 && radius.is_finite()) {
        return Err(SphereError::Radius { radius });
    }
    let cone =
        |view: &PosedOutline| cone_from_points(&view.outline, &view.intrinsics, MIN_INLIER_SHARE);
    let marks: Vec<Result<MarkFit, SphereError>> = views.iter().map(cone).collect();
    let marked = views.iter().zip(&marks).enumerate();
    let known: Vec<Known> = marked
        .filter_map(|(idx, (view, mark))| Some(Known::new(idx, view, mark.as_ref().ok()?)))
        .collect();
    if known.is_empty() {
        let first = marks.into_iter().find_map(Result::err);
        return Err(first.unwrap_or(SphereError::NoView));
    }
    let is_metric = scale == WorldScale::Metric;
    if known.len() == 1 && !is_metric {
        return Err(SphereError::OneView);
    }
    if is_metric && known.len() > 1 {
        check_radius(&known, radius)?;
    }
    let (solution, used) = settled(&known, radius, is_metric, bias_px)?;
    let state = solution.state;
    let center_sigma = solution.center_sigma;
    let agreements: Vec<ViewAgreement> = views
        .iter()
        .zip(&marks)
        .enumerate()
        .map(|(idx, (view, mark))| {
            let at = known.iter().position(|k| k.view_idx == idx);
            let at = at.map(|p| (&known[p], used[p]));
            view_agreement(view.photo, mark, at, &state)
        })
        .collect();
    let seen_in = agreements.iter().filter(|view| view.used);
    let seen_in = seen_in.map(|view| (view.photo, view.rms_px)).collect();
    let active = in_use(&known, &used);
    let with_radius = match scale {
        WorldScale::Free => Some(solution),
        // The outlines' own radius, whatever was stated.
        WorldScale::Metric if active.len() > 1 => refine(state, &active, true, bias_px).ok(),
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

/// The sphere fitted to the views that it explains, and which these are. Repeated: views that the
/// fitted sphere no longer explains leave, others come in.
fn settled(
    known: &[Known],
    radius: f64,
    is_metric: bool,
    bias_px: f64,
) -> Result<(Refined, Vec<bool>), SphereError> {
    const NUM_ROUNDS: usize = 3;
    let (start, mut used) = consensus(known, radius, is_metric)?;
    let mut solution = refine(start, &in_use(known, &used), !is_metric, bias_px)?;
    for round in 1..=NUM_ROUNDS {
        let explained = |k: &Known| k.agreement(&solution.state).0 <= MAX_VIEW_RMS_PX;
        let next: Vec<bool> = known.iter().map(explained).collect();
        let num_next = next.iter().filter(|&&u| u).count();
        if next == used || num_next < 1 + usize::from(!is_metric) {
            break;
        }
        used = next;
        if round < NUM_ROUNDS {
            solution = refine(solution.state, &in_use(known, &used), !is_metric, bias_px)?;
        }
    }
    Ok((solution, used))
}

/// How one view agrees; `known` where its mark is an outline, and whether it was used.
fn view_agreement(
    photo: PhotoIdx,
    mark: &Result<MarkFit, SphereError>,
    known: Option<(&Known, bool)>,
    state: &State,
) -> ViewAgreement {
    let inlier_share = mark.as_ref().map_or(0.0, |mark| mark.inlier_share);
    let (rms_px, bias_px) = known.map_or((f64::INFINITY, 0.0), |(k, _)| k.agreement(state));
    let used = known.is_some_and(|(_, used)| used);
    let reason = match mark {
        Err(error) => Some(error.to_string()),
        Ok(_) => (!used).then(|| {
            format!(
                "its outline lies {rms_px:.1} px from the sphere that the other photos agree on"
            )
        }),
    };
    ViewAgreement {
        photo,
        used,
        rms_px,
        bias_px,
        inlier_share,
        reason,
    }
}

/// The views that take part.
fn in_use<'a, 'b>(known: &'a [Known<'b>], used: &[bool]) -> Vec<&'a Known<'b>> {
    let views = known.iter().zip(used);
    views.filter_map(|(k, &used)| used.then_some(k)).collect()
}
