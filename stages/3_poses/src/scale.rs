//! Unit of the world: metric from given poses, a known distance or reference spheres, else
//! arbitrary.
//!
//! A sphere of known radius `R` that measures `r` in the world's unit makes one unit `R/r` metres;
//! centres, points and the sphere are multiplied by that. Where given poses are metric already, the
//! sphere is only located.
//!
//! The spheres are located after the adjustment, not in it. Linearised over poses, points and sphere,
//! with the residuals' own 0.07 px and 0.1 px for the outline, two sets of eight photos and 7000
//! points give: in the adjustment, the sphere would lessen the standard deviation of a camera's place
//! by 0.6 % at most and move it by 0.11 of that, and the scale's would be 0.0560 instead of 0.0556 %
//! and 0.0495 instead of 0.0493 %. An outline that is biased by its own shadow then cannot bend the
//! poses. The stated deviation of a centre leaves out what the poses add to it (0.06 mm instead of
//! 0.08 mm there).

use crate::error::PosesError;
use crate::error::warn;
use crate::known_distance::KnownDistance;
use crate::options::PosesOptions;
use crate::report::PosesReport;
use nalgebra::{Point3, Vector3};
use rilievo_photometry::sphere::{
    LocatedSpheres, ScaleContradiction, ScaleOutcome, SphereError, SphereFit, SphereOptions,
    WorldScale, locate_request,
};
use rilievo_scene::loading::num_at_once;
use rilievo_scene::{
    MarkedSphere, Observer, PhotoIdx, PhotoSet, PosedViews, Scale, ScaleSource, SphereRequest,
    Unit, first_and_more,
};
use std::collections::BTreeSet;

/// Sets the scale and locates the spheres; what hinders a sphere becomes a warning.
///
/// # Errors
/// When a known distance cannot be found in the model, or the observer asked to stop.
pub(crate) fn apply(
    photos: &PhotoSet,
    sphere: Option<&SphereRequest>,
    has_given_poses: bool,
    options: &PosesOptions,
    posed: &mut PosedViews,
    report: &mut PosesReport,
    observer: &dyn Observer,
) -> Result<(), PosesError> {
    if has_given_poses {
        posed.scale = Scale {
            unit: options.given_world.unit,
            source: ScaleSource::GivenPoses,
            relative_sigma: None,
        };
        posed.offset = options.given_world.offset;
    }
    let metres_per_given = match &options.known_distance {
        Some(known) => by_distance(known, has_given_poses, posed, report, observer)?,
        None => 1.0,
    };
    // What a sphere's centre may be stated in.
    let given = has_given_poses.then_some(metres_per_given);
    if let Some(request) = sphere
        && (!request.spheres.is_empty() || request.search_radius.is_some())
    {
        let at_once = num_at_once(photos, options.memory);
        by_spheres(photos, request, given, at_once, posed, report, observer)?;
    }
    report.scale = posed.scale;
    report.offset = posed.coordinates().offset();
    Ok(())
}

/// Sets the scale from a known distance, or compares it with the one that there is; the new unit of the world over
/// the old one.
fn by_distance(
    known: &KnownDistance,
    has_given_poses: bool,
    posed: &mut PosedViews,
    report: &mut PosesReport,
    observer: &dyn Observer,
) -> Result<f64, PosesError> {
    let (metres_per_unit, relative_sigma) = known.metres_per_unit(posed, report)?;
    if posed.scale.unit == Unit::Metre {
        let apart = (metres_per_unit - 1.0).abs();
        if apart > (3.0 * relative_sigma).max(0.01) {
            let message = format!(
                "the known distance is {:.1} % of what the given cameras say; check it, or their unit",
                100.0 * metres_per_unit
            );
            warn(observer, message)?;
        }
        return Ok(1.0);
    }
    multiply(posed, report, metres_per_unit);
    posed.scale = Scale {
        unit: Unit::Metre,
        source: ScaleSource::KnownDistance,
        relative_sigma: Some(relative_sigma),
    };
    if has_given_poses {
        warn(
            observer,
            became_metric("the known distance", metres_per_unit),
        )?;
    }
    Ok(metres_per_unit)
}

