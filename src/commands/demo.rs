//! `rilievo demo`: a synthetic scene, photographed to JPEG files, reconstructed from those files
//! alone through all six stages, and measured against the truth.

use super::bring::bring_run_up_to_date;
use super::evaluate::{self, Comparison};
use super::reporting::reporting_judged;
use super::synth::{SynthOptions, is_new, is_set, not_ours, write_set};
use crate::cli::{DemoArgs, SynthFormat};
use crate::config::StageOptions;
use crate::observe::Console;
use crate::pipeline::{Range, Request, SphereInput};
use crate::report::Judgement;
use crate::store::{RunDir, absolute};
use rilievo_scene::StageId;
use rilievo_synthetic::compare::AlignmentRequest;
use std::path::Path;

/// Runs the command.
pub fn demo(args: &DemoArgs) -> anyhow::Result<()> {
    let facts = serde_json::json!({"folder": args.output.display().to_string()});
    reporting_judged(&Console::new(args.work.json), false, facts, |console| {
        run(args, console)
    })
}

fn run(args: &DemoArgs, console: &Console) -> anyhow::Result<Option<Judgement>> {
    let folder = absolute(&args.output)?;
    let set = folder.join("photographed");
    let run = folder.join("run");
    if !is_set(&set) && !is_new(&folder)? {
        return Err(not_ours(&args.output, "demo").into());
    }
    start_afresh(&run)?;
    photograph(&set, args.seed, console)?;
    let request = Request {
        masks: Some(set.join("masks")),
        cameras: Some(set.join("intrinsics.json")),
        sphere: SphereInput::File {
            path: set.join("sphere.json"),
            radius: None,
        },
        ..Request::of_photos(vec![set.join("photos")], StageOptions::default())
    };
    let range = Range {
        overwrite: true,
        ..Range::until(StageId::Fusion)
    };
    let brought = bring_run_up_to_date(&request, &run, range, &args.work, console)?;
    let judgement = brought.report(&run, console);
    let comparison = Comparison::open(&run, &set.join("truth"), AlignmentRequest::Se3)?;
    let evaluation = comparison.measure()?;
    comparison.show(&evaluation, &|line| tell!("{line}"))?;
    if args.work.json {
        let line = serde_json::json!({"event": "evaluation", "evaluation": evaluation});
        say!("{line}")?;
        return Ok(judgement);
    }
    say!(
        "\nAccuracy against the truth:\n{}",
        evaluate::table(&evaluation)
    )?;
    for (what, file) in [
        ("photos and truth", "photographed"),
        ("depth maps", "run/5_shading/depth"),
        ("normal maps", "run/5_shading/normal"),
        ("point cloud", "run/6_fusion/cloud.ply"),
        ("mesh", "run/6_fusion/mesh.ply"),
        ("asset", "run/6_fusion/asset.glb"),
        ("report", "run/report.html"),
    ] {
        say!("{what:<16}  {}", args.output.join(file).display())?;
    }
    Ok(judgement)
}

/// Photographs the scene.
fn photograph(set: &Path, seed: u64, console: &Console) -> anyhow::Result<()> {
    console.note("photographing a synthetic scene");
    let mut options = SynthOptions::default();
    options.scene.seed = seed;
    write_set(
        set,
        &options,
        SynthFormat::Jpeg,
        None,
        &console.of_command("demo"),
    )
}

/// Deletes what an earlier demo left: this one shows what this program does, all of it.
fn start_afresh(run: &Path) -> anyhow::Result<()> {
    if run.join("run.json").exists() {
        let run = RunDir::open(run)?;
        for stage in StageId::ALL {
            run.clean(stage)?;
        }
    }
    Ok(())
}
