//! What can be wrong with a run directory.

use std::path::{Path, PathBuf};

/// A run directory that cannot be used, or a file in it that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The folder holds something else.
    #[error(
        "{} is not empty and is not a run directory of rilievo (it has no run.json); \
         choose another folder with -o",
        path.display()
    )]
    NotARun { path: PathBuf },
    /// There is no run directory.
    #[error("{} is not a run directory of rilievo: it has no run.json{}", path.display(), results(*.holds_results))]
    Missing {
        path: PathBuf,
        /// Whether stages of a run lie there.
        holds_results: bool,
    },
    /// Written by a version that this one does not know.
    #[error(
        "{} was written in format {found}, this program reads format {known}; \
         use the program that wrote it, or another folder",
        path.display()
    )]
    OtherVersion {
        path: PathBuf,
        /// Format in the folder.
        found: u64,
        /// Format of this program.
        known: u64,
    },
    /// Another process works there.
    #[error(
        "{} is in use by process {owner}; wait for it, or choose another folder",
        path.display()
    )]
    InUse {
        path: PathBuf,
        /// Process id, as written by the owner.
        owner: String,
    },
    /// A file in it cannot be understood.
    #[error("{} is damaged: {reason}; `rilievo clean` the stage and run it again", path.display())]
    Damaged { path: PathBuf, reason: String },
    /// What was asked for cannot be understood.
    #[error(
        "{} is damaged: {reason}; `rilievo reconstruct` with the options of this run writes it anew \
         and keeps the results",
        path.display()
    )]
    DamagedRequest { path: PathBuf, reason: String },
    /// Something else stands in the place of a file or folder of the run.
    #[error(
        "{} is {found}, not {expected} of this run; nothing in a run directory is followed to \
         another place: remove it, or choose another folder",
        path.display()
    )]
    NotOurs {
        path: PathBuf,
        /// What belongs there ("a file").
        expected: &'static str,
        /// What is there ("a link").
        found: &'static str,
    },
    /// A file cannot be read.
    #[error(transparent)]
    Io(#[from] rilievo_io::IoError),
    /// The disk said no.
    #[error("cannot {action} {}: {reason}", path.display())]
    Files {
        /// What was tried ("write").
        action: &'static str,
        /// On which file.
        path: PathBuf,
        /// The system's reason; part of the message, so no further cause.
        reason: std::io::Error,
    },
}

/// What can be done where results lie without the file that says what they are of.
fn results(there: bool) -> &'static str {
    if there {
        ", but results of one; `rilievo reconstruct` with the options of that run writes it anew and \
         keeps the results"
    } else {
        ""
    }
}

impl StoreError {
    /// Names what stands in the place of a file or folder of the run.
    pub fn not_ours(path: &Path, expected: &'static str, found: &std::fs::Metadata) -> Self {
        let kind = found.file_type();
        Self::NotOurs {
            path: path.to_path_buf(),
            expected,
            found: if kind.is_symlink() {
                "a link"
            } else if kind.is_dir() {
                "a folder"
            } else if kind.is_file() {
                "a file"
            } else {
                "a pipe, socket or device"
            },
        }
    }

    /// Wraps a system error with what was tried.
    pub fn files(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |reason| Self::Files {
            action,
            path,
            reason,
        }
    }
}