/// Locates the spheres, which set the scale where nothing did. `given` is the world's unit over that of given
/// cameras.
fn by_spheres(
    photos: &PhotoSet,
    request: &SphereRequest,
    given: Option<f64>,
    at_once: usize,
    posed: &mut PosedViews,
    report: &mut PosesReport,
    observer: &dyn Observer,
) -> Result<(), PosesError> {
    let is_metric = posed.scale.unit == Unit::Metre;
    let world_scale = if is_metric {
        WorldScale::Metric
    } else {
        WorldScale::Free
    };
    let (placed, unplaced) = in_known_frame(request, given, is_metric);
    let found = locate_request(
        photos,
        &posed.views,
        &placed,
        world_scale,
        &SphereOptions::default(),
        at_once,
    );
    let found = match (found, unplaced.first()) {
        (Ok(mut located), _) => {
            located.missing.extend(unplaced);
            Ok(located)
        }
        // What was said of the sphere is more to the point than that nothing is left of it.
        (Err(SphereError::NoView), Some((_, why))) => Err(why.clone()),
        (Err(error), _) => Err(error),
    };
    match found {
        Ok(located) => {
            let mut warnings = warnings_of(photos, request, &located, is_metric);
            warnings.extend(centers_of(request, &located, given, posed));
            for message in warnings {
                warn(observer, message)?;
            }
            posed.spheres = located.fits.into_iter().map(|fit| fit.sphere).collect();
            // Centres that were merely stated say nothing of the scale.
            if let Some(estimate) = located.scale.estimate.filter(|_| !is_metric) {
                multiply(posed, report, estimate.metres_per_unit);
                let unit = match request.is_unitless {
                    true => Unit::Arbitrary,
                    false => Unit::Metre,
                };
                posed.scale = Scale {
                    unit,
                    source: ScaleSource::Sphere,
                    relative_sigma: Some(estimate.relative_sigma),
                };
                if given.is_some() && unit == Unit::Metre {
                    warn(
                        observer,
                        became_metric("the sphere", estimate.metres_per_unit),
                    )?;
                }
            }
        }
        Err(mut error) => {
            if let SphereError::OutOfSight { center, .. } = &mut error {
                *center = in_world(*center, posed).into();
            }
            let why = format!("{error}{}", of_photos(photos, &request.spheres, &error));
            let message = format!(
                "the reference sphere was not located, the scale stays {}: {why}",
                if is_metric { "as it is" } else { "arbitrary" },
            );
            warn(observer, message)?;
            // Whoever needs the sphere later ends for this reason.
            posed.no_sphere = Some(why);
        }
    }
    Ok(())
}

/// What to say of given cameras that got a unit.
fn became_metric(by: &str, metres_per_unit: f64) -> String {
    format!(
        "the given cameras have no unit of length: {by} makes one of theirs {metres_per_unit:.6} m, and all \
         results are in metres"
    )
}

/// A place of the world here in that of the given cameras.
fn in_world(place: [f64; 3], posed: &PosedViews) -> Point3<f64> {
    Point3::from(place) + Vector3::from(posed.offset)
}

