//! Finding spheres without marks.
//!
//! # Steps
//! 1. In each photo: edges, circle votes, and candidates whose outline and shading a sphere
//!    explains.
//! 2. Between posed photos: every pair of candidates proposes a centre and a radius in the world;
//!    the proposal that the candidates of most photos agree with is the sphere. Things that look
//!    round in one photo do not stay a sphere of one size in one place.
//! 3. The fit of [`super::locate`], refined on the edges of all photos; then support and shading
//!    are checked once more where the common sphere is predicted.
//! 4. The same with the candidates that are left, as long as a further sphere is confirmed. Further
//!    ones of the first one's size have the stated radius too; others are reported and left.
//!
//! A single photo is searched by step 1 alone, with a stricter threshold.

mod edges;
mod verify;
mod votes;

use super::around::load_around;
use super::cone::{OutlineCone, SphereInCamera};
use super::consensus::crossing;
use super::error::SphereError;
use super::known::PosedOutline;
use super::locate::{SphereFit, WorldScale, locate};
use super::options::SphereOptions;
use super::posed_image::{Photo, PosedImage};
use super::refine::{Effort, refine_outline};
use super::refit::refine_in_views;
use super::several::overlap;
use super::shading::shading;
use nalgebra::Point3;
use rilievo_scene::loading::map_few_at_once;
use rilievo_scene::{Intrinsics, LinearImage, LocatedSphere, PhotoSet, PosedView};
use verify::Candidate;

/// Circles that are looked at more closely per photo.
const MAX_CIRCLES: usize = 40;
/// Smallest and largest radius of an outline, as shares of the photo's longer side.
const RADIUS_SHARES: [f64; 2] = [0.015, 0.25];
/// Candidates kept per photo.
const MAX_CANDIDATES: usize = 8;

fn candidates(photo: &Photo, options: &SphereOptions) -> Vec<Candidate> {
    let edges = edges::find_edges(photo.image);
    let longer = photo.image.width.max(photo.image.height) as f64;
    let range = [RADIUS_SHARES[0] * longer, RADIUS_SHARES[1] * longer];
    let mut found: Vec<Candidate> = votes::circles(&edges, range, MAX_CIRCLES)
        .iter()
        .filter_map(|circle| verify::verify(photo, circle))
        .filter(|candidate| {
            candidate
                .shading
                .is_sphere(2.0 * options.max_shading_residual)
        })
        .collect();
    found.sort_by(|a, b| b.score(options).total_cmp(&a.score(options)));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in found {
        let known = kept.iter().any(|other| {
            other.cone.axis.dot(&candidate.cone.axis) > (0.1 * other.cone.half_angle).cos()
        });
        if !known && kept.len() < MAX_CANDIDATES {
            kept.push(candidate);
        }
    }
    kept
}

/// Whether outline and shading together leave no doubt: an edge nearly all around with shading that
/// a sphere explains well, or a broken edge (ground of the sphere's brightness) with shading that
/// it explains almost entirely. Measured: spheres reach 0.97 and 0.995; round stonework, the best
/// of what was taken for one, 0.82 and 0.965.
fn is_convincing(support: f64, explained: f64) -> bool {
    (support >= 0.9 && explained >= 0.9) || explained >= 0.985
}

/// Score of a candidate that one photo alone is believed.
const SINGLE_PHOTO_SCORE: f64 = 0.55;

/// Finds the sphere in one photo (a calibration photo, or photos without poses).
///
/// # Errors
/// [`SphereError::NotFound`].
pub fn detect_in_photo(
    image: &LinearImage,
    intrinsics: &Intrinsics,
    clip_level: f32,
) -> Result<OutlineCone, SphereError> {
    let photo = Photo {
        image,
        intrinsics,
        object: None,
        clip_level,
    };
    let options = &SphereOptions::default();
    match candidates(&photo, options).first() {
        Some(best)
            if best.score(options) >= SINGLE_PHOTO_SCORE
                && is_convincing(best.support, best.shading.explained) =>
        {
            Ok(best.cone)
        }
        Some(best) => Err(SphereError::NotFound {
            why: format!(
                "the best candidate has {:.0} % of its outline on an edge and leaves {:.1} % of \
                 its shading unexplained; mark the sphere by hand",
                100.0 * best.support,
                100.0 * best.shading.residual
            ),
        }),
        None => Err(SphereError::NotFound {
            why: "no round outline with the shading of a sphere; mark it by hand".to_owned(),
        }),
    }
}

