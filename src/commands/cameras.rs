//! `rilievo import` and `rilievo export`: cameras of other programs, in and out.

use super::{diligent, output_files};
use crate::cli::{ExportArgs, ExportFormat, ImportArgs, ImportFormat};
use crate::exit::Failure;
use crate::pipeline::load_poses;
use crate::store::RunDir;
use rilievo_io::colmap::{ColmapModel, binary_files, text_files};
use rilievo_io::{
    CameraFile, CameraFormat, blender_file, camera_files, cameras_file, import_cameras,
    is_diligent, light_file, read_lighting,
};
use rilievo_photos::PhotosReport;
use rilievo_scene::{Orientation, PosedViews, StageId, first_and_more};
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
            if args.photos.is_some() {
                let reason =
                    "--photos is of formats that leave out the photos' size, not of diligent";
                return Err(Failure::Usage(reason.to_owned()).into());
            }
            return diligent::import(args, &output("diligent"));
        }
        Some(ImportFormat::Cameras(format)) => Some(format),
        None => None,
    };
    if args.lamp.is_some() {
        return Err(Failure::Usage("--lamp is of the format diligent".to_owned()).into());
    }
    let output = output("cameras.json");
    let (cameras, format) = read(&args.source, format, args.photos.as_deref())?;
    let file = cameras_file(&output, &cameras).map_err(Failure::from)?;
    output_files::write(&[file], args.overwrite)?;
    let posed = num_posed(&cameras);
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
    if matches!(args.format, ExportFormat::Lp) {
        return export_lights(args, run.as_ref());
    }
    let views = run.as_ref().map(load_poses).transpose()?;
    let views = views.map(PosedViews::in_given_unit);
    let cameras = match &views {
        Some(views) => CameraFile::from_posed_views(views),
        None => read(&args.source, None, None)?.0,
    };
    let output = &args.output;
    let mut num = cameras.cameras.len();
    let mut points = String::new();
    let (files, format) = match args.format {
        ExportFormat::Cameras(format) => {
            // COLMAP's model has a place for what was triangulated.
            let files = match (format, &views) {
                (CameraFormat::Colmap, Some(views)) => {
                    text_files(output, &ColmapModel::from_posed_views(views))
                }
                (CameraFormat::ColmapBinary, Some(views)) => {
                    binary_files(output, &ColmapModel::from_posed_views(views))
                }
                (format, _) => camera_files(output, format, &cameras),
            };
            let has_points = matches!(format, CameraFormat::Colmap | CameraFormat::ColmapBinary);
            let num_points = views
                .filter(|_| has_points)
                .map_or(0, |views| views.points.len());
            if num_points > 0 {
                points = format!(" and {num_points} points");
            }
            (files, format!(" ({})", format.name()))
        }
        _ => {
            num = num_posed(&cameras);
            let use_of = ": run it in Blender's Text Editor, or with blender --python";
            let file = blender_file(output, &cameras);
            (file.map(|file| vec![file]), use_of.to_owned())
        }
    };
    output_files::write(&files.map_err(Failure::from)?, args.overwrite)?;
    say!("{num} cameras{points} are in {}{format}", output.display())?;
    warn_of_turned_photos(run.as_ref())
}

/// Number of cameras with a pose.
fn num_posed(file: &CameraFile) -> usize {
    let cameras = file.cameras.iter();
    cameras
        .filter(|camera| camera.cam_from_world.is_some())
        .count()
}

/// Warns of photos that the program which the cameras are for may turn.
fn warn_of_turned_photos(run: Option<&RunDir>) -> anyhow::Result<()> {
    let manifest = run.map(|run| run.manifest(StageId::Photos)).transpose()?;
    let Some(manifest) = manifest.flatten() else {
        return Ok(());
    };
    // The files are written: a report that cannot be read is no reason to fail.
    let report = serde_json::from_value(manifest.report);
    let report: PhotosReport = report.unwrap_or_default();
    let photos = report.photos.iter();
    let turned = photos.filter(|photo| photo.orientation != Orientation::UPRIGHT);
    if let Some(names) = first_and_more(turned.map(|photo| photo.file_name.as_str())) {
        tell!(
            "{names}: to be turned for display; the cameras are those of the pixels as stored. A program that turns \
             photos needs copies that do not ask for it (of JPEG and TIFF: exiftool -Orientation= ; of HEIC: as \
             JPEG or TIFF, not turned)",
        );
    }
    Ok(())
}

/// The lamps of a run's posed photos, in the cameras' order, so that views keep their numbers.
fn export_lights(args: &ExportArgs, run: Option<&RunDir>) -> anyhow::Result<()> {
    let run = run.ok_or_else(|| Failure::input(&args.source, "is no run directory"))?;
    let file = run.stage_dir(StageId::Lighting).join("lighting.json");
    let lighting = read_lighting(&file, None).map_err(Failure::from)?;
    let lights: Vec<_> = load_poses(run)?
        .views
        .iter()
        .filter_map(|view| {
            let light = lighting.for_view(&view.name)?;
            Some((view.file_name.clone(), light.clone()))
        })
        .collect();
    let file = light_file(&args.output, &lights).map_err(Failure::from)?;
    output_files::write(&[file], args.overwrite)?;
    say!(
        "{} lights are in {} (lp)",
        lights.len(),
        args.output.display()
    )?;
    Ok(())
}

fn read(
    source: &Path,
    format: Option<CameraFormat>,
    photos: Option<&Path>,
) -> Result<(CameraFile, CameraFormat), Failure> {
    if let Some(folder) = photos.filter(|folder| !folder.is_dir()) {
        return Err(Failure::input(folder, "is no folder (--photos)"));
    }
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
    Ok((import_cameras(source, format, photos)?, format))
}
