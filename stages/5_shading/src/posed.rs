//! The coupled problem of posed views: photos, poses, anchors and lighting as a [`ShadingProblem`].

use crate::error::ShadingError;
use crate::options::ShadingOptions;
use crate::photo::rectify::Rectification;
use crate::problem::{DepthAnchor, ShadingProblem, ShadingView, ViewLight};
use crate::solution::ShadingReport;
use rilievo_scene::{
    LightingCalibration, Mask, Observer, PhotoSet, PosedViews, ShadedView, ShadedViews, ViewIdx,
};
use std::sync::Arc;

/// Builds the problem, solves it, and gives the maps back on the photos' own pixels.
pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &ShadingOptions,
    observer: &dyn Observer,
) -> Result<(ShadedViews, ShadingReport), ShadingError> {
    let mut shaded = ShadedViews::default();
    let mut report = ShadingReport::default();
    // One view at a time: anchors carry what the others say, and memory stays that of one view.
    for (index, posed_view) in posed.views.iter().enumerate() {
        let photo = photos
            .photos
            .get(posed_view.photo.0)
            .ok_or(ShadingError::UnknownView {
                what: "a posed view's photo",
                index: posed_view.photo.0,
                num_views: photos.photos.len(),
            })?;
        let light = lighting
            .views
            .iter()
            .find(|light| light.view == ViewIdx(index))
            .ok_or_else(|| ShadingError::MissingLighting {
                view: posed_view.name.clone(),
            })?;
        let image = photo.pixels.load()?;
        let mask = photo.mask.as_deref().cloned().unwrap_or_else(|| {
            report.warnings.push(format!(
                "{}: no mask, the whole frame is taken for the object",
                posed_view.name
            ));
            Mask::filled(image.width, image.height, true)
        });
        let rectification = Rectification::new(&posed_view.intrinsics);
        let (straight_image, straight_mask) = if rectification.is_identity() {
            (image.clone(), mask.clone())
        } else {
            let (image, mask) = rectification.straighten(&image, &mask);
            (Arc::new(image), mask)
        };
        let mut view = ShadingView::new(
            posed_view.name.clone(),
            straight_image,
            straight_mask,
            rectification.pinhole,
            ViewLight::Uniform(light.lighting.clone()),
        );
        view.clip_level = Some(photo.clip_level);
        view.noise = light.residual;
        view.cam_from_world = Some(posed_view.cam_from_world);
        view.anchors = anchors(posed, ViewIdx(index), &rectification);
        let problem = ShadingProblem {
            views: vec![view],
            matches: Vec::new(),
        };
        let solution = match crate::solver::solve(&problem, options, observer) {
            Ok(solution) => solution,
            Err(ShadingError::Interrupted) => return Err(ShadingError::Interrupted),
            Err(error) => {
                report.warnings.push(format!("left out: {error}"));
                continue;
            }
        };
        report.views.extend(solution.report.views);
        report.warnings.extend(solution.report.warnings);
        for solved in solution.views {
            let (depth, normal) = if rectification.is_identity() {
                (solved.depth, solved.normal)
            } else {
                rectification.bend_back(&mask, &solved.depth, &solved.normal)
            };
            shaded.views.push(ShadedView {
                view: ViewIdx(index),
                name: posed_view.name.clone(),
                depth,
                normal,
                confidence: solved.confidence.filter(|_| rectification.is_identity()),
                rendered: rectification.is_identity().then_some(solved.rendered),
                albedo: None,
            });
        }
    }
    if shaded.views.is_empty() {
        return Err(ShadingError::NoViews);
    }
    Ok((shaded, report))
}

/// Anchors, or failing these sparse points, that a view sees, at pixels of its pinhole camera.
fn anchors(posed: &PosedViews, view: ViewIdx, rectification: &Rectification) -> Vec<DepthAnchor> {
    let pinhole = &rectification.pinhole;
    let straight = |pixel: [f64; 2]| {
        let ray = rectification
            .original
            .normalized(&nalgebra::Point2::new(pixel[0], pixel[1]));
        [
            pinhole.fx * ray.x + pinhole.cx,
            pinhole.fy * ray.y + pinhole.cy,
        ]
    };
    let found: Vec<DepthAnchor> = posed
        .anchors
        .iter()
        .flat_map(|anchor| &anchor.observations)
        .filter(|o| o.view == view)
        .map(|o| DepthAnchor {
            pixel: straight(o.pixel),
            depth: o.depth,
            sigma_ln_depth: o.sigma_ln_depth,
        })
        .collect();
    if !found.is_empty() {
        return found;
    }
    let pose = &posed.views[view.0].cam_from_world;
    posed
        .points
        .iter()
        .filter_map(|point| {
            let element = point.track.iter().find(|e| e.view == view)?;
            let depth = pose.apply(&nalgebra::Point3::from(point.position)).z;
            // A pixel's angle over a typical triangulation angle of ten degrees.
            let sigma = point.error_px.max(0.3) / pinhole.focal_px() / 0.17;
            (depth > 0.0).then(|| DepthAnchor {
                pixel: straight(element.pixel),
                depth,
                sigma_ln_depth: sigma,
            })
        })
        .collect()
}
