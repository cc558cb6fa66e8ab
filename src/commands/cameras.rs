//! `rilievo import` and `rilievo export`: cameras of other programs, in and out.

use crate::cli::{ExportArgs, ImportArgs};
use crate::exit::Failure;
use crate::pipeline::{from_io, load_poses};
use crate::store::RunDir;
use rilievo_io::{CameraFile, CameraFormat, export_cameras, import_cameras, write_cameras};
use std::path::Path;

/// `rilievo import`
///
/// # Errors
/// When the source cannot be read as cameras, or the file cannot be written.
pub fn import(args: &ImportArgs) -> anyhow::Result<()> {
    let (cameras, format) = read(&args.source, args.format)?;
    write_cameras(&args.output, &cameras).map_err(from_io)?;
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
        args.output.display()
    )?;
    Ok(())
}

/// `rilievo export`
///
/// # Errors
/// When a camera has no equivalent in the format, or a file cannot be written.
pub fn export(args: &ExportArgs) -> anyhow::Result<()> {
    let cameras = if args.source.join("run.json").exists() {
        let run = RunDir::open_to_read(&args.source)?;
        CameraFile::from_posed_views(&load_poses(&run)?)
    } else {
        read(&args.source, None)?.0
    };
    export_cameras(&args.output, args.format, &cameras).map_err(from_io)?;
    say!(
        "{} cameras are in {} ({})",
        cameras.cameras.len(),
        args.output.display(),
        args.format.name()
    )?;
    Ok(())
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