/// Spheres that a search found.
#[derive(Clone, Debug, Default)]
pub struct Detected {
    /// Those of the stated radius, the best first.
    pub fits: Vec<SphereFit>,
    /// Radii of further spheres, over that of the first.
    pub other_sizes: Vec<f64>,
}

/// More matte balls than this are no reference spheres.
const MAX_SPHERES: usize = 6;
/// Proposals beside a confirmed sphere that may fail before the search ends.
const MAX_REFUSED: usize = 3;
/// Balls sold as of one size differ by less.
const SAME_SIZE: f64 = 0.03;

/// Finds all spheres of a radius in posed photos.
///
/// `radius` in metres; in a metric world a sphere must have it to 10 %, elsewhere the best one is
/// taken as having it. Whole photos are in memory while candidates are sought, `at_once` of them.
///
/// # Errors
/// [`SphereError::NotFound`], [`SphereError::Pixels`], and those of [`locate`].
pub fn detect(
    photos: &PhotoSet,
    views: &[PosedView],
    radius: f64,
    scale: WorldScale,
    options: &SphereOptions,
    at_once: usize,
) -> Result<Detected, SphereError> {
    let mut found: Vec<Vec<Candidate>> = map_few_at_once(views, at_once, |view| {
        let image = PosedImage::load(photos, view)?;
        Ok::<_, SphereError>(candidates(&image.as_photo(), options))
    })?;
    let num_with = found.iter().filter(|list| !list.is_empty()).count();
    let mut known: Vec<SphereFit> = Vec::new();
    let mut detected = Detected::default();
    let mut num_refused = 0;
    while known.len() < MAX_SPHERES && num_refused < MAX_REFUSED {
        let search = Search {
            views,
            found: &found,
            known: &known,
            options,
        };
        let Some((_, agreeing)) = search.best_proposal(radius, scale) else {
            break;
        };
        let outlines: Vec<PosedOutline> = agreeing
            .iter()
            .map(|&(view, k)| PosedOutline::of(&views[view], found[view][k].outline.clone()))
            .collect();
        match confirmed(photos, views, &outlines, radius, scale, options) {
            Ok(fit) if known.iter().all(|k| !overlap(&k.sphere, &fit.sphere)) => known.push(fit),
            Err(error @ SphereError::Pixels(_)) => return Err(error),
            // What is no sphere leaves room for the next best, once there is one to lean on.
            Err(error) if known.is_empty() => return Err(error),
            _ => num_refused += 1,
        }
        for (view, candidate) in agreeing {
            found[view][candidate].is_spent = true;
        }
    }
    for fit in known {
        let size = detected.fits.first().map_or(1.0, |first: &SphereFit| {
            match (&first.scale, &fit.scale) {
                (Some(first), Some(own)) => first.metres_per_unit / own.metres_per_unit,
                _ => 1.0,
            }
        });
        if size.ln().abs() < SAME_SIZE {
            detected.fits.push(fit);
        } else {
            detected.other_sizes.push(size);
        }
    }
    if detected.fits.is_empty() {
        return Err(SphereError::NotFound {
            why: format!(
                "{num_with} of {} photos have a round outline with the shading of a sphere, but no \
                 two of them agree on one place and size; mark it in two photos",
                views.len()
            ),
        });
    }
    if detected.fits.len() > 1 {
        for (k, fit) in detected.fits.iter_mut().enumerate() {
            fit.sphere.name = format!("sphere {}", k + 1);
        }
    }
    Ok(detected)
}

