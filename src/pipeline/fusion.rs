//! Stage 6: `cloud.ply`, and the mesh as `mesh.ply`, and where asked for `mesh.obj`, `mesh.glb` and the asset.

use super::artifacts::read_json;
use super::context::Context;
use super::errors::from_fusion;
use crate::exit::Failure;
use crate::store::{FileScratch, RunDir, StageWriter};
use rilievo_fusion::{Fused, Inputs, MeshFormat};
use rilievo_io::{
    CloudPlyWriter, ViewerFrame, write_asset, write_mesh_glb, write_mesh_obj, write_mesh_ply,
};
use rilievo_scene::{CloudError, CloudPoint, CloudSink, Observer, PosedViews, StageId};
use std::path::PathBuf;

/// Fuses all views.
///
/// # Errors
/// When nothing agrees, the memory does not suffice, or the user asked to stop.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    let photos = super::photos::load_with(context, false)?;
    let views = super::poses::load(context.run)?;
    let maps = super::shading::MapFiles::open(context.run)?;
    let inputs = Inputs {
        photos: &photos,
        posed: &views,
        maps: &maps,
        scratch: &FileScratch::new(writer.dir()),
    };
    let options = &context.request.options.fusion;
    // The first process alone keeps what all of them make together.
    if !context.console.team().is_first() {
        let fused = rilievo_fusion::run(inputs, &mut Nowhere, options, context.console);
        fused.map_err(from_fusion)?;
        return Ok(serde_json::Value::Null);
    }
    let mut cloud = CloudPlyWriter::create(&writer.path("cloud.ply")?, views.coordinates())?;
    let fused = rilievo_fusion::run(inputs, &mut cloud, options, context.console);
    let fused = fused.map_err(from_fusion)?;
    cloud.finish()?;
    write_surface(&fused, &views, &options.formats, &|name| {
        Ok(writer.path(name)?)
    })?;
    Ok(serde_json::to_value(fused.report)?)
}

/// Keeps no point.
struct Nowhere;

impl CloudSink for Nowhere {
    fn add(&mut self, _points: &[CloudPoint]) -> Result<(), CloudError> {
        Ok(())
    }
}

/// File of the offset, where there is one.
pub const OFFSET: &str = "offset.json";

/// What the file of the offset states.
#[derive(serde::Deserialize)]
struct StatedOffset {
    offset: [f64; 3],
}

/// What is added to positions of a committed stage 6 for those of the world.
///
/// # Errors
/// When the file that states it is damaged.
pub fn cloud_offset(run: &RunDir) -> anyhow::Result<[f64; 3]> {
    if !run.stage_dir(StageId::Fusion).join(OFFSET).exists() {
        return Ok([0.0; 3]);
    }
    let StatedOffset { offset } = read_json(run, StageId::Fusion, OFFSET)?;
    Ok(offset)
}

/// Writes a mesh as PLY and in the other formats that are asked for, and the asset, to the paths of their names.
pub fn write_surface(
    Fused { mesh, asset, .. }: &Fused,
    views: &PosedViews,
    formats: &[MeshFormat],
    path: &dyn Fn(&str) -> Result<PathBuf, Failure>,
) -> Result<(), Failure> {
    let world = views.coordinates();
    if let Some(offset) = world.offset() {
        let text = serde_json::json!({
            "offset": offset,
            "unit": world.unit,
            "meaning": "x_world = x_file + offset: of cloud.ply, mesh.ply, mesh.obj and asset/asset.obj; the .glb files \
                        are turned to y up besides",
        });
        let path = path(OFFSET)?;
        let wrong =
            |error: std::io::Error| Failure::ReadOrWrite(format!("{}: {error}", path.display()));
        std::fs::write(&path, format!("{text:#}\n")).map_err(wrong)?;
    }
    write_mesh_ply(&path("mesh.ply")?, mesh, world)?;
    // An empty mesh is valid PLY, and nothing that a viewer could show.
    if mesh.triangles.is_empty() {
        return Ok(());
    }
    if formats.contains(&MeshFormat::Obj) {
        write_mesh_obj(&path("mesh.obj")?, mesh, world)?;
    }
    let frame = ViewerFrame::from_views(views);
    if formats.contains(&MeshFormat::Glb) {
        write_mesh_glb(&path("mesh.glb")?, mesh, world, &frame)?;
    }
    match asset {
        Some(asset) => write_asset(asset, world, &frame, path),
        None => Ok(()),
    }
}
