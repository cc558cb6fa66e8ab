//! Stage 4: `lighting.json`, `calibration.json` (everything that the stage found), and where there is
//! a sphere `overlay/NAME.png`: outline, re-rendered sphere and excluded pixels side by side, a row
//! per sphere.

use super::artifacts::{read_json, write_text};
use super::context::Context;
use super::errors::from_lighting;
use super::inputs::shape_file;
use super::request::LightingInput;
use crate::exit::Failure;
use crate::store::StageWriter;
use rilievo_io::{
    IoError, IoErrorKind, Preview, read_depth, read_lighting, write_lighting, write_preview_png,
};
use rilievo_lighting::LightingRequest;
use rilievo_scene::{
    LightingCalibration, Observer, PhotoSet, PosedViews, StageId, ViewIdx, first_and_more,
};

const CALIBRATION: &str = "calibration.json";

/// Calibrates the lighting of every view.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    // Not divided: the others wait for the result.
    if !context.console.team().is_first() {
        return Ok(serde_json::Value::Null);
    }
    let photos = super::photos::load(context)?;
    let views = super::poses::load(context.run)?;
    let request = lighting_request(context, &photos, &views)?;
    let (calibration, report) = rilievo_lighting::run(
        &photos,
        &views,
        &request,
        &context.request.options.lighting,
        context.console,
    )
    .map_err(from_lighting)?;
    write_lighting(&writer.path("lighting.json")?, &calibration, &views).map_err(Failure::from)?;
    let overlays =
        rilievo_lighting::overlays(&photos, &views, &calibration).map_err(from_lighting)?;
    for overlay in &overlays {
        let path = writer.path(&format!("overlay/{}.png", overlay.name))?;
        write_preview_png(&path, Preview::Linear(&overlay.picture), 0).map_err(Failure::from)?;
    }
    write_text(writer, CALIBRATION, &calibration)?;
    Ok(serde_json::to_value(report)?)
}

/// Lighting of a committed stage 4.
pub fn load(context: &Context<'_>) -> anyhow::Result<LightingCalibration> {
    read_json(context.run, StageId::Lighting, CALIBRATION)
}

fn lighting_request(
    context: &Context<'_>,
    photos: &PhotoSet,
    views: &PosedViews,
) -> Result<LightingRequest, Failure> {
    match &context.request.lighting {
        LightingInput::File { path, name } => {
            let file = read_lighting(path, name.as_deref())?;
            let lit = |name: &str| Some((name.to_owned(), file.for_view(name)?.clone()));
            let names = || views.views.iter().map(|view| view.name.as_str());
            let missing: Vec<&str> = names().filter(|name| lit(name).is_none()).collect();
            if !missing.is_empty() {
                return Err(IoError {
                    path: path.clone(),
                    kind: IoErrorKind::Input,
                    reason: format!("has no lighting for {}", first_and_more(missing).unwrap_or_default()),
                    hint: Some(
                        "its views go by the photos' names; FILE:NAME picks one lighting for all views"
                            .to_owned(),
                    ),
                }
                .into());
            }
            let given = names().filter_map(lit).collect();
            Ok(LightingRequest::Given(given))
        }
        LightingInput::Shape { folder } => {
            let mut shapes = Vec::new();
            for (index, view) in views.views.iter().enumerate() {
                let file = shape_file(folder, &view.name);
                if file.exists() {
                    let depth = read_depth(&file)?;
                    shapes.push((ViewIdx(index), depth));
                }
            }
            Ok(LightingRequest::Shape(shapes))
        }
        LightingInput::Found => {
            // Photos that the sphere file names in vain were reported by stage 3.
            let spheres = super::poses::sphere_request(context, photos)?;
            Ok(spheres.map_or(LightingRequest::OwnShape, |spheres| {
                LightingRequest::Sphere(spheres.request)
            }))
        }
    }
}
