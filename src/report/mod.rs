//! `report.json` and `report.html`: what a person, or a program, judges a run by.

mod facts;
mod html;
mod outcome;

pub use html::ViewErrors;
pub use outcome::Outcome;

use crate::pipeline::{Plan, Request};
use crate::store::{RunDir, own_file, seal, unseal, write_atomically};
use facts::Facts;
use html::Addition;
use maud::Markup;
use rilievo_synthetic::compare::HalvesComparison;
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
    let section = html::evaluation_section(table, views, deviations_mm);
    put(root, &[(Addition::Evaluation, section)])
}

/// Puts what two halves of the photos agree on into the report of a run, as [`add_evaluation`].
///
/// # Errors
/// When the report cannot be read or written.
pub fn add_halves(root: &Path, table: &str, found: &HalvesComparison) -> anyhow::Result<bool> {
    put(
        root,
        &[(Addition::Halves, html::halves_section(table, found))],
    )
}

/// Takes evaluations out of the report of a run, since the results that they judged are gone.
///
/// # Errors
/// When the report cannot be read or written.
pub fn drop_evaluation(root: &Path) -> anyhow::Result<()> {
    let nothing = |addition| (addition, Markup::default());
    put(root, &[Addition::Evaluation, Addition::Halves].map(nothing)).map(|_| ())
}

fn put(root: &Path, sections: &[(Addition, Markup)]) -> anyhow::Result<bool> {
    let path = root.join("report.html");
    let Some(page) = own_file(&path)? else {
        return Ok(false);
    };
    let mut page = String::from_utf8_lossy(&page).into_owned();
    for (addition, section) in sections {
        let Some(with_section) = addition.put(&page, section) else {
            return Ok(false);
        };
        page = with_section;
    }
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
