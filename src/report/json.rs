//! `report.json`: outcome, stages with their facts and warnings, and where the results lie.

use super::Outcome;
use crate::pipeline::{Plan, Request};
use crate::store::{Look, Manifest, RunDir};
use crate::system;
use rilievo_scene::StageId;
use serde_json::{Map, Value, json};

/// Gathers the report from the stages' manifests.
///
/// # Errors
/// When a stage's files cannot be looked at. A stage whose manifest is damaged is left out.
pub fn collect(
    run: &RunDir,
    request: &Request,
    outcome: &Outcome,
    plan: Option<&Plan>,
) -> anyhow::Result<Value> {
    let mut stages = Map::new();
    let mut warnings = Vec::new();
    let mut last: Option<Manifest> = None;
    let mut peak_memory_bytes = None;
    for stage in StageId::ALL {
        let Ok(Some(manifest)) = run.manifest(stage) else {
            continue;
        };
        for message in &manifest.warnings {
            warnings.push(json!({"stage": stage, "message": message}));
        }
        let state = plan.map(|plan| plan.state(run, stage, Look::Sizes));
        let state = state.transpose()?;
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
                "peak_memory_bytes": manifest.peak_memory_bytes,
            }),
        );
        peak_memory_bytes = manifest.peak_memory_bytes.max(peak_memory_bytes);
        last = Some(manifest);
    }
    Ok(json!({
        "program": system::PROGRAM,
        "outcome": outcome,
        "request": request,
        "stages": stages,
        "warnings": warnings,
        "threads": last.map(|manifest| manifest.threads),
        "peak_memory_bytes": peak_memory_bytes,
        "citation": "Queau, Melou, Durou, Cremers: Dense Multi-view 3D-reconstruction Without Dense \
                     Correspondences. ICCV 2017",
    }))
}
