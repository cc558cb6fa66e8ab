//! `rilievo clean RUN STAGE`: deletes the results of a stage.

use crate::cli::StageArgs;
use crate::store::RunDir;

/// Runs the command.
///
/// # Errors
/// When the run directory is in use, or something cannot be deleted.
pub fn clean(args: &StageArgs) -> anyhow::Result<()> {
    let run = RunDir::open(&args.run)?;
    if run.clean(args.stage)? {
        say!(
            "{} is deleted; stages that read it will be redone",
            args.stage
        )?;
    } else {
        say!("{} has no result", args.stage)?;
    }
    Ok(())
}
