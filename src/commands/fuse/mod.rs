//! `rilievo fuse`: depth and normal maps of other programs to one cloud and one mesh.

mod maps;
mod photos;

use super::reporting::reporting;
use crate::cli::FuseArgs;
use crate::config::StageOptions;
use crate::exit::Failure;
use crate::observe::{Console, StageNews};
use crate::pipeline::{OFFSET, from_fusion, write_surface};
use crate::store::{
    FileScratch, StoreError, create_folder, own_file, own_folder, write_atomically,
};
use crate::system;
use maps::Views;
use rilievo_fusion::{FusionError, Inputs};
use rilievo_io::{ASSET_FILES, CloudPlyWriter};
use rilievo_numerics::robust::median;
use rilievo_scene::{
    MapSource, PhotoIdx, PhotoSet, PosedView, PosedViews, Scale, ScaleSource, StageId, Unit,
};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Ratio of depths to the cameras' distances beyond which they are hardly in one unit: metres and
/// millimetres differ by a thousand.
const MAX_DEPTH_RATIO: f64 = 200.0;

/// Runs the command.
///
/// # Errors
/// When maps or cameras cannot be used, nothing agrees, or the results cannot be written.
pub fn fuse(args: &FuseArgs) -> anyhow::Result<()> {
    let facts = serde_json::json!({"folder": args.output.display().to_string()});
    reporting(&Console::new(args.work.json), facts, |console| {
        run(args, console)
    })
}

fn run(args: &FuseArgs, console: &Console) -> anyhow::Result<()> {
    let mut options = StageOptions::read(args.config.config.as_deref())?;
    args.surface.apply(&mut options.fusion);
    args.work.bound(&mut options.fusion);
    options.validate()?;
    own_folder(&args.output.join("asset"))?;
    let ours = own_results(&args.output, args.overwrite)?;
    let mut views = maps::read(&args.maps, args.cameras.as_deref())?;
    let slopes = views.views.iter().filter(|v| v.normals_are_slopes);
    let slopes = slopes.count();
    let unit;
    (unit, views.factor) = scale(args.scale, views.unit)?;
    if unit == Unit::Arbitrary {
        console.warn(
            StageId::Fusion,
            "the maps name no unit: lengths are written as they are; --scale METRES makes metres",
        );
    }
    if slopes > 0 {
        let message = format!(
            "{slopes} of {} views have no normal map: the depths' slopes stand in, with less detail",
            views.num_views()
        );
        console.warn(StageId::Fusion, message);
    }
    let mut posed = posed(&views, unit);
    let photos = match &args.photos {
        Some(folder) => photos::find(folder, &mut posed)?,
        None => PhotoSet::default(),
    };
    create_folder(&args.output)?;

    let began = Instant::now();
    let started = format!("{} views of {}", posed.views.len(), views.format());
    console.stage(StageId::Fusion, &StageNews::Started(started));
    // All files are written before the first of an earlier surface is replaced.
    let writing = tempfile::tempdir_in(&args.output)
        .map_err(StoreError::files("write into", &args.output))?;
    let inputs = Inputs {
        photos: &photos,
        posed: &posed,
        maps: &views,
        scratch: &FileScratch::new(writing.path()),
    };
    let mut cloud = CloudPlyWriter::create(&writing.path().join("cloud.ply"), posed.coordinates())?;
    let fused = rilievo_fusion::run(inputs, &mut cloud, &options.fusion, console).map_err(
        |error| match (error, unit_hint(&views)) {
            (error @ FusionError::NothingAgrees { .. }, Some(hint)) => {
                Failure::NoResult(format!("{error}; {hint}")).into()
            }
            (error, _) => from_fusion(error),
        },
    )?;
    cloud.finish()?;
    let formats = &options.fusion.formats;
    write_surface(&fused, &posed, formats, &|name| {
        Ok(with_its_folder(writing.path().join(name))?)
    })?;
    // A format that was not written now does not stay with an earlier surface.
    let mut files = Vec::new();
    for name in surface() {
        let (path, written) = (args.output.join(name), writing.path().join(name));
        if written.exists() {
            let path = with_its_folder(path)?;
            std::fs::rename(written, &path).map_err(StoreError::files("replace", &path))?;
            files.push(name);
        } else if path.exists() && ours.contains(&name) {
            std::fs::remove_file(&path).map_err(StoreError::files("remove", &path))?;
        }
    }
    if !files.iter().any(|name| name.starts_with("asset/")) {
        // Only an empty one can be removed, and nothing is lost where it stays.
        let _ = std::fs::remove_dir(args.output.join("asset"));
    }
    let seconds = began.elapsed().as_secs_f64();
    let text = serde_json::json!({
        "program": system::PROGRAM,
        "maps": args.maps.display().to_string(),
        "format": views.format(),
        "unit": unit,
        "options": options.fusion,
        "files": files,
        "warnings": console.take_warnings(StageId::Fusion),
        "seconds": seconds,
        "report": fused.report,
    });
    write_atomically(
        &args.output.join(REPORT),
        &serde_json::to_vec_pretty(&text)?,
    )?;
    console.stage(StageId::Fusion, &StageNews::Finished(seconds));
    console.note(&format!(
        "{} points and {} triangles are in {}",
        fused.report.num_points,
        fused.mesh.triangles.len(),
        Path::display(&args.output)
    ));
    Ok(())
}

