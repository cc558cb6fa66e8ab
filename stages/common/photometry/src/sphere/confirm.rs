//! Whether the marked photos show the sphere where it was located.
//!
//! Marks that are all too large, or that follow another thing, agree with each other all the same.
//! What only a sphere shows distinguishes it: an edge along the predicted outline, and brightness
//! inside it that nine harmonics of its normals explain.

use super::mark::{INLIER_PX, distance_px};
use super::posed_image::PosedImage;
use super::refine::{Effort, refine_outline};
use super::shading::shading;
use rilievo_scene::{LocatedSphere, PhotoIdx};
use serde::{Deserialize, Serialize};

/// What a marked photo shows of the located sphere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkEvidence {
    /// The photo.
    pub photo: PhotoIdx,
    /// Share of the visible outline that an edge of the photo follows within 1.5 px.
    pub edge_share: f64,
    /// Relative residual of nine harmonics inside the outline; `None` with too few unclipped
    /// pixels.
    pub shading_residual: Option<f64>,
}

/// Smallest part of an outline in which an edge is looked for.
const MIN_VISIBLE: f64 = 0.25;

/// Looks at the photos of `marked` around a located sphere. Photos in which the object, the frame
/// or another sphere hides it are left out.
pub(super) fn confirm(
    images: &[PosedImage],
    marked: &[PhotoIdx],
    located: &LocatedSphere,
    search_px: f64,
) -> Vec<MarkEvidence> {
    let seen = images.iter().filter(|image| marked.contains(&image.photo));
    let evidence = seen.filter_map(|view| {
        let sphere = view.sphere(located);
        let cone = sphere.cone()?;
        let photo = view.as_photo();
        let found = refine_outline(&photo, &sphere, search_px, Effort::Thorough);
        if found.visible_share() < MIN_VISIBLE {
            return None;
        }
        let on_outline = found.points.iter().filter(|point| {
            let ray = view.intrinsics.ray(point).normalize();
            distance_px(&cone, &ray, &view.intrinsics).abs() <= INLIER_PX
        });
        Some(MarkEvidence {
            photo: view.photo,
            edge_share: on_outline.count() as f64 / found.num_searched.max(1) as f64,
            shading_residual: shading(&photo, &cone).map(|found| found.residual),
        })
    });
    evidence.collect()
}
