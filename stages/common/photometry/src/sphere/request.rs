//! From what the user said of the spheres to the spheres in the world.
//!
//! # Steps
//! 1. Marks locate each ([`super::locate`]); without marks they are searched for
//!    ([`super::detect`]), or taken from a stated centre.
//! 2. The outline that the common sphere predicts in *every* posed photo is looked for on the
//!    image, so that marks in two photos suffice for all, and the fit is repeated on these edge
//!    points, with a narrower search each time.
//! 3. All together give the world's scale ([`super::common_scale`]).

use super::around::load_around;
use super::cone::SphereInCamera;
use super::confirm::confirm;
use super::error::SphereError;
use super::locate::{PosedOutline, SphereFit, ViewAgreement, WorldScale, locate};
use super::mark::outline_of_mark;
use super::options::SphereOptions;
use super::refine::{Effort, refine_outline};
use super::several::{CommonScale, common_scale, without_doubles};
use rayon::prelude::*;
use rilievo_scene::{
    Intrinsics, LinearImage, LocatedSphere, MarkedSphere, Mask, PhotoIdx, PhotoSet, PosedView,
    RigidTransform, SphereRequest,
};
use std::sync::Arc;

/// A posed photo with its pixels.
#[derive(Clone, Debug)]
pub struct PosedImage {
    /// The photo.
    pub photo: PhotoIdx,
    /// Linear pixels.
    pub image: Arc<LinearImage>,
    /// Camera.
    pub intrinsics: Intrinsics,
    /// Pose, in the world's unit.
    pub cam_from_world: RigidTransform,
    /// Object mask: no outline is looked for on it.
    pub object: Option<Arc<Mask>>,
    /// Linear value from which a channel counts as clipped.
    pub clip_level: f32,
}

impl PosedImage {
    /// The sphere in this camera's frame.
    pub fn sphere(&self, located: &LocatedSphere) -> SphereInCamera {
        SphereInCamera::seen(located, &self.cam_from_world)
    }
}

/// The whole photos of posed views.
///
/// # Errors
/// [`SphereError::Pixels`].
pub fn load_posed_images(
    photos: &PhotoSet,
    views: &[PosedView],
) -> Result<Vec<PosedImage>, SphereError> {
    views
        .iter()
        .map(|view| {
            let photo = &photos.photos[view.photo.0];
            Ok(PosedImage {
                photo: view.photo,
                image: photo.linear()?,
                intrinsics: view.intrinsics,
                cam_from_world: view.cam_from_world,
                object: photo.mask.clone(),
                clip_level: photo.clip_level,
            })
        })
        .collect()
}

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
/// make it metric. A sphere that cannot be located does not hinder the others.
///
/// # Errors
/// That of the first sphere where none can be located, [`SphereError::Pixels`]; [`SphereError::NoView`] when the request has no sphere.
pub fn locate_request(
    photos: &PhotoSet,
    views: &[PosedView],
    request: &SphereRequest,
    scale: WorldScale,
    options: &SphereOptions,
) -> Result<LocatedSpheres, SphereError> {
    options.validate()?;
    let mut located = LocatedSpheres::default();
    let mut radii = Vec::new();
    for sphere in &request.spheres {
        match locate_marked(views, sphere, scale, options) {
            Ok(fit) => {
                located.fits.push(fit);
                radii.push((&sphere.name, sphere.radius));
            }
            Err(error) => located.missing.push((sphere.name.clone(), error)),
        }
    }
    if options.refine {
        let around = load_around(photos, views, &located.fits, options.search_px)?;
        // Robust fits of the brightness inside take most of the time; no sphere depends on another.
        let each = located.fits.par_iter_mut().zip(&around).zip(&radii);
        each.for_each(|((fit, images), (_, radius))| {
            let unused_marks = fit.unused_marks.clone();
            let marked = fit.views.iter().filter(|view| view.used);
            let marked: Vec<PhotoIdx> = marked.map(|view| view.photo).collect();
            let refined = refine_in_views(images, fit.clone(), *radius, scale, options);
            *fit = SphereFit {
                unused_marks,
                evidence: confirm(images, &marked, &refined.sphere, options),
                ..refined
            };
        });
    }
    for (fit, (name, _)) in located.fits.iter_mut().zip(&radii) {
        fit.sphere.name.clone_from(name);
    }
    if let Some(radius) = request.search_radius {
        let images = load_posed_images(photos, views)?;
        let found = super::detect(&images, radius, scale, options)?;
        located.fits.extend(found.fits);
        located.other_sizes = found.other_sizes;
    }
    let doubles = without_doubles(&mut located.fits);
    located.missing.extend(doubles);
    if located.fits.is_empty() {
        let first = located.missing.into_iter().next();
        return Err(first.map_or(SphereError::NoView, |(_, error)| error));
    }
    located.scale = common_scale(&located.fits, options);
    Ok(located)
}

/// Locates one sphere from its marks or its stated centre.
fn locate_marked(
    views: &[PosedView],
    sphere: &MarkedSphere,
    scale: WorldScale,
    options: &SphereOptions,
) -> Result<SphereFit, SphereError> {
    let radius = sphere.radius;
    let outlines: Vec<PosedOutline> = sphere
        .marks
        .iter()
        .filter_map(|(photo, mark)| {
            let view = views.iter().find(|view| view.photo == *photo)?;
            Some(PosedOutline {
                photo: *photo,
                intrinsics: view.intrinsics,
                cam_from_world: view.cam_from_world,
                outline: outline_of_mark(mark),
            })
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
    locate(&outlines, radius, scale, options)
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

/// Repeats the fit on the edges found near the outline that it predicts, in all photos. Keeps the
/// given fit where the edges do not support a better one.
pub fn refine_in_views(
    images: &[PosedImage],
    fit: SphereFit,
    radius: f64,
    scale: WorldScale,
    options: &SphereOptions,
) -> SphereFit {
    let mut best = fit;
    for narrowing in [1.0, 0.7, 0.5] {
        let search_px = (options.search_px * narrowing).max(1.5);
        let outlines = edges_in_views(images, &best.sphere, search_px, options);
        match locate(&outlines, radius, scale, options) {
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
    options: &SphereOptions,
) -> Vec<PosedOutline> {
    images
        .iter()
        .filter_map(|view| {
            let found = refine_outline(
                &view.image,
                &view.intrinsics,
                &view.sphere(sphere),
                search_px,
                view.object.as_deref(),
                Effort::Thorough,
            );
            // A quarter of the outline still fixes the ellipse's centre across that arc.
            let enough = found.visible_share() > 0.25 && found.support() > options.min_edge_support;
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
