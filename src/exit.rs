//! How a command can fail, and its exit codes.
//!
//! | code | meaning |
//! |---|---|
//! | 0 | done |
//! | 1 | an unexpected error |
//! | 2 | wrong usage |
//! | 3 | input that cannot be used |
//! | 4 | the data do not allow a result |
//! | 5 | run directory in use, damaged, or of another version |
//! | 6 | reading or writing failed |
//! | 130 | interrupted, resumable |

use crate::paths;
use crate::store::StoreError;
use rilievo_io::{IoError, IoErrorKind};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One file that cannot be used, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// The file.
    #[serde(serialize_with = "paths::shown")]
    pub file: PathBuf,
    /// What is wrong with it, and what to try.
    pub reason: String,
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.file.display(), self.reason)
    }
}

/// A failure that has an exit code of its own; every other error is unexpected (1).
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The command line or the configuration asks for something that does not exist.
    #[error("{0}")]
    Usage(String),
    /// Files that cannot be used.
    #[error("input that cannot be used:{}", list(.0))]
    Input(Vec<Problem>),
    /// The data do not allow a result.
    #[error("{0}")]
    NoResult(String),
    /// The run directory cannot be worked in.
    #[error("{0}")]
    RunDirectory(String),
    /// Reading or writing failed.
    #[error("{0}")]
    ReadOrWrite(String),
    /// Ctrl-C or a termination signal.
    #[error("interrupted; the same command goes on from here")]
    Interrupted,
}

fn list(problems: &[Problem]) -> String {
    problems
        .iter()
        .map(|problem| format!("\n  {problem}"))
        .collect()
}

impl Failure {
    /// A single unusable file.
    pub fn input(file: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self::Input(vec![Problem {
            file: file.into(),
            reason: reason.into(),
        }])
    }

    /// The exit code.
    pub fn code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            Self::Input(_) => 3,
            Self::NoResult(_) => 4,
            Self::RunDirectory(_) => 5,
            Self::ReadOrWrite(_) => 6,
            Self::Interrupted => 130,
        }
    }

    /// The unusable files, when there are any.
    pub fn problems(&self) -> &[Problem] {
        match self {
            Self::Input(problems) => problems,
            _ => &[],
        }
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Files { .. } | StoreError::Io(_) => Self::ReadOrWrite(error.to_string()),
            _ => Self::RunDirectory(error.to_string()),
        }
    }
}

impl From<IoError> for Problem {
    fn from(error: IoError) -> Self {
        let reason = match error.hint {
            Some(hint) => format!("{} ({hint})", error.reason),
            None => error.reason,
        };
        Self {
            file: error.path,
            reason,
        }
    }
}

impl From<IoError> for Failure {
    fn from(error: IoError) -> Self {
        match error.kind {
            IoErrorKind::Input => Self::Input(vec![error.into()]),
            IoErrorKind::Read | IoErrorKind::Write => Self::ReadOrWrite(error.to_string()),
        }
    }
}

/// Exit code of any error: a [`Failure`] or [`StoreError`] anywhere in the chain decides.
pub fn code_of(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if let Some(failure) = cause.downcast_ref::<Failure>() {
            return failure.code();
        }
        if let Some(error) = cause.downcast_ref::<StoreError>() {
            let is_disk = matches!(error, StoreError::Files { .. } | StoreError::Io(_));
            return if is_disk { 6 } else { 5 };
        }
        if cause.is::<std::io::Error>() {
            return 6;
        }
    }
    1
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn the_code_survives_added_context() {
        let error = Err::<(), _>(Failure::input("a.jpg", "is empty"))
            .context("reading photos")
            .unwrap_err();
        assert_eq!(code_of(&error), 3);
        let disk = Err::<(), _>(std::io::Error::other("disk full"))
            .context("writing")
            .unwrap_err();
        assert_eq!(code_of(&disk), 6);
        assert_eq!(code_of(&anyhow::anyhow!("surprise")), 1);
    }
}
