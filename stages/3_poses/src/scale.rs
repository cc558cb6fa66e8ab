//! Unit of the world: metric from given poses, a known distance or the reference sphere, else
//! arbitrary.
//!
//! A sphere of known radius `R` that measures `r` in the world's unit makes one unit `R/r` metres;
//! centres, points and the sphere are multiplied by that. Given poses are metres already, and the
//! sphere is then only located.
//!
//! The sphere is located after the adjustment, not in it: its outline gives a view two coordinates
//! of the centre, as precise as one of the thousand points that the view sees, so that it would move
//! the poses by less than a twentieth of their standard deviation; and an outline that is biased by
//! its own shadow cannot bend them.

use crate::error::PosesError;
use crate::options::PosesOptions;
use crate::report::PosesReport;
use rilievo_photometry::sphere::{SphereError, WorldScale, locate_request};
use rilievo_scene::{PhotoIdx, PhotoSet, PosedViews, Scale, ScaleSource, SphereRequest, Unit};

/// Sets the scale and locates the sphere; what hinders the sphere becomes a warning.
///
/// # Errors
/// When a known distance cannot be found in the model.
pub fn apply(
    photos: &PhotoSet,
    sphere: Option<&SphereRequest>,
    has_given_poses: bool,
    options: &PosesOptions,
    posed: &mut PosedViews,
    report: &mut PosesReport,
    warnings: &mut Vec<String>,
) -> Result<(), PosesError> {
    if has_given_poses {
        posed.scale = Scale {
            unit: Unit::Metre,
            source: ScaleSource::GivenPoses,
            relative_sigma: None,
        };
    }
    if let Some(known) = &options.known_distance {
        let (metres_per_unit, relative_sigma) = known.metres_per_unit(posed, report)?;
        if has_given_poses {
            let apart = (metres_per_unit - 1.0).abs();
            if apart > (3.0 * relative_sigma).max(0.01) {
                warnings.push(format!(
                    "the known distance is {:.1} % of what the given cameras say; check it, or their unit",
                    100.0 * metres_per_unit
                ));
            }
        } else {
            multiply(posed, report, metres_per_unit);
            posed.scale = Scale {
                unit: Unit::Metre,
                source: ScaleSource::KnownDistance,
                relative_sigma: Some(relative_sigma),
            };
        }
    }
    let is_metric = posed.scale.unit == Unit::Metre;
    if let Some(request) = sphere
        && request.radius.is_some()
    {
        let world_scale = if is_metric {
            WorldScale::Metric
        } else {
            WorldScale::Free
        };
        let found = locate_request(photos, &posed.views, request, world_scale, &options.sphere);
        match found {
            Ok(fit) => {
                for (photo, reason) in &fit.unused_marks {
                    let found = fit.views.iter().any(|v| v.photo == *photo && v.used);
                    warnings.push(format!(
                        "{}: the mark of the sphere is left out: {reason}{}",
                        photos.photos[photo.0].file_name,
                        if found {
                            "; the outline found in the photo itself is used"
                        } else {
                            ""
                        }
                    ));
                }
                posed.sphere = Some(fit.sphere);
                // Without views the centre was merely stated: it says nothing of the scale.
                if !is_metric && !fit.views.is_empty() {
                    multiply(posed, report, fit.metres_per_unit);
                    posed.scale = Scale {
                        unit: Unit::Metre,
                        source: ScaleSource::Sphere,
                        relative_sigma: Some(fit.relative_sigma),
                    };
                }
                if let Some(ratio) = fit.radius_ratio
                    && (ratio - 1.0).abs() > 0.05
                {
                    warnings.push(format!(
                        "the sphere's outlines give {:.1} % of its stated radius; check the radius, or what gave the unit",
                        100.0 * ratio
                    ));
                }
            }
            Err(error) => warnings.push(format!(
                "the reference sphere was not located, the scale stays {}: {error}{}",
                if is_metric { "as it is" } else { "arbitrary" },
                of_photos(photos, request, &error)
            )),
        }
    }
    report.scale = posed.scale;
    Ok(())
}

/// The photos that an error is about: the one that disagrees most, or all that are marked.
fn of_photos(photos: &PhotoSet, request: &SphereRequest, error: &SphereError) -> String {
    let name = |photo: PhotoIdx| photos.photos[photo.0].file_name.as_str();
    let marked: Vec<&str> = request
        .marks
        .iter()
        .map(|(photo, _)| name(*photo))
        .collect();
    match error {
        SphereError::Contradiction { worst, .. } => format!(" (the worst is {})", name(*worst)),
        _ if marked.is_empty() => String::new(),
        _ => format!(" (marked in {})", marked.join(", ")),
    }
}

/// Multiplies every length of the world.
fn multiply(posed: &mut PosedViews, report: &mut PosesReport, factor: f64) {
    for view in &mut posed.views {
        view.cam_from_world.translation *= factor;
    }
    for point in &mut posed.points {
        for v in &mut point.position {
            *v *= factor;
        }
    }
    if let Some(sphere) = &mut posed.sphere {
        for v in sphere
            .center_in_world
            .iter_mut()
            .chain(&mut sphere.center_sigma)
        {
            *v *= factor;
        }
        sphere.radius *= factor;
    }
    report.median_point_sigma = report.median_point_sigma.map(|s| s * factor);
    for view in &mut report.views {
        view.center_sigma = view.center_sigma.map(|s| s * factor);
    }
}
