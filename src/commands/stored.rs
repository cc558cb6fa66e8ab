//! What a run directory was made for.

use crate::exit::Failure;
use crate::paths;
use crate::pipeline::{Plan, Request, StageState, upstream};
use crate::store::{Look, RunDir, StoreError, absolute};
use rilievo_scene::StageId;

/// The request that a run directory was made for, as it stands where the run is now; warns where
/// `run.json` is damaged.
pub fn stored_request(run: &RunDir) -> Result<Request, Failure> {
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
    let place = absolute(run.root())?;
    Ok(match paths::from_json(&found.root) {
        Some(before) if before != place => request.moved(&before, &place),
        _ => request,
    })
}

/// Refuses to redo what a stage makes where a stage that it reads is missing, stale or damaged.
///
/// # Errors
/// Names that stage, and what is wrong with it.
pub fn check_upstream(run: &RunDir, plan: &Plan, stage: StageId) -> anyhow::Result<()> {
    for &needed in upstream(stage) {
        match plan.state(run, needed, Look::Contents)? {
            StageState::Valid => {}
            state => {
                return Err(Failure::RunDirectory(format!(
                    "stage {stage} needs {needed}, which is {state}; run it first, or use \
                     `rilievo reconstruct`"
                ))
                .into());
            }
        }
    }
    Ok(())
}
