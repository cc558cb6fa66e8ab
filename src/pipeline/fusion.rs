//! Stage 6: `cloud.ply`, `mesh.ply`.

use super::Context;
use super::errors::{from_fusion, from_io};
use crate::store::StageWriter;
use rilievo_io::{write_cloud_ply, write_mesh_ply};
use rilievo_scene::StageId;

/// Fuses all views.
///
/// # Errors
/// When nothing agrees, or the user asked to stop.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    let photos = super::photos::load(context)?;
    let views = super::poses::load(context.run)?;
    let shaded = super::shading::load(context.run)?;
    let (fused, report) = rilievo_fusion::run(
        &photos,
        &views,
        &shaded,
        &context.request.options.fusion,
        context.console,
    )
    .map_err(from_fusion)?;
    context.console.warn_all(StageId::Fusion, &report.warnings);
    let unit = views.scale.unit;
    write_cloud_ply(&writer.path("cloud.ply")?, &fused.cloud, unit).map_err(from_io)?;
    write_mesh_ply(&writer.path("mesh.ply")?, &fused.mesh, unit).map_err(from_io)?;
    Ok(serde_json::to_value(report)?)
}