/// The request without the spheres of which a centre alone is known, in a frame that is not the world's or
/// with a radius in another unit; and these. `given` is the world's unit over that of given cameras.
fn in_known_frame(
    request: &SphereRequest,
    given: Option<f64>,
    is_metric: bool,
) -> (SphereRequest, Vec<(String, SphereError)>) {
    let is_comparable = is_metric || request.is_unitless;
    let is_placed = |sphere: &MarkedSphere| {
        let is_usable = given.is_some() && is_comparable;
        is_usable || !sphere.marks.is_empty() || sphere.center_in_world.is_none()
    };
    let why = match given {
        Some(_) => SphereError::NoUnit,
        None => SphereError::NoFrame,
    };
    let (placed, frameless): (Vec<MarkedSphere>, Vec<MarkedSphere>) =
        request.spheres.iter().cloned().partition(is_placed);
    // Where the poses were found, a centre cannot stand in for marks either.
    let spheres = placed.into_iter().map(|sphere| MarkedSphere {
        center_in_world: (sphere.center_in_world.zip(given))
            .map(|(center, factor)| center * factor),
        ..sphere
    });
    let placed = SphereRequest {
        spheres: spheres.collect(),
        search_radius: request.search_radius,
        light: request.light,
        is_unitless: request.is_unitless,
        calibration: Vec::new(),
    };
    let frameless = frameless.into_iter();
    (placed, frameless.map(|s| (s.name, why.clone())).collect())
}

/// Share of the radius by which a stated centre may differ from that of the marks: the normals differ by
/// as many radians.
const MAX_CENTER_SHIFT: f64 = 0.1;

/// What the user should know of centres that were stated beside marks.
fn centers_of(
    request: &SphereRequest,
    located: &LocatedSpheres,
    given: Option<f64>,
    posed: &PosedViews,
) -> Vec<String> {
    let warnings = located.fits.iter().filter_map(|fit| {
        let sphere = request.spheres.iter().find(|s| s.name == fit.sphere.name)?;
        let stated = sphere.center_in_world.filter(|_| !fit.views.is_empty())?;
        let Some(factor) = given else {
            return Some(format!(
                "the stated centre of {} is not used: it stands in the frame of given cameras, but the \
                 poses were found from the photos; its marks are used",
                sphere.name
            ));
        };
        let stated = stated * factor;
        let found = fit.sphere.center_in_world;
        let shift = (stated - Point3::from(found)).norm();
        let unit = posed.scale.unit.words();
        let (stated, found) = (in_world(stated.into(), posed), in_world(found, posed));
        (shift > MAX_CENTER_SHIFT * fit.sphere.radius).then(|| {
            format!(
                "the stated centre of {} ({:.4}, {:.4}, {:.4}) lies {shift:.4} {unit} from where its outlines \
                 put it ({:.4}, {:.4}, {:.4}), {:.1} times its radius: the outlines are used; check the \
                 centre, its frame and its unit",
                sphere.name,
                stated.x,
                stated.y,
                stated.z,
                found[0],
                found[1],
                found[2],
                shift / fit.sphere.radius
            )
        })
    });
    warnings.collect()
}

/// Share of a marked outline that an edge follows in a photo that shows the sphere there.
const MIN_EDGE_SHARE: f64 = 0.5;
/// Relative residual of a sphere's shading above which something else is inside the outline.
const MAX_SHADING_RESIDUAL: f64 = 0.1;

/// What the user should know of marks that the photos do not confirm.
fn unconfirmed(photos: &PhotoSet, fit: &SphereFit) -> Option<String> {
    let photos: Vec<String> = fit
        .evidence
        .iter()
        .filter_map(|seen| {
            let residual = seen.shading_residual.unwrap_or(0.0);
            (seen.edge_share < MIN_EDGE_SHARE || residual > MAX_SHADING_RESIDUAL).then(|| {
                format!(
                    "{} (edge along {:.0} % of it, {:.0} % of the brightness inside unexplained)",
                    photos.photos[seen.photo.0].file_name,
                    100.0 * seen.edge_share,
                    100.0 * residual
                )
            })
        })
        .collect();
    (!photos.is_empty()).then(|| {
        format!(
            "the marks of {} outline no matte sphere in {}: an edge along {:.0} % or more and less than \
             {:.0} % unexplained are expected; check that they follow its outline, and that nothing \
             stands before it",
            fit.sphere.name,
            first_and_more(photos.iter().map(String::as_str)).unwrap_or_default(),
            100.0 * MIN_EDGE_SHARE,
            100.0 * MAX_SHADING_RESIDUAL
        )
    })
}