/// The fit on the outlines of candidates that agree, refined and confirmed.
fn confirmed(
    photos: &PhotoSet,
    views: &[PosedView],
    outlines: &[PosedOutline],
    radius: f64,
    scale: WorldScale,
    options: &SphereOptions,
) -> Result<SphereFit, SphereError> {
    let first = locate(outlines, radius, scale)?;
    let around = load_around(
        photos,
        views,
        std::slice::from_ref(&first),
        options.search_px,
    )?;
    let images: Vec<PosedImage> = around.into_iter().flatten().collect();
    let fit = refine_in_views(&images, first, radius, scale, options.search_px);
    confirm(&images, views.len(), fit, options)
}

/// A proposal in the world, with the `(view, candidate)` pairs that agree with it.
type Proposal = ((Point3<f64>, f64), Vec<(usize, usize)>);

/// Deviation of centre and radius, in radii, within which a candidate agrees with a proposal.
const AGREEMENT: f64 = 0.12;

/// What proposals are made from.
struct Search<'a> {
    views: &'a [PosedView],
    found: &'a [Vec<Candidate>],
    /// Spheres that stand already.
    known: &'a [SphereFit],
    options: &'a SphereOptions,
}

impl Search<'_> {
    fn left(&self, view: usize) -> impl Iterator<Item = &Candidate> {
        self.found[view].iter().filter(|c| !c.is_spent)
    }

    fn best_proposal(&self, radius: f64, scale: WorldScale) -> Option<Proposal> {
        let views = self.views;
        let mut best: Option<(f64, Proposal)> = None;
        for first in 0..views.len() {
            for second in first + 1..views.len() {
                for a in self.left(first) {
                    for b in self.left(second) {
                        let Some(sphere) = pair(&views[first], a, &views[second], b) else {
                            continue;
                        };
                        let fits =
                            scale == WorldScale::Free || (sphere.1 / radius - 1.0).abs() <= 0.1;
                        if !fits || self.is_known(&sphere) {
                            continue;
                        }
                        let agreeing = self.agreeing_candidates(&sphere);
                        let score: f64 = agreeing
                            .iter()
                            .map(|&(view, k)| self.found[view][k].score(self.options))
                            .sum();
                        if agreeing.len() >= 2 && best.as_ref().is_none_or(|(s, _)| score > *s) {
                            best = Some((score, (sphere, agreeing)));
                        }
                    }
                }
            }
        }
        best.map(|(_, proposal)| proposal)
    }

    fn is_known(&self, (center, radius): &(Point3<f64>, f64)) -> bool {
        let proposed = LocatedSphere {
            name: String::new(),
            center_in_world: center.coords.into(),
            radius: *radius,
            center_sigma: [0.0; 3],
            seen_in: Vec::new(),
        };
        self.known.iter().any(|fit| overlap(&fit.sphere, &proposed))
    }

    fn agreeing_candidates(&self, sphere: &(Point3<f64>, f64)) -> Vec<(usize, usize)> {
        let mut agreeing = Vec::new();
        for (view, posed) in self.views.iter().enumerate() {
            let in_camera = SphereInCamera {
                center: posed.cam_from_world.apply(&sphere.0),
                radius: sphere.1,
            };
            let Some(cone) = in_camera.cone() else {
                continue;
            };
            let best = self.found[view]
                .iter()
                .enumerate()
                .filter(|(_, candidate)| {
                    let off = candidate.cone.axis.angle(&cone.axis) / cone.half_angle;
                    let larger = (candidate.cone.half_angle / cone.half_angle - 1.0).abs();
                    !candidate.is_spent && off < AGREEMENT && larger < AGREEMENT
                })
                .max_by(|a, b| a.1.score(self.options).total_cmp(&b.1.score(self.options)));
            agreeing.extend(best.map(|(k, _)| (view, k)));
        }
        agreeing
    }
}

