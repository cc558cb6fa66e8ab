//! `report.json` and `report.html`: what a person, or a program, judges a run by.

mod facts;
mod html;
mod outcome;
mod verdict;

pub use html::ViewErrors;
pub use outcome::Outcome;
pub use verdict::Judgement;

use crate::pipeline::{Plan, Request};
use crate::store::{RunDir, own_file, seal, unseal, write_atomically};
use facts::Facts;
use html::Addition;
use maud::Markup;
use rilievo_scene::Finding;
use rilievo_synthetic::compare::HalvesComparison;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::Path;

/// Puts an evaluation into the report of a run, in the place of an earlier one; returns whether
/// there is a report. Whatever redoes or deletes results drops it again.
///
/// # Errors
/// When the report cannot be read or written.
pub fn add_evaluation(
    root: &Path,
    table: &str,
    views: &[ViewErrors],
    deviations: (&[f64], &str),
) -> anyhow::Result<bool> {
    let section = html::evaluation_section(table, views, deviations);
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

/// What is reported of a run: its facts, and the judgement that follows from them.
#[derive(Serialize)]
pub struct Report {
    verdict: Judgement,
    findings: Vec<Finding>,
    #[serde(flatten)]
    facts: Facts,
}

impl Report {
    /// Gathers what is known of a run; the plan knows which results are stale, where there is one.
    ///
    /// # Errors
    /// When artifacts cannot be read.
    pub fn gather(
        run: &RunDir,
        request: &Request,
        outcome: &Outcome,
        plan: Option<&Plan>,
    ) -> anyhow::Result<Self> {
        let facts = Facts::gather(run, request, outcome, plan)?;
        let findings = verdict::findings(&facts);
        Ok(Self {
            verdict: Judgement::of(&findings),
            findings,
            facts,
        })
    }

    /// Size of the result, in a line; `None` without a mesh.
    pub fn size(&self) -> Option<String> {
        self.facts.stages.size()
    }

    /// How far the result can be relied on.
    pub fn into_judgement(self) -> Judgement {
        self.verdict
    }

    /// Whether the run has its report in both forms, undamaged, with this request, outcome and
    /// verdict.
    pub fn is_told_by(&self, run: &RunDir) -> bool {
        let whole = |file: &str| own_file(&run.root().join(file)).ok().flatten();
        let written = whole("report.json").and_then(|text| unseal(&text).ok());
        let same = |key: &str, now: Value| written.as_ref().and_then(|r| r.get(key)) == Some(&now);
        whole("report.html").is_some_and(|page| html::is_whole(&page))
            && same("outcome", json!(self.facts.outcome))
            && same("request", json!(self.facts.request))
            && same("verdict", json!(self.verdict))
    }

    /// Writes both forms.
    ///
    /// # Errors
    /// When artifacts cannot be read, or the reports cannot be written.
    pub fn write(&self, run: &RunDir) -> anyhow::Result<()> {
        let text = seal(self)?;
        write_atomically(&run.root().join("report.json"), &text)?;
        let page = html::page(run, &self.facts, &self.findings)?;
        write_atomically(
            &run.root().join("report.html"),
            html::sealed(&page).as_bytes(),
        )?;
        Ok(())
    }
}
