//! `report.json` and `report.html`: what a person, or a program, judges a run by.

mod facts;
mod html;
mod outcome;

pub use html::ViewErrors;
pub use outcome::Outcome;

use crate::pipeline::{Plan, Request};
use crate::store::{RunDir, own_file, seal, unseal, write_atomically};
use facts::Facts;
use maud::Markup;
use serde_json::{Value, json};
use std::path::Path;

/// Puts an evaluation into the report of a run, in the place of an earlier one; tells whether there is
/// a report. Whatever redoes or deletes results drops it again.
///
/// # Errors
/// When the report cannot be read or written.
pub fn add_evaluation(
    root: &Path,
    table: &str,
    views: &[ViewErrors],
    deviations_mm: &[f64],
) -> anyhow::Result<bool> {
    put_evaluation(root, &html::evaluation_section(table, views, deviations_mm))
}

/// Takes an evaluation out of the report of a run, since the results that it judged are gone.
///
/// # Errors
/// When the report cannot be read or written.
pub fn drop_evaluation(root: &Path) -> anyhow::Result<()> {
    put_evaluation(root, &Markup::default()).map(|_| ())
}

fn put_evaluation(root: &Path, section: &Markup) -> anyhow::Result<bool> {
    let path = root.join("report.html");
    let Some(page) = own_file(&path)? else {
        return Ok(false);
    };
    let page = String::from_utf8_lossy(&page);
    let Some(page) = html::with_evaluation(&page, section) else {
        return Ok(false);
    };
    write_atomically(&path, html::sealed(&page).as_bytes())?;
    Ok(true)
}

/// Whether a run has its report, undamaged, and it tells this outcome of this request.
pub fn tells(run: &RunDir, request: &Request, outcome: &Outcome) -> bool {
    let whole = |file: &str| own_file(&run.root().join(file)).ok().flatten();
    let report = whole("report.json").and_then(|text| unseal(&text).ok());
    let same = |key: &str, now: Value| report.as_ref().and_then(|r| r.get(key)) == Some(&now);
    whole("report.html").is_some_and(|page| html::is_whole(&page))
        && same("outcome", json!(outcome))
        && same("request", json!(request))
}

/// Writes both reports of a run; the plan tells which results are stale, where there is one.
///
/// # Errors
/// When artifacts cannot be read, or the reports cannot be written.
pub fn write(
    run: &RunDir,
    request: &Request,
    outcome: &Outcome,
    plan: Option<&Plan>,
) -> anyhow::Result<()> {
    let facts = Facts::gather(run, request, outcome, plan)?;
    let text = seal(&facts)?;
    write_atomically(&run.root().join("report.json"), &text)?;
    let page = html::page(run, &facts)?;
    write_atomically(
        &run.root().join("report.html"),
        html::sealed(&page).as_bytes(),
    )?;
    Ok(())
}
