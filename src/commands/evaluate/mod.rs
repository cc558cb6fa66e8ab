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

/// Runs the command.
///
/// # Errors
/// When run or truth cannot be read, have nothing in common, or cannot be aligned as asked; when the halves cannot be
/// shaped.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<()> {
    let Some(truth) = &args.truth else {
        return halves::evaluate(&args.run, args.json);
    };
    if !truth.is_dir() {
        return Err(Failure::input(truth, "there is no such folder (--truth)").into());
    }
    let comparison = Comparison::open(&args.run, truth, args.align)?;
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
    comparison.show(&evaluation)
}
