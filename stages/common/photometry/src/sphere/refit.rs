//! A located sphere once more, from the edges that all posed photos show where it predicts its outline.

use super::cone::SphereInCamera;
use super::known::PosedOutline;
use super::locate::{SphereFit, ViewAgreement, WorldScale, locate};
use super::mark::{OUTLINE_BIAS_PX, distance_px};
use super::posed_image::PosedImage;
use super::refine::{Effort, MIN_EDGE_SUPPORT, refine_outline};
use super::several::MAX_DEVIATIONS;
use rilievo_numerics::robust::median;
use rilievo_scene::{LocatedSphere, PhotoIdx};

/// Repeats the fit on the edges found near the outline that it predicts, in all photos. Keeps the
/// given fit where the edges do not support a better one.
pub fn refine_in_views(
    images: &[PosedImage],
    fit: SphereFit,
    radius: f64,
    scale: WorldScale,
    search_px: f64,
) -> SphereFit {
    let mut best = fit;
    for narrowing in [1.0, 0.7, 0.5] {
        let search_px = (search_px * narrowing).max(1.5);
        let outlines = edges_in_views(images, &best.sphere, search_px);
        match locate(&outlines, radius, scale) {
            // Marks that no edge follows stay in the list of views, unused.
            Ok(next) => best = with_missing(next, &best),
            Err(_) => break,
        }
    }
    best
}

/// A sphere located from masks in all its photos, or refined on the photos' edges, whichever outlines agree
/// better with one sphere.
///
/// A mask's outline is as good as its pixels, whereas a photo's edges follow sheen, shadows on the sphere
/// and the camera's sharpening. What one sphere explains cannot show is a mask that is too large or too
/// small everywhere: then the edges lie on one side of it in all photos alike, and count.
pub(super) fn refine_masks(
    images: &[PosedImage],
    masks: SphereFit,
    radius: f64,
    scale: WorldScale,
    search_px: f64,
) -> SphereFit {
    let mut offsets = Vec::new();
    for outline in edges_in_views(images, &masks.sphere, search_px) {
        let seen = SphereInCamera::seen(&masks.sphere, &outline.cam_from_world);
        let Some(cone) = seen.cone() else { continue };
        let distance = |point| {
            let ray = outline.intrinsics.ray(point).normalize();
            distance_px(&cone, &ray, &outline.intrinsics)
        };
        let mut distances: Vec<f64> = outline.outline.iter().map(distance).collect();
        offsets.extend(median(&mut distances));
    }
    let refined = refine_in_views(images, masks.clone(), radius, scale, search_px);
    let closer = agreement_px(&masks) < agreement_px(&refined);
    if closer && !is_displaced(&offsets) {
        with_found(masks, refined)
    } else {
        refined
    }
}

/// The fit to masks, with the photos without one in which the edges were found.
fn with_found(mut masks: SphereFit, edges: SphereFit) -> SphereFit {
    let without_mask = |photo: PhotoIdx| masks.views.iter().all(|view| view.photo != photo);
    let (seen, views) = (edges.sphere.seen_in, edges.views);
    let seen: Vec<_> = (seen.into_iter().filter(|(p, _)| without_mask(*p))).collect();
    let views: Vec<_> = (views.into_iter().filter(|v| without_mask(v.photo))).collect();
    masks.sphere.seen_in.extend(seen);
    masks.sphere.seen_in.sort_by_key(|(photo, _)| *photo);
    masks.views.extend(views);
    masks.views.sort_by_key(|view| view.photo);
    masks
}

/// Distance of the outlines from the common sphere, root mean square over the views in use.
fn agreement_px(fit: &SphereFit) -> f64 {
    let used = || fit.views.iter().filter(|view| view.used);
    let square: f64 = used().map(|view| view.rms_px.powi(2)).sum();
    (square / used().count().max(1) as f64).sqrt()
}

/// Whether offsets, one a photo, have a mean that neither their scatter explains nor the bias that any edge has.
fn is_displaced(offsets: &[f64]) -> bool {
    let num = offsets.len() as f64;
    let mean = offsets.iter().sum::<f64>() / num;
    let square = offsets.iter().map(|o| (o - mean).powi(2)).sum::<f64>();
    let variance = square / (num - 1.0) / num;
    mean.abs() > MAX_DEVIATIONS * (variance + OUTLINE_BIAS_PX.powi(2)).sqrt()
}

/// Outlines that the images show near a predicted sphere, where enough of an outline is seen.
fn edges_in_views(
    images: &[PosedImage],
    sphere: &LocatedSphere,
    search_px: f64,
) -> Vec<PosedOutline> {
    images
        .iter()
        .filter_map(|view| {
            let predicted = view.sphere(sphere);
            let found = refine_outline(&view.as_photo(), &predicted, search_px, Effort::Thorough);
            // A quarter of the outline still fixes the ellipse's centre across that arc.
            let enough = found.visible_share() > 0.25 && found.support() > MIN_EDGE_SUPPORT;
            enough.then_some(PosedOutline {
                photo: view.photo,
                intrinsics: view.intrinsics,
                cam_from_world: view.cam_from_world,
                outline: found.points,
            })
        })
        .collect()
}

fn with_missing(mut next: SphereFit, before: &SphereFit) -> SphereFit {
    let missing: Vec<ViewAgreement> =
        before
            .views
            .iter()
            .filter(|old| next.views.iter().all(|new| new.photo != old.photo))
            .map(|old| ViewAgreement {
                used: false,
                reason: Some(old.reason.clone().unwrap_or_else(|| {
                    "no edge follows the marked outline in this photo".to_owned()
                })),
                ..old.clone()
            })
            .collect();
    next.views.extend(missing);
    next.views.sort_by_key(|view| view.photo);
    next
}
