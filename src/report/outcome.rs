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
        match error {
            None => Self {
                exit_code: 0,
                error: None,
                problems: Vec::new(),
            },
            Some(error) => Self {
                exit_code: exit::code_of(error),
                error: Some(format!("{error:#}")),
                problems: error
                    .downcast_ref::<Failure>()
                    .map_or(Vec::new(), |failure| failure.problems().to_vec()),
            },
        }
    }
}
