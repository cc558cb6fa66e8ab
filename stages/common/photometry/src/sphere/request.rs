//! From what the user said of the spheres to the spheres in the world.
//!
//! # Steps
//! 1. Marks locate each ([`super::locate`]); without marks they are searched for
//!    ([`super::detect`]), or taken from a stated centre.
//! 2. The outline that the common sphere predicts in *every* posed photo is looked for on the
//!    image, so that marks in two photos suffice for all, and the fit is repeated on these edge
//!    points, with a narrower search each time. Masks stay where they agree better with one sphere.
//! 3. All together give the world's scale ([`super::common_scale`]).

use super::around::load_around;
use super::cone::SphereInCamera;
use super::confirm::confirm;
use super::detect::detect;
use super::error::SphereError;
use super::known::PosedOutline;
use super::locate::{SphereFit, WorldScale, locate};
use super::mark::outline_of_mark;
use super::options::SphereOptions;
use super::refit::{refine_in_views, refine_masks};
use super::several::{CommonScale, common_scale, without_doubles};
use rayon::prelude::*;
use rilievo_scene::{
    LocatedSphere, MarkedSphere, PhotoIdx, PhotoSet, PosedView, SphereMark, SphereRequest,
};

/// The spheres of a request.
#[derive(Clone, Debug, Default)]
pub struct LocatedSpheres {
    /// Those that were located, each by itself; at least one.
    pub fits: Vec<SphereFit>,
    /// Those that were not, by name, and why.
    pub missing: Vec<(String, SphereError)>,
    /// Radii over the stated one of further spheres that a search found and left.
    pub other_sizes: Vec<f64>,
    /// The world's scale from all of them.
    pub scale: CommonScale,
}

/// Locates the spheres that a request describes in posed views.
///
/// With [`WorldScale::Free`], multiply the world by `scale` of the result, where there is one, to
/// make it metric. A sphere that cannot be located does not hinder the others. A search has
/// `at_once` whole photos in memory at most.
///
/// # Errors
/// That of the first sphere where none can be located, [`SphereError::Pixels`];
/// [`SphereError::NoView`] when the request has no sphere.
pub fn locate_request(
    photos: &PhotoSet,
    views: &[PosedView],
    request: &SphereRequest,
    scale: WorldScale,
    options: &SphereOptions,
    at_once: usize,
) -> Result<LocatedSpheres, SphereError> {
    let mut located = LocatedSpheres::default();
    let mut radii = Vec::new();
    for sphere in &request.spheres {
        match locate_marked(views, sphere, scale) {
            Ok(fit) => {
                located.fits.push(fit);
                radii.push((sphere, sphere.radius));
            }
            Err(error) => located.missing.push((sphere.name.clone(), error)),
        }
    }
    let around = load_around(photos, views, &located.fits, options.search_px)?;
    // Robust fits of the brightness inside take most of the time; no sphere depends on another.
    let each = located.fits.par_iter_mut().zip(&around).zip(&radii);
    each.for_each(|((fit, images), (sphere, radius))| {
        let unused_marks = fit.unused_marks.clone();
        let marked = fit.views.iter().filter(|view| view.used);
        let marked: Vec<PhotoIdx> = marked.map(|view| view.photo).collect();
        let all_masks = (sphere.marks.iter()).all(|(_, mark)| matches!(mark, SphereMark::Mask(_)));
        let refine = if all_masks {
            refine_masks
        } else {
            refine_in_views
        };
        let refined = refine(images, fit.clone(), *radius, scale, options.search_px);
        *fit = SphereFit {
            unused_marks,
            evidence: confirm(images, &marked, &refined.sphere, options.search_px),
            ..refined
        };
    });
    for (fit, (sphere, _)) in located.fits.iter_mut().zip(&radii) {
        fit.sphere.name.clone_from(&sphere.name);
    }
    if let Some(radius) = request.search_radius {
        let found = detect(photos, views, radius, scale, options, at_once)?;
        located.fits.extend(found.fits);
        located.other_sizes = found.other_sizes;
    }
    let doubles = without_doubles(&mut located.fits);
    located.missing.extend(doubles);
    if located.fits.is_empty() {
        let first = located.missing.into_iter().next();
        return Err(first.map_or(SphereError::NoView, |(_, error)| error));
    }
    located.scale = common_scale(&located.fits);
    Ok(located)
}

/// Locates one sphere from its marks or its stated centre.
fn locate_marked(
    views: &[PosedView],
    sphere: &MarkedSphere,
    scale: WorldScale,
) -> Result<SphereFit, SphereError> {
    let radius = sphere.radius;
    let outlines: Vec<PosedOutline> = sphere
        .marks
        .iter()
        .filter_map(|(photo, mark)| {
            let view = views.iter().find(|view| view.photo == *photo)?;
            Some(PosedOutline::of(view, outline_of_mark(mark)))
        })
        .collect();
    if outlines.is_empty() {
        let center = sphere.center_in_world.ok_or(SphereError::NoView)?;
        let fit = stated(center.coords.into(), radius);
        let in_sight = views.iter().any(|view| {
            let seen = SphereInCamera::seen(&fit.sphere, &view.cam_from_world);
            seen.is_in_frame(&view.intrinsics)
        });
        return if in_sight {
            Ok(fit)
        } else {
            Err(SphereError::OutOfSight {
                center: fit.sphere.center_in_world,
                radius,
                views: views.len(),
            })
        };
    }
    locate(&outlines, radius, scale)
}

fn stated(center_in_world: [f64; 3], radius: f64) -> SphereFit {
    SphereFit {
        sphere: LocatedSphere {
            name: MarkedSphere::ONLY.to_owned(),
            center_in_world,
            radius,
            center_sigma: [0.0; 3],
            seen_in: Vec::new(),
        },
        scale: None,
        views: Vec::new(),
        unused_marks: Vec::new(),
        evidence: Vec::new(),
    }
}
