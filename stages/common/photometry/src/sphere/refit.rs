//! A located sphere once more, from the edges that all posed photos show where it predicts its outline.

use super::known::PosedOutline;
use super::locate::{SphereFit, ViewAgreement, WorldScale, locate};
use super::posed_image::PosedImage;
use super::refine::{Effort, MIN_EDGE_SUPPORT, refine_outline};
use rilievo_scene::LocatedSphere;

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
