//! Poses despite intrinsics that are not quite right.
//!
//! Given intrinsics stay as they are, to the bit. But a lens that was "corrected" often keeps a
//! little distortion, and with a narrow field of view poses bend to explain it: rotation and
//! distance almost cancel each other there, so that a pixel at the corners moves the centres by
//! many times their standard deviation. So radial distortion is a nuisance parameter:
//!
//! `min over P, X, k₁ of Σ ρ(|π(c, k₁, P, X) − x| / σ) + ½ (k₁ / σ_k)²`
//!
//! gives the poses `P`, `k₁` is dropped, and the points are adjusted to these poses under the given
//! intrinsics. Only where the observations show it clearly: with exact intrinsics the parameter is
//! worth nothing, and poses that were found without it are more exact.
//!
//! A focal length that is wrong altogether (another lens, a zoom, photos resized after the
//! calibration) leaves good residuals too, and bends depth by per cents. It is reported where the
//! same minimum with the focal length free as well is clearly lower and lies elsewhere. Poses then
//! stay as they are: a distortion would explain part of the wrong length. Of several cameras the
//! middle change counts, since single ones may be free to drift.

use crate::adjustment::BundleOptions;
use crate::error::PosesError;
use crate::incremental::{MIN_NUM_VIEWS_FOR_DISTORTION, Reconstruction};
use crate::matched::{CameraPrior, MatchedPhotos};
use crate::model::{AdjustmentScope, IntrinsicsScope, Model};
use crate::options::{PosesOptions, RefineIntrinsics};
use crate::projection::{FOCAL, K1};
use crate::report::{AdjustmentReport, ContradictedFocal, LensReport};
use rilievo_numerics::robust::median;

/// Least change of a given focal length that is reported: a calibration at another focus is off by
/// about as much.
const MIN_FOCAL_CHANGE: f64 = 0.03;
/// Least relative drop of the cost: below it, distortion is less than what patches and noise do.
const MIN_COST_DROP: f64 = 0.03;
/// Least drop of the squared residuals over their variance. One parameter lowers it by 1 on average
/// when observations are independent; neighbouring ones are not, so ask for five deviations.
pub(crate) const MIN_CHI_SQUARE_DROP: f64 = 25.0;

/// Moves the poses to where they are with radial distortion free, when given intrinsics clearly
/// leave some, and finds focal lengths that the photos contradict.
pub(crate) fn check_given_intrinsics(
    matched: &MatchedPhotos<'_>,
    reconstruction: &mut Reconstruction,
    options: &PosesOptions,
) -> Result<(), PosesError> {
    let model = &mut reconstruction.model;
    let fixed = |c: &CameraPrior| c.prior_sigma.iter().all(Option::is_none);
    // The last adjustment of all poses has the intrinsics as given.
    let Some(before) = reconstruction.adjustments.last().filter(|_| {
        options.refine_intrinsics == RefineIntrinsics::Auto
            && model.num_views() >= MIN_NUM_VIEWS_FOR_DISTORTION
            && matched.cameras.iter().all(fixed)
    }) else {
        return Ok(());
    };
    let bundle_options = BundleOptions::complete(1e-8);
    let mut bent = model.clone();
    let step = "radial distortion as a nuisance";
    let scope = AdjustmentScope::all(step, IntrinsicsScope::Nuisance);
    let after = bent.adjust(matched, &scope, &bundle_options)?;
    let mut free = bent.clone();
    let step = "radial distortion and focal length as nuisances";
    let scope = AdjustmentScope::all(step, IntrinsicsScope::NuisanceAndFocal);
    // The model stands without what this looks for.
    if let Ok(with_focal) = free.adjust(matched, &scope, &bundle_options)
        && clear_drop(&after, &with_focal).is_some()
    {
        reconstruction.contradicted_focal = contradicted_focal(matched, &free);
    }
    let Some(cost_drop) = clear_drop(before, &after) else {
        return Ok(());
    };
    if reconstruction.contradicted_focal.is_some() {
        return Ok(());
    }
    reconstruction.lens = Some(LensReport {
        k1: bent.cameras.iter().map(|c| c.deviation[K1]).collect(),
        largest_px: largest_shift_px(matched, &bent),
        cost_drop,
    });
    model.poses = bent.poses;
    model.points = bent.points;
    let scope = AdjustmentScope::points("points, intrinsics as given");
    let settled = model.adjust(matched, &scope, &bundle_options)?;
    reconstruction.adjustments.extend([after, settled]);
    Ok(())
}

/// Largest displacement by `k₁` at an observation, pixels.
fn largest_shift_px(matched: &MatchedPhotos<'_>, bent: &Model) -> f64 {
    let mut largest_px = 0.0_f64;
    for track in 0..bent.points.len() {
        for (place, pixel, _) in bent.observations(matched, track) {
            let camera = matched.camera_of[matched.tracks[track][place].photo];
            let intrinsics = &matched.cameras[camera].initial;
            let radius = intrinsics.ray(&pixel).xy().norm();
            let k1 = bent.cameras[camera].deviation[K1];
            largest_px = largest_px.max((k1 * radius.powi(3) * intrinsics.focal_px()).abs());
        }
    }
    largest_px
}

/// Share by which the cost falls, where it clearly does.
pub(crate) fn clear_drop(before: &AdjustmentReport, after: &AdjustmentReport) -> Option<f64> {
    let cost = before.solve.final_cost;
    let drop = (cost - after.solve.final_cost) / cost.max(f64::MIN_POSITIVE);
    let is_clear = drop >= MIN_COST_DROP && chi_square_drop(before, after) >= MIN_CHI_SQUARE_DROP;
    is_clear.then_some(drop)
}

/// By how much the squared residuals over their variance fall.
pub(crate) fn chi_square_drop(before: &AdjustmentReport, after: &AdjustmentReport) -> f64 {
    let (cost, cost_after) = (before.solve.final_cost, after.solve.final_cost);
    let parameters = 3 * before.num_points + 6 * before.num_views;
    let degrees = (2 * before.num_observations).saturating_sub(parameters);
    (cost - cost_after) / (cost_after / degrees.max(1) as f64)
}

/// The focal length, where a model that was free to choose it has another one.
fn contradicted_focal(matched: &MatchedPhotos<'_>, free: &Model) -> Option<ContradictedFocal> {
    let posed = (0..matched.num_photos()).filter(|&photo| free.poses[photo].is_some());
    let photo = posed.clone().next()?;
    let mut used: Vec<usize> = posed.map(|photo| matched.camera_of[photo]).collect();
    used.sort_unstable();
    used.dedup();
    let changes = used.iter().map(|&c| free.cameras[c].deviation[FOCAL]);
    let change = median(&mut changes.collect::<Vec<f64>>())?.exp();
    let given_px = matched.cameras[matched.camera_of[photo]].initial.focal_px();
    ((change - 1.0).abs() > MIN_FOCAL_CHANGE).then(|| ContradictedFocal {
        file_name: matched.photos.photos[photo].file_name.clone(),
        given_px,
        found_px: given_px * change,
    })
}
