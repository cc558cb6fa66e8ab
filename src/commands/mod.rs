//! One file per command of the command line.

mod cameras;
mod check;
mod clean;
mod demo;
mod diligent;
mod evaluate;
mod fuse;
mod mask;
mod output_files;
mod reconstruct;
mod run;
mod shade;
mod status;
mod synth;

#[cfg(test)]
pub use synth::SynthOptions;

use crate::cli::Command;
use crate::exit::Failure;
use crate::observe::Console;
use crate::paths;
use crate::pipeline::Request;
use crate::store::{RunDir, StoreError};

/// Runs the command of a command line.
///
/// # Errors
/// Whatever makes the command fail; [`crate::exit::code_of`] knows its exit code.
pub fn dispatch(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(args) => demo::demo(&args),
        Command::Reconstruct(args) => reconstruct::reconstruct(&args),
        Command::Run(args) => run::run(&args),
        Command::Status(args) => status::status(&args),
        Command::Why(args) => status::why(&args),
        Command::Clean(args) => clean::clean(&args),
        Command::Shade(args) => shade::shade(&args),
        Command::Evaluate(args) => evaluate::evaluate(&args),
        Command::Fuse(args) => fuse::fuse(&args),
        Command::Synth(args) => synth::synth(&args),
        Command::Check(args) => check::check(&args),
        Command::Mask(args) => mask::mask(&args),
        Command::Import(args) => cameras::import(&args),
        Command::Export(args) => cameras::export(&args),
        // Answered before any command: it is no work of the user's.
        Command::DecodeRaw(_) => Ok(()),
    }
}

/// The request that a run directory was made for, as it stands where the run is now; a damage of
/// `run.json` is told.
fn stored_request(run: &RunDir) -> Result<Request, Failure> {
    let found = run.read_run_file()?;
    if let Some(repaired) = &found.repaired {
        tell!("warning: {repaired}");
    }
    let request: Request = serde_json::from_value(found.request).map_err(|error| {
        Failure::from(StoreError::DamagedRequest {
            path: run.root().join("run.json"),
            reason: error.to_string(),
        })
    })?;
    let place = std::path::absolute(run.root()).map_err(StoreError::files("find", run.root()))?;
    Ok(match paths::from_json(&found.root) {
        Some(before) if before != place => request.moved(&before, &place),
        _ => request,
    })
}

/// Runs a command with a console, and tells scripts how it ended: its exit code, its error, and
/// what `facts` names of it.
fn reporting(
    json: bool,
    facts: serde_json::Value,
    command: impl FnOnce(&Console) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    reporting_found(json, |console| (command(console), facts))
}

/// As [`reporting`], with facts that the command finds, whether it fails or not.
fn reporting_found(
    json: bool,
    command: impl FnOnce(&Console) -> (anyhow::Result<()>, serde_json::Value),
) -> anyhow::Result<()> {
    let console = Console::new(json);
    let (outcome, facts) = command(&console);
    let mut line = serde_json::json!({ "exit_code": 0 });
    if let (Some(line), serde_json::Value::Object(facts)) = (line.as_object_mut(), facts) {
        line.extend(facts);
    }
    if let Err(error) = &outcome {
        line["exit_code"] = crate::exit::code_of(error).into();
        line["error"] = format!("{error:#}").into();
    }
    console.finished(&line);
    outcome
}
