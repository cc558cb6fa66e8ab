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
//! A focal length that is wrong altogether (another lens, a zoom, photos resized after the calibration) leaves good residuals
//! too, and bends depth by per cents. It is told where the same minimum with the focal length free as well is
//! clearly lower and lies elsewhere. Poses then stay as they are: a distortion would explain part of the wrong length.
//! Of several cameras the middle change counts, since single ones may be free to drift.

use crate::adjustment::BundleOptions;
use crate::error::PosesError;
use crate::model::{AdjustmentScope, IntrinsicsScope, Model};
use crate::options::{PosesOptions, RefineIntrinsics};
use crate::projection::{FOCAL, K1};
use crate::report::{AdjustmentReport, ContradictedFocal, LensReport};
use crate::scene::Scene;
use rilievo_numerics::robust::median;

/// Views from which lens distortion is told from the shape of the scene.
pub const MIN_NUM_VIEWS_FOR_DISTORTION: usize = 4;
/// Least change of a given focal length that is told: a calibration at another focus is off by about as much.
const MIN_FOCAL_CHANGE: f64 = 0.03;
/// Least relative drop of the cost: below it, distortion is less than what patches and noise do.
const MIN_COST_DROP: f64 = 0.03;
/// Least drop of the squared residuals over their variance. One parameter lowers it by 1 on average
/// when observations are independent; neighbouring ones are not, so ask for five deviations.
const MIN_CHI_SQUARE_DROP: f64 = 25.0;

/// What the photos say of given intrinsics.
#[derive(Default)]
pub struct Findings {
    /// Distortion that they leave, and the adjustments that let the poses allow for it.
    pub distortion: Option<(LensReport, Vec<AdjustmentReport>)>,
    /// The given focal length, where the photos contradict it.
    pub contradicted_focal: Option<ContradictedFocal>,
}

/// Moves the poses to where they are with radial distortion free, when given intrinsics clearly
/// leave some, and tells focal lengths that the photos contradict.
///
/// `before`: the last adjustment of all poses with the intrinsics as given.
///
/// # Errors
/// When an adjustment breaks down.
pub fn check_given_intrinsics(
    scene: &Scene<'_>,
    model: &mut Model,
    before: &AdjustmentReport,
    bundle_options: &BundleOptions,
    options: &PosesOptions,
) -> Result<Findings, PosesError> {
    let fixed = |c: &crate::scene::SceneCamera| c.prior_sigma.iter().all(Option::is_none);
    if options.refine_intrinsics != RefineIntrinsics::Auto
        || model.num_views() < MIN_NUM_VIEWS_FOR_DISTORTION
        || !scene.cameras.iter().all(fixed)
    {
        return Ok(Findings::default());
    }
    let mut bent = model.clone();
    let mut scope = AdjustmentScope {
        step: "radial distortion as a nuisance",
        photos: None,
        intrinsics: IntrinsicsScope::Nuisance,
    };
    let after = bent.adjust(scene, &scope, bundle_options)?;
    let mut found = Findings::default();
    let mut free = bent.clone();
    scope.step = "radial distortion and focal length as nuisances";
    scope.intrinsics = IntrinsicsScope::NuisanceAndFocal;
    // The model stands without what this looks for.
    if let Ok(with_focal) = free.adjust(scene, &scope, bundle_options)
        && clear_drop(&after, &with_focal).is_some()
    {
        found.contradicted_focal = contradicted_focal(scene, &free);
    }
    let Some(drop) = clear_drop(before, &after).filter(|_| found.contradicted_focal.is_none())
    else {
        return Ok(found);
    };
    let k1: Vec<f64> = bent.cameras.iter().map(|c| c.deviation[K1]).collect();
    let mut largest_px = 0.0_f64;
    for (t, point) in bent.points.iter().enumerate() {
        if point.is_none() {
            continue;
        }
        for (place, pixel, _) in bent.observations(scene, t) {
            let camera = scene.camera_of[scene.tracks[t][place].photo];
            let intrinsics = &scene.cameras[camera].initial;
            let radius = intrinsics.ray(&pixel).xy().norm();
            let shift = (k1[camera] * radius.powi(3) * intrinsics.focal_px()).abs();
            largest_px = largest_px.max(shift);
        }
    }
    model.poses = bent.poses;
    model.points = bent.points;
    let points_only = AdjustmentScope {
        step: "points, intrinsics as given",
        photos: Some(&[]),
        intrinsics: IntrinsicsScope::Fixed,
    };
    let settled = model.adjust(scene, &points_only, bundle_options)?;
    let report = LensReport {
        k1,
        largest_px,
        cost_drop: drop,
    };
    found.distortion = Some((report, vec![after, settled]));
    Ok(found)
}

/// Share by which the cost falls, where it clearly does.
fn clear_drop(before: &AdjustmentReport, after: &AdjustmentReport) -> Option<f64> {
    let (cost, cost_after) = (before.solve.final_cost, after.solve.final_cost);
    let parameters = 3 * before.num_points + 6 * before.num_views;
    let degrees = (2 * before.num_observations).saturating_sub(parameters);
    let drop = (cost - cost_after) / cost.max(f64::MIN_POSITIVE);
    let chi_square_drop = (cost - cost_after) / (cost_after / degrees.max(1) as f64);
    (drop >= MIN_COST_DROP && chi_square_drop >= MIN_CHI_SQUARE_DROP).then_some(drop)
}

/// The focal length, where a model that was free to choose it has another one.
fn contradicted_focal(scene: &Scene<'_>, free: &Model) -> Option<ContradictedFocal> {
    let posed = (0..scene.num_photos()).filter(|&photo| free.poses[photo].is_some());
    let photo = posed.clone().next()?;
    let mut used: Vec<usize> = posed.map(|photo| scene.camera_of[photo]).collect();
    used.sort_unstable();
    used.dedup();
    let changes = used.iter().map(|&c| free.cameras[c].deviation[FOCAL]);
    let change = median(&mut changes.collect::<Vec<f64>>())?.exp();
    let given_px = scene.cameras[scene.camera_of[photo]].initial.focal_px();
    ((change - 1.0).abs() > MIN_FOCAL_CHANGE).then(|| ContradictedFocal {
        file_name: scene.photos.photos[photo].file_name.clone(),
        given_px,
        found_px: given_px * change,
    })
}
