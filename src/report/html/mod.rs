//! `report.html`: one self-contained page that opens from the disk without a network.
//!
//! Overview and verdict first; then every view with observed, re-rendered, normals and depth; then
//! the stages with their tables and the solver's convergence; then settings, versions and hashes.

mod element;
mod evaluation;
mod halves;
mod overview;
mod picture;
mod plot;
mod stages;
mod viewer;
mod views;

pub use evaluation::{ViewErrors, section as evaluation_section};
pub use halves::section as halves_section;

use super::facts::Facts;
use crate::pipeline::load_poses;
use crate::store::{RunDir, hash_bytes};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use rilievo_scene::Finding;

const STYLE: &str = include_str!("page.css");
const PAGE_SCRIPT: &str = include_str!("page.js");
const VIEWER_SCRIPT: &str = include_str!("viewer.js");

/// A section that `rilievo evaluate` puts into a page that stands already, between marks of its
/// own.
#[derive(Clone, Copy, Debug)]
pub enum Addition {
    /// Accuracy against the truth.
    Evaluation,
    /// What two halves of the photos agree on.
    Halves,
}

impl Addition {
    /// Before and behind the section.
    fn marks(self) -> [&'static str; 2] {
        match self {
            Self::Evaluation => ["<!-- evaluation -->", "<!-- end of evaluation -->"],
            Self::Halves => ["<!-- halves -->", "<!-- end of halves -->"],
        }
    }

    /// The marks with nothing between them.
    fn place(self) -> Markup {
        PreEscaped(self.marks().concat())
    }

    /// A page with a section in the place of an earlier one; `None` where the page has no such
    /// place.
    pub fn put(self, page: &str, section: &Markup) -> Option<String> {
        let [begin, end] = self.marks();
        let (before, rest) = page.split_once(begin)?;
        let (_, after) = rest.split_once(end)?;
        Some([before, begin, section.0.as_str(), end, after].concat())
    }
}

/// Before the hash that ends a page.
const SEAL: &str = "<!-- blake3 of the page before this line: ";

/// A page with the hash of its content at its end, in the place of an earlier one.
pub fn sealed(page: &str) -> String {
    let content = page.rsplit_once(SEAL).map_or(page, |(content, _)| content);
    format!("{content}{SEAL}{} -->\n", hash_bytes(content.as_bytes()))
}

/// Whether a page has the content that it was written with.
pub fn is_whole(page: &[u8]) -> bool {
    std::str::from_utf8(page).is_ok_and(|page| sealed(page) == page)
}

/// In place of pictures whose files a stage left and something else damaged.
fn unreadable(error: &anyhow::Error) -> Markup {
    html! {
        section {
            h2 { "Not to be read" }
            p { "Results cannot be shown: " (format!("{error:#}")) ". "
                code { "rilievo status --verify" } " names what is damaged, "
                code { "rilievo reconstruct" } " makes it again." }
        }
    }
}

/// The page.
///
/// # Errors
/// When artifacts of a committed stage cannot be read.
pub fn page(run: &RunDir, facts: &Facts, findings: &[Finding]) -> anyhow::Result<String> {
    let posed = match &facts.stages.poses {
        Some(_) => Some(load_poses(run)?),
        None => None,
    };
    let overview = overview::section(run, facts, findings, posed.as_ref());
    let (viewer, views) = match &posed {
        Some(posed) => (
            viewer::section(run, posed).unwrap_or_else(|error| unreadable(&error)),
            views::section(run, facts, posed).unwrap_or_else(|error| unreadable(&error)),
        ),
        None => Default::default(),
    };
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "rilievo report" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                a.skip href="#main" { "skip to the results" }
                main id="main" {
                    (overview) (viewer) (views)
                    (Addition::Evaluation.place()) (Addition::Halves.place())
                    (stages::sections(facts))
                }
                script { (PreEscaped(PAGE_SCRIPT)) }
                script { (PreEscaped(VIEWER_SCRIPT)) }
            }
        }
    };
    Ok(page.into_string())
}
