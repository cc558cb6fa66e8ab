//! The coupled problem of posed views: photos, poses, anchors and lighting as a [`ShadingProblem`].

use super::options::PaperOptions;
use super::problem::{DepthAnchor, ShadingProblem, ShadingView, ViewLight};
use super::solution::{PaperReport, SolvedView};
use crate::error::{ShadingError, warn};
use crate::photo_of::photo_of;
use rilievo_scene::{
    ConfidenceMap, DepthMap, LightingCalibration, LinearImage, Mask, Observer, PhotoSet,
    PosedViews, Raster, ShadedView, ShadedViews, ViewIdx,
};
use rilievo_stereo::rectify::Rectification;
use std::sync::Arc;

/// Builds the problem, solves it, and gives the maps back on the photos' own pixels.
pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &PaperOptions,
    observer: &dyn Observer,
) -> Result<(ShadedViews, PaperReport), ShadingError> {
    let mut shaded = ShadedViews::default();
    let mut report = PaperReport::default();
    // One view at a time: anchors carry what the others say, and memory stays that of one view.
    for (index, posed_view) in posed.views.iter().enumerate() {
        let photo = photo_of(photos, posed_view)?;
        let light = lighting
            .views
            .iter()
            .find(|light| light.view == ViewIdx(index))
            .ok_or_else(|| ShadingError::MissingLighting {
                view: posed_view.name.clone(),
            })?;
        let image = photo.linear()?;
        let mask = match photo.mask.as_deref() {
            Some(mask) => mask.unpacked(),
            None => {
                let message = format!(
                    "{}: no mask, the whole frame is taken for the object",
                    posed_view.name
                );
                warn(observer, message)?;
                Mask::filled(image.width, image.height, true)
            }
        };
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
        let solution = match super::solver::solve(&problem, options, observer) {
            Ok(solution) => solution,
            Err(ShadingError::Interrupted) => return Err(ShadingError::Interrupted),
            Err(error) => {
                warn(observer, format!("left out: {error}"))?;
                continue;
            }
        };
        report.views.extend(solution.report.views);
        for solved in solution.views {
            let SolvedView {
                mut depth,
                mut normal,
                mut rendered,
                mut confidence,
                ..
            } = solved;
            if !rectification.is_identity() {
                (rendered, confidence) =
                    bent(&rectification, &mask, &depth, &rendered, &confidence);
                (depth, normal) = rectification.bend_back(&mask, &depth, &normal);
            }
            shaded.views.push(ShadedView {
                view: ViewIdx(index),
                name: posed_view.name.clone(),
                depth,
                normal,
                confidence: Some(confidence),
                rendered: Some(rendered),
                albedo: None,
            });
        }
    }
    if shaded.views.is_empty() {
        return Err(ShadingError::NoViews);
    }
    Ok((shaded, report))
}

/// A straightened view's picture and confidence on the photo's own pixels.
fn bent(
    rectification: &Rectification,
    mask: &Mask,
    depth: &DepthMap,
    image: &LinearImage,
    confidence: &ConfidenceMap,
) -> (LinearImage, ConfidenceMap) {
    let channels = image.channels;
    let pixels = image.data.chunks_exact(channels).zip(&confidence.data);
    let values = Raster {
        width: depth.width,
        height: depth.height,
        data: pixels
            .map(|(p, &sure)| [p[0], p[1.min(channels - 1)], p[channels - 1], sure])
            .collect(),
    };
    let bent = rectification.bend_values_back(mask, depth, &values);
    let (width, height) = (bent.width, bent.height);
    let image = LinearImage {
        width,
        height,
        channels,
        data: bent
            .data
            .iter()
            .flat_map(|v| v[..channels].iter().copied())
            .collect(),
    };
    let confidence = Raster {
        width,
        height,
        data: bent.data.iter().map(|v| v[3]).collect(),
    };
    (image, confidence)
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
