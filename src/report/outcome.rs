//! How a command ended, for reports.

use crate::exit::{self, Failure, Problem};
use serde::Serialize;

/// How the command ended.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// The exit code.
    pub exit_code: u8,
    /// The error, where there was one.
    pub error: Option<String>,
    /// Files that could not be used.
    pub problems: Vec<Problem>,
}

impl Outcome {
    /// Outcome of a command that failed with `error`, or did not fail.
    pub fn of(error: Option<&anyhow::Error>) -> Self {
        let failure = error.and_then(|error| error.downcast_ref::<Failure>());
        Self {
            exit_code: error.map_or(0, exit::code_of),
            error: error.map(|error| format!("{error:#}")),
            problems: failure.map_or(Vec::new(), |failure| failure.problems().to_vec()),
        }
    }
}
