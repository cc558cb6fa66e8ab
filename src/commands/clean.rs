//! `rilievo clean RUN STAGE`: deletes the results of a stage.

use crate::cli::StageArgs;
use crate::report;
use crate::store::RunDir;

/// Runs the command.
///
/// # Errors
/// When the run directory is in use, or something cannot be deleted.
pub fn clean(args: &StageArgs) -> anyhow::Result<()> {
    let run = RunDir::open(&args.run)?;
    if !run.clean(args.stage)? {
        say!("{} has no result", args.stage)?;
        return Ok(());
    }
    report::drop_evaluation(run.root())?;
    say!(
        "{} is deleted; `rilievo reconstruct` makes it again, and keeps the stages after it that still \
         fit",
        args.stage
    )?;
    Ok(())
}
