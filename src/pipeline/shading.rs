//! Stage 5: `lighting.json` (the light that was used), `depth/NAME.exr`, `normal/NAME.exr`, and
//! `confidence`, `rendered`, `albedo` where the stage has them; a picture in PNG beside each.

use super::artifacts::{checked_names, read_json, write_text};
use super::context::Context;
use super::errors::{from_check, from_shading};
use crate::exit::Failure;
use crate::store::{FileScratch, RunDir, StageCheckpoint, StageWriter, StoreError, hash_json};
use crate::system;
use rilievo_io::{
    IoError, Preview, read_channel, read_depth, read_linear, read_normal, write_channel,
    write_depth, write_lighting, write_linear, write_normal, write_preview_png,
};
use rilievo_photometry::surface_check::{SurfaceCheck, SurfaceReport};
use rilievo_scene::{
    DividedStep, LightingCalibration, LinearImage, MapSource, Observer, PixelError, ShadedImages,
    ShadedView, StageId, ViewIdx,
};
use rilievo_shading::{ShadingReport, Surroundings};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Longer side of the pictures, pixels: all detail of usual photos, little space.
const PREVIEW_SIDE: usize = 1600;

/// What stage 5 found, and how the light that it used agrees with its surface.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShadingFacts {
    /// The solver's report.
    #[serde(flatten)]
    pub solver: ShadingReport,
    /// Whether the light was the right one.
    pub light_on_surface: SurfaceReport,
}

const VIEWS: &str = "views.json";

/// What a view has beside depth and normals.
#[derive(Debug, Serialize, Deserialize)]
struct ViewFiles {
    name: String,
    view: ViewIdx,
    confidence: bool,
    rendered: bool,
    albedo: bool,
}

/// Finds the dense shape of every view; how far it is goes to the work folder under the stage's `fingerprint`.
pub fn run(
    context: &Context<'_>,
    fingerprint: &str,
    writer: &StageWriter,
) -> anyhow::Result<serde_json::Value> {
    let team = context.console.team();
    let key = hash_json(&(system::PROGRAM, fingerprint));
    let checkpoint = StageCheckpoint::open_together(team, writer, key)?;
    let photos = super::photos::load(context)?;
    let views = super::poses::load(context.run)?;
    let lighting = super::lighting::load(context)?;
    let mut options = context.request.options.shading.clone();
    options.photo.memory = context.resources.given;
    let (shaded, solver) = rilievo_shading::run(
        &photos,
        &views,
        &lighting,
        &options,
        Surroundings {
            observer: context.console,
            checkpoint: &checkpoint,
            scratch: &FileScratch::new(writer.dir()),
        },
    )
    .map_err(from_shading)?;
    let used = (lighting.source, solver.light.as_slice());
    let check = SurfaceCheck::new(&photos, &views, used).map_err(from_check)?;
    let step = "writing maps, comparing them with the photos";
    let step = DividedStep::new(context.console, StageId::Shading, step);
    let interrupted = || anyhow::Error::from(Failure::Interrupted);
    // One at a time: the maps of a large photo take most of a gigabyte.
    let written = step.run(shaded.num_views(), 1, interrupted, |index| {
        let view = shaded.view(index).map_err(from_shading)?;
        let checked = check.view(&view).map_err(from_check)?;
        write_maps(&|file: &str| writer.path(file), &view)?;
        let files = ViewFiles {
            name: view.name,
            view: view.view,
            confidence: view.confidence.is_some(),
            rendered: view.rendered.is_some(),
            albedo: view.albedo.is_some(),
        };
        Ok((files, checked))
    })?;
    let (files, checked): (Vec<ViewFiles>, Vec<_>) = written.into_iter().unzip();
    let light_on_surface = check.finish(checked.into_iter().flatten().collect());
    let used = LightingCalibration {
        views: solver.light.clone(),
        environment_in_world: None,
        spheres: Vec::new(),
        samples: Vec::new(),
        ..lighting
    };
    if team.is_first() && !used.views.is_empty() {
        write_lighting(&writer.path("lighting.json")?, &used, &views).map_err(Failure::from)?;
    }
    for finding in light_on_surface.findings() {
        context.console.warn(StageId::Shading, finding.sentence());
    }
    if team.is_first() {
        write_text(writer, VIEWS, &files)?;
    }
    Ok(serde_json::to_value(ShadingFacts {
        solver,
        light_on_surface,
    })?)
}

/// Writes the maps of a view, and a picture beside each that can be looked at; `path` returns the
/// place of `KIND/NAME.ENDING`, in a folder that exists.
pub fn write_maps(
    path: &(dyn Fn(&str) -> Result<PathBuf, StoreError> + Sync),
    view: &ShadedView,
) -> Result<(), Failure> {
    let file = |kind: &str, ending: &str| path(&format!("{kind}/{}.{ending}", view.name));
    let picture = |kind: &str, preview: Preview<'_>| {
        write_preview_png(&file(kind, "png")?, preview, PREVIEW_SIDE).map_err(Failure::from)
    };
    let maps = || -> Result<(), Failure> {
        write_depth(&file("depth", "exr")?, &view.depth)?;
        write_normal(&file("normal", "exr")?, &view.normal)?;
        picture("depth", Preview::Depth(&view.depth))?;
        picture("normal", Preview::Normal(&view.normal))?;
        if let Some(map) = &view.confidence {
            write_channel(&file("confidence", "exr")?, "C", map)?;
            picture("confidence", Preview::Error { map, max: 1.0 })?;
        }
        Ok(())
    };
    let images = || -> Result<(), Failure> {
        if let Some(rendered) = &view.rendered {
            write_linear(&file("rendered", "exr")?, rendered)?;
            picture("rendered", Preview::Linear(rendered))?;
        }
        if let Some(albedo) = &view.albedo {
            write_linear(&file("albedo", "exr")?, albedo)?;
            picture("albedo", Preview::Linear(&shown_albedo(albedo)))?;
        }
        Ok(())
    };
    let (maps, images) = rayon::join(maps, images);
    maps.and(images)
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
    resolved_px: f64,
}

impl MapFiles {
    /// The maps of a run.
    pub fn open(run: &RunDir) -> anyhow::Result<Self> {
        let folder = run.stage_dir(StageId::Shading);
        let views: Vec<ViewFiles> = read_json(run, StageId::Shading, VIEWS)?;
        let names = views.iter().map(|view| view.name.as_str());
        checked_names(run, StageId::Shading, VIEWS, names)?;
        let manifest = run.manifest(StageId::Shading)?;
        let facts = manifest.and_then(|manifest| serde_json::from_value(manifest.report).ok());
        let photo = facts.and_then(|facts: ShadingFacts| facts.solver.photo);
        let resolved_px = photo.map_or(1.0, |photo| photo.resolved_px());
        Ok(Self {
            folder,
            views,
            resolved_px,
        })
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

    fn resolved_px(&self) -> f64 {
        self.resolved_px
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
        // Who has the albedo needs nothing that it could be guessed from.
        Ok(ShadedImages {
            rendered: image(files.rendered && !files.albedo, "rendered")?,
            albedo: image(files.albedo, "albedo")?,
        })
    }
}
