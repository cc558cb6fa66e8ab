//! `rilievo demo`: a synthetic scene, photographed to JPEG files, reconstructed from those files
//! alone through all six stages, and measured against the truth.

use super::evaluate;
use super::finish;
use super::reconstruct::bring_run_up_to_date;
use super::synth::{SynthOptions, write_set};
use crate::cli::DemoArgs;
use crate::config::StageOptions;
use crate::observe::Console;
use crate::pipeline::{LightingInput, Range, Request, SphereInput};
use crate::store::{StoreError, write_atomically};
use rilievo_scene::StageId;
use rilievo_synthetic::compare::AlignmentRequest;
use std::path::Path;

/// Runs the command.
///
/// # Errors
/// When a stage fails, or the folder cannot be written.
pub fn demo(args: &DemoArgs) -> anyhow::Result<()> {
    let console = Console::new(args.work.json);
    let outcome = run(args, &console);
    finish(
        &console,
        &outcome,
        serde_json::json!({"folder": args.output}),
    );
    outcome
}

fn run(args: &DemoArgs, console: &Console) -> anyhow::Result<()> {
    let folder =
        std::path::absolute(&args.output).map_err(StoreError::files("find", &args.output))?;
    let set = folder.join("photographed");
    photograph(&set, args.seed, console)?;
    let request = Request {
        photos: vec![set.join("photos")],
        masks: Some(set.join("masks")),
        cameras: Some(set.join("intrinsics.json")),
        sphere: SphereInput::File {
            path: set.join("sphere.json"),
            radius: None,
        },
        lighting: LightingInput::Found,
        options: StageOptions::default(),
    };
    let range = Range {
        redo_from: None,
        until: StageId::Fusion,
    };
    let run = folder.join("run");
    bring_run_up_to_date(&request, &run, range, &args.work, console)?;
    let evaluation = evaluate::measure(&run, &set.join("truth"), AlignmentRequest::Se3)?;
    if args.work.json {
        let line = serde_json::json!({"event": "evaluation", "evaluation": evaluation});
        println!("{line}");
        return Ok(());
    }
    println!(
        "\nAccuracy against the truth:\n{}",
        evaluate::table(&evaluation)
    );
    println!("photos and truth  {}", set.display());
    println!(
        "depth maps        {}",
        run.join("5_shading/depth").display()
    );
    println!(
        "normal maps       {}",
        run.join("5_shading/normal").display()
    );
    println!(
        "point cloud       {}",
        run.join("6_fusion/cloud.ply").display()
    );
    println!(
        "mesh              {}",
        run.join("6_fusion/mesh.ply").display()
    );
    println!("report            {}", run.join("report.html").display());
    Ok(())
}

/// Photographs the scene, unless this version did so before with the same seed.
fn photograph(set: &Path, seed: u64, console: &Console) -> anyhow::Result<()> {
    let mark = set.join("made.json");
    let what = format!(
        "{{\"program\": \"rilievo {}\", \"seed\": {seed}}}\n",
        env!("CARGO_PKG_VERSION")
    );
    if std::fs::read_to_string(&mark).is_ok_and(|found| found == what) {
        return Ok(());
    }
    console.note("photographing a synthetic scene");
    let mut options = SynthOptions::default();
    options.scene.seed = seed;
    write_set(set, &options, console)?;
    write_atomically(&mark, what.as_bytes())?;
    Ok(())
}
