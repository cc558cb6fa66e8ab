//! Unit of the world: metric from the reference sphere or from given poses, else arbitrary.
//!
//! A sphere of known radius `R` that measures `r` in the world's unit makes one unit `R/r` metres;
//! centres, points and the sphere are multiplied by that. Given poses are metres already, and the
//! sphere is then only located.

use crate::report::PosesReport;
use rilievo_photometry::sphere::{SphereOptions, WorldScale, locate_request};
use rilievo_scene::{PhotoSet, PosedViews, Scale, ScaleSource, SphereRequest, Unit};

/// Sets the scale and locates the sphere; what hinders becomes a warning.
pub fn apply(
    photos: &PhotoSet,
    sphere: Option<&SphereRequest>,
    has_given_poses: bool,
    posed: &mut PosedViews,
    report: &mut PosesReport,
    warnings: &mut Vec<String>,
) {
    if has_given_poses {
        posed.scale = Scale {
            unit: Unit::Metre,
            source: ScaleSource::GivenPoses,
            relative_sigma: None,
        };
    }
    if let Some(request) = sphere
        && request.radius.is_some()
    {
        let world_scale = if has_given_poses {
            WorldScale::Metric
        } else {
            WorldScale::Free
        };
        let found = locate_request(
            photos,
            &posed.views,
            request,
            world_scale,
            &SphereOptions::default(),
        );
        match found {
            Ok(fit) => {
                posed.sphere = Some(fit.sphere);
                // Without views the centre was merely stated: it says nothing of the scale.
                if !has_given_poses && !fit.views.is_empty() {
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
                        "the sphere's outlines give {:.1} % of its stated radius; check the radius, or the unit of the given cameras",
                        100.0 * ratio
                    ));
                }
            }
            Err(error) => warnings.push(format!(
                "the reference sphere was not located, the scale stays {}: {error}",
                if has_given_poses {
                    "that of the given cameras"
                } else {
                    "arbitrary"
                }
            )),
        }
    }
    report.scale = posed.scale;
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
