//! `rilievo evaluate RUN --truth DIR`: accuracy against ground truth, the alignment said aloud.

mod appearance;
mod comparison;
mod errors;
mod estimate;
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
/// When run or truth cannot be read, have nothing in common, or cannot be aligned as asked.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<()> {
    if !args.truth.is_dir() {
        return Err(Failure::input(&args.truth, "there is no such folder (--truth)").into());
    }
    let comparison = Comparison::open(&args.run, &args.truth, args.align)?;
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
