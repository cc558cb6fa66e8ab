//! `rilievo import` and `rilievo export`: cameras of other programs, in and out.

use super::diligent;
use crate::cli::{ExportArgs, ExportFormat, ImportArgs, ImportFormat};
use crate::exit::Failure;
use crate::pipeline::{from_io, load_poses};
use crate::store::{RunDir, StoreError};
use rilievo_io::{
    CameraFile, CameraFormat, LightFormat, export_cameras, import_cameras, is_diligent,
    read_lighting, write_cameras, write_lights,
};
use rilievo_scene::StageId;
use std::path::Path;

/// `rilievo import`
///
/// # Errors
/// When the source cannot be read as cameras, or the file cannot be written.
pub fn import(args: &ImportArgs) -> anyhow::Result<()> {
    let format = match args.format {
        None if is_diligent(&args.source) => Some(ImportFormat::Diligent),
        format => format,
    };
    let output = |default: &str| args.output.clone().unwrap_or_else(|| default.into());
    let format = match format {
        Some(ImportFormat::Diligent) => {
            return diligent::import(&args.source, &output("diligent"), args.lamp);
        }
        Some(ImportFormat::Cameras(format)) => Some(format),
        None => None,
    };
    if args.lamp.is_some() {
        return Err(Failure::Usage("--lamp is of the format diligent".to_owned()).into());
    }
    let output = output("cameras.json");
    let (cameras, format) = read(&args.source, format)?;
    make_parent(&output)?;
    write_cameras(&output, &cameras).map_err(from_io)?;
    let posed = cameras
        .cameras
        .iter()
        .filter(|camera| camera.cam_from_world.is_some())
        .count();
    say!(
        "{} cameras ({posed} with a pose) from {} ({}) are in {}",
        cameras.cameras.len(),
        args.source.display(),
        format.name(),
        output.display()
    )?;
    Ok(())
}

/// `rilievo export`
///
/// # Errors
/// When a camera or light has no equivalent in the format, or a file cannot be written.
pub fn export(args: &ExportArgs) -> anyhow::Result<()> {
    let run = args
        .source
        .join("run.json")
        .exists()
        .then(|| RunDir::open_to_read(&args.source))
        .transpose()?;
    let format = match args.format {
        ExportFormat::Cameras(format) => format,
        ExportFormat::Lights(format) => return export_lights(args, format, run.as_ref()),
    };
    let cameras = match &run {
        Some(run) => CameraFile::from_posed_views(&load_poses(run)?),
        None => read(&args.source, None)?.0,
    };
    make_parent(&args.output)?;
    export_cameras(&args.output, format, &cameras).map_err(from_io)?;
    say!(
        "{} cameras are in {} ({})",
        cameras.cameras.len(),
        args.output.display(),
        format.name()
    )?;
    Ok(())
}

/// The lamps of a run's posed photos, in the cameras' order, so that views keep their numbers.
fn export_lights(
    args: &ExportArgs,
    format: LightFormat,
    run: Option<&RunDir>,
) -> anyhow::Result<()> {
    let run = run.ok_or_else(|| Failure::input(&args.source, "is no run directory"))?;
    let file = run.stage_dir(StageId::Lighting).join("lighting.json");
    let lighting = read_lighting(&file, None).map_err(from_io)?;
    let lights: Vec<_> = load_poses(run)?
        .views
        .iter()
        .filter_map(|view| {
            let light = lighting.for_view(&view.name)?;
            Some((view.file_name.clone(), light.clone()))
        })
        .collect();
    make_parent(&args.output)?;
    write_lights(&args.output, format, &lights).map_err(from_io)?;
    say!(
        "{} lights are in {} ({})",
        lights.len(),
        args.output.display(),
        format.name()
    )?;
    Ok(())
}

/// Makes the folder that a file or folder is written into.
fn make_parent(path: &Path) -> Result<(), StoreError> {
    match path.parent() {
        Some(folder) => {
            std::fs::create_dir_all(folder).map_err(StoreError::files("create", folder))
        }
        None => Ok(()),
    }
}

fn read(
    source: &Path,
    format: Option<CameraFormat>,
) -> Result<(CameraFile, CameraFormat), Failure> {
    let format = match format.or_else(|| CameraFormat::detect(source)) {
        Some(format) => format,
        None if !source.exists() => {
            return Err(Failure::input(source, "there is no such file or folder"));
        }
        None => {
            return Err(Failure::input(
                source,
                "its format cannot be told from its name; say it with --format",
            ));
        }
    };
    Ok((import_cameras(source, format).map_err(from_io)?, format))
}