/// What the user should know of the spheres that were located, and of those that were not.
fn warnings_of(
    photos: &PhotoSet,
    request: &SphereRequest,
    located: &LocatedSpheres,
    is_metric: bool,
) -> Vec<String> {
    let mut warnings = Vec::new();
    for (name, error) in &located.missing {
        let marked: Vec<MarkedSphere> = request
            .spheres
            .iter()
            .filter(|sphere| sphere.name == *name)
            .cloned()
            .collect();
        warnings.push(format!(
            "{name} was not located, the others go on: {error}{}",
            of_photos(photos, &marked, error)
        ));
    }
    for fit in &located.fits {
        let name = &fit.sphere.name;
        for (photo, reason) in &fit.unused_marks {
            let found = fit.views.iter().any(|v| v.photo == *photo && v.used);
            warnings.push(format!(
                "{}: the mark of {name} is left out: {reason}{}",
                photos.photos[photo.0].file_name,
                if found {
                    "; the outline found in the photo itself is used"
                } else {
                    ""
                }
            ));
        }
        warnings.extend(unconfirmed(photos, fit));
        if let Some(scale) = fit.scale.filter(|_| is_metric)
            && (1.0 / scale.metres_per_unit - 1.0).abs() > 0.05
        {
            warnings.push(format!(
                "the outlines of {name} give {:.1} % of its stated radius; check the radius, or what gave the unit",
                100.0 / scale.metres_per_unit
            ));
        }
    }
    let mut sizes = BTreeSet::new();
    for size in &located.other_sizes {
        let size = format!("{size:.2}");
        // One warning for several of one size.
        if sizes.insert(size.clone()) {
            warnings.push(format!(
                "a further sphere {size} times as large was found and left, the one that is seen best \
                 was taken as that of the stated radius; give a sphere file to use both"
            ));
        }
    }
    let contradictions = located.scale.contradictions.iter();
    warnings.extend(contradictions.map(|found| contradiction(found, is_metric)));
    warnings
}

fn contradiction(found: &ScaleContradiction, is_metric: bool) -> String {
    format!(
        "the scale that {} gives is {:.2} % of that of the other sphere{} (standard deviation {:.2} %): \
         {}; measure the radii again",
        found.sphere,
        100.0 * found.ratio,
        if found.outcome == ScaleOutcome::Outvoted {
            "s"
        } else {
            ""
        },
        100.0 * found.sigma,
        match (is_metric, found.outcome) {
            (true, _) => "a radius is wrong",
            (false, ScaleOutcome::Outvoted) => "it is left out of the scale",
            (false, ScaleOutcome::Averaged) =>
                "one of the two radii is wrong, the scale is their mean",
            (false, ScaleOutcome::NoScale) =>
                "a radius is wrong or in another unit, the scale stays arbitrary, and the light is \
                 taken from both all the same",
        }
    )
}

/// The photos that an error is about: the one that disagrees most, or all that are marked.
fn of_photos(photos: &PhotoSet, spheres: &[MarkedSphere], error: &SphereError) -> String {
    let name = |photo: PhotoIdx| photos.photos[photo.0].file_name.as_str();
    let marked: BTreeSet<PhotoIdx> = spheres
        .iter()
        .flat_map(|sphere| sphere.marks.iter().map(|(photo, _)| *photo))
        .collect();
    let names: Vec<&str> = marked.into_iter().map(name).collect();
    match error {
        SphereError::Contradiction { worst, .. } => format!(" (the worst is {})", name(*worst)),
        _ if names.is_empty() => String::new(),
        _ => format!(" (marked in {})", first_and_more(names).unwrap_or_default()),
    }
}

/// Multiplies every length of the world.
pub(crate) fn multiply(posed: &mut PosedViews, report: &mut PosesReport, factor: f64) {
    posed.multiply(factor);
    report.median_point_sigma = report.median_point_sigma.map(|s| s * factor);
    for view in &mut report.views {
        view.center_sigma = view.center_sigma.map(|s| s * factor);
    }
}
