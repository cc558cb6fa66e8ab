//! `rilievo fuse`: depth and normal maps of other programs to one cloud and one mesh.

mod maps;
mod photos;

use super::reporting;
use crate::cli::FuseArgs;
use crate::config::StageOptions;
use crate::exit::Failure;
use crate::observe::{Console, StageNews};
use crate::pipeline::{Resources, from_fusion, write_surface};
use crate::store::{StoreError, write_atomically};
use maps::Views;
use rilievo_scene::{
    PhotoIdx, PhotoSet, PosedView, PosedViews, Scale, ScaleSource, ShadedView, ShadedViews,
    StageId, Unit, ViewIdx,
};
use std::path::Path;
use std::time::Instant;

/// Ratio of depths to the cameras' distances beyond which they are hardly in one unit: metres and
/// millimetres differ by a thousand.
const MAX_DEPTH_RATIO: f64 = 200.0;

/// Runs the command.
///
/// # Errors
/// When maps or cameras cannot be used, nothing agrees, or the results cannot be written.
pub fn fuse(args: &FuseArgs) -> anyhow::Result<()> {
    let facts = serde_json::json!({"folder": args.output});
    reporting(args.work.json, facts, |console| run(args, console))
}

fn run(args: &FuseArgs, console: &Console) -> anyhow::Result<()> {
    // Sets the number of threads.
    let _resources = Resources::new(&args.work);
    let mut options = StageOptions::read(args.config.as_deref())?;
    args.surface.apply(&mut options.fusion);
    options.validate()?;
    let Views {
        format,
        unit,
        views,
    } = maps::read(&args.maps, args.cameras.as_deref())?;
    let slopes = views.iter().filter(|v| v.normals_are_slopes).count();
    let (unit, factor) = scale(args.scale, unit)?;
    if unit == Unit::Arbitrary {
        console.warn(
            StageId::Fusion,
            "the maps tell no unit: lengths are written as they are; --scale METRES makes metres",
        );
    }
    if slopes > 0 {
        let message = format!(
            "{slopes} of {} views have no normal map: the depths' slopes stand in, with less detail",
            views.len()
        );
        console.warn(StageId::Fusion, message);
    }
    let (mut posed, shaded) = assemble(views, unit, factor);
    let photos = match &args.photos {
        Some(folder) => photos::find(folder, &mut posed)?,
        None => PhotoSet::default(),
    };
    std::fs::create_dir_all(&args.output).map_err(StoreError::files("create", &args.output))?;

    let began = Instant::now();
    let started = format!("{} views of {format}", posed.views.len());
    console.stage(StageId::Fusion, &StageNews::Started(started));
    let (fused, report) = rilievo_fusion::run(&photos, &posed, &shaded, &options.fusion, console)
        .map_err(|error| {
        let hint = unit_hint(&posed, &shaded);
        match (from_fusion(error), hint) {
            (error, None) => error,
            (error, Some(hint)) => Failure::NoResult(format!("{error}; {hint}")).into(),
        }
    })?;
    console.warn_all(StageId::Fusion, &report.warnings);
    write_surface(&fused, &posed, &|name| Ok(args.output.join(name)))?;
    let seconds = began.elapsed().as_secs_f64();
    let text = serde_json::json!({
        "program": concat!("rilievo ", env!("CARGO_PKG_VERSION")),
        "maps": args.maps,
        "format": format,
        "unit": unit,
        "options": options.fusion,
        "warnings": console.take_warnings(StageId::Fusion),
        "seconds": seconds,
        "report": report,
    });
    write_atomically(
        &args.output.join("report.json"),
        &serde_json::to_vec_pretty(&text)?,
    )?;
    console.stage(StageId::Fusion, &StageNews::Finished(seconds));
    console.note(&format!(
        "{} points and {} triangles are in {}",
        report.num_points,
        fused.mesh.triangles.len(),
        Path::display(&args.output)
    ));
    Ok(())
}

/// Unit of the results, and the factor from the maps' lengths to it.
fn scale(asked: Option<f64>, unit: Unit) -> Result<(Unit, f64), Failure> {
    match (asked, unit) {
        (None, unit) => Ok((unit, 1.0)),
        (Some(factor), _) if !(factor.is_finite() && factor > 0.0) => Err(Failure::Usage(format!(
            "--scale {factor} must be a positive number of metres"
        ))),
        (Some(factor), Unit::Metre) if factor != 1.0 => Err(Failure::Usage(format!(
            "--scale {factor}: the cameras say that their unit is the metre"
        ))),
        (Some(factor), _) => Ok((Unit::Metre, factor)),
    }
}

fn assemble(views: Vec<maps::View>, unit: Unit, factor: f64) -> (PosedViews, ShadedViews) {
    let mut posed = PosedViews {
        scale: Scale {
            unit,
            source: ScaleSource::GivenPoses,
            relative_sigma: None,
        },
        ..PosedViews::default()
    };
    let mut shaded = ShadedViews::default();
    for (i, mut view) in views.into_iter().enumerate() {
        let name = Path::new(&view.image).file_stem().map_or_else(
            || view.image.clone(),
            |stem| stem.to_string_lossy().into_owned(),
        );
        view.cam_from_world.translation *= factor;
        for z in &mut view.depth.data {
            *z = (f64::from(*z) * factor) as f32;
        }
        posed.views.push(PosedView {
            photo: PhotoIdx(i),
            name: name.clone(),
            file_name: view.image,
            intrinsics: view.intrinsics,
            cam_from_world: view.cam_from_world,
        });
        shaded.views.push(ShadedView {
            view: ViewIdx(i),
            name,
            depth: view.depth,
            normal: view.normal,
            confidence: view.confidence,
            rendered: None,
            albedo: None,
        });
    }
    (posed, shaded)
}

/// Depths and cameras in different units are the usual reason why nothing agrees.
fn unit_hint(posed: &PosedViews, shaded: &ShadedViews) -> Option<String> {
    let centers: Vec<_> = posed
        .views
        .iter()
        .map(|v| v.cam_from_world.center_in_source())
        .collect();
    let baseline = centers
        .iter()
        .flat_map(|a| centers.iter().map(move |b| (a - b).norm()))
        .fold(0.0, f64::max);
    let mut depths: Vec<f32> = shaded
        .views
        .iter()
        .flat_map(|v| v.depth.data.iter().step_by(17))
        .copied()
        .filter(|z| z.is_finite() && *z > 0.0)
        .collect();
    if depths.is_empty() || baseline <= 0.0 {
        return None;
    }
    let middle = depths.len() / 2;
    let depth = f64::from(*depths.select_nth_unstable_by(middle, f32::total_cmp).1);
    let ratio = depth / baseline;
    (!(1.0 / MAX_DEPTH_RATIO..=MAX_DEPTH_RATIO).contains(&ratio)).then(|| {
        format!(
            "the depths are {ratio:.3} times the largest distance between two cameras: are both in \
             one unit?"
        )
    })
}
