//! `rilievo shade` on arrays.

use super::arguments::parsed;
use super::failure::CommandFailure;
use super::host::{Stop, Tell, console, guarded, in_own_threads};
use crate::cli::Command;
use crate::commands::{Described, ViewParts, reporting, shade_options, solve_shading};
use rilievo_scene::{
    DecodedPhoto, DepthMap, Intrinsics, Lighting, LinearImage, Mask, NormalMap, Raster,
    RigidTransform,
};
use rilievo_shading::paper::ViewMatches;
use std::ffi::OsString;

/// One view, all of whose rasters have the photo's size.
#[derive(Clone, Debug)]
pub struct ArrayView {
    /// Name for messages and the report.
    pub name: String,
    /// The image: integers as a camera's files hold them, floats linear with white at 1.
    pub photo: DecodedPhoto,
    /// The object; `None` is the whole frame.
    pub mask: Option<Mask>,
    /// Camera without distortion.
    pub intrinsics: Intrinsics,
    /// Pose, needed where matches tie the view to others.
    pub cam_from_world: Option<RigidTransform>,
    /// Lighting times mean albedo; `None` fits it on the prior or initial depth.
    pub lighting: Option<Lighting>,
    /// Start; 0 where there is no value.
    pub initial: Option<DepthMap>,
    /// Measured depth to stay near to; 0 where there is no value.
    pub prior: Option<DepthMap>,
}

/// Views to be solved together.
#[derive(Clone, Debug, Default)]
pub struct ShadeRequest {
    /// The views.
    pub views: Vec<ArrayView>,
    /// Matches between them: indices of two views, and `[x1, y1, x2, y2]` in pixels.
    pub matches: Vec<([usize; 2], Vec<[f64; 4]>)>,
    /// Options of the command line (`--order=1`), without those that name files of views.
    pub options: Vec<OsString>,
}

/// Shape of one view.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadedArrays {
    /// The view's name.
    pub name: String,
    /// Depth along the optical axis, 0 outside the mask.
    pub depth: DepthMap,
    /// Unit normals in the camera frame, zero outside the mask.
    pub normal: NormalMap,
    /// The image that the shape explains, linear.
    pub rendered: LinearImage,
    /// How well data determine each pixel, 0 to 1, where it was asked for.
    pub confidence: Option<Raster<f32>>,
}

/// Solves the views; answers with their shapes in order, and with what `rilievo shade` writes to `report.json`.
///
/// # Errors
/// As the command line fails, with its exit code.
pub fn shade(
    request: ShadeRequest,
    stop: &Stop,
    tell: Tell,
) -> Result<(Vec<ShadedArrays>, serde_json::Value), CommandFailure> {
    guarded(|| {
        // The scene and the folder are never looked at: the views are here, and so will the results be.
        let mut arguments: Vec<OsString> = ["shade", "--output=-"].map(OsString::from).into();
        arguments.extend(request.options);
        arguments.extend(["--", "arrays"].map(OsString::from));
        let Command::Shade(args) = parsed(&arguments)? else {
            return Err(CommandFailure::usage("this is not `shade`"));
        };
        let console = console(stop, tell);
        let (views, matches) = (request.views, request.matches);
        in_own_threads(args.work.threads, || {
            let (mut shaded, mut report) = (Vec::new(), serde_json::Value::Null);
            reporting(&console, serde_json::json!({}), |console| {
                let options = shade_options(&args)?;
                let mut described = Described::default();
                for view in views {
                    described.add(parts(view), args.prior_weight, &options, console)?;
                }
                described.problem.matches = matches
                    .into_iter()
                    .map(|(views, pixels)| ViewMatches { views, pixels })
                    .collect();
                described.tell_of_matches(console);
                let solved = solve_shading(&described, &options, console, |_, view| {
                    shaded.push(ShadedArrays {
                        name: view.name,
                        depth: view.depth,
                        normal: view.normal,
                        rendered: view.rendered,
                        confidence: view.confidence,
                    });
                    Ok(())
                })?;
                solved.report(console);
                report = solved.report;
                Ok(())
            })?;
            Ok((shaded, report))
        })
    })
}

fn parts(view: ArrayView) -> ViewParts {
    ViewParts {
        name: view.name,
        photo: view.photo,
        mask: view.mask,
        intrinsics: view.intrinsics,
        cam_from_world: view.cam_from_world,
        lighting: view.lighting.map(|lighting| (lighting, "given".to_owned())),
        initial: view.initial,
        prior: view.prior,
    }
}
