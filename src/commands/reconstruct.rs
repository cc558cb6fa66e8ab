//! `rilievo reconstruct`: photographs to depth maps, a point cloud and a mesh.

use super::bring::bring_run_up_to_date;
use super::mask::{with_accepted_masks, with_proposed_masks};
use super::reporting::reporting_judged;
use crate::cli::ReconstructArgs;
use crate::observe::Console;
use crate::pipeline::{Range, Request};
use rilievo_scene::StageId;

/// Runs the command.
///
/// # Errors
/// The first failure; stages before it stay committed, and the same command goes on from there.
pub fn reconstruct(args: &ReconstructArgs) -> anyhow::Result<()> {
    reconstruct_to(args, &Console::new(args.work.json))
}

/// The same on a console that is there already.
pub fn reconstruct_to(args: &ReconstructArgs, console: &Console) -> anyhow::Result<()> {
    let range = Range {
        redo_from: args.from,
        overwrite: args.overwrite,
        ..Range::until(args.until.unwrap_or(StageId::Fusion))
    };
    let facts = serde_json::json!({"run": args.output.display().to_string(), "until": range.until});
    reporting_judged(console, args.strict, facts, |console| {
        let request = Request::from_args(args)?;
        let (root, work) = (&args.output, &args.work);
        let request = match args.masks {
            Some(_) => with_accepted_masks(request, root)?,
            None => with_proposed_masks(request, root, range, work, console)?,
        };
        let brought = bring_run_up_to_date(&request, root, range, work, console)?;
        Ok(brought.report(root, console))
    })
}