/// Nearest point of two candidates' axes and the radius there; `None` where they disagree.
fn pair(
    view_a: &PosedView,
    a: &Candidate,
    view_b: &PosedView,
    b: &Candidate,
) -> Option<(Point3<f64>, f64)> {
    let poses = [&view_a.cam_from_world, &view_b.cam_from_world];
    let found = crossing(poses, [&a.cone, &b.cone])?;
    let radius = 0.5 * (found.radii[0] + found.radii[1]);
    let in_front = poses
        .iter()
        .all(|pose| pose.apply(&found.center).z > radius);
    // Below two degrees the depth of the crossing is guesswork.
    (found.sine >= 0.035
        && in_front
        && found.gap < 2.0 * AGREEMENT * radius
        && (found.radii[0] / found.radii[1] - 1.0).abs() < 2.0 * AGREEMENT)
        .then_some((found.center, radius))
}

/// Half width of the last look at the outline, pixels.
const CONFIRM_PX: f64 = 2.0;

/// The common sphere must be seen where it is predicted, and shaded as a sphere, in most of the
/// photos that should show it. `images` are the parts around it of those `num_views` that may show it.
fn confirm(
    images: &[PosedImage],
    num_views: usize,
    fit: SphereFit,
    options: &SphereOptions,
) -> Result<SphereFit, SphereError> {
    let mut residuals: Vec<f64> = Vec::new();
    let (mut supports, mut explained) = (Vec::new(), Vec::new());
    let mut num_unlike = 0;
    let mut num_expected = 0_usize;
    for view in images {
        let in_camera = view.sphere(&fit.sphere);
        let Some(cone) = in_camera.cone() else {
            continue;
        };
        let inside = view.intrinsics.project(&in_camera.center).is_some_and(|p| {
            let (x, y) = (p.x.round() as isize, p.y.round() as isize);
            let camera = &view.intrinsics;
            (0..camera.width as isize).contains(&x)
                && (0..camera.height as isize).contains(&y)
                && !view.as_photo().is_object(x, y)
        });
        num_expected += usize::from(inside);
        let mut seen_in = fit.sphere.seen_in.iter();
        if seen_in.any(|(photo, _)| *photo == view.photo) {
            let photo = view.as_photo();
            let found = shading(&photo, &cone);
            residuals.extend(found.map(|s| s.residual));
            explained.extend(found.map(|s| s.explained));
            let outline = refine_outline(&photo, &in_camera, CONFIRM_PX, Effort::Thorough);
            supports.push(outline.support());
            // Too few unclipped pixels say nothing; a photo that contradicts counts against it.
            if found.is_some_and(|s| !s.is_sphere(2.0 * options.max_shading_residual)) {
                num_unlike += 1;
            }
        }
    }
    let num_seen = fit.sphere.seen_in.len();
    let residual = rilievo_numerics::robust::quantile(&mut residuals, 0.5).unwrap_or(f64::INFINITY);
    let support = rilievo_numerics::robust::quantile(&mut supports, 0.5).unwrap_or(0.0);
    let share = rilievo_numerics::robust::quantile(&mut explained, 0.5).unwrap_or(0.0);
    let num_alike = num_seen - num_unlike.min(num_seen);
    // Two photos agree by chance now and then, three hardly ever.
    let at_least: usize = if num_views < 4 { 2 } else { 3 };
    let needed = at_least.max((2 * num_expected).div_ceil(3));
    let is_sphere = is_convincing(support, share) && residual <= options.max_shading_residual;
    if num_alike < needed || !is_sphere {
        return Err(SphereError::NotFound {
            why: format!(
                "the best candidate looks like a sphere in {num_alike} photos ({needed} needed), \
                 has {:.0} % of its outline on an edge, and leaves {:.1} % of its shading \
                 unexplained; mark it in two photos",
                100.0 * support,
                100.0 * residual
            ),
        });
    }
    Ok(fit)
}
