//! What a run directory was made for.

use crate::exit::Failure;
use crate::paths;
use crate::pipeline::Request;
use crate::store::{RunDir, StoreError, absolute};

/// The request that a run directory was made for, as it stands where the run is now; a damage of
/// `run.json` is told.
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
