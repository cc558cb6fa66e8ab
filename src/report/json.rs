//! `report.json`: outcome, stages with their facts and warnings, and where the results lie.

use super::Outcome;
use super::system::peak_memory;
use crate::pipeline::{Plan, Request};
use crate::store::RunDir;
use rilievo_scene::StageId;
use serde_json::{Map, Value, json};

/// Gathers the report from the stages' manifests.
///
/// # Errors
/// When a manifest cannot be read.
pub fn collect(
    run: &RunDir,
    request: &Request,
    outcome: &Outcome,
    plan: Option<&Plan>,
) -> anyhow::Result<Value> {
    let mut stages = Map::new();
    let mut warnings = Vec::new();
    for stage in StageId::ALL {
        let Some(manifest) = run.manifest(stage)? else {
            continue;
        };
        for message in &manifest.warnings {
            warnings.push(json!({"stage": stage, "message": message}));
        }
        let state = plan.map(|plan| plan.state(run, stage)).transpose()?;
        stages.insert(
            stage.name().to_owned(),
            json!({
                "state": state,
                "seconds": manifest.seconds,
                "fingerprint": manifest.fingerprint,
                "program": manifest.program,
                "seed": manifest.seed,
                "options": manifest.ingredients.options,
                "inputs": manifest.ingredients.inputs,
                "files": manifest.files,
                "report": manifest.report,
            }),
        );
    }
    Ok(json!({
        "program": concat!("rilievo ", env!("CARGO_PKG_VERSION")),
        "outcome": outcome,
        "request": request,
        "stages": stages,
        "warnings": warnings,
        "threads": rayon::current_num_threads(),
        "peak_memory_bytes": peak_memory(),
        "citation": "Queau, Melou, Durou, Cremers: Dense Multi-view 3D-reconstruction Without Dense \
                     Correspondences. ICCV 2017",
    }))
}
