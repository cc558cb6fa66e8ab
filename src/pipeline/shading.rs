//! Stage 5: `depth/NAME.exr`, `normal/NAME.exr`, and `confidence`, `rendered`, `albedo` where the
//! stage gives them; a picture in PNG beside each.

use super::Context;
use super::errors::{from_io, from_lighting, from_shading};
use crate::exit::Failure;
use crate::store::{RunDir, StageWriter, StoreError};
use rilievo_io::{
    IoError, Preview, read_channel, read_depth, read_linear, read_normal, write_channel,
    write_depth, write_linear, write_normal, write_preview_png,
};
use rilievo_scene::{
    LinearImage, MapSource, PixelError, ShadedImages, ShadedView, StageId, ViewIdx,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Longer side of the pictures, pixels: all detail of usual photos, little space.
const PREVIEW_SIDE: usize = 1600;

/// What a view has beside depth and normals.
#[derive(Debug, Serialize, Deserialize)]
struct ViewFiles {
    name: String,
    view: ViewIdx,
    confidence: bool,
    rendered: bool,
    albedo: bool,
}

/// Finds the dense shape of every view.
///
/// # Errors
/// When it cannot be found, or the user asked to stop.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    let photos = super::photos::load(context)?;
    let views = super::poses::load(context.run)?;
    let lighting = super::lighting::load(context)?;
    let (shaded, report) = rilievo_shading::run(
        &photos,
        &views,
        &lighting,
        &context.request.options.shading,
        context.console,
    )
    .map_err(from_shading)?;
    context.console.warn_all(StageId::Shading, &report.warnings);
    let light_on_surface = rilievo_lighting::check_on_surface(
        &photos,
        &views,
        &lighting,
        &shaded,
        &|name| report.photo.as_ref().is_some_and(|p| p.explains(name)),
        &context.request.options.lighting,
        context.console,
    )
    .map_err(from_lighting)?;
    context
        .console
        .warn_all(StageId::Shading, &light_on_surface.advice);
    let mut files = Vec::new();
    for view in &shaded.views {
        write_maps(&|file: &str| writer.path(file), view)?;
        files.push(ViewFiles {
            name: view.name.clone(),
            view: view.view,
            confidence: view.confidence.is_some(),
            rendered: view.rendered.is_some(),
            albedo: view.albedo.is_some(),
        });
    }
    let path = writer.path("views.json")?;
    std::fs::write(&path, serde_json::to_vec_pretty(&files)?)
        .map_err(StoreError::files("write", &path))?;
    let mut report = serde_json::to_value(report)?;
    report["light_on_surface"] = serde_json::to_value(light_on_surface)?;
    Ok(report)
}

/// Writes the maps of a view, and a picture beside each that can be looked at; `path` gives the place
/// of `KIND/NAME.ENDING`, in a folder that exists.
///
/// # Errors
/// When one cannot be written.
pub fn write_maps(
    path: &dyn Fn(&str) -> Result<PathBuf, StoreError>,
    view: &ShadedView,
) -> Result<(), Failure> {
    let file = |kind: &str, ending: &str| path(&format!("{kind}/{}.{ending}", view.name));
    write_depth(&file("depth", "exr")?, &view.depth).map_err(from_io)?;
    write_normal(&file("normal", "exr")?, &view.normal).map_err(from_io)?;
    if let Some(confidence) = &view.confidence {
        write_channel(&file("confidence", "exr")?, "C", confidence).map_err(from_io)?;
    }
    let picture = |kind: &str, preview: Preview<'_>| {
        write_preview_png(&file(kind, "png")?, preview, PREVIEW_SIDE).map_err(from_io)
    };
    picture("depth", Preview::Depth(&view.depth))?;
    picture("normal", Preview::Normal(&view.normal))?;
    if let Some(rendered) = &view.rendered {
        write_linear(&file("rendered", "exr")?, rendered).map_err(from_io)?;
        picture("rendered", Preview::Linear(rendered))?;
    }
    if let Some(albedo) = &view.albedo {
        write_linear(&file("albedo", "exr")?, albedo).map_err(from_io)?;
        picture("albedo", Preview::Linear(&shown_albedo(albedo)))?;
    }
    if let Some(map) = &view.confidence {
        picture("confidence", Preview::Error { map, max: 1.0 })?;
    }
    Ok(())
}

/// Albedo as a picture: the mean albedo, 1, becomes a middle grey.
pub fn shown_albedo(albedo: &LinearImage) -> LinearImage {
    const MEAN_LEVEL: f32 = 0.5;
    LinearImage {
        data: albedo.data.iter().map(|v| v * MEAN_LEVEL).collect(),
        ..*albedo
    }
}

/// Maps of a committed stage 5, read when they are asked for.
pub struct MapFiles {
    folder: PathBuf,
    views: Vec<ViewFiles>,
}

impl MapFiles {
    /// The maps of a run.
    ///
    /// # Errors
    /// When stage 5 is not there or damaged.
    pub fn open(run: &RunDir) -> anyhow::Result<Self> {
        let folder = run.stage_dir(StageId::Shading);
        let path = folder.join("views.json");
        let text = std::fs::read(&path).map_err(|_| super::poses::not_there(StageId::Shading))?;
        let views = serde_json::from_slice(&text).map_err(|error| StoreError::Damaged {
            path,
            reason: error.to_string(),
        })?;
        Ok(Self { folder, views })
    }
}

impl MapFiles {
    /// A view's file of a kind, read by `read`.
    fn file<T>(
        &self,
        idx: usize,
        kind: &str,
        read: impl FnOnce(&Path) -> Result<T, IoError>,
    ) -> Result<T, PixelError> {
        let name = &self.views[idx].name;
        let path = self.folder.join(kind).join(format!("{name}.exr"));
        read(&path).map_err(|error| PixelError {
            name: name.clone(),
            reason: error.to_string(),
        })
    }
}

impl MapSource for MapFiles {
    fn num_views(&self) -> usize {
        self.views.len()
    }

    fn load(&self, idx: usize) -> Result<ShadedView, PixelError> {
        let files = &self.views[idx];
        let confidence = || self.file(idx, "confidence", |path| read_channel(path, "C"));
        Ok(ShadedView {
            view: files.view,
            name: files.name.clone(),
            depth: self.file(idx, "depth", read_depth)?,
            normal: self.file(idx, "normal", read_normal)?,
            confidence: files.confidence.then(confidence).transpose()?,
            rendered: None,
            albedo: None,
        })
    }

    fn images(&self, idx: usize) -> Result<ShadedImages, PixelError> {
        let files = &self.views[idx];
        let image = |present: bool, kind: &str| {
            present
                .then(|| self.file(idx, kind, read_linear))
                .transpose()
        };
        Ok(ShadedImages {
            rendered: image(files.rendered, "rendered")?,
            albedo: image(files.albedo, "albedo")?,
        })
    }
}
