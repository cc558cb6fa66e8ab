//! `rilievo shade`: shape from shading alone, one view or several coupled (eq. 17), and refinement
//! of a measured depth.
//!
//! Writes `DIR/depth/NAME.exr`, `DIR/normal/NAME.exr`, `DIR/rendered/NAME.exr` with a picture
//! beside each, and `DIR/report.json`.

mod depth_order;
mod problem;

use super::reporting::reporting;
use crate::cli::{Projection, ShadeArgs, Splitting};
use crate::config::StageOptions;
use crate::exit::Failure;
use crate::observe::{Console, StageNews};
use crate::pipeline::{Resources, from_shading, write_maps};
use crate::store::{StoreError, write_atomically};
use crate::system;
use rilievo_scene::{ShadedView, StageId, ViewIdx};
use rilievo_shading::paper::{HarmonicOrder, SolvedView, StartShape};
use std::path::Path;
use std::time::Instant;

/// Runs the command.
///
/// # Errors
/// Unusable input, or a problem that the solver refuses.
pub fn shade(args: &ShadeArgs) -> anyhow::Result<()> {
    let facts = serde_json::json!({"folder": args.output.display().to_string()});
    reporting(args.work.json, facts, |console| run(args, console))
}

fn run(args: &ShadeArgs, console: &Console) -> anyhow::Result<()> {
    // Sets the number of threads; shading has no memory to bound.
    let _ = Resources::new(&args.work);
    let options = options(args)?;
    let problem = problem::build(args, &options, console)?;
    std::fs::create_dir_all(&args.output).map_err(StoreError::files("create", &args.output))?;

    let began = Instant::now();
    let started = format!("solving {} view(s)", problem.problem.views.len());
    console.stage(StageId::Shading, &StageNews::Started(started));
    let solution = rilievo_shading::paper::solve(&problem.problem, &options.shading.paper, console)
        .map_err(from_shading)?;
    for (index, view) in solution.views.into_iter().enumerate() {
        write_view(&args.output, index, view)?;
    }
    let seconds = began.elapsed().as_secs_f64();
    let report = serde_json::json!({
        "program": system::PROGRAM,
        "options": options.shading,
        "lighting": problem.lighting,
        "warnings": console.take_warnings(StageId::Shading),
        "seconds": seconds,
        "report": solution.report,
    });
    write_atomically(
        &args.output.join("report.json"),
        &serde_json::to_vec_pretty(&report)?,
    )?;
    console.stage(StageId::Shading, &StageNews::Finished(seconds));
    for view in &solution.report.views {
        console.note(&format!(
            "  {}: {} pixels, re-rendered image differs by {:.4} RMS (start {:.4})",
            view.name, view.num_pixels, view.rms_rendered, view.rms_start
        ));
    }
    console.note(&format!("results are in {}", args.output.display()));
    Ok(())
}

fn options(args: &ShadeArgs) -> Result<StageOptions, Failure> {
    let mut options = StageOptions::read(args.config.as_deref())?;
    options.override_with(None, None, args.encoding);
    match args.splitting {
        Some(Splitting::Full) => {
            options.shading.paper.splitting = rilievo_shading::paper::Splitting::Full
        }
        Some(Splitting::Paper) => {
            options.shading.paper.splitting = rilievo_shading::paper::Splitting::Paper
        }
        Some(Splitting::FixedPoint) => {
            options.shading.paper.splitting = rilievo_shading::paper::Splitting::FixedPoint;
        }
        None => {}
    }
    match args.order {
        Some(1) => options.shading.paper.order = HarmonicOrder::First,
        Some(_) => options.shading.paper.order = HarmonicOrder::Second,
        None => {}
    }
    match args.projection {
        Some(Projection::Perspective) => {
            options.shading.paper.projection = rilievo_shading::paper::Projection::Perspective;
        }
        Some(Projection::Orthographic) => {
            options.shading.paper.projection = rilievo_shading::paper::Projection::Orthographic;
        }
        None => {}
    }
    match args.init.as_deref() {
        None => {}
        Some("plane") => options.shading.paper.start = StartShape::Plane,
        Some("anchors") => options.shading.paper.start = StartShape::Anchors,
        Some(_) => options.shading.paper.start = StartShape::Given,
    }
    if let Some(weight) = args.area_weight {
        options.shading.paper.area_weight = weight;
    }
    options.validate()?;
    Ok(options)
}

/// The maps of a view as the stage's own run would write them.
fn write_view(folder: &Path, index: usize, view: SolvedView) -> anyhow::Result<()> {
    let shaded = ShadedView {
        view: ViewIdx(index),
        name: view.name,
        depth: view.depth,
        normal: view.normal,
        confidence: view.confidence,
        rendered: Some(view.rendered),
        albedo: None,
    };
    let path = |file: &str| {
        let path = folder.join(file);
        let dir = path.parent().unwrap_or(folder);
        std::fs::create_dir_all(dir).map_err(StoreError::files("create", dir))?;
        Ok(path)
    };
    write_maps(&path, &shaded)?;
    Ok(())
}
