//! `rilievo evaluate RUN --truth DIR`: accuracy against ground truth, the alignment said aloud; with `--halves`,
//! without a truth, what two halves of the photos agree on.

mod appearance;
mod comparison;
mod errors;
mod estimate;
mod halves;
mod optional_file;
mod parts;
mod table;
mod truth;

pub use comparison::Comparison;
pub use table::table;

use crate::cli::EvaluateArgs;
use crate::exit::Failure;
use rilievo_synthetic::compare::{AlignmentRequest, Evaluation};
use std::path::Path;

/// Runs the command.
///
/// # Errors
/// When run or truth cannot be read, have nothing in common, or cannot be aligned as asked; when the halves cannot be
/// shaped.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<()> {
    let Some(truth) = &args.truth else {
        return halves::evaluate(&args.run, args.json);
    };
    let comparison = compared(&args.run, truth, args.align)?;
    if let Some(failure) = comparison.nothing_in_common()? {
        // Programs get their nulls with the reasons all the same.
        if args.json
            && let Ok(evaluation) = comparison.measure()
        {
            say!("{}", serde_json::to_string_pretty(&evaluation)?)?;
        }
        return Err(failure.into());
    }
    let evaluation = comparison.measure()?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&evaluation)?)?;
    } else {
        say!("{}", table(&evaluation).trim_end())?;
    }
    comparison.show(&evaluation, &|line| tell!("{line}"))
}

/// The numbers without printing them; they are shown in the run's report as [`evaluate`] does.
pub fn evaluation(
    run: &Path,
    truth: &Path,
    align: AlignmentRequest,
    note: &dyn Fn(&str),
) -> anyhow::Result<Evaluation> {
    let comparison = compared(run, truth, align)?;
    if let Some(failure) = comparison.nothing_in_common()? {
        return Err(failure.into());
    }
    let evaluation = comparison.measure()?;
    comparison.show(&evaluation, note)?;
    Ok(evaluation)
}

fn compared(run: &Path, truth: &Path, align: AlignmentRequest) -> anyhow::Result<Comparison> {
    if !truth.is_dir() {
        return Err(Failure::input(truth, "there is no such folder (--truth)").into());
    }
    Comparison::open(run, truth, align)
}
