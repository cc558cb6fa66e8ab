//! `rilievo run STAGE RUN`: one stage again, with what the run directory says.

use super::reporting::reporting;
use super::stored::{check_upstream, stored_request};
use crate::cli::RunArgs;
use crate::observe::Console;
use crate::pipeline::{Context, Inputs, Plan, Resources, run_stage};
use crate::report::{self, Outcome};
use crate::store::RunDir;

/// Runs the command.
///
/// # Errors
/// When a stage that this one reads is missing or stale, or the stage fails.
pub fn run(args: &RunArgs) -> anyhow::Result<()> {
    let facts = serde_json::json!({"run": args.run.display().to_string(), "stage": args.stage});
    reporting(args.work.json, facts, |console| redo(args, console))
}

fn redo(args: &RunArgs, console: &Console) -> anyhow::Result<()> {
    let resources = Resources::new(&args.work);
    let run = RunDir::open(&args.run)?;
    let request = stored_request(&run)?;
    let inputs = Inputs::scan(&request)?;
    let plan = Plan::new(&request, &inputs);
    check_upstream(&run, &plan, args.stage)?;
    let context = Context {
        run: &run,
        request: &request,
        inputs: &inputs,
        resources,
        console,
    };
    let outcome = run_stage(&context, &plan, args.stage, "redone as asked");
    let written = report::write(
        &run,
        &request,
        &Outcome::of(outcome.as_ref().err()),
        Some(&plan),
    );
    outcome?;
    written
}
