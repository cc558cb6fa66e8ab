//! `rilievo shade`: shape from shading alone, one view or several coupled (eq. 17), and refinement
//! of a measured depth.
//!
//! Writes `DIR/depth/NAME.exr`, `DIR/normal/NAME.exr`, `DIR/rendered/NAME.exr` with a picture
//! beside each, and `DIR/report.json`.

mod depth_order;
mod described;
mod problem;

pub use described::{Described, ViewParts};

use super::reporting::reporting;
use crate::cli::ShadeArgs;
use crate::config::{StageOptions, take_over};
use crate::exit::Failure;
use crate::observe::{Console, StageNews};
use crate::pipeline::{Resources, from_shading, write_maps};
use crate::store::{create_folder, write_atomically};
use crate::system;
use rilievo_scene::{ShadedView, StageId, ViewIdx};
use rilievo_shading::paper::{HarmonicOrder, PaperReport, SolvedView, StartShape};
use std::path::Path;
use std::time::Instant;

/// Runs the command.
///
/// # Errors
/// Unusable input, or a problem that the solver refuses.
pub fn shade(args: &ShadeArgs) -> anyhow::Result<()> {
    let facts = serde_json::json!({"folder": args.output.display().to_string()});
    reporting(&Console::new(args.work.json), facts, |console| {
        run(args, console)
    })
}

fn run(args: &ShadeArgs, console: &Console) -> anyhow::Result<()> {
    // Sets the number of threads; shading has no memory to bound.
    let _ = Resources::new(&args.work);
    let options = options(args)?;
    let problem = problem::build(args, &options, console)?;
    create_folder(&args.output)?;
    let solved = solve(&problem, &options, console, |index, view| {
        write_view(&args.output, index, view)
    })?;
    write_atomically(
        &args.output.join("report.json"),
        &serde_json::to_vec_pretty(&solved.report)?,
    )?;
    solved.report(console);
    console.note(&format!("results are in {}", args.output.display()));
    Ok(())
}

/// What became of a problem, beside its views.
pub struct Solved {
    /// As `report.json` holds it.
    pub report: serde_json::Value,
    facts: PaperReport,
    seconds: f64,
}

impl Solved {
    /// Reports that the work is done, and how well it went.
    pub fn report(&self, console: &Console) {
        console.stage(StageId::Shading, &StageNews::Finished(self.seconds));
        for view in &self.facts.views {
            console.note(&format!(
                "  {}: {} pixels, re-rendered image differs by {:.4} RMS (start {:.4})",
                view.name, view.num_pixels, view.rms_rendered, view.rms_start
            ));
        }
    }
}

/// Solves a problem and hands its views to `keep`.
///
/// # Errors
/// A problem that the solver refuses, or what `keep` fails with.
pub fn solve(
    described: &Described,
    options: &StageOptions,
    console: &Console,
    mut keep: impl FnMut(usize, SolvedView) -> anyhow::Result<()>,
) -> anyhow::Result<Solved> {
    let began = Instant::now();
    let problem = &described.problem;
    let started = format!("solving {} view(s)", problem.views.len());
    console.stage(StageId::Shading, &StageNews::Started(started));
    let solution = rilievo_shading::paper::solve(problem, &options.shading.paper, console)
        .map_err(from_shading)?;
    for (index, view) in solution.views.into_iter().enumerate() {
        keep(index, view)?;
    }
    let seconds = began.elapsed().as_secs_f64();
    let report = serde_json::json!({
        "program": system::PROGRAM,
        "options": options.shading,
        "lighting": described.lighting,
        "warnings": console.take_warnings(StageId::Shading),
        "seconds": seconds,
        "report": solution.report,
    });
    Ok(Solved {
        report,
        facts: solution.report,
        seconds,
    })
}

/// The options of the stages that a command line asks for.
///
/// # Errors
/// A config file that cannot be used, or a value out of its range.
pub fn options(args: &ShadeArgs) -> Result<StageOptions, Failure> {
    let mut options = StageOptions::read(args.config.config.as_deref())?;
    take_over(&mut options.photos.encoding, args.encoding.encoding);
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
        confidence: Some(view.confidence),
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
