//! Whether the spheres stand where a reference sphere can stand.
//!
//! In a world whose scale comes from the sphere a wrong radius only rescales everything; with given
//! poses it shows as a sphere far nearer or farther than the scene. Both are compared by distance
//! from the cameras that saw it (all, where its centre was stated): the sphere against the median of
//! the sparse points and anchors. Other cameras would measure their distance from those.

use nalgebra::Point3;
use rilievo_numerics::robust::median;
use rilievo_scene::{LocatedSphere, PosedViews};

/// Ratio of distances beyond which the sphere cannot stand beside the object.
const MAX_RATIO: f64 = 5.0;

/// Warnings of spheres that do not stand near the scene.
pub(crate) fn odd(posed: &PosedViews) -> impl Iterator<Item = String> {
    posed.spheres.iter().filter_map(|s| odd_sphere(posed, s))
}

fn odd_sphere(posed: &PosedViews, sphere: &LocatedSphere) -> Option<String> {
    let center = Point3::from(sphere.center_in_world);
    let mut ratios = Vec::new();
    let saw = |photo| sphere.seen_in.is_empty() || sphere.seen_in.iter().any(|(p, _)| *p == photo);
    for view in posed.views.iter().filter(|view| saw(view.photo)) {
        let to_sphere = view.cam_from_world.apply(&center).coords.norm();
        let points = posed.points.iter().map(|p| p.position);
        let anchors = posed.anchors.iter().map(|a| a.position);
        // A few hundred points determine the distance of the scene.
        let stride = ((posed.points.len() + posed.anchors.len()) / 500).max(1);
        let mut distances: Vec<f64> = points
            .chain(anchors)
            .step_by(stride)
            .map(|p| view.cam_from_world.apply(&Point3::from(p)).coords.norm())
            .collect();
        if let Some(scene) = median(&mut distances) {
            ratios.push(to_sphere / scene);
        }
    }
    let ratio = median(&mut ratios)?;
    (!(1.0 / MAX_RATIO..MAX_RATIO).contains(&ratio)).then(|| {
        format!(
            "{} would stand at {ratio:.2} times the distance of the scene: its radius ({:.4}) does \
             not fit the cameras' unit, or something else was taken for it",
            sphere.name, sphere.radius
        )
    })
}
