//! `report.html`: one self-contained page.

use crate::store::RunDir;
use serde_json::Value;

/// The page.
///
/// # Errors
/// When artifacts cannot be read.
pub fn page(_run: &RunDir, report: &Value) -> anyhow::Result<String> {
    Ok(format!("<!doctype html><pre>{report:#}</pre>"))
}
