//! Stage 6: `cloud.ply`, and the mesh as `mesh.ply`, `mesh.obj` and `mesh.glb`.

use super::context::Context;
use super::errors::from_fusion;
use crate::exit::Failure;
use crate::store::StageWriter;
use rilievo_io::{ViewerFrame, write_cloud_ply, write_mesh_glb, write_mesh_obj, write_mesh_ply};
use rilievo_scene::{FusedCloud, Observer, PosedViews};
use std::path::PathBuf;

/// Fuses all views.
///
/// # Errors
/// When nothing agrees, or the user asked to stop.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    // Not divided: the others wait for the result.
    if !context.console.team().is_first() {
        return Ok(serde_json::Value::Null);
    }
    let photos = super::photos::load(context)?;
    let views = super::poses::load(context.run)?;
    let maps = super::shading::MapFiles::open(context.run)?;
    let (fused, report) = rilievo_fusion::run(
        &photos,
        &views,
        &maps,
        &context.request.options.fusion,
        context.console,
    )
    .map_err(from_fusion)?;
    write_surface(&fused, &views, &|name| Ok(writer.path(name)?))?;
    Ok(serde_json::to_value(report)?)
}

/// Writes cloud and mesh in all formats, to the paths of their names.
///
/// # Errors
/// When a file cannot be written.
pub fn write_surface(
    fused: &FusedCloud,
    views: &PosedViews,
    path: &dyn Fn(&str) -> Result<PathBuf, Failure>,
) -> Result<(), Failure> {
    let unit = views.scale.unit;
    write_cloud_ply(&path("cloud.ply")?, &fused.cloud, unit)?;
    write_mesh_ply(&path("mesh.ply")?, &fused.mesh, unit)?;
    // An empty mesh is valid PLY, and nothing that a viewer could show.
    if !fused.mesh.triangles.is_empty() {
        write_mesh_obj(&path("mesh.obj")?, &fused.mesh, unit)?;
        let frame = ViewerFrame::from_views(views);
        write_mesh_glb(&path("mesh.glb")?, &fused.mesh, unit, &frame)?;
    }
    Ok(())
}
