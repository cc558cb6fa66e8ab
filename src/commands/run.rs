//! `rilievo run STAGE RUN`: one stage again, with what the run directory says.

use super::bring::write_report;
use super::handshake::{check_inputs, check_options, open_run};
use super::reporting::reporting_judged;
use super::stored::{check_upstream, stored_request};
use crate::cli::RunArgs;
use crate::observe::Console;
use crate::pipeline::{Context, Inputs, Plan, Resources, run_stage};
use crate::ranks;
use crate::report::Judgement;
use crate::store::RunDir;
use rilievo_scene::StageId;

/// Runs the command.
///
/// # Errors
/// When a stage that this one reads is missing or stale, or the stage fails.
pub fn run(args: &RunArgs) -> anyhow::Result<()> {
    let facts = serde_json::json!({"run": args.run.display().to_string(), "stage": args.stage});
    reporting_judged(&Console::new(args.work.json), false, facts, |console| {
        redo(args, console)
    })
}

fn redo(args: &RunArgs, console: &Console) -> anyhow::Result<Option<Judgement>> {
    let resources = Resources::new(&args.work);
    check_options(&serde_json::json!({"stage": args.stage}))?;
    let run = open_run(&args.run, || Ok(RunDir::open(&args.run)?))?;
    let mut request = stored_request(&run)?;
    if args.stage == StageId::Fusion {
        args.work.bound(&mut request.options.fusion);
    }
    let inputs = Inputs::scan(&request)?;
    let plan = Plan::new(&request, &inputs);
    check_inputs(&inputs, &plan)?;
    check_upstream(&run, &plan, args.stage)?;
    let context = Context {
        run: &run,
        request: &request,
        inputs: &inputs,
        resources,
        console,
    };
    let outcome = run_stage(&context, &plan, args.stage, "redone as asked");
    let outcome = ranks::agree(outcome);
    if !ranks::team().is_first() {
        return outcome.map(|()| None);
    }
    let report = write_report(&run, &request, Some(&plan), &outcome, false);
    // A report that cannot be written must not hide why the stage failed.
    outcome?;
    Ok(Some(report?.into_judgement()))
}
