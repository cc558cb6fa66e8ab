//! `rilievo shade`: shape from shading alone, one view or several coupled (eq. 17), and refinement
//! of a measured depth.
//!
//! Writes `DIR/depth/NAME.exr`, `DIR/normal/NAME.exr`, `DIR/rendered/NAME.exr` with a picture
//! beside each, and `DIR/report.json`.

mod depth_order;
mod problem;

use super::reporting::reporting;
use crate::cli::ShadeArgs;
use crate::config::{StageOptions, take_over};
use crate::exit::Failure;
use crate::observe::{Console, StageNews};
use crate::pipeline::{Resources, from_shading, write_maps};
use crate::store::{create_folder, write_atomically};
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
    create_folder(&args.output)?;

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
    take_over(&mut options.photos.encoding, args.encoding);
    let paper = &mut options.shading.paper;
    take_over(&mut paper.splitting, args.splitting);
    take_over(&mut paper.projection, args.projection);
    take_over(&mut paper.area_weight, args.area_weight);
    let order = args.order.map(|order| match order {
        1 => HarmonicOrder::First,
        _ => HarmonicOrder::Second,
    });
    take_over(&mut paper.order, order);
    let start = args.init.as_deref().map(|init| match init {
        "plane" => StartShape::Plane,
        "anchors" => StartShape::Anchors,
        _ => StartShape::Given,
    });
    take_over(&mut paper.start, start);
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
        create_folder(dir)?;
        Ok(path)
    };
    write_maps(&path, &shaded)?;
    Ok(())
}
