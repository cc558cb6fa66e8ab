//! A run directory brought up to date: what `reconstruct` does, and `demo` and `mask` on the way.

use super::handshake::{check_inputs, check_options, open_run};
use crate::cli::WorkArgs;
use crate::exit::Failure;
use crate::interrupt;
use crate::observe::Console;
use crate::pipeline::{
    Context, Inputs, Plan, REPORT, Range, Request, Resources, StageState, WRITING,
    bring_up_to_date, expect, expect_with_masks, is_another_set,
};
use crate::ranks;
use crate::report::{Judgement, Outcome, Report};
use crate::store::{Look, RunDir};
use rilievo_scene::{Observer, StageId};
use std::path::Path;

/// What bringing a run up to date came to.
pub struct Brought {
    /// Whether anything had to be done.
    redone: bool,
    /// How far the result can be relied on; of several processes the first one judges.
    judgement: Option<Judgement>,
    /// Size of the result, where there is one.
    size: Option<String>,
}

impl Brought {
    /// Reports where the results are.
    pub fn report(self, root: &Path, console: &Console) -> Option<Judgement> {
        let root = root.display();
        if self.judgement.is_some() {
            console.note(&if self.redone {
                format!("results are in {root}")
            } else {
                format!("everything in {root} is up to date: nothing to do")
            });
            console.note(&format!("open {root}/report.html first"));
            if let Some(size) = &self.size {
                console.note(&format!("size: {size}"));
            }
        }
        self.judgement
    }
}

/// Opens or creates a run directory for a request, brings its stages up to date and writes its report. Of several
/// processes all work, and the first one writes.
///
/// # Errors
/// The first failure; stages before it stay committed, and the same request goes on from there.
pub fn bring_run_up_to_date(
    request: &Request,
    root: &Path,
    range: Range,
    work: &WorkArgs,
    console: &Console,
) -> anyhow::Result<Brought> {
    if let (Some(from), until) = (range.redo_from, range.until)
        && from > until
    {
        return Err(Failure::Usage(format!("--from {from} comes after --until {until}")).into());
    }
    let resources = Resources::new(work);
    check_options(&serde_json::json!({"request": request, "range": range}))?;
    let run = open_run(root, || {
        let run = RunDir::create_or_open(root)?;
        if run.is_new() {
            // Written first, so that the folder is known as ours whatever follows.
            run.write_run_file(request)?;
        }
        Ok(run)
    })?;
    if let Ok(found) = run.read_run_file()
        && let Some(repaired) = found.repaired
    {
        console.note(&format!("warning: {repaired}"));
    }
    interrupt::is_resumable(ranks::team().size() > 1);
    let mut plan = None;
    let outcome = work_in(&run, request, range, resources, console, &mut plan);
    let outcome = ranks::agree(outcome);
    if !ranks::team().is_first() {
        return outcome.map(|redone| Brought {
            redone,
            judgement: None,
            size: None,
        });
    }
    if outcome.is_ok() {
        // A stop was reported already.
        let _ = console
            .of_command(REPORT)
            .progress(StageId::Fusion, WRITING, (0, 1));
    }
    let is_same = matches!(&outcome, Ok(false));
    let report = write_report(&run, request, plan.as_ref(), &outcome, is_same);
    // A report that cannot be written must not hide why the run failed.
    let (redone, report) = (outcome?, report?);
    Ok(Brought {
        redone,
        size: report.size(),
        judgement: Some(report.into_judgement()),
    })
}

/// Reports on a run and how its work ended; what is written already stays where the run `is_same`.
pub fn write_report<T>(
    run: &RunDir,
    request: &Request,
    plan: Option<&Plan>,
    outcome: &anyhow::Result<T>,
    is_same: bool,
) -> anyhow::Result<Report> {
    let ended = Outcome::of(outcome.as_ref().err());
    let report = Report::gather(run, request, &ended, plan)?;
    if !is_same || !report.is_told_by(run) {
        report.write(run)?;
    }
    Ok(report)
}

/// A finished run of other photos is somebody's work: it is not replaced by accident.
fn same_object(run: &RunDir, inputs: &Inputs) -> Result<(), Failure> {
    match run.manifest(StageId::Photos) {
        Ok(Some(manifest)) if is_another_set(inputs, &manifest.ingredients) => {
            Err(Failure::Usage(format!(
                "{} holds a run of other photos (none of {} is the same): choose another folder \
                 with -o, or say --overwrite to replace its results",
                run.root().display(),
                inputs.photos.len(),
            )))
        }
        _ => Ok(()),
    }
}

/// Brings stages up to date; returns whether anything had to be done.
fn work_in(
    run: &RunDir,
    request: &Request,
    range: Range,
    resources: Resources,
    console: &Console,
    planned: &mut Option<Plan>,
) -> anyhow::Result<bool> {
    let inputs = Inputs::scan(request)?;
    let plan = planned.insert(Plan::new(request, &inputs));
    check_inputs(&inputs, plan)?;
    if !range.overwrite {
        same_object(run, &inputs)?;
    }
    if ranks::team().is_first() {
        // A request whose files cannot be used does not replace the one that the results are of.
        run.write_run_file(request)?;
    }
    let context = Context {
        run,
        request,
        inputs: &inputs,
        resources,
        console,
    };
    if ranks::team().is_first() {
        if let Some(until) = range.then_masked_until {
            expect_with_masks(request, &inputs, until, console);
        } else if range.until >= StageId::Shading
            && plan.state(run, StageId::Shading, Look::Sizes)? != StageState::Valid
        {
            plan.expected = expect(request, &inputs, resources, range.until, console);
        }
    }
    let redone = bring_up_to_date(&context, plan, range)?;
    Ok(!redone.is_empty())
}