/// Files of the surface beside the asset's.
const SURFACE: [&str; 5] = ["cloud.ply", "mesh.ply", "mesh.obj", "mesh.glb", OFFSET];

/// Files that are written.
fn surface() -> impl Iterator<Item = &'static str> {
    SURFACE.into_iter().chain(ASSET_FILES)
}

/// The path of a file, whose folder is made where it is not there.
fn with_its_folder(path: PathBuf) -> Result<PathBuf, StoreError> {
    path.parent().map_or(Ok(()), create_folder)?;
    Ok(path)
}

const REPORT: &str = "report.json";

/// Files of an earlier call of this command, which the next one may replace or remove. Refuses a folder in which others
/// would be replaced, unless they may be.
fn own_results(folder: &Path, overwrite: bool) -> Result<Vec<&'static str>, Failure> {
    let report = own_file(&folder.join(REPORT)).ok().flatten();
    let report = report.and_then(|text| serde_json::from_slice::<serde_json::Value>(&text).ok());
    let report = report.filter(|report| {
        let program = report["program"].as_str().unwrap_or_default();
        program.starts_with("rilievo ") && report.get("maps").is_some()
    });
    let is_ours = |name: &str| match report.as_ref().map(|report| report["files"].as_array()) {
        Some(Some(files)) => name == REPORT || files.iter().any(|file| file == name),
        // Reports without a list are of a time without assets.
        Some(None) => !name.starts_with("asset"),
        None => false,
    };
    let there = |name: &&str| std::fs::symlink_metadata(folder.join(name)).is_ok();
    let found = surface().chain([REPORT]).filter(there);
    let (ours, others): (Vec<&str>, Vec<&str>) = found.partition(|name| is_ours(name));
    if others.is_empty() || overwrite {
        return Ok(ours);
    }
    Err(Failure::Usage(format!(
        "{} holds {} that `rilievo fuse` did not write: choose another folder with -o, or say \
         --overwrite",
        folder.display(),
        others.join(", ")
    )))
}

/// Unit of the results, and the factor from the maps' lengths to it.
fn scale(asked: Option<f64>, unit: Unit) -> Result<(Unit, f64), Failure> {
    match (asked, unit) {
        (None, unit) => Ok(match unit.metres() {
            Some(metres) => (Unit::Metre, metres),
            None => (unit, 1.0),
        }),
        (Some(factor), _) if !(factor.is_finite() && factor > 0.0) => Err(Failure::Usage(format!(
            "--scale {factor} must be a positive number of metres"
        ))),
        (Some(factor), _) if unit.metres().is_some_and(|metres| metres != factor) => {
            Err(Failure::Usage(format!(
                "--scale {factor}: the cameras say that their unit is the {}",
                unit.name()
            )))
        }
        (Some(factor), _) => Ok((Unit::Metre, factor)),
    }
}

/// The views' cameras, in the results' unit.
fn posed(views: &Views, unit: Unit) -> PosedViews {
    let scale = Scale {
        unit,
        source: ScaleSource::GivenPoses,
        relative_sigma: None,
    };
    let posed = views.views.iter().enumerate().map(|(i, view)| {
        let mut cam_from_world = view.cam_from_world;
        cam_from_world.translation *= views.factor;
        PosedView {
            photo: PhotoIdx(i),
            name: maps::name_of(&view.image),
            file_name: view.image.clone(),
            intrinsics: view.intrinsics,
            cam_from_world,
        }
    });
    PosedViews {
        scale,
        frame: views.frame,
        offset: views.offset.map(|v| v * views.factor),
        views: posed.collect(),
        ..PosedViews::default()
    }
}

/// Depths and cameras in different units are the usual reason why nothing agrees.
fn unit_hint(views: &Views) -> Option<String> {
    let centers: Vec<_> = views
        .views
        .iter()
        .map(|v| v.cam_from_world.center_in_source())
        .collect();
    let baseline = centers
        .iter()
        .flat_map(|a| centers.iter().map(move |b| (a - b).norm()))
        .fold(0.0, f64::max);
    let mut depths: Vec<f64> = views.views.iter().filter_map(|v| v.median_depth).collect();
    let ratio = median(&mut depths).filter(|_| baseline > 0.0)? / baseline;
    (!(1.0 / MAX_DEPTH_RATIO..=MAX_DEPTH_RATIO).contains(&ratio)).then(|| {
        format!(
            "the depths are {ratio:.3} times the largest distance between two cameras: are both in \
             one unit?"
        )
    })
}
